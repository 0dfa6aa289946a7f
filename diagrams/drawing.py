"""Drawings of machines in Meshcat, and pictures by Drake's renderer without a browser."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    RenderCameraCore,
    RenderEngineVtkParams,
    Role,
    SceneGraph,
)
from pydrake.lcm import DrakeLcm
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, System
from pydrake.systems.rendering import MultibodyPositionToGeometryPose
from pydrake.systems.sensors import CameraInfo

from parapod.diagrams.wiring import add, connect

# Bus without sockets, for what Drake's drawings would tell other programs.
NO_LCM = DrakeLcm("memq://")


def publish(
    builder: DiagramBuilder, scene_graph: SceneGraph, meshcat: Meshcat | None, prefix: str
) -> None:
    """Publishes what a scene graph holds, thirty times a second.

    Args:
        builder: builder of the diagram that holds `scene_graph`.
        scene_graph: scene that is drawn.
        meshcat: scene; None: nothing is published, for callers that only read the poses.
        prefix: prefix of the path there.
    """
    if meshcat is None:
        return
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
        builder: builder of the diagram that holds `scene_graph`.
        plant: finalized, registered with `scene_graph`, and no part of the diagram.
        positions: positions of its joints.
        scene_graph: scene that is drawn.
    """
    to_geometry = add(builder, MultibodyPositionToGeometryPose(plant))
    connect(builder, positions, to_geometry.get_input_port())
    source_id = plant.get_source_id()
    assert source_id is not None
    connect(builder, to_geometry.get_output_port(), scene_graph.get_source_pose_port(source_id))


def draw_model(
    builder: DiagramBuilder,
    path: str,
    add_model: Callable[[MultibodyPlant], System],
    signals: Mapping[str, OutputPort],
) -> tuple[SceneGraph, OutputPort]:
    """Adds a scene graph with a model that is only drawn, posed by signals.

    Args:
        builder: builder of the diagram that holds the signals' systems.
        path: path of the drawing in the scene.
        add_model: adds the model to a plant and finalizes it; returns a system that makes the
            positions of its joints.
        signals: signals that this system takes, by the names of its ports.

    Returns:
        The scene graph, which is left to publish, and the positions of the joints.
    """
    plant = MultibodyPlant(time_step=1.0)
    scene_graph = add(builder, SceneGraph(), f"drawing_of_{path}")
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    positions = add(builder, add_model(plant), f"positions_of_{path}")
    for name, port in signals.items():
        connect(builder, port, positions.GetInputPort(name))
    draw(builder, plant, positions.get_output_port(), scene_graph)
    return scene_graph, positions.get_output_port()


_KEEPS_VISUALS = ContextVar("keeps_visuals", default=False)


@contextmanager
def visuals_kept() -> Iterator[None]:
    """Has diagrams that are built meanwhile keep what `remove_visuals` would remove."""
    token = _KEEPS_VISUALS.set(True)
    try:
        yield
    finally:
        _KEEPS_VISUALS.reset(token)


def remove_visuals(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Removes what is there to be seen only, so that a step does not compute its pose.

    While `visuals_kept` it stays.
    """
    if _KEEPS_VISUALS.get():
        return
    inspector = scene_graph.model_inspector()
    touched = set(inspector.GetAllGeometryIds(Role.kProximity))
    source_id = plant.get_source_id()
    assert source_id is not None
    for geometry in set(inspector.GetAllGeometryIds()) - touched:
        scene_graph.RemoveGeometry(source_id, geometry)


_RENDERER = "photograph"


@dataclass(frozen=True)
class View:
    """From where a picture is taken.

    Attributes:
        camera: place of the camera (3) [m].
        target: point in the middle of the picture (3) [m].
        angle: angle of view, from the lower to the upper edge [rad].
        size: width and height [pixel].
        up: direction that is up in the picture (3).
        depth: largest distance from the target of what is in the picture [m].
    """

    camera: tuple[float, float, float]
    target: tuple[float, float, float]
    angle: float = 0.6
    size: tuple[int, int] = (1200, 900)
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    depth: float = 4.0

    @property
    def X_WC(self) -> RigidTransform:
        """The camera's pose: z into the picture, x to the right, y down."""
        ahead = np.subtract(self.target, self.camera)
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, self.up)
        right /= np.linalg.norm(right)
        axes = np.column_stack([right, np.cross(ahead, right), ahead])
        return RigidTransform(RotationMatrix(axes), np.array(self.camera))


def add_renderer(
    scene_graph: SceneGraph, background: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> None:
    """Lets pictures be taken of a scene graph; to be called before the model is added.

    Args:
        scene_graph: without geometry.
        background: its red, green and blue (3) [0..1].

    Raises:
        RuntimeError: there is no OpenGL that Drake's renderer could use.
    """
    scene_graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(_engine(background)))


def take(
    scene_graph: SceneGraph, root_context: Context, views: Sequence[View]
) -> list[NDArray[np.uint8]]:
    """Pictures (height, width, 3) of what a scene graph holds.

    Args:
        scene_graph: scene graph with a renderer, part of a diagram.
        root_context: root context of the diagram.
        views: from where; one picture each.
    """
    port = scene_graph.get_query_output_port()
    scene: Any = port.Eval(scene_graph.GetMyContextFromRoot(root_context))
    world = scene_graph.world_frame_id()
    return [
        scene.RenderColorImage(_camera(view), world, view.X_WC).data[:, :, :3].copy()
        for view in views
    ]


def photograph[M](
    views: Sequence[View],
    add_model: Callable[[MultibodyPlant, DiagramBuilder, SceneGraph], M],
    put: Callable[[M, Context], None],
) -> list[NDArray[np.uint8]]:
    """Pictures (height, width, 3) of a machine at rest.

    Args:
        views: from where; one picture each.
        add_model: adds the machine to a plant, and finalizes that.
        put: puts the machine into a posture, by the plant's context.

    Raises:
        RuntimeError: there is no OpenGL that Drake's renderer could use.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1.0)
    add_renderer(scene_graph)
    model = add_model(plant, builder, scene_graph)
    root_context = builder.Build().CreateDefaultContext()
    put(model, plant.GetMyMutableContextFromRoot(root_context))
    return take(scene_graph, root_context, views)


def _engine(background: tuple[float, float, float]) -> RenderEngineVtkParams:
    # Over the photographer's left shoulder, from above, and a little from below.
    lights = [
        LightParameter(type="directional", frame=frame, direction=direction, intensity=intensity)
        for frame, direction, intensity in (
            ("camera", [0.45, 0.55, 1.0], 1.0),
            ("camera", [-0.8, 0.2, 0.6], 0.35),
            ("world", [0.0, 0.0, -1.0], 0.35),
            ("world", [0.0, 0.0, 1.0], 0.2),
        )
    ]
    return RenderEngineVtkParams(
        default_clear_color=np.array(background), lights=lights, backend="EGL"
    )


def _camera(view: View) -> ColorRenderCamera:
    width, height = view.size
    distance = float(np.linalg.norm(np.subtract(view.target, view.camera)))
    core = RenderCameraCore(
        _RENDERER,
        CameraInfo(width=width, height=height, fov_y=view.angle),
        ClippingRange(max(0.05, distance - view.depth), distance + view.depth),
        RigidTransform(),
    )
    return ColorRenderCamera(core, show_window=False)
