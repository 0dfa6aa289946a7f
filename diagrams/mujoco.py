"""Plants of rigid bodies that MuJoCo simulates, as all machines have them."""

from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.wiring import add, connect
from parapod.systems.physics.mujoco.plant import MujocoPlant


def make_plant(
    builder: DiagramBuilder, time_step: float, meshcat: Meshcat | None
) -> tuple[MultibodyPlant, SceneGraph]:
    """A plant to be filled, finalized and translated; and its scene graph.

    Neither simulates anything; the scene graph draws.

    Args:
        builder: builder of the diagram, which gets the scene graph if there is something to draw.
        time_step: step of the plant [s].
        meshcat: scene in which it is drawn; None for no drawing.
    """
    plant = MultibodyPlant(time_step)
    scene_graph = SceneGraph()
    if meshcat is not None:
        add(builder, scene_graph, "drawing")
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    return plant, scene_graph


def draw(builder: DiagramBuilder, bodies: MujocoPlant, scene_graph: SceneGraph) -> None:
    """Poses the geometry of the bodies where MuJoCo has them.

    Args:
        builder: builder of the diagram that holds both.
        bodies: the bodies.
        scene_graph: scene with which their plant is registered.
    """
    source_id = bodies.model.plant.get_source_id()
    assert source_id is not None
    sink = scene_graph.get_source_pose_port(source_id)
    connect(builder, bodies.GetOutputPort("geometry_pose"), sink)
