"""Figures of the experiment `chair-circle`."""

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from parapod.sims.chair_circle_recording import SETTLING, Recording
from parapod.sims.figures import COLOURS, Figure
from parapod.systems.walking_chair.geometry import branch_names

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# How much larger errors of the radius are drawn than the circle.
_MAGNIFIED = 20.0
_MODE_COLOURS = {"compound": COLOURS[0], "velocity": COLOURS[1], "position": COLOURS[2]}
_PLANNED = "black"
# Of the ripple: how long, and which branch, the one that moves fastest [s].
_WINDOW = 0.4
_FASTEST = 1
_PANEL = 9  # font size of a panel's title


def figures(recordings: dict[str, Recording]) -> tuple[Figure, ...]:
    """The paper's Figs. 11 and 14, and what is behind the latter."""
    return (
        Figure(
            "fig11_circle_branches",
            "Branches of the leg on the circle",
            "Lengths and velocities of the three branches for a lap of Eq. (49) (Fig. 11).",
            partial(_draw_branches, recordings["compound"]),
            (9.0, 3.2),
        ),
        Figure(
            "fig14_circle",
            "The foot's trajectory in three control modes",
            f"From above: the circle of Eq. (49), and the foot's trajectory with errors of the "
            f"radius {_MAGNIFIED:g} times as large (Fig. 14). All laps. That the mode velocity is "
            "late does not show here.",
            partial(_draw_circle, recordings),
            (9.6, 3.7),
        ),
        Figure(
            "circle_errors",
            "Error of the foot over time",
            "Above the distance from where the foot should be at the same instant; below the "
            "error of the trajectory's radius, which a foot that is late has not.",
            partial(_draw_errors, recordings),
            (8.0, 4.6),
        ),
        Figure(
            "circle_ripple",
            "Velocity of a branch in three control modes",
            f"{branch_names((1,))[_FASTEST].capitalize()} at its fastest: what is planned, and "
            "what the drive does.",
            partial(_draw_ripple, recordings),
            (9.0, 3.0),
        ),
    )


def _draw_branches(recording: Recording, canvas: "Canvas") -> None:
    lap = recording.time <= recording.circle.period + recording.circle.ramp
    time, planned = recording.time[lap], recording.planned
    panels: Any = canvas.subplots(1, 2)
    for axes, values, label in zip(
        panels,
        (planned.length, planned.velocity),
        ("length [mm]", "velocity [mm/s]"),
        strict=True,
    ):
        for i, name in enumerate(branch_names((1,))):
            axes.plot(time, 1e3 * values[lap, i], label=name)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(label)
    canvas.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8
    )


def _draw_circle(recordings: dict[str, Recording], canvas: "Canvas") -> None:
    panels: Any = canvas.subplots(1, len(recordings), sharex=True, sharey=True)
    for axes, (mode, recording) in zip(panels, recordings.items(), strict=True):
        circle = recording.circle
        planned = circle.motion(recording.time).position[:, :2]
        outwards = recording.foot[:, :2] - (0.0, circle.centre_y)
        outwards /= np.linalg.norm(outwards, axis=-1, keepdims=True)
        radius = circle.radius + _MAGNIFIED * recording.radial_error[:, np.newaxis]
        drawn = (0.0, circle.centre_y) + radius * outwards
        axes.plot(*1e3 * planned.T, color=_PLANNED, linewidth=0.9, label="Eq. (49)")
        axes.plot(*1e3 * drawn.T, color=_MODE_COLOURS[mode], linewidth=0.9)
        axes.set_aspect("equal")
        axes.set_title(f"mode {mode}", fontsize=_PANEL)
        axes.set_xlabel("x [mm]")
    panels[0].set_ylabel("y [mm]")
    panels[0].legend(loc="center", fontsize=8)


def _draw_errors(recordings: dict[str, Recording], canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1, sharex=True)
    for i, (mode, recording) in enumerate(recordings.items()):
        # The first on top: the last one runs to and fro.
        style: dict[str, Any] = {"color": _MODE_COLOURS[mode], "linewidth": 0.9, "zorder": 9 - i}
        upper.plot(recording.time, 1e3 * recording.distance, label=f"mode {mode}", **style)
        lower.plot(recording.time, 1e3 * recording.radial_error, **style)
    upper.set_ylabel("error [mm]")
    lower.set_ylabel("radial error [mm]")
    lower.set_xlabel("time [s]")
    for axes in (upper, lower):
        axes.axvline(SETTLING, color="0.6", linewidth=0.8, linestyle="dotted")
    canvas.legend(
        *upper.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8
    )


def _draw_ripple(recordings: dict[str, Recording], canvas: "Canvas") -> None:
    panels: Any = canvas.subplots(1, len(recordings), sharex=True, sharey=True)
    for axes, (mode, recording) in zip(panels, recordings.items(), strict=True):
        planned = np.where(recording.is_settled, recording.planned.velocity[:, _FASTEST], 0.0)
        middle = recording.time[np.argmax(np.abs(planned))]
        shown = np.abs(recording.time - middle) <= 0.5 * _WINDOW
        time = recording.time[shown]
        velocity = recording.velocity[shown, _FASTEST]
        axes.plot(time, 1e3 * velocity, color=_MODE_COLOURS[mode], label="drive")
        axes.plot(time, 1e3 * planned[shown], color=_PLANNED, linewidth=0.9, label="planned")
        axes.set_title(f"mode {mode}", fontsize=_PANEL)
        axes.set_xlabel("time [s]")
    panels[0].set_ylabel("velocity [mm/s]")
    canvas.legend(
        *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, fontsize=8
    )
