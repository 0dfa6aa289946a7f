"""The paper's schemes, drawn from the dimensions that everything else is computed with."""

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.style import COLOURS
from parapod.sims.output.figures import Figure
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.leg import carried, leg_corners

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

_CHAIR = ChairGeometry()
_LEG = _CHAIR.leg
# A posture in which nothing hides behind something else: l_11 [m], alpha, beta [rad].
_UP = np.array((0.68, math.radians(7.0), math.radians(9.0)))
_NAMES = ("UP", "UPS 2", "UPS 3")
_GREY = "0.6"


def _lower_joints(up: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) lower ends of the branches in {A1} [m]."""
    return carried(_LEG, up, _LEG.lower_joints) + _LEG.upper_joints[0]


def _polygon(axes: "Axes", points: Any, **style: Any) -> None:
    closed = np.vstack((points, points[:1]))
    axes.plot(1e3 * closed[:, 0], 1e3 * closed[:, 1], **style)


def _draw_leg(canvas: "Canvas") -> None:
    """Figs. 3 and 6, from the front and from the side."""
    views: Any = canvas.subplots(1, 2, sharey=True)
    upper, lower = _LEG.upper_joints, _lower_joints(_UP)
    face = upper * (1.0, 1.0, 0.0)
    foot = leg_corners(_LEG, _UP)
    for axes, along in zip(views, (0, 1), strict=True):
        plane = [along, 2]
        for triangle, colour in ((face, "black"), (foot, "black")):
            _polygon(axes, triangle[:, plane], color=colour, linewidth=1.6)
        for k, name in enumerate(_NAMES):
            ends = np.array((face[k], upper[k], lower[k], foot[k]))[:, plane]
            axes.plot(1e3 * ends[:2, 0], 1e3 * ends[:2, 1], color=_GREY)
            axes.plot(1e3 * ends[2:, 0], 1e3 * ends[2:, 1], color=_GREY)
            line = {"color": COLOURS[k], "linewidth": 2.4, "marker": "o", "label": name}
            axes.plot(1e3 * ends[1:3, 0], 1e3 * ends[1:3, 1], **line)
        for k in range(3):
            place = 1e3 * foot[k, plane]
            axes.annotate(f"$E_{k + 1}$", place, (0, -12), textcoords="offset points", ha="center")
            place = 1e3 * face[k, plane]
            axes.annotate(f"$A_{k + 1}$", place, (0, 6), textcoords="offset points", ha="center")
        axes.set(xlabel=f"{'xy'[along]} [mm]", aspect="equal")
        axes.margins(0.12)
    views[0].set_ylabel("z [mm]")
    handles = views[0].get_legend_handles_labels()
    canvas.legend(*handles, loc="outside upper center", ncols=3)


def _draw_arrangement(canvas: "Canvas") -> None:
    """Figs. 4 and 5."""
    axes: Any = canvas.subplots()
    corners = _LEG.upper_joints * (1.0, 1.0, 0.0)
    for leg in range(4):
        rotated = corners @ _CHAIR.R_SA[leg].T + _CHAIR.p_SA[leg]
        _polygon(axes, rotated[:, :2], color="black", linewidth=1.4)
        for k, (x, y, _) in enumerate(rotated):
            axes.plot(1e3 * x, 1e3 * y, "o", color=COLOURS[k], ms=6)
        x, y, _ = rotated.mean(axis=0)
        axes.text(1e3 * x, 1e3 * y, f"leg {leg + 1}", ha="center", va="center")
        outward = 1e3 * rotated[0, 1]
        label = f"$A_{leg + 1}$"
        shift = (0, 8 if outward > 0.0 else -14)
        place = (1e3 * rotated[0, 0], outward)
        axes.annotate(label, place, shift, textcoords="offset points", ha="center")
    for vector, name in (((80.0, 0.0), "$x_S$"), ((0.0, 80.0), "$y_S$")):
        axes.annotate("", vector, (0.0, 0.0), arrowprops={"arrowstyle": "->"})
        axes.text(1.15 * vector[0], 1.15 * vector[1], name, ha="center", va="center")
    axes.plot(0.0, 0.0, "k.", ms=8)
    axes.text(-14.0, -14.0, "S", ha="right", va="top")
    axes.set(xlabel="x, to the right [mm]", ylabel="y, ahead [mm]", aspect="equal")
    axes.margins(0.12)


DRAWINGS = (
    Figure(
        "chair_leg",
        "The leg",
        "The 2-UPS+UP leg from the front and from the side, tilted by alpha = 7 and beta = 9 deg "
        "(Figs. 3 and 6): branches between the centres of their joints, platforms as triangles.",
        _draw_leg,
        (7.0, 5.4),
    ),
    Figure(
        "chair_arrangement",
        "The arrangement of the legs",
        "Upper platforms from above (Figs. 4 and 5); that the UP branches (blue) stand outwards "
        "is an assumption.",
        _draw_arrangement,
        (5.0, 5.4),
    ),
)
