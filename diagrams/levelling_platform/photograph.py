"""Pictures of the levelling platform, taken by Drake's renderer without a browser."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    LightParameter,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo

from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.parallel_links import ParallelLinks
from parapod.systems.levelling_platform.platform_model import MODEL_GEOMETRY, standing_pose

_RENDERER = "photograph"
_SCENE = 4.0  # nothing is further from what a picture is taken of [m]


@dataclass(frozen=True)
class View:
    """From where a picture is taken.

    Attributes:
        camera: where the camera is (3) [m].
        target: what is in the middle of the picture (3) [m].
        angle: of view, from the lower to the upper edge [rad].
        size: width and height [pixel].
        up: what is up in the picture (3).
    """

    camera: tuple[float, float, float]
    target: tuple[float, float, float]
    angle: float = 0.6
    size: tuple[int, int] = (1200, 900)
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def X_WC(self) -> RigidTransform:
        """The camera's pose: z into the picture, x to the right, y down."""
        ahead = np.subtract(self.target, self.camera)
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, self.up)
        right /= np.linalg.norm(right)
        axes = np.column_stack([right, np.cross(ahead, right), ahead])
        return RigidTransform(RotationMatrix(axes), np.array(self.camera))


def photograph(
    views: Sequence[View],
    posture: ArrayLike,
    ground: tuple[float, float] = (0.0, 0.0),
    arm: tuple[float, float] = (0.0, 0.0),
) -> list[NDArray[np.uint8]]:
    """Pictures (height, width, 3) of the platform in a posture on plane ground.

    Args:
        views: from where; one picture each.
        posture: (3) roll, pitch, height [rad, rad, m].
        ground: roll and pitch [rad].
        arm: turntable and arm angle [rad].

    Raises:
        UnreachablePosture: the legs do not reach it.
        RuntimeError: there is no OpenGL that Drake's renderer could use.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1.0)
    scene_graph.AddRenderer(_RENDERER, MakeRenderEngineVtk(_engine()))
    model = add_platform(plant, "full", ground=ground)
    state = plant.get_state_output_port()
    links = add(builder, ParallelLinks(model, scene_graph, state.size()))
    connect(builder, state, links.get_input_port())
    connect(builder, links.get_output_port(), scene_graph.get_source_pose_port(links.source_id))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    extension = inverse_kinematics(MODEL_GEOMETRY, posture, ground)
    positions = model.positions_at(extension, standing_pose(posture, ground), arm)
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), positions)
    port = scene_graph.get_query_output_port()
    scene: Any = port.Eval(scene_graph.GetMyContextFromRoot(context))
    world = scene_graph.world_frame_id()
    return [
        scene.RenderColorImage(_camera(view), world, view.X_WC).data[:, :, :3].copy()
        for view in views
    ]


def _engine() -> RenderEngineVtkParams:
    lights = [
        LightParameter(type="directional", frame="world", direction=direction, intensity=intensity)
        for direction, intensity in (
            ([0.35, 0.55, -1.0], 0.9),
            ([-0.5, 0.8, -0.25], 0.55),
            ([0.0, 0.0, -1.0], 0.15),
            ([0.0, 0.0, 1.0], 0.2),
        )
    ]
    return RenderEngineVtkParams(
        default_clear_color=np.array([1.0, 1.0, 1.0]), lights=lights, backend="EGL"
    )


def _camera(view: View) -> ColorRenderCamera:
    width, height = view.size
    distance = float(np.linalg.norm(np.subtract(view.target, view.camera)))
    core = RenderCameraCore(
        _RENDERER,
        CameraInfo(width=width, height=height, fov_y=view.angle),
        ClippingRange(max(0.05, distance - _SCENE), distance + _SCENE),
        RigidTransform(),
    )
    return ColorRenderCamera(core, show_window=False)
