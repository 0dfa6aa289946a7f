"""A run: the ways in which it is watched, and what it leaves."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydrake.systems.framework import Context, EventStatus

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.recording import Recording
from parapod.sims.lab.panel import Panel, Readout
from parapod.sims.output.results import Metric

type Monitor = Callable[[Context], EventStatus]
type ReadOut = Callable[[ClosedLoop[Any], Context], Readout]


@dataclass(frozen=True)
class Run(Recording):
    """A recording, and the run that it is of.

    Attributes:
        loop: the closed loop that was built for it.
        context: root context at the end of the run; None where it was a row among others.
        elapsed: wall-clock time of the simulation [s].
        panel: the page on which it was shown, or None.
        again: carries it out once more, in real time where it was shown.
    """

    loop: ClosedLoop[Any]
    context: Any
    elapsed: float
    panel: Panel | None
    again: Callable[[], float]

    @property
    def realtime_factor(self) -> float:
        """Simulated time by wall-clock time."""
        return float(self.time[-1]) / self.elapsed


def realtime_metric(*runs: Run) -> Metric:
    """Metric for the speed of the slowest of some runs."""
    factor = min(run.realtime_factor for run in runs)
    meaning = "simulated time by wall-clock time"
    return Metric("realtime_factor", factor, meaning=meaning, is_timing=True)
