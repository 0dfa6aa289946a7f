"""Draws the levelling platform in Meshcat."""

from pydrake.geometry import Meshcat, MeshcatVisualizer, MeshcatVisualizerParams, SceneGraph
from pydrake.systems.framework import DiagramBuilder, OutputPort

from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.parallel_links import ParallelLinks
from parapod.systems.levelling_platform.platform_model import PlatformModel


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
    # Not `ApplyVisualizationConfig`, which wants the plant to be part of the diagram.
    params = MeshcatVisualizerParams(
        publish_period=1.0 / 30.0, prefix="platform", delete_on_initialization_event=False
    )
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
