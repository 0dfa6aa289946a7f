"""Draws the levelling platform in Meshcat."""

from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort

from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.visualization import draw, publish
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.model import ParallelLinks, PlatformModel, PlatformPose


def add_visualization(
    builder: DiagramBuilder,
    model: PlatformModel,
    positions: OutputPort,
    scene_graph: SceneGraph,
    meshcat: Meshcat,
) -> None:
    """Adds the links that the plant leaves out, and publishes the whole to Meshcat.

    Args:
        builder: of the diagram that holds `scene_graph`.
        model: the platform.
        positions: of the model's joints (or its whole state).
        scene_graph: what is drawn.
        meshcat: where.
    """
    links = add(builder, ParallelLinks(model, scene_graph, positions.size()))
    connect(builder, positions, links.get_input_port())
    connect(builder, links.get_output_port(), scene_graph.get_source_pose_port(links.source_id))
    publish(builder, scene_graph, meshcat, "platform")


def add_drawing(
    builder: DiagramBuilder,
    ground: tuple[float, float],
    meshcat: Meshcat,
    extension: OutputPort,
    base_pose: OutputPort,
    arm_position: OutputPort,
) -> None:
    """Adds a drawing of the full model for a plant that is simulated with fewer joints or none.

    Args:
        builder: of the diagram that holds the plant.
        ground: roll and pitch that the drawn slab keeps [rad].
        meshcat: where to draw.
        extension: extensions (4) [m].
        base_pose: quaternion and position (7) of the platform.
        arm_position: turntable and arm angle (2) [rad].
    """
    plant = MultibodyPlant(time_step=1.0)
    scene_graph = add(builder, SceneGraph(), "drawing")
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = add_platform(plant, "full", ground=ground)
    pose = add(builder, PlatformPose(model))
    connect(builder, extension, pose.GetInputPort("extension"))
    connect(builder, base_pose, pose.GetInputPort("base_pose"))
    connect(builder, arm_position, pose.GetInputPort("arm_position"))
    draw(builder, plant, pose.get_output_port(), scene_graph)
    add_visualization(builder, model, pose.get_output_port(), scene_graph, meshcat)
