"""A diagram advanced with the wall clock: absolute deadlines, safe end when they are missed."""

import gc
import math
import resource
import sys
from collections import deque
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram

from parapod.diagrams.wiring import leaf_systems
from parapod.sims.real_machine.privileges import (
    FIFO,
    KERNEL,
    MEMORY,
    Kernel,
    Outcome,
    privileges,
)
from parapod.systems.core.errors import ParapodError
from parapod.systems.hardware.clock import EmulatedClock, Hold, hold, monotonic, sleep
from parapod.systems.hardware.signals import signals_between_ticks

# A controller that is this late is not in control [s].
_HOPELESS = 0.1
# This share of missed deadlines within a second is a computer that is too slow [-].
_TOLERATED_SHARE = 0.5
_WINDOW = 1.0  # [s]
# An emulated time waits for ticks that begin, or take, so much longer [periods].
_LATE, _SLOW = 0.1, 0.5
# Part of a period between two ticks that make up for lost time [-].
_HURRIED = 0.8
# Time for which a thread may compute while others wait for the interpreter [s]; Python's own
# is 5 ms.
SWITCH_INTERVAL = 1e-4
# Number of ticks whose timing is kept: a quarter of an hour at 100 Hz.
KEPT = 100_000
# Privileges of every job.
USUAL = (FIFO, MEMORY)


class DeadlineError(ParapodError):
    """A computer that does not keep up with the machine; the machine has been stopped."""


@dataclass
class Timing:
    """Punctuality of a loop.

    A loop may run for days: `late`, `cost`, and the values calculated from them cover its newest
    100 000 ticks unless `kept` says otherwise. The counts cover all ticks.

    Attributes:
        period: period of the loop [s].
        kept: number of the newest ticks in `late` and `cost`; None for all.
        late: delay of each tick after its deadline [s].
        cost: duration of each tick [s].
        ticks: number of ticks.
        missed: deadlines that passed without a tick.
        missed_at: ends of the newest ticks that left out deadlines, by the loop's clock [s].
        page_faults: pages of memory that the program touched first while the loop ran.
        disk_faults: pages that were read from the disk meanwhile.
        refused: privileges that the kernel has refused it.
        clock: emulated time by which the loop goes; None: the computer's.
        waited: emulated time that was waited for the emulated machine, and for controllers [s].
    """

    period: float
    kept: int | None = KEPT
    late: deque[float] = field(init=False)
    cost: deque[float] = field(init=False)
    missed_at: deque[float] = field(init=False)
    ticks: int = 0
    missed: int = 0
    page_faults: int = 0
    disk_faults: int = 0
    refused: tuple[Outcome, ...] = ()
    clock: EmulatedClock | None = None
    waited: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        self.late, self.cost = deque(maxlen=self.kept), deque(maxlen=self.kept)
        self.missed_at = deque(maxlen=self.kept)

    def add(self, late: float, cost: float) -> None:
        """Notes a tick.

        Args:
            late: delay of the tick after its deadline [s].
            cost: duration of the tick [s].
        """
        self.late.append(late)
        self.cost.append(cost)
        self.ticks += 1

    @property
    def period_error(self) -> list[float]:
        """By how much the time between two of these ticks differed from the period [s]."""
        return np.abs(np.diff(list(self.late))).tolist()


def percentiles(values: Collection[float]) -> NDArray[np.float64]:
    """Median, 99th percentile and maximum."""
    return np.percentile(list(values), [50.0, 99.0, 100.0]) if values else np.full(3, np.nan)


def _unshifted(due: float) -> float:
    """Keeps to the schedule."""
    return 0.0


class RealTimeLoop:
    """Advances a simulator by one period at each deadline of an absolute schedule.

    Tick k is due k periods after the beginning, whatever the ticks before have cost, unless the
    schedule is to be shifted by a small part of a period after each. When a tick comes so late
    that the next one is due as well, the schedule is moved: ticks are left out and counted, and
    never run in a burst, because each would command a machine of the past.

    The loop ends with an error when a tick would begin, or has ended, 0.1 s too late, or when half
    of the deadlines of a second are missed, whether ticks took long or began late; whoever runs it
    then stops the machine.
    """

    def __init__(
        self,
        simulator: Simulator,
        period: float,
        on_tick: Callable[[Context], None] | None = None,
        is_strict: bool = True,
        clock: Callable[[], float] = monotonic,
        sleep: Callable[[float], None] = sleep,
        kept: int | None = KEPT,
        patience: float = 0.0,
        hold: Hold | None = None,
        slack: float | None = None,
        shift: Callable[[float], float] = _unshifted,
    ):
        """Prepares the loop.

        Args:
            simulator: initialized.
            period: period of the diagram's controllers [s].
            on_tick: function called with the context after each tick; raises to end the loop.
            is_strict: missed deadlines end the loop, as said above.
            clock: monotonic [s].
            sleep: waits for a time [s].
            kept: see `Timing`.
            patience: delay up to which ticks are made up for, a quarter faster than the clock, and
                not left out [s]: for physics, whose time does not stop.
            hold: hold by which an emulated time waits for the ticks; None for a new one.
            slack: delay with which ticks may end before it waits for them [s]; None: they may
                begin a tenth of a period late, and then take half of one.
            shift: time by which all that follows the tick due at a time is shifted [s].
        """
        self._simulator, self._on_tick, self._patience = simulator, on_tick, patience
        self._slack = _LATE * period if slack is None else slack
        self._longest = _SLOW * period if slack is None else None
        self._is_strict, self._clock, self._sleep, self._hold = is_strict, clock, sleep, hold
        self._shift = shift
        self.timing = Timing(period, kept)
        self._window = max(10, round(_WINDOW / period))
        self._is_missed: deque[bool] = deque(maxlen=self._window)

    def run(self, until: float) -> None:
        """Runs to a time of the simulation; what interrupts the program does so between ticks.

        Args:
            until: [s].

        Raises:
            DeadlineError: see the class.
        """
        before = resource.getrusage(resource.RUSAGE_SELF)
        clock = self.timing.clock
        waited_before = clock.waited if clock is not None else (0.0, 0.0)
        try:
            with signals_between_ticks() as interrupted:
                self._run(until, interrupted, self._hold or hold())
        finally:
            if clock is not None:
                physics, controllers = clock.waited
                self.timing.waited = physics - waited_before[0], controllers - waited_before[1]
            after = resource.getrusage(resource.RUSAGE_SELF)
            self.timing.page_faults += after.ru_minflt - before.ru_minflt
            self.timing.disk_faults += after.ru_majflt - before.ru_majflt

    def _run(self, until: float, interrupted: Callable[[], None], standing: Hold) -> None:
        try:
            self._tick(until, interrupted, standing)
        finally:
            standing.until(math.inf)

    def _tick(self, until: float, interrupted: Callable[[], None], standing: Hold) -> None:
        period, timing = self.timing.period, self.timing
        context = self._simulator.get_context()
        begin = context.get_time()
        ticks = round((until - begin) / period)
        due = earliest = self._clock()
        for k in range(ticks):
            standing.until(due + self._slack)
            self._wait(max(due, earliest))
            interrupted()
            started = self._clock()
            if self._longest is not None:
                standing.until(started + self._longest)
            if self._is_strict and started - due > _HOPELESS:
                late = 1e3 * (started - due)
                raise DeadlineError(f"a tick would have begun {late:.0f} ms late")
            # Half a period beyond the tick, so that its writing events are in it.
            self._simulator.AdvanceTo(begin + (k + 0.5) * period)
            if self._on_tick is not None:
                self._on_tick(context)
            ended = self._clock()
            timing.add(started - due, ended - started)
            self._is_missed.append(False)
            due += period + self._shift(due)
            if self._patience and not standing.is_kept:
                earliest = started + _HURRIED * period
            if (behind := ended - due) > self._patience:
                left_out = int(behind / period) + 1
                timing.missed += left_out
                timing.missed_at.append(ended)
                self._is_missed.extend([True] * min(left_out, self._window))
                due += left_out * period
                if self._is_strict:
                    self._judge(behind)

    def _wait(self, due: float) -> None:
        while (time_left := due - self._clock()) > 0.0:
            self._sleep(time_left)

    def _judge(self, behind: float) -> None:
        timing = self.timing
        if behind > _HOPELESS:
            raise DeadlineError(f"a tick ended {1e3 * behind:.0f} ms after the next was due")
        miss_count = sum(self._is_missed)
        if miss_count >= _TOLERATED_SHARE * self._window:
            raise DeadlineError(
                f"{miss_count} of {self._window} deadlines were missed at a period of "
                f"{1e3 * timing.period:g} ms; this computer is too slow for it"
            )


def rehearse(diagram: Diagram, context: Context) -> None:
    """Calculates once what a tick calculates, on a copy of a context: nothing changes.

    What runs for the first time is slow, because pages are touched and tables are built: 14 ms of
    a period of 10 for the walking chair. Updates of discrete states and all outputs of all systems
    are calculated; events that publish, such as those that write to devices, are not triggered.

    Args:
        diagram: diagram of any depth.
        context: one of its contexts, initialized.
    """
    copy = context.Clone()
    for system in leaf_systems(diagram):
        own = system.GetMyContextFromRoot(copy)
        if system.GetUniquePeriodicDiscreteUpdateAttribute() is not None:
            system.EvalUniquePeriodicDiscreteUpdate(own)
        for k in range(system.num_output_ports()):
            system.get_output_port(k).Eval(own)


@contextmanager
def undisturbed(
    requests: Collection[str] = USUAL, kernel: Kernel = KERNEL
) -> Iterator[tuple[Outcome, ...]]:
    """Keeps Python's garbage collector and other programs away, as far as permitted.

    What exists is frozen out of the collector's sight and nothing is collected meanwhile. The
    calling thread and those that it starts get the privileges that are asked for, where the user
    may have them.

    Args:
        requests: names of `PRIVILEGES`.
        kernel: system calls.

    Yields what the kernel has said to each of them.
    """
    interval = sys.getswitchinterval()
    enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL)
    try:
        with privileges(requests, kernel) as outcomes:
            yield outcomes
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if enabled:
            gc.enable()
