"""What the experiment `deploy` draws."""

from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from parapod.sims.figures import Figure
from parapod.sims.job import Signals
from parapod.sims.posture_errors import AXES, in_deg_and_mm
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.supervisor import Phase

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

# A phase that is shorter has no room for its name [s].
_NAMED = 1.5


def figures(time: NDArray[np.float64], signals: Signals) -> tuple[Figure, ...]:
    """The operation over time, and its legs."""
    return (
        Figure(
            "deploy_posture",
            "The operation",
            "Posture of the platform against gravity, and the supervisor's phases.",
            partial(_draw_posture, time, signals),
            (9.0, 5.2),
        ),
        Figure(
            "deploy_legs",
            "Legs and arm",
            "Extensions with the closing of the contact switches (dots), and the arm's angle.",
            partial(_draw_legs, time, signals),
            (9.0, 4.2),
        ),
    )


def _draw_posture(time: NDArray[np.float64], signals: Signals, canvas: "Canvas") -> None:
    posture = in_deg_and_mm(signals["truth.posture"])
    rows: Any = canvas.subplots(3, 1, sharex=True)
    for i, (axes, (_, _, label)) in enumerate(zip(rows, AXES, strict=True)):
        axes.plot(time, posture[:, i])
        axes.set_ylabel(label)
        _mark_phases(axes, time, signals, named=i == 0)
    rows[-1].set_xlabel("time [s]")


def _draw_legs(time: NDArray[np.float64], signals: Signals, canvas: "Canvas") -> None:
    legs, arm = canvas.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    extension = 1e3 * signals["legs.extension"]
    contact = signals["legs.limits"][:, 2 * LEG_COUNT :] > 0.5
    for i in range(LEG_COUNT):
        (line,) = legs.plot(time, extension[:, i], label=f"leg {i + 1}")
        if contact[:, i].any():
            first = int(np.argmax(contact[:, i]))
            legs.plot(time[first], extension[first, i], "o", color=line.get_color(), ms=4)
    legs.set_ylabel("extension [mm]")
    legs.legend(fontsize=8, ncols=LEG_COUNT, loc="upper center")
    arm.plot(time, np.degrees(signals["arm_command"][:, 1]))
    arm.set(ylabel="arm [deg]", xlabel="time [s]")
    _mark_phases(legs, time, signals, named=True)
    _mark_phases(arm, time, signals, named=False)


def _mark_phases(axes: "Axes", time: NDArray[np.float64], signals: Signals, named: bool) -> None:
    """Bands behind the curves, one a phase."""
    phase = signals["phase"][:, 0]
    edges = [0, *(np.flatnonzero(np.diff(phase)) + 1).tolist(), phase.size - 1]
    for k, (begin, end) in enumerate(pairwise(edges)):
        if k % 2:
            axes.axvspan(time[begin], time[end], color="0.95", zorder=0)
        if named and time[end] - time[begin] >= _NAMED:
            axes.annotate(
                Phase(int(phase[begin])).name.lower(),
                (0.5 * (time[begin] + time[end]), 1.02),
                xycoords=("data", "axes fraction"),
                ha="center",
                fontsize=7,
            )
