"""Figures of the experiment `slip`."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from parapod.sims.figures import Figure
from parapod.sims.slip_recording import Recording
from parapod.sims.slip_scenario import SlipScenario
from parapod.systems.levelling_platform.geometry import LEG_COUNT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas


def figures(scenario: SlipScenario, recording: Recording) -> tuple[Figure, ...]:
    """The two parts of the paper's Fig. 23."""
    return (
        Figure(
            "fig23a_height_and_arm",
            "Height of the platform and angle of the arm",
            "First the actuators lift the platform, then they are braked (shaded) and the arm "
            "swings (Fig. 23a).",
            partial(_draw_motion, scenario, recording),
            (7.0, 4.2),
        ),
        Figure(
            "fig23b_slip",
            "Displacement of the support points in the plane of the ground",
            "Above from the start of the lift, below from the start of the arm's swing, which "
            "shows the slip with braked actuators (Fig. 23b).",
            partial(_draw_slip, scenario, recording),
            (7.0, 4.6),
        ),
    )


def _shade_braked(axes: "Axes", scenario: SlipScenario) -> None:
    axes.axvspan(scenario.braked_at, scenario.end, color="0.92", zorder=0, label="braked")
    axes.set_xlim(0.0, scenario.end)


def _draw_motion(scenario: SlipScenario, recording: Recording, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1, sharex=True)
    for axes, values, label in (
        (upper, 1e3 * recording.posture[:, 2], "height [mm]"),
        (lower, np.degrees(recording.arm), "arm [deg]"),
    ):
        _shade_braked(axes, scenario)
        axes.plot(recording.time, values)
        axes.set_ylabel(label)
    lower.set_xlabel("time [s]")
    upper.legend(loc="upper left", fontsize=8)


def _draw_slip(scenario: SlipScenario, recording: Recording, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1)
    _shade_braked(upper, scenario)
    for axes, since, unit, label in (
        (upper, 0.0, 1e3, "since the start [mm]"),
        (lower, scenario.swing_at, 1e6, "since the swing [µm]"),
    ):
        moved = unit * recording.displacement(since)
        time = recording.time[-len(moved) :]
        for leg in range(LEG_COUNT):
            width = 2.8 - 0.6 * leg
            axes.plot(time, moved[:, leg], label=f"leg {leg + 1}", linewidth=width)
        axes.set_ylabel(label)
        axes.set_xlabel("time [s]")
        axes.set_xlim(since, scenario.end)
        axes.set_ylim(bottom=0.0)
    handles, labels = upper.get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8)
