"""Dimensioned drawings of a machine as it is set: plan and elevation, in vectors."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Rgba,
    Role,
    SceneGraph,
    Sphere,
)
from pydrake.systems.framework import Context
from scipy.spatial import ConvexHull  # type: ignore[import-untyped]

from parapod.diagrams.twin import MEASURED
from parapod.sims.output.drawn import DrawnLog
from parapod.sims.output.figures import Figure
from parapod.sims.sheet.sheet import Dimension

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

# Axes of the world across and up in each view, and the one towards the eye with its sign.
_VIEWS: dict[str, tuple[int, int, int, float]] = {
    "plan": (0, 1, 2, 1.0),
    "elevation": (0, 2, 1, -1.0),
}
_TITLES = {"plan": "Plan", "elevation": "Elevation"}
# Points round a circle, and along a meridian of a sphere.
_ROUND, _MERIDIAN = 24, 9
# Distances of dimension lines from the outline and from each other, by the drawing's size [-].
_AWAY, _APART = 0.06, 0.075
_LINE, _EXTENSION = "#33485c", "#9fb0bd"
_WIDTH = 7.2  # width of a drawing [inch]


@dataclass(frozen=True)
class Outline:
    """One part of a machine as it stands in the world.

    Attributes:
        corners: points (n, 3) whose convex hull it is [m].
        colour: red, green, blue (3) [0..1].
    """

    corners: NDArray[np.float64]
    colour: tuple[float, float, float]


def outlines_of(
    experiment: Any, scenario: Any, signals: Mapping[str, NDArray[np.float64]]
) -> list[Outline]:
    """Parts of a machine as it stands, the ground left out.

    Args:
        experiment: an experiment that runs the machine's closed loop.
        scenario: a scenario of the experiment, on a simulated backend.
        signals: signals by which the machine is drawn; none: those at the scenario's beginning.

    Raises:
        ParapodError: the machine has no drawing.
    """
    values = dict(signals)
    if not values:
        loop = experiment.loop(scenario, log=())
        context = loop.CreateDefaultContext()
        loop.reset(context)
        values = {name: read() for name, read in loop.readings(context).items()}
    settings = experiment.machine_scenario(scenario)
    machine = experiment.machine.for_scenario(settings)
    shapes = {name: value.shape for name, value in values.items()}
    twin = DrawnLog.from_shapes(machine, settings, experiment.drawing, shapes).make()
    twin.show(values)
    return list(_outlines(*twin.scene_graphs()[MEASURED]))


def _outlines(scene_graph: SceneGraph, context: Context) -> Iterator[Outline]:
    query: Any = scene_graph.get_query_output_port().Eval(context)
    inspector = query.inspector()
    for geometry in inspector.GetAllGeometryIds(Role.kIllustration):
        frame = inspector.GetFrameId(geometry)
        if inspector.GetName(frame).startswith("ground"):
            continue
        corners = _corners(inspector.GetShape(geometry))
        if corners is None:
            hull = inspector.GetConvexHull(geometry)
            if hull is None:
                continue
            corners = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        properties: Any = inspector.GetIllustrationProperties(geometry)
        rgba = properties.GetPropertyOrDefault("phong", "diffuse", Rgba(0.8, 0.8, 0.8, 1.0))
        if rgba.a() > 0.0:
            X_WG = query.GetPoseInWorld(geometry)
            yield Outline(X_WG.multiply(corners.T).T, (rgba.r(), rgba.g(), rgba.b()))


def _corners(shape: Any) -> NDArray[np.float64] | None:
    """Points (n, 3) whose hull is a shape, about its own frame [m]; None: ask for its hull."""
    if isinstance(shape, Box):
        half = 0.5 * np.array([shape.width(), shape.depth(), shape.height()])
        return half * np.array(list(product((-1.0, 1.0), repeat=3)))
    turn = np.linspace(0.0, 2.0 * math.pi, _ROUND, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(_ROUND)])
    if isinstance(shape, Cylinder):
        ends = np.array([[0.0, 0.0, side * 0.5 * shape.length()] for side in (-1.0, 1.0)])
        return np.concatenate([shape.radius() * circle + end for end in ends])
    latitude = np.linspace(-0.5 * math.pi, 0.5 * math.pi, _MERIDIAN)
    ball = np.concatenate(
        [np.cos(angle) * circle + (0.0, 0.0, math.sin(angle)) for angle in latitude]
    )
    if isinstance(shape, Sphere):
        return shape.radius() * ball
    if isinstance(shape, Ellipsoid):
        return ball * (shape.a(), shape.b(), shape.c())
    if isinstance(shape, Capsule):
        reach = np.sign(ball[:, 2:]) * (0.0, 0.0, 0.5 * shape.length())
        return shape.radius() * ball + reach
    return None


def drawings(outlines: Sequence[Outline], dimensions: Iterable[Dimension]) -> list[Figure]:
    """Plan and elevation with their dimensions in millimetres.

    Args:
        outlines: parts of the machine.
        dimensions: lines beside those of length, width and height.
    """
    lines = list(dimensions)
    points = np.concatenate([part.corners for part in outlines])
    low, high = points.min(axis=0), points.max(axis=0)
    figures = []
    for view in ("plan", "elevation"):
        across, up, *_ = _VIEWS[view]
        own = [line for line in lines if line.view == view]
        room = 2.0 * (_AWAY + _APART * (1 + max(1, len(own))))
        wide, tall = (high - low)[[across, up]] + room * float((high - low)[[across, up]].max())
        figures.append(
            Figure(
                view,
                _TITLES[view],
                "Dimensions in mm.",
                partial(_draw, outlines, view, own),
                (_WIDTH, min(1.4 * _WIDTH, _WIDTH * tall / wide)),
            )
        )
    return figures


def _draw(
    outlines: Sequence[Outline],
    view: Literal["plan", "elevation"],
    dimensions: Sequence[Dimension],
    canvas: "Canvas",
) -> None:
    from matplotlib.patches import Polygon

    across, up, towards, sign = _VIEWS[view]
    axes = canvas.add_subplot()
    axes.set_aspect("equal")
    axes.axis("off")
    points = np.concatenate([part.corners for part in outlines])
    low, high = points.min(axis=0), points.max(axis=0)
    for part in sorted(outlines, key=lambda part: _nearness(part, towards, sign)):
        flat = part.corners[:, [across, up]]
        hull = flat[ConvexHull(flat, qhull_options="QJ").vertices]
        pale = tuple(0.35 + 0.65 * shade for shade in part.colour)
        axes.add_patch(Polygon(hull, closed=True, facecolor=pale, edgecolor="0.25", linewidth=0.4))
    size = float((high - low)[[across, up]].max())
    whole = [
        ((low[across], low[up]), (high[across], low[up]), (0.0, -1.0)),
        ((high[across], low[up]), (high[across], high[up]), (1.0, 0.0)),
    ]
    for first, last, way in whole:
        _dimension(axes, first, last, way, _AWAY * size, size, "")
    for number, line in enumerate(dimensions):
        ends = (np.asarray(point, dtype=float) for point in (line.start, line.end))
        start, end = (point[[across, up]] for point in ends)
        upright = abs(end[1] - start[1]) > abs(end[0] - start[0])
        way = (-1.0, 0.0) if upright else (0.0, 1.0)
        edge = low[across] if upright else high[up]
        place = start[0] if upright else start[1]
        away = abs(edge - place) + (_AWAY + _APART * number) * size
        _dimension(axes, start, end, way, away, size, line.name)
    axes.autoscale_view()
    axes.margins(0.02)


def _nearness(part: Outline, towards: int, sign: float) -> float:
    return sign * float((sign * part.corners[:, towards]).max())


def _dimension(
    axes: "Axes",
    start: Any,
    end: Any,
    way: tuple[float, float],
    away: float,
    size: float,
    name: str,
) -> None:
    """Draws one dimension line away from two points, with its extension lines."""
    start, end, aside = np.asarray(start), np.asarray(end), np.asarray(way)
    along = np.array([1.0, 0.0]) if way[0] == 0.0 else np.array([0.0, 1.0])
    # Both ends lie on one line that is parallel to an axis.
    level = float(start @ aside) + away
    ends = [point + (level - float(point @ aside)) * aside for point in (start, end)]
    for point, at in zip((start, end), ends, strict=True):
        beyond = at + 0.01 * size * aside
        axes.plot(*np.transpose([point, beyond]), color=_EXTENSION, linewidth=0.5)
    axes.annotate(
        "", ends[0], ends[1], arrowprops={"arrowstyle": "<|-|>", "color": _LINE, "linewidth": 0.8,
                                          "shrinkA": 0.0, "shrinkB": 0.0, "mutation_scale": 8.0},
    )  # fmt: skip
    length = abs(float((ends[1] - ends[0]) @ along))
    text = f"{name} = {1e3 * length:.0f}" if name else f"{1e3 * length:.0f}"
    x, y = 0.5 * (ends[0] + ends[1]) + 0.012 * size * np.abs(along[::-1]) * (
        np.sign(aside) if way[0] < 0.0 else 1.0
    )
    axes.text(
        x, y, text,
        rotation=90.0 if along[1] else 0.0,
        ha="right" if way[0] < 0.0 else ("left" if along[1] else "center"),
        va="center" if along[1] else "bottom",
        fontsize=8.0, color=_LINE, parse_math=False,
    )  # fmt: skip
