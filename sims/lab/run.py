"""A run: the ways in which it is watched, and what it leaves."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
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
        root: gives the root context at the end of the run.
        elapsed: wall-clock time of the simulation [s].
        panel: the page on which it was shown, or None.
        again: carries it out once more, in real time where it was shown.
    """

    loop: ClosedLoop[Any]
    root: Callable[[], Context]
    elapsed: float
    panel: Panel | None
    again: Callable[[], float]

    @cached_property
    def context(self) -> Context:
        """Root context at the end of the run."""
        return self.root()

    @property
    def realtime_factor(self) -> float:
        """Simulated time by wall-clock time."""
        return float(self.time[-1]) / self.elapsed


def realtime_metric(*runs: Run) -> Metric:
    """Metric for the speed of the slowest of some runs."""
    factor = min(run.realtime_factor for run in runs)
    meaning = "simulated time by wall-clock time"
    return Metric("realtime_factor", factor, meaning=meaning, is_timing=True)
