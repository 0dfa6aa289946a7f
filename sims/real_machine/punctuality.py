"""Punctuality of this computer: the controller in real time, beside a loop that only wakes up."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machine import Machine
from parapod.sims.output.progress import progress
from parapod.sims.real_machine.real_time import (
    RealTimeLoop,
    Timing,
    percentiles,
    rehearse,
    undisturbed,
)
from parapod.sims.real_machine.wake_up import wake_up_latency
from parapod.systems.hardware.signals import ended_by_signals


@dataclass(frozen=True)
class Punctuality:
    """Punctuality at one rate; times are median, 99th percentile and largest [s].

    Attributes:
        rate: rate of the loop [Hz].
        period_error: difference of the time between two ticks from the period.
        cost: duration of a tick.
        missed: deadlines without a tick.
        wake_up: delay after its deadline of a program that does nothing but wake up, in turns
            with the loop, at the same rate.
    """

    rate: float
    period_error: NDArray[np.float64]
    cost: NDArray[np.float64]
    missed: int
    wake_up: NDArray[np.float64]

    def as_json(self) -> dict[str, float]:
        """The figures by their names [ms]."""
        values: dict[str, float] = {"rate_hz": self.rate, "missed": self.missed}
        for what in ("period_error", "cost", "wake_up"):
            for name, value in zip(("p50", "p99", "max"), getattr(self, what), strict=True):
                values[f"{what}_{name}_ms"] = 1e3 * float(value)
        return values


def measure_punctuality(
    machine: Machine[Any],
    scenario: Any,
    rates: Sequence[float],
    seconds: float,
    console: Console,
) -> list[Punctuality]:
    """Runs the closed loop in real time at each rate, in turns with a loop that only wakes up.

    Args:
        machine: the machine.
        scenario: one of its scenarios; its `control.period` is replaced.
        rates: rates of the loop [Hz].
        seconds: duration of each run [s].
        console: console for progress.
    """
    results = []
    with progress(console, "real time", 2.0 * seconds * len(rates)) as report:
        for k, rate in enumerate(rates):
            timing, wake_up = _run(
                machine, scenario, rate, seconds, partial(_report, report, k, seconds)
            )
            results.append(
                Punctuality(
                    rate,
                    percentiles(timing.period_error),
                    percentiles(timing.cost),
                    timing.missed,
                    percentiles(wake_up),
                )
            )
    return results


def _report(report: Callable[[float], None], run: int, seconds: float, t: float) -> None:
    report(2.0 * (run * seconds + t))


def _run(
    machine: Machine[Any],
    scenario: Any,
    rate: float,
    seconds: float,
    report: Callable[[float], None],
) -> tuple[Timing, list[float]]:
    """Timing of the loop at one rate, and the lateness of waking up [s]."""
    control = replace(scenario.control, period=1.0 / rate)
    loop = ClosedLoop(machine, replace(scenario, control=control), log=())
    simulator = loop.simulator()
    wake_up: list[float] = []
    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        stack.enter_context(loop.station.active())
        loop.reset(simulator.get_mutable_context())
        simulator.Initialize()
        rehearse(loop, simulator.get_context())
        # A measurement is of all its ticks, however many.
        running = RealTimeLoop(
            simulator,
            1.0 / rate,
            lambda context: report(context.get_time()),
            is_strict=False,
            kept=None,
        )
        stack.enter_context(undisturbed())
        # In turns, so that both see the same disturbances.
        for k in range(1, round(seconds) + 1):
            running.run(float(k))
            wake_up += wake_up_latency(1.0 / rate, 1.0)
    return running.timing, wake_up


def print_punctuality(results: Sequence[Punctuality], console: Console) -> None:
    """Prints a table, in milliseconds."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for name in ("rate", "period error", "tick cost", "missed", "wake-up alone"):
        table.add_column(name, justify="right", no_wrap=True)
    for result in results:
        table.add_row(
            f"{result.rate:g} Hz",
            _shown(result.period_error),
            _shown(result.cost),
            str(result.missed),
            _shown(result.wake_up),
        )
    console.print(table)
    console.print("median / 99 % / largest, in milliseconds", highlight=False)


def _shown(seconds: NDArray[np.float64]) -> str:
    return " / ".join(three_digits(1e3 * value) for value in seconds)


def three_digits(ms: float) -> str:
    """Format a time with four characters, so that three times three fit a terminal."""
    decimals = 2 if ms < 9.995 else 1 if ms < 99.95 else 0
    return f"{ms:.{decimals}f}"
