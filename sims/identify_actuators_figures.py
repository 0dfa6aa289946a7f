"""Figures of the experiment `identify-actuators`."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from parapod.sims.figures import Figure
from parapod.sims.identify_actuators_estimate import Steps
from parapod.sims.identify_actuators_metrics import SHARE
from parapod.sims.identify_actuators_recording import CASES, Recording, Recordings
from parapod.sims.identify_actuators_scenario import NOMINAL
from parapod.systems.levelling_platform.geometry import LEG_COUNT

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

_MARKERS = ("o", "x")
# Both cases of a step stand side by side [steps].
_ASIDE = (-0.1, 0.1)


def figures(recordings: Recordings, cases: tuple[Steps, ...]) -> tuple[Figure, ...]:
    """The paper's Figs. 13 to 15.

    Args:
        recordings: of both cases.
        cases: the steps in them.
    """
    return (
        Figure(
            "fig13_steps_unloaded",
            "Ten voltage steps without load",
            "Above the applied voltage, below the extension by the encoders; the legs are lifted "
            "(Fig. 13).",
            partial(_draw_steps, recordings.unloaded),
            (7.0, 4.2),
        ),
        Figure(
            "fig14_steps_loaded",
            "Ten voltage steps under the platform's weight",
            "Above the applied voltage, below the extension by the encoders; the feet are on the "
            "ground (Fig. 14).",
            partial(_draw_steps, recordings.loaded),
            (7.0, 4.2),
        ),
        Figure(
            "fig15a_speed_over_voltage",
            "Speed of the actuators over voltage",
            f"Slope of each ramp, mean of the four legs, beside K = {NOMINAL:g} (m/s)/V "
            "(Fig. 15a).",
            partial(_draw_speed, cases),
        ),
        Figure(
            "fig15b_gain_per_step",
            "Gain K of each step",
            f"Mean of the four legs with their range; shaded: {NOMINAL:g} within "
            f"{100 * SHARE:g} % (Fig. 15b).",
            partial(_draw_gain, cases),
        ),
    )


def _draw_steps(recording: Recording, canvas: "Canvas") -> None:
    upper, lower = canvas.subplots(2, 1, sharex=True)
    upper.step(recording.time, recording.voltage[:, 0], where="post", color="black")
    upper.set_ylabel("voltage [V]")
    for leg in range(LEG_COUNT):
        extension = 1e3 * recording.extension[:, leg]
        width = 2.8 - 0.6 * leg
        lower.plot(recording.time, extension, label=f"leg {leg + 1}", linewidth=width)
    lower.set_ylabel("extension [mm]")
    lower.set_xlabel("time [s]")
    lower.set_xlim(0.0, recording.time[-1])
    canvas.legend(
        *lower.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=LEG_COUNT,
        fontsize=8,
    )


def _draw_speed(cases: tuple[Steps, ...], canvas: "Canvas") -> None:
    axes = canvas.subplots()
    voltage = np.array([cases[0].voltage.min(), cases[0].voltage.max()])
    axes.plot(
        voltage, 1e3 * NOMINAL * voltage, color="0.6", label=f"K = {NOMINAL:g} (m/s)/V", zorder=1
    )
    for case, steps, marker in zip(CASES, cases, _MARKERS, strict=True):
        speed = 1e3 * steps.speed.mean(axis=1)
        axes.scatter(steps.voltage, speed, marker=marker, label=case, zorder=2)
    axes.set_xlabel("voltage [V]")
    axes.set_ylabel("speed [mm/s]")
    axes.legend(loc="upper left", fontsize=8)


def _draw_gain(cases: tuple[Steps, ...], canvas: "Canvas") -> None:
    axes = canvas.subplots()
    axes.axhspan((1.0 - SHARE) * NOMINAL, (1.0 + SHARE) * NOMINAL, color="0.92", zorder=0)
    for case, steps, marker, aside in zip(CASES, cases, _MARKERS, _ASIDE, strict=True):
        gain = steps.gain
        middle = gain.mean(axis=1)
        around = np.array([middle - gain.min(axis=1), gain.max(axis=1) - middle]).clip(min=0.0)
        number = np.arange(1, middle.size + 1) + aside
        axes.errorbar(number, middle, around, marker=marker, ls="", capsize=3, label=case)
    axes.set_xticks(np.arange(1, cases[0].voltage.size + 1))
    axes.set_xlabel("step")
    axes.set_ylabel("K [(m/s)/V]")
    axes.grid(visible=False, axis="x")
    canvas.legend(
        *axes.get_legend_handles_labels(), loc="outside upper center", ncols=2, fontsize=8
    )
