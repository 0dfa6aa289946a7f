"""The workspace above the machine in Meshcat: a picture that can be turned."""

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from rich.console import Console

from parapod.diagrams.levelling_platform.visualization import add_drawing
from parapod.diagrams.wiring import add
from parapod.sims.simulate import make_viewer
from parapod.sims.workspace_figures import face_colour, face_name
from parapod.sims.workspace_scenario import WorkspaceScenario
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY, standing_pose
from parapod.systems.levelling_platform.turntable import swept_surface
from parapod.systems.levelling_platform.workspace import SUPPORT_LEG, Workspace, faces

_LEVEL = (0.0, 0.0)
_EDGE = 25
_AROUND, _ACROSS = 73, 145
_STOP = "Stop"
_LOOK_PERIOD = 0.1  # [s]
# Axes of frame {B}: colours, lengths [0.1 m], half a tick's length [m].
_AXES = {"x": Rgba(0.80, 0.15, 0.10), "y": Rgba(0.10, 0.55, 0.15), "z": Rgba(0.10, 0.25, 0.80)}
_LENGTHS = (15, 12, 28)
_TICK = 0.02
_ABOVE_SLAB = (0.0, 0.0, 0.005)  # [m]
# Strokes from point to point in a square of +-1.
_LETTERS = {
    "x": [((-1, -1), (1, 1)), ((-1, 1), (1, -1))],
    "y": [((-1, 1), (0, 0)), ((1, 1), (0, 0)), ((0, 0), (0, -1))],
    "z": [((-1, 1), (1, 1)), ((1, 1), (-1, -1)), ((-1, -1), (1, -1))],
}


def draw(scenario: WorkspaceScenario) -> Meshcat:
    """The workspace above the machine, which stands level in the middle of its stroke.

    With the turntable the ring that the leaning arm sweeps is drawn too, translucent.
    """
    arm = scenario.arm.upright
    meshcat = make_viewer(camera=(2.9, -5.2, 3.3), target=(0.0, 0.0, 1.42))
    turned = scenario.arm.lean if scenario.turntable else 0.0
    p_WB = _draw_machine(meshcat, turned)
    if scenario.turntable:
        arm = replace(arm, lean=turned)
        ring = swept_surface(PlatformGeometry(), arm, _AROUND, _ACROSS)
        _draw_patch(meshcat, "/workspace/turntable", ring + p_WB, Rgba(0.95, 0.60, 0.30, 0.45))
    workspace = Workspace(PlatformGeometry(), arm)
    for key, extension in faces(workspace.geometry, _EDGE).items():
        points = workspace.tip_of_extensions(extension) + p_WB
        path = f"/workspace/{face_name(*key)}"
        _draw_patch(meshcat, path, points, Rgba(*face_colour(*key), 1.0))
        outline = np.concatenate([points[0], points[:, -1], points[::-1, 0]])
        meshcat.SetLine(f"{path}/edges", outline.T, 2.0, Rgba(0.1, 0.1, 0.1))
    _draw_axes(meshcat, np.add(p_WB, _ABOVE_SLAB))
    return meshcat


def wait(meshcat: Meshcat, console: Console) -> None:
    """Keeps the picture until the viewer says that it is enough, or Ctrl-C."""
    console.print(
        f"'{_STOP}' in the browser or Ctrl-C ends.", markup=False, highlight=False, soft_wrap=True
    )
    meshcat.AddButton(_STOP)
    try:
        while meshcat.GetButtonClicks(_STOP) == 0:
            time.sleep(_LOOK_PERIOD)
    except KeyboardInterrupt:
        pass
    finally:
        meshcat.DeleteButton(_STOP)


def _draw_machine(meshcat: Meshcat, lean: float) -> NDArray[np.float64]:
    """Draws the machine about the world's origin; returns where its foot 2 stands (3) [m]."""
    middle = 0.5 * (MODEL_GEOMETRY.extension_min + MODEL_GEOMETRY.extension_max)
    extension = np.full(LEG_COUNT, middle)
    posture = forward_kinematics(MODEL_GEOMETRY, extension, _LEVEL)
    builder = DiagramBuilder()
    ports = [
        add(builder, ConstantVectorSource(np.asarray(value, dtype=float)), name).get_output_port()
        for name, value in (
            ("extension", extension),
            ("base_pose", standing_pose(posture, _LEVEL)),
            ("arm_position", (0.0, lean)),
        )
    ]
    add_drawing(builder, _LEVEL, meshcat, *ports)
    diagram = builder.Build()
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    x, y, _ = foot_to_centre(MODEL_GEOMETRY.legs[SUPPORT_LEG], middle)
    return np.array([-x, -y, 0.0])


def _draw_patch(meshcat: Meshcat, path: str, points: NDArray[np.float64], colour: Rgba) -> None:
    """Draws a grid of points (n, m, 3) as a surface."""
    rows, columns = points.shape[:2]
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    halves = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    triangles = np.concatenate([half.reshape(-1, 3) for half in halves])
    meshcat.SetTriangleMesh(path, points.reshape(-1, 3).T, triangles.T, colour)


def _draw_axes(meshcat: Meshcat, p_WB: NDArray[np.float64]) -> None:
    """Draws frame {B} with a stroke every tenth of a metre, and a letter at each axis's end."""
    for i, (name, colour) in enumerate(_AXES.items()):
        direction = np.eye(3)[i]
        ticks = p_WB + 0.1 * np.arange(_LENGTHS[i] + 1)[:, np.newaxis] * direction
        across = _TICK * np.eye(3)[1 if name == "x" else 0]
        meshcat.SetLine(f"/axes/{name}", ticks.T, 3.0, colour)
        path = f"/axes/{name}/every 0.1 m"
        meshcat.SetLineSegments(path, (ticks - across).T, (ticks + across).T, 1.0, colour)
        # Letters stand upright in the plane of x and z, which the camera looks at.
        strokes = np.array(_LETTERS[name], dtype=float)[..., [0, 0, 1]] * (1.0, 0.0, 1.0)
        starts, ends = (
            ticks[-1]
            + 0.1 * direction
            + (0.0, 0.0, 0.05)
            + 1.6 * _TICK * np.moveaxis(strokes, 1, 0)
        )
        meshcat.SetLineSegments(f"/axes/{name}/letter", starts.T, ends.T, 3.0, colour)
