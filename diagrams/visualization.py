"""Drawing machines in Meshcat."""

from pydrake.geometry import (
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Role,
    SceneGraph,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from parapod.diagrams.wiring import add, connect


def publish(
    builder: DiagramBuilder, scene_graph: SceneGraph, meshcat: Meshcat, prefix: str
) -> None:
    """Publishes what a scene graph holds, thirty times a second.

    Args:
        builder: of the diagram that holds `scene_graph`.
        scene_graph: what is drawn.
        meshcat: where.
        prefix: of the path there.
    """
    # Not `ApplyVisualizationConfig`, which wants the plant to be part of the diagram.
    params = MeshcatVisualizerParams(
        publish_period=1.0 / 30.0, prefix=prefix, delete_on_initialization_event=False
    )
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)


def draw(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    positions: OutputPort,
    scene_graph: SceneGraph,
) -> None:
    """Poses the geometry of a plant that is only drawn.

    Args:
        builder: of the diagram that holds `scene_graph`.
        plant: finalized, registered with `scene_graph`, and no part of the diagram.
        positions: of its joints.
        scene_graph: what is drawn.
    """
    to_geometry = add(builder, MultibodyPositionToGeometryPose(plant))
    connect(builder, positions, to_geometry.get_input_port())
    source_id = plant.get_source_id()
    assert source_id is not None
    connect(builder, to_geometry.get_output_port(), scene_graph.get_source_pose_port(source_id))


def remove_visuals(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Removes what is there to be seen only, so that a step does not compute its pose."""
    inspector = scene_graph.model_inspector()
    touched = set(inspector.GetAllGeometryIds(Role.kProximity))
    source_id = plant.get_source_id()
    assert source_id is not None
    for geometry in set(inspector.GetAllGeometryIds()) - touched:
        scene_graph.RemoveGeometry(source_id, geometry)
