"""Speed of a simulated closed loop."""

from collections.abc import Callable
from typing import Any

from pydrake.systems.analysis import Simulator

from benchmarks.report import Measurement
from benchmarks.yardstick import Pace, Yardstick, seconds
from parapod.diagrams.closed_loop import ClosedLoop


def real_time_factor(
    loop: ClosedLoop[Any], duration: float, yardstick: Yardstick, runs: int
) -> tuple[float, Pace]:
    """Best of some runs of the whole loop from its beginning, and the pace of the yardstick.

    Args:
        loop: loop without a recording.
        duration: simulated time [s].
        yardstick: taken before, between and after the runs.
        runs: number of runs; what a neighbour on the machine costs is in the slower ones.
    """
    best, pace = yardstick.best_beside(lambda: _run(loop, duration), runs)
    return duration / best, pace


def measured_factor(
    name: str,
    loop: ClosedLoop[Any],
    duration: float,
    yardstick: Yardstick,
    floor: float,
    aim: float | None = None,
    runs: int = 3,
) -> Measurement:
    """The real-time factor of a loop beside its bound, see `real_time_factor`."""
    factor, pace = real_time_factor(loop, duration, yardstick, runs)
    return Measurement(f"real-time factor, {name}", factor, "x", floor, aim, pace=pace)


def rate(
    work: Callable[[], object], count: float, yardstick: Yardstick, runs: int = 5
) -> tuple[float, Pace]:
    """Number of things a second that some work does, best of some runs, and the pace [1/s]."""
    best, pace = yardstick.best_beside(lambda: seconds(work), runs)
    return count / best, pace


def _run(loop: ClosedLoop[Any], duration: float) -> float:
    simulator = Simulator(loop)
    if loop.monitor is not None:
        simulator.set_monitor(loop.monitor)
    simulator.Initialize()
    return seconds(lambda: simulator.AdvanceTo(duration))
