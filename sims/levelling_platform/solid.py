"""The workspace above the machine in Meshcat: a picture that can be turned."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, Rgba
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from rich.console import Console

from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.model import add_drawing
from parapod.diagrams.style import COLOURS
from parapod.diagrams.wiring import add
from parapod.sims.lab.panel import Panel, Readout, Row
from parapod.sims.lab.runner import END, LOOK_PERIOD, make_viewer, say_where
from parapod.sims.output.figures import Figure
from parapod.sims.output.options import RunOptions
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.model import standing_pose
from parapod.systems.levelling_platform.turntable import stroke_left_turning, swept_surface
from parapod.systems.levelling_platform.workspace import (
    SUPPORT_LEG,
    SURFACE_COUNT,
    ArmGeometry,
    Workspace,
    boundary,
    faces,
    surface_margins,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


_EDGE = 25
_PIXELS = 241
_RIM = 0.04  # around a section, by the workspace's width [-]
_FILL, _SWEPT = "#9FB8CE", "#F6D3B8"
_COARSE_EDGE, _TURNS = 5, 240


def face_colour(leg: int, is_long: bool) -> tuple[float, float, float]:
    """Colour of a face: the leg's, paler where it is at the long end of its stroke."""
    from matplotlib.colors import to_rgb

    red, green, blue = (0.45 + 0.55 * c if is_long else c for c in to_rgb(COLOURS[leg]))
    return red, green, blue


def face_name(geometry: PlatformGeometry, leg: int, is_long: bool) -> str:
    """Name of a face: which leg is at which end of its stroke."""
    end = geometry.extension_max if is_long else geometry.extension_min
    return f"leg {leg + 1} at {1e3 * end:.0f} mm"


def figures(
    geometry: PlatformGeometry, arm: ArmGeometry, turn: float | None, has_surfaces: bool
) -> tuple[Figure, ...]:
    """Figures of the workspace.

    Args:
        geometry: the platform.
        arm: the arm, upright.
        turn: lean of the arm that the turntable turns [rad]; None: it does not turn.
        has_surfaces: true if the paper prints surfaces of it.
    """
    surfaces = "Filled: exact"
    if has_surfaces:
        surfaces += "; lines: traces of the eight printed surfaces; black: inside all eight"
    solid = Figure(
        "workspace",
        "Workspace of the arm's tip",
        "On each of its faces one leg is at one end of its stroke (Fig. 12b). Heights are drawn "
        "larger than lengths.",
        partial(_draw_solid, geometry, arm),
        (7.0, 5.2),
    )
    sections = Figure(
        "workspace_sections",
        "Sections of the workspace",
        f"{surfaces}.",
        partial(_draw_sections, geometry, arm, has_surfaces),
        (10.0, 3.9),
    )
    if turn is None:
        return solid, sections
    ring = Figure(
        "workspace_turntable",
        "Workspace with the turntable",
        f"Arm leaning by {math.degrees(turn):g} deg: without the turntable (blue) and with "
        "it (orange), from above and in the section through the turntable's axis.",
        partial(_draw_ring, geometry, arm, turn),
        (9.0, 4.2),
    )
    return solid, sections, ring


def _draw_solid(geometry: PlatformGeometry, arm: ArmGeometry, canvas: "Canvas") -> None:
    from matplotlib.patches import Patch

    axes: Any = canvas.add_subplot(projection="3d", computed_zorder=True)
    for key, extension in faces(geometry, _EDGE).items():
        x, y, z = np.moveaxis(Workspace(geometry, arm).tip_of_extensions(extension), -1, 0)
        axes.plot_surface(
            x, y, z, color=face_colour(*key), rcount=_EDGE, ccount=_EDGE, linewidth=0.0,
            antialiased=False,
        )  # fmt: skip
        for line in ((x[:, 0], y[:, 0], z[:, 0]), (x[:, -1], y[:, -1], z[:, -1])):
            axes.plot(*line, color="black", linewidth=0.8)
    _label(axes, 0, 1)
    axes.set_zlabel("z [m]")
    axes.set_box_aspect((1.0, 1.3, 0.65), zoom=0.95)
    axes.locator_params(nbins=5)
    axes.view_init(elev=16.0, azim=-62.0)
    keys = faces(geometry, 2)
    canvas.legend(
        handles=[Patch(color=face_colour(*key), label=face_name(geometry, *key)) for key in keys],
        loc="outside right center",
    )


def _draw_sections(
    geometry: PlatformGeometry, arm: ArmGeometry, has_surfaces: bool, canvas: "Canvas"
) -> None:
    low, high = _box(geometry, arm)
    planes: Any = canvas.subplots(1, 3)
    for axes, normal in zip(planes, (1, 0, 2), strict=True):
        middle = 0.5 * (low[normal] + high[normal])
        across, up = (i for i in range(3) if i != normal)
        u, v, point = _plane(low, high, normal, middle)
        stroke_left = _stroke_left(geometry, arm, point)
        axes.contourf(u, v, stroke_left, [0.0, 1.0], colors=[_FILL])
        axes.contour(u, v, stroke_left, [0.0], colors=["#5B7083"], linewidths=1.0)
        if has_surfaces:
            _draw_surfaces(axes, u, v, point)
        axes.set_title(f"{'xyz'[normal]} = {middle:.3f} m")
        _label(axes, across, up)
    if has_surfaces:
        _legend_surfaces(canvas)


def _draw_surfaces(
    axes: Any, u: NDArray[np.float64], v: NDArray[np.float64], point: NDArray[np.float64]
) -> None:
    """Draws the traces of the printed surfaces in a plane."""
    margins = surface_margins(point)
    for i in range(SURFACE_COUNT):
        colour, dashes = _surface_style(i)
        axes.contour(u, v, margins[..., i], [0.0], colors=[colour], linestyles=[dashes])
    axes.contour(u, v, margins.min(axis=-1), [0.0], colors=["black"], linewidths=1.3)


def _legend_surfaces(canvas: "Canvas") -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Patch(color=_FILL, label="exact workspace")]
    handles.append(Line2D([], [], color="black", label="inside all eight"))
    for i in range(SURFACE_COUNT):
        colour, dashes = _surface_style(i)
        handles.append(Line2D([], [], color=colour, linestyle=dashes, label=f"surface {i + 1}"))
    canvas.legend(handles=handles, loc="outside lower center", ncols=5)


def _surface_style(i: int) -> tuple[str, Literal["dashed", "dotted"]]:
    """Colour and dashes of a printed surface's trace."""
    return COLOURS[i % LEG_COUNT], "dashed" if i < LEG_COUNT else "dotted"


def _box(
    geometry: PlatformGeometry, arm: ArmGeometry
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper corner of a box with some room around the workspace [m]."""
    tips = Workspace(geometry, arm).tip_of_extensions(boundary(geometry, _EDGE))
    rim = _RIM * float(np.ptp(tips[:, 0]))
    return tips.min(axis=0) - rim, tips.max(axis=0) + rim


def _plane(
    low: NDArray[np.float64], high: NDArray[np.float64], normal: int, at: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Two axes and the points of a grid in a plane perpendicular to an axis (its index)."""
    across, up = (i for i in range(3) if i != normal)
    u, v = (np.linspace(low[i], high[i], _PIXELS) for i in (across, up))
    point = np.full((_PIXELS, _PIXELS, 3), at)
    point[..., across], point[..., up] = np.meshgrid(u, v)
    return u, v, point


def _stroke_left(
    geometry: PlatformGeometry, arm: ArmGeometry, point: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`Workspace.stroke_left` with finite numbers only, for contours."""
    return np.maximum(Workspace(geometry, arm).stroke_left(point), -1.0)


def _label(axes: Any, across: int, up: int) -> None:
    axes.set_xlabel(f"{'xyz'[across]} [m]")
    axes.set_ylabel(f"{'xyz'[up]} [m]")


def _draw_ring(
    geometry: PlatformGeometry, arm: ArmGeometry, lean: float, canvas: "Canvas"
) -> None:
    arm = replace(arm, lean=lean)
    above, section = canvas.subplots(1, 2, width_ratios=(1.0, 1.0))
    turns = np.linspace(0.0, 2.0 * np.pi, _TURNS, endpoint=False)
    every_turn = replace(arm, turn=turns[:, np.newaxis, np.newaxis])
    _fill_from_above(above, geometry, every_turn, _SWEPT)
    _fill_from_above(above, geometry, arm, _FILL)
    above.set_title("from above")
    above.set_aspect("equal")
    _label(above, 0, 1)
    low, high = _box(geometry, arm)
    u, v, point = _plane(low, high, 1, 0.5 * float(low[1] + high[1]))
    swept = stroke_left_turning(geometry, arm, point)
    section.contourf(u, v, np.maximum(swept, -1.0), [0.0, 1.0], colors=[_SWEPT])
    section.contourf(u, v, _stroke_left(geometry, arm, point), [0.0, 1.0], colors=[_FILL])
    section.set_title(f"section at y = {point[0, 0, 1]:.3f} m")
    _label(section, 0, 2)


def _fill_from_above(
    axes: "Axes", geometry: PlatformGeometry, arm: ArmGeometry, colour: str
) -> None:
    """Fills what all faces cover; the arm's turn may be many, in shape (n, 1, 1)."""
    from matplotlib.collections import PolyCollection

    # Round each triangle: along an edge, the opposite side, and back.
    outlines = [
        np.concatenate([extension[0], extension[:, -1], extension[::-1, 0]])
        for extension in faces(geometry, _COARSE_EDGE).values()
    ]
    tips = Workspace(geometry, arm).tip_of_extensions(np.stack(outlines))
    corners = tips[..., :2].reshape(-1, len(outlines[0]), 2)
    axes.add_collection(
        PolyCollection(list(corners), color=colour, linewidth=1.0, rasterized=True)
    )
    axes.autoscale_view()


_LEVEL = (0.0, 0.0)
# Places of camera and of what it looks at, by the machine's size [m].
_CAMERA, _TARGET = (2.9, -5.2, 3.3), (0.0, 0.0, 1.42)
_FACE_EDGE = 25
_AROUND, _ACROSS = 73, 145
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


def draw(
    machine: PlatformDesign, geometry: PlatformGeometry, arm: ArmGeometry, turn: float | None
) -> Meshcat:
    """The workspace above the machine, which stands level in the middle of its stroke.

    With the turntable the ring that the leaning arm sweeps is drawn too, translucent.

    Args:
        machine: the platform.
        geometry: its legs, on points or on rollers.
        arm: the arm, upright.
        turn: lean of the arm that the turntable turns [rad]; None: it does not turn.
    """
    size = machine.size
    camera, target = ((size * np.array(place)).tolist() for place in (_CAMERA, _TARGET))
    meshcat = make_viewer(camera, target)
    p_WB = draw_machine(meshcat, machine, turn or 0.0)
    if turn is not None:
        arm = replace(arm, lean=turn)
        ring = swept_surface(geometry, arm, _AROUND, _ACROSS)
        draw_patch(meshcat, "/workspace/turntable", ring + p_WB, Rgba(0.95, 0.60, 0.30, 0.45))
    workspace = Workspace(geometry, arm)
    for key, extension in faces(geometry, _FACE_EDGE).items():
        points = workspace.tip_of_extensions(extension) + p_WB
        path = f"/workspace/{face_name(geometry, *key)}"
        draw_patch(meshcat, path, points, Rgba(*face_colour(*key), 1.0))
        outline = np.concatenate([points[0], points[:, -1], points[::-1, 0]])
        meshcat.SetLine(f"{path}/edges", outline.T, 2.0, Rgba(0.1, 0.1, 0.1))
    _draw_axes(meshcat, np.add(p_WB, _ABOVE_SLAB), size)
    return meshcat


def present(
    panel: Panel, what: str, rows: Sequence[Row], options: RunOptions
) -> Callable[[], None] | None:
    """Shows a picture and numbers in the browser; what is left to do is to wait for its viewers.

    Args:
        panel: the page.
        what: name of the picture.
        rows: the numbers.
        options: options of the run.
    """
    panel.show(Readout("exact, in closed form", rows))
    say_where(panel, what, options.console)
    if options.live:
        return partial(wait, panel, options.console)
    panel.close()
    return None


def wait(panel: Panel, console: Console) -> None:
    """Keeps the page until the viewer says that it is enough, or Ctrl-C."""
    console.print(
        f"'{END}' in the browser or Ctrl-C ends.", markup=False, highlight=False, soft_wrap=True
    )
    panel.AddButton(END)
    try:
        while panel.GetButtonClicks(END) == 0:
            time.sleep(LOOK_PERIOD)
    except KeyboardInterrupt:
        pass
    finally:
        panel.close()


def draw_machine(meshcat: Meshcat, machine: PlatformDesign, lean: float) -> NDArray[np.float64]:
    """Draws the machine about the world's origin; returns where its foot 2 stands (3) [m]."""
    geometry, extension = machine.geometry, np.array(machine.extensions_at(0.5))
    posture = forward_kinematics(geometry, extension, _LEVEL)
    builder = DiagramBuilder()
    ports = [
        add(builder, ConstantVectorSource(np.asarray(value, dtype=float)), name).get_output_port()
        for name, value in (
            ("extension", extension),
            ("base_pose", standing_pose(posture, _LEVEL)),
            ("arm_position", (0.0, lean)),
        )
    ]
    structure = machine.structure
    add_drawing(builder, _LEVEL, meshcat, *ports, geometry=geometry, structure=structure)
    diagram = builder.Build()
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    x, y, _ = foot_to_centre(geometry.legs[SUPPORT_LEG], extension[SUPPORT_LEG])
    return np.array([-x, -y, 0.0])


def draw_patch(
    meshcat: Meshcat, path: str, points: NDArray[np.float64], colour: Rgba | NDArray[np.float64]
) -> None:
    """Draws a grid of points (n, m, 3) as a surface, which ends where they are not numbers.

    Args:
        meshcat: the scene.
        path: path of the surface.
        points: the grid [m].
        colour: one of all, or red, green and blue (n, m, 3) of each.
    """
    rows, columns = points.shape[:2]
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    halves = [np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)]
    triangles = np.concatenate([half.reshape(-1, 3) for half in halves])
    flat = points.reshape(-1, 3)
    triangles = triangles[np.isfinite(flat[triangles]).all(axis=(1, 2))].T
    vertices = np.nan_to_num(flat).T
    if isinstance(colour, Rgba):
        meshcat.SetTriangleMesh(path, vertices, triangles, colour)
    else:
        meshcat.SetTriangleColorMesh(path, vertices, triangles, colour.reshape(-1, 3).T)


def _draw_axes(meshcat: Meshcat, p_WB: NDArray[np.float64], size: float) -> None:
    """Draws frame {B} with a stroke every tenth of a metre, and a letter at each axis's end."""
    for i, (name, colour) in enumerate(_AXES.items()):
        direction = np.eye(3)[i]
        count = round(size * _LENGTHS[i])
        ticks = p_WB + 0.1 * np.arange(count + 1)[:, np.newaxis] * direction
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
