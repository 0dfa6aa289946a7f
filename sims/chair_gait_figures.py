"""Figures of the experiment `chair-gait`."""

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from parapod.sims.chair_gait_motion import Floats, SampledWalk
from parapod.sims.figures import COLOURS, Figure
from parapod.systems.walking_chair.checks import SPEED_LIMIT
from parapod.systems.walking_chair.gait import FIRST_SWING, SECOND_SWING, SHIFT
from parapod.systems.walking_chair.geometry import LEG_COUNT
from parapod.systems.walking_chair.support import GaitSupport

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_QUANTITIES = (
    ("a", "length", "length [mm]", "Lengths"),
    ("b", "velocity", "velocity [mm/s]", "Velocities"),
    ("c", "acceleration", "acceleration [mm/s²]", "Accelerations"),
)
# The two UPS branches of a leg do the same; the second is dashed so that both are seen.
_STYLES: tuple[dict[str, Any], ...] = (
    {"color": COLOURS[0]},
    {"color": COLOURS[1], "linewidth": 2.0},
    {"color": COLOURS[6], "linewidth": 0.9, "linestyle": (0, (4, 4))},
)
_PANEL = 9  # font size of a panel's title
_GROUND, _GHOST, _RED = "0.55", "0.75", "#C0392B"
# Feet that are drawn of a swing, the first palest.
_DRAWN_FEET = 5
_PALEST = 0.2
_ENOUGH = 10  # of the samples, each so-manieth is drawn


def figures(printed: SampledWalk, smooth: SampledWalk, law: str) -> tuple[Figure, ...]:
    """The paper's Figs. 7 and 8, and the feet's swing.

    Args:
        printed: with the body moved by Eq. (45).
        smooth: with the body moved by the law.
        law: the law's name.
    """
    of_branches = tuple(
        Figure(
            f"fig08{letter}_{quantity}",
            f"{words} of all branches",
            f"{words} of the branches of each leg, above with the body moved by Eq. (45), below "
            f"by the law '{law}' (Fig. 8{letter}). The two UPS branches of a leg do the same.",
            partial(_draw_branches, (printed, smooth), ("Eq. (45)", law), quantity, label),
            (10.0, 4.4),
        )
        for letter, quantity, label, words in _QUANTITIES
    )
    return (
        Figure(
            "fig07_footprints",
            "Footprints, support polygons and the body's way",
            "The phases of a step from above (Fig. 7): feet that stand, the polygon that they "
            "span for the whole phase, where the feet that swing come from and go to, and the "
            "body's centre S.",
            partial(_draw_plan, smooth),
            (9.6, 4.4),
        ),
        *of_branches,
        Figure(
            "swing",
            "A foot's swing from the side",
            "Trajectory of the corner that is the reference, Eqs. (40) and (44), with the foot "
            "drawn at equal times, the later the darker; it leans as much as its UP branch.",
            partial(_draw_swing, smooth),
            (9.0, 3.1),
        ),
    )


def _draw_branches(
    walks: tuple[SampledWalk, ...],
    names: tuple[str, ...],
    quantity: str,
    label: str,
    canvas: "Canvas",
) -> None:
    rows: Any = canvas.subplots(len(walks), LEG_COUNT, sharex=True, sharey=True)
    for row, walk, name in zip(rows, walks, names, strict=True):
        values = 1e3 * getattr(walk.branches, quantity)
        kept = _kept(walk)
        for leg, axes in enumerate(row):
            for branch, style in enumerate(_STYLES):
                drawn = values[kept, leg, branch]
                axes.plot(walk.time[kept], drawn, label=f"branch {branch + 1}", **style)
            for end in walk.walk.ends[:-1]:
                axes.axvline(end, color="0.9", linewidth=0.8, zorder=0)
            if quantity == "velocity":
                for limit in (1e3 * SPEED_LIMIT, -1e3 * SPEED_LIMIT):
                    axes.axhline(limit, color=_GROUND, linewidth=0.8, linestyle="dotted")
        row[0].set_ylabel(f"{name}\n{label}")
    for leg, axes in enumerate(rows[0]):
        axes.set_title(f"leg {leg + 1}", fontsize=_PANEL)
    for axes in rows[-1]:
        axes.set_xlabel("time [s]")
        axes.set_xlim(0.0, walks[0].walk.duration)
    handles = rows[0, 0].get_lines()[: len(_STYLES)]
    labels = ("UP branch", "UPS branch 2", "UPS branch 3")
    canvas.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=8)


def _kept(walk: SampledWalk) -> NDArray[np.bool_]:
    """(n) samples that are drawn: some, and all at the ends of phases."""
    kept = np.zeros(len(walk.time), dtype=np.bool_)
    kept[::_ENOUGH] = kept[-1] = True
    changes = np.flatnonzero(np.diff(walk.phase))
    kept[changes] = kept[changes + 1] = True
    return kept


def _draw_plan(walk: SampledWalk, canvas: "Canvas") -> None:
    support = GaitSupport(walk.geometry, walk.walk)
    phases = walk.walk.phases
    shown = [phases.index(name) for name in (FIRST_SWING, SHIFT, SECOND_SWING)]
    panels: Any = canvas.subplots(1, len(shown), sharex=True, sharey=True)
    for axes, phase in zip(panels, shown, strict=True):
        samples = np.flatnonzero(walk.phase == phase)
        before, after = samples[0], samples[-1]
        polygon = 1e3 * support.polygon(phase).corners
        axes.fill(*polygon.T, facecolor=_RED, alpha=0.12, edgecolor="none", zorder=0)
        axes.fill(*polygon.T, facecolor="none", edgecolor=_RED, linewidth=1.2, zorder=3)
        for leg, stands in enumerate(walk.walk.standing[phase]):
            _draw_foot(axes, walk.corners[after, leg], filled=stands)
            if not stands:
                _draw_foot(axes, walk.corners[before, leg], filled=False, ghost=True)
            x, y = 1e3 * walk.corners[after, leg, :, :2].mean(axis=0)
            axes.annotate(f"{leg + 1}", (x, y), ha="center", va="center", fontsize=8)
        _draw_body(axes, 1e3 * walk.body[before, :2], 1e3 * walk.body[after, :2])
        axes.set_title(f"{phases[phase]}, {_seconds(walk, phase)}", fontsize=_PANEL)
        axes.set_xlabel("x [mm]")
        axes.set_aspect("equal")
    panels[0].set_ylabel("y [mm]")


def _seconds(walk: SampledWalk, phase: int) -> str:
    begin, end = (0.0, *walk.walk.ends)[phase : phase + 2]
    return f"{begin:g} to {end:g} s"


def _draw_foot(axes: Any, corners: Floats, filled: bool, ghost: bool = False) -> None:
    colour = _GHOST if ghost else COLOURS[0]
    face = (*_rgb(COLOURS[0]), 0.25) if filled else "none"
    dashes = "dashed" if ghost else "solid"
    axes.fill(*1e3 * corners[:, :2].T, facecolor=face, edgecolor=colour, linestyle=dashes)


def _rgb(colour: str) -> tuple[float, float, float]:
    from matplotlib.colors import to_rgb

    return to_rgb(colour)


def _draw_body(axes: Any, before: Floats, after: Floats) -> None:
    axes.plot(*before, marker="o", color="black", markersize=4)
    if np.linalg.norm(after - before) > 1.0:
        axes.annotate("", after, before, arrowprops={"arrowstyle": "->", "linewidth": 1.2})
        axes.plot(*after, marker="o", color="white", markeredgecolor="black", markersize=4)
    axes.annotate("S", before, xytext=(6, -3), textcoords="offset points", fontsize=8)


def _draw_swing(walk: SampledWalk, canvas: "Canvas") -> None:
    phase = walk.walk.phases.index(FIRST_SWING)
    samples = np.flatnonzero(walk.phase == phase)
    legs = [leg for leg, stands in enumerate(walk.walk.standing[phase]) if not stands]
    references = walk.walk.motion(walk.geometry, walk.time[samples[1]]).references
    panels: Any = canvas.subplots(1, len(legs), sharey=True)
    for axes, leg in zip(panels, legs, strict=True):
        corner = int(references[leg]) - 1
        path = 1e3 * walk.corners[samples, leg, corner, 1:]
        axes.axhline(0.0, color=_GROUND, linewidth=1.0)
        axes.plot(*path.T, color=COLOURS[1], linewidth=1.2)
        for share in np.linspace(0.0, 1.0, _DRAWN_FEET):
            sample = samples[round(share * (len(samples) - 1))]
            # E1 and the edge E2 E3, which from the side is a point.
            foot = 1e3 * walk.corners[sample, leg, :2, 1:]
            colour = (*_rgb(COLOURS[0]), _PALEST + (1.0 - _PALEST) * share)
            axes.plot(*foot.T, color=colour, linewidth=2.4, solid_capstyle="round")
        axes.set_title(f"leg {leg + 1}, reference E{corner + 1}", fontsize=_PANEL)
        axes.set_xlabel("y [mm]")
        axes.set_aspect("equal")
    panels[0].set_ylabel("z [mm]")
