"""Figures of the experiment `chair-payload`."""

from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from parapod.sims.chair_payload_scenario import ChairPayloadScenario
from parapod.sims.chair_payload_survey import (
    GEOMETRY,
    MASSES,
    PAPER_PAYLOAD,
    Floats,
    Instant,
    paper_stiffness,
)
from parapod.sims.figures import COLOURS, Figure
from parapod.systems.walking_chair.gait import FIRST_SWING, SECOND_SWING
from parapod.systems.walking_chair.geometry import LEG_COUNT
from parapod.systems.walking_chair.masses import centre_of_mass
from parapod.systems.walking_chair.support import GaitSupport, SupportPolygon

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# The two UPS branches of a leg bear nearly the same; the second is dashed so that both are seen.
_STYLES: tuple[dict[str, Any], ...] = (
    {"color": COLOURS[0]},
    {"color": COLOURS[1], "linewidth": 2.0},
    {"color": COLOURS[6], "linewidth": 0.9, "linestyle": (0, (4, 4))},
)
_LIMIT = {"color": "0.55", "linewidth": 0.8, "linestyle": "dotted"}
_RED = "#C0392B"
_PANEL = 9  # font size of a panel's title


def figures(scenario: ChairPayloadScenario, instants: list[Instant]) -> tuple[Figure, ...]:
    """What can be drawn of the payload."""
    mass, softness = scenario.payload.mass_kg, paper_stiffness(scenario.walk)
    return (
        Figure(
            "payload_over_time",
            "Largest payload through a step",
            "What the best distribution of forces carries at each instant, within every branch's "
            f"{scenario.force_limit:g} N, beside the paper's {PAPER_PAYLOAD:g} kg.",
            partial(_draw_payload, scenario, instants),
            (8.0, 3.2),
        ),
        Figure(
            "payload_support",
            "Support polygons while two feet swing",
            "From above: the feet that stand, the polygon that they span, the centre of mass of "
            f"the chair with {mass:g} kg on it, and how far it is from the nearest edge, when "
            "that is least.",
            partial(_draw_support, scenario, instants),
            (6.6, 4.0),
        ),
        Figure(
            "fig17_branch_forces",
            f"Forces of the branches under {mass:g} kg",
            "Forces on branches that give, by legs: above with branches that are all as stiff, "
            f"below with UPS branches {softness:.2f} times as stiff as UP branches, which would "
            f"explain that {PAPER_PAYLOAD:g} kg are the most (Fig. 17 has the motors' currents). "
            "Dotted: the actuators' thrust.",
            partial(_draw_forces, scenario, instants),
            (10.0, 4.4),
        ),
    )


def _by_phase(instants: list[Instant], values: Floats) -> tuple[Floats, Floats]:
    """Times and values with a gap between two phases, where they may jump."""
    time = np.array([instant.time for instant in instants])
    changes = [i + 1 for i, (a, b) in enumerate(pairwise(instants)) if a.phase != b.phase]
    gaps = np.full((len(changes), *values.shape[1:]), np.nan)
    return np.insert(time, changes, np.nan), np.insert(values, changes, gaps, axis=0)


def _draw_payload(
    scenario: ChairPayloadScenario, instants: list[Instant], canvas: "Canvas"
) -> None:
    axes = canvas.subplots()
    for name, label in (
        ("friction", f"friction {scenario.friction:g}"),
        ("frictionless", "no friction"),
    ):
        masses = np.array([getattr(instant, name).mass for instant in instants])
        axes.plot(*_by_phase(instants, masses), label=label)
    axes.axhline(PAPER_PAYLOAD, color="black", linewidth=0.9, linestyle="dashed", label="paper")
    for end in scenario.walk.ends[:-1]:
        axes.axvline(end, color="0.9", linewidth=0.8, zorder=0)
    axes.set_xlim(0.0, scenario.walk.duration)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("largest payload [kg]")
    canvas.legend(
        *axes.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8
    )


def _draw_support(
    scenario: ChairPayloadScenario, instants: list[Instant], canvas: "Canvas"
) -> None:
    walk = scenario.walk
    support = GaitSupport(GEOMETRY, walk, MASSES)
    shown = [walk.phases.index(name) for name in (FIRST_SWING, SECOND_SWING)]
    panels: Any = canvas.subplots(1, len(shown), sharex=True, sharey=True)
    for axes, phase in zip(panels, shown, strict=True):
        name = walk.phases[phase]
        polygon = support.polygon(phase)
        placed = min(
            (_placed(scenario, instant) for instant in instants if instant.phase == name),
            key=lambda placed: polygon.margin(placed.centre[:2]),
        )
        for leg, stands in enumerate(walk.standing[phase]):
            if stands:
                outline = 1e3 * placed.feet[leg, :, :2]
                axes.fill(*outline.T, color=COLOURS[0], alpha=0.25, linewidth=0.0)
                x, y = outline.mean(axis=0)
                axes.annotate(f"{leg + 1}", (x, y), ha="center", va="center", fontsize=8)
        axes.fill(*1e3 * polygon.corners.T, facecolor="none", edgecolor=_RED, linewidth=1.2)
        _draw_margin(axes, polygon, placed.centre[:2])
        margin = 1e3 * polygon.margin(placed.centre[:2])
        axes.set_title(f"{name}, {placed.time:.1f} s: {margin:.1f} mm", fontsize=_PANEL)
        axes.set_aspect("equal")
        axes.set_xlabel("x [mm]")
    panels[0].set_ylabel("y [mm]")


class _Placed(NamedTuple):
    """The chair at an instant: corners (4, 3, 3) of its feet and its centre of mass [m]."""

    time: float
    feet: Floats
    centre: Floats


def _placed(scenario: ChairPayloadScenario, instant: Instant) -> _Placed:
    body = np.asarray(scenario.walk.motion(GEOMETRY, instant.time).body.position)
    feet = instant.stand.corners.reshape(LEG_COUNT, 3, 3)
    _, centre = centre_of_mass(MASSES, scenario.payload.passenger, feet.mean(axis=1))
    return _Placed(instant.time, body + feet, body + centre)


def _draw_margin(axes: Any, polygon: SupportPolygon, centre: Floats) -> None:
    """The centre of mass, and a line from it to the nearest edge."""
    distances = polygon.offsets - polygon.normals @ centre
    nearest = int(np.argmin(distances))
    edge = centre + distances[nearest] * polygon.normals[nearest]
    axes.plot(*1e3 * np.array((centre, edge)).T, color="black", linewidth=1.0)
    axes.plot(*1e3 * centre, marker="o", color="black", markersize=5)


def _draw_forces(
    scenario: ChairPayloadScenario, instants: list[Instant], canvas: "Canvas"
) -> None:
    labels = ("all as stiff", f"UPS {paper_stiffness(scenario.walk):.2f} times")
    rows: Any = canvas.subplots(2, LEG_COUNT, sharex=True, sharey=True)
    for row, name, label in zip(rows, ("equal", "soft"), labels, strict=True):
        forces = np.array([getattr(instant, name).branch_forces for instant in instants])
        time, drawn = _by_phase(instants, forces.reshape(-1, LEG_COUNT, 3))
        for leg, axes in enumerate(row):
            for branch, style in enumerate(_STYLES):
                axes.plot(time, drawn[:, leg, branch], **style)
            axes.axhline(scenario.force_limit, **_LIMIT)
            for end in scenario.walk.ends[:-1]:
                axes.axvline(end, color="0.9", linewidth=0.8, zorder=0)
        row[0].set_ylabel(f"{label}\nforce [N]")
    for leg, axes in enumerate(rows[0]):
        axes.set_title(f"leg {leg + 1}", fontsize=_PANEL)
    for axes in rows[-1]:
        axes.set_xlabel("time [s]")
        axes.set_xlim(0.0, scenario.walk.duration)
    names = ("UP branch", "UPS branch 2", "UPS branch 3")
    handles = rows[0, 0].get_lines()[: len(names)]
    canvas.legend(handles, names, loc="outside upper center", ncols=3, fontsize=8)
