"""The paper's schemes, drawn from the dimensions that everything else is computed with."""

from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.diagrams.style import COLOURS
from parapod.sims.machining_centre.workspace import NAMES
from parapod.sims.output.figures import Figure
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_HEIGHT = 0.48  # height of the platform [m]


def _project(points: Array) -> Array:
    """Points (..., 3) as seen from the front right and above (..., 2) [mm]."""
    yaw, pitch = np.radians((-62.0, 22.0))
    right = np.array((np.cos(yaw + 0.5 * np.pi), np.sin(yaw + 0.5 * np.pi), 0.0))
    towards = np.array((np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)))
    up = np.cross(towards, right)
    return 1e3 * np.stack((points @ right, points @ up), axis=-1)


def _line(axes: "Axes", points: Any, **style: Any) -> None:
    flat = _project(np.asarray(points))
    axes.plot(flat[:, 0], flat[:, 1], **style)


def _draw_sketch(canvas: "Canvas") -> None:
    """Both centres at home, seen obliquely."""
    panels: Any = canvas.subplots(1, 2, sharey=True)
    for axes, (limbs, name) in zip(panels, NAMES.items(), strict=True):
        geometry = CentreGeometry(limbs)
        pivots = geometry.pivots + np.array((0.0, 0.0, _HEIGHT))
        feet = geometry.footholds[:, :3]
        circle = np.linspace(0.0, 2.0 * np.pi, 100)
        ring = geometry.pattern_radius * np.stack(
            (np.cos(circle), np.sin(circle), 0.0 * circle), axis=-1
        )
        _line(axes, ring, color="0.7", linewidth=0.8, linestyle="dashed")
        _line(axes, [*pivots, pivots[0]], color="black", linewidth=2.0)
        for i in range(limbs):
            for k, side in enumerate(("left leg", "right leg")):
                label = side if i == 0 else None
                ends = (feet[i], pivots[2 * i + k])
                _line(axes, ends, color=COLOURS[k], linewidth=2.2, label=label)
            _mark(axes, feet[i], f"$A_{i + 1}$", (0, -13))
        _mark(axes, np.array((0.0, 0.0, _HEIGHT)), "$P_O$", (0, 6))
        axes.set(title=name, aspect="equal", xlabel="across [mm]")
        axes.margins(0.1)
    panels[0].set_ylabel("up [mm]")
    panels[0].legend(loc="upper left", fontsize=8)


def _mark(axes: "Axes", point: Array, text: str, offset: tuple[int, int]) -> None:
    (place,) = _project(point[np.newaxis])
    axes.plot(*place, "o", color="black", markersize=3)
    axes.annotate(text, place, offset, textcoords="offset points", ha="center")


def _draw_pattern(canvas: "Canvas") -> None:
    """Pivots and feet from above."""
    panels: Any = canvas.subplots(1, 2, sharey=True)
    for axes, (limbs, name) in zip(panels, NAMES.items(), strict=True):
        geometry = CentreGeometry(limbs)
        pivots, feet = 1e3 * geometry.pivots, 1e3 * geometry.footholds[:, :3]
        circle = np.linspace(0.0, 2.0 * np.pi, 200)
        for radius, style in ((geometry.pattern_radius, "dashed"), (0.1, "dotted")):
            round_ = 1e3 * radius * np.stack((np.cos(circle), np.sin(circle)))
            axes.plot(*round_, color="0.6", linewidth=0.8, linestyle=style)
        for k in range(geometry.legs):
            foot = feet[k // 2]
            line = np.stack((foot, pivots[k]))
            axes.plot(line[:, 0], line[:, 1], color=COLOURS[k % 2], linewidth=1.6)
        for i, foot in enumerate(feet):
            axes.annotate(f"$A_{i + 1}$", 1.13 * foot[:2], ha="center", va="center")
        axes.plot(feet[:, 0], feet[:, 1], "o", color="black")
        axes.set(title=name, aspect="equal", xlabel="u [mm]")
        axes.margins(0.15)
    panels[0].set_ylabel("v [mm]")


DRAWINGS = (
    Figure(
        "centre_sketch",
        "Tripod and quadruped",
        "Both centres with the platform 480 mm above the feet (Figs. 3 to 6).",
        _draw_sketch,
        (7.0, 4.2),
    ),
    Figure(
        "centre_pattern",
        "Supporting pattern",
        "Feet on a circle of 180 mm, pivots on one of 100 mm, from above (Fig. 11). Neighbouring "
        "pivots of the quadruped coincide.",
        _draw_pattern,
        (7.0, 4.2),
    ),
)
