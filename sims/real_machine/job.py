"""A job on the real machine, in real time."""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.devices import Parts
from parapod.diagrams.drivers.driver import time_of
from parapod.diagrams.guard import Guard, Tripped
from parapod.diagrams.station import Station
from parapod.sims.output.logs.live import LiveLog
from parapod.sims.output.options import RunOptions
from parapod.sims.output.progress import progress
from parapod.sims.real_machine.age_limit import ages_of, allow_old_measurements
from parapod.sims.real_machine.phase import Phase
from parapod.sims.real_machine.real_time import (
    USUAL,
    DeadlineError,
    RealTimeLoop,
    Timing,
    percentiles,
    rehearse,
    undisturbed,
)
from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.core.scenario_file import dump_scenario
from parapod.systems.hardware.clock import monotonic, sleep
from parapod.systems.hardware.io import DeviceThread
from parapod.systems.hardware.position_memory import IncrementalDevice
from parapod.systems.hardware.signals import ended_by_signals

# A device that has been wrong for so long does not come back by itself [s].
_PATIENCE = 0.2
# Ratio of the rates at which trust is lost and comes back [-].
_DISTRUST = 4.0


# Longer than anybody operates a machine at a stretch [s].
_FOREVER = 1e6


class _Over(Exception):
    """The work is done."""


def _nothing(now: float) -> None:
    """Ignores the progress of work of unknown duration."""


def _unheard(timing: Timing) -> None:
    """Ignores a timing that is not used before the end."""


class DeviceWatch:
    """Ends a run in which a device has failed; for controllers that have no supervisor.

    The time for which a device is wrong is added up, and forgotten four times slower while it is
    right again: one that comes and goes is found as well.
    """

    def __init__(self, threads: Sequence[DeviceThread], patience: float = _PATIENCE):
        """Begins to watch.

        Args:
            threads: threads of the devices.
            patience: time for which a device may be wrong [s].
        """
        self._threads, self._patience = threads, patience
        self._wrong = [0.0] * len(threads)
        self._checked: float | None = None

    def check(self, now: float) -> None:
        """Looks at every device.

        Args:
            now: `clock.monotonic` [s].

        Raises:
            DeviceError: one has been wrong for too long; has its words.
        """
        since = 0.0 if self._checked is None else now - self._checked
        self._checked = now
        for i, thread in enumerate(self._threads):
            error = thread.error
            if error is None:
                self._wrong[i] = max(0.0, self._wrong[i] - since / _DISTRUST)
                continue
            self._wrong[i] += since
            if self._wrong[i] > self._patience:
                raise error


def run_on_hardware(
    loop: ClosedLoop[Any],
    simulator: Simulator,
    until: float,
    options: RunOptions,
    what: str,
    is_over: Callable[[Context], bool] = lambda root: False,
    requests: Collection[str] = USUAL,
    announce: Callable[[Timing], None] = _unheard,
) -> Timing:
    """Runs a closed loop whose station is hardware; the machine is neutral when this returns.

    Configures and activates the devices, begins with what they measure, and deactivates them at
    the end, after Ctrl-C, after a signal that ends programs, and after any error.

    Args:
        loop: built for the backend "hardware".
        simulator: simulator of its diagram.
        until: end of the run [s]; infinite: until `is_over`.
        options: console for progress, and file of the log.
        what: name of the work, for the progress and in the log.
        is_over: called with the root context at every tick; whether the work is done.
        requests: names of the privileges that it takes, see `privileges`.
        announce: is given the timing before the first tick, also of a run that then fails.

    Raises:
        DeviceError: a device is not there, is another one, or has failed.
        Tripped: the machine's guard has found what cannot be.
        DeadlineError: this computer is too slow.
        OutputError: the log cannot be written, or is not to be an MCAP file.
        ScenarioError: the devices are the emulator's, and there is none.
    """
    station = loop.station
    parts = station.behind.handle_as(Parts)
    root = simulator.get_mutable_context()
    watch = DeviceWatch(parts.all_threads)
    with ExitStack() as stack:
        drivers = loop.machine.drivers(station.scenario)
        clock = stack.enter_context(time_of(drivers, loop.machine.experiment))
        stack.enter_context(ended_by_signals())
        write = stack.enter_context(logged(options, loop, root, what))
        # Before any device waits for heartbeats, because a collection stops all threads; and the
        # devices' threads, which send them, inherit the priority.
        outcomes = stack.enter_context(undisturbed(requests))

        def say(text: str) -> None:
            options.console.print(text, markup=False, highlight=False, soft_wrap=True)

        def say_news() -> None:
            for text in parts.news():
                say(text)

        stack.callback(say_news)  # also of devices that are refused
        stack.enter_context(station.active())
        say_news()
        report: Callable[[float], None] = _nothing
        if until < _FOREVER:
            report = stack.enter_context(progress(options.console, what, until))
        loop.reset(root)
        simulator.Initialize()
        rehearse(loop, root)
        guard = loop.machine.real.guard and loop.machine.real.guard(station.scenario)
        look = partial(ages_of, parts.all_threads, station.scenario.control.period)
        allow_old_measurements(loop, root, guard, look, say)
        guarded = end_by_guard(loop, root, guard)

        def on_tick(context: Context) -> None:
            # First, so that a log shows the tick that has ended the job.
            write(context.get_time())
            watch.check(monotonic())
            guarded(monotonic())
            report(context.get_time())
            if is_over(context):
                raise _Over

        phase = Phase(parts.all_threads, station.scenario.control.period)
        running = RealTimeLoop(
            simulator, station.scenario.control.period, on_tick, shift=phase.shift
        )
        running.timing.refused = tuple(each for each in outcomes if not each.is_taken)
        running.timing.clock = clock
        announce(running.timing)
        # Those of the beginning have grown old meanwhile.
        parts.await_measurements(_PATIENCE)
        # The first tick follows those that come by themselves.
        sleep(-phase.late(monotonic()) % station.scenario.control.period)
        try:
            running.run(min(until, _FOREVER))
        except _Over:
            pass
        except DeadlineError as error:
            raise DeadlineError(f"{error}{_unprivileged(running.timing)}") from None
    return running.timing


def _unprivileged(timing: Timing) -> str:
    """Remark about a loop that other programs, or the disk, may delay."""
    return "".join(f"; {outcome.text}" for outcome in timing.refused)


def end_by_guard(
    loop: ClosedLoop[Any], root: Context, guard: Guard | None
) -> Callable[[float], None]:
    """A check, at a time [s], that ends the job when the machine's guard does.

    No file remembers positions of parts that the guard distrusts. Before the first command that is
    not idle nothing has moved, and they stay known.

    Args:
        loop: the loop.
        root: its context, initialized.
        guard: the guard; None for a machine without one.
    """
    if guard is None or loop.machine.real.guard is None:
        return lambda now: None
    idle = {spec.name: (spec.idle, spec.neutral) for spec in loop.machine.inputs}
    commands = loop.readings(root, frozenset(idle))
    has_acted = False
    parts = loop.station.behind.handle_as(Parts)
    signals = loop.readings(root, guard.signals)
    # What runs for the first time is slow: another guard does it, on a copy, and is forgotten.
    first = loop.readings(root.Clone(), guard.signals)
    loop.machine.real.guard(loop.station.scenario).check(
        0.0, {n: read() for n, read in first.items()}
    )

    def check(now: float) -> None:
        nonlocal has_acted
        has_acted = has_acted or not all(
            _is_any(read(), idle[name]) for name, read in commands.items()
        )
        trip = guard.check(now, {name: read() for name, read in signals.items()})
        if trip is None:
            return
        for part in trip.distrusted if has_acted else ():
            for thread in parts.threads[part]:
                if isinstance(thread.device, IncrementalDevice):
                    thread.device.distrust()
        if not trip.ends:
            return
        # A device that says what is wrong with it knows better.
        errors = (thread.error for thread in parts.all_threads)
        raise next(filter(None, errors), Tripped(trip, loop.machine.axes))

    return check


def _is_any(values: NDArray[np.float64], numbers: Iterable[float]) -> bool:
    """Whether all values equal one of these numbers."""
    return any(
        np.array_equal(values, np.full_like(values, number), equal_nan=True) for number in numbers
    )


@contextmanager
def logged(
    options: RunOptions, loop: ClosedLoop[Any], root: Context, what: str
) -> Iterator[Callable[[float], None]]:
    """Yields what writes all ports to an MCAP file; without one, nothing.

    Args:
        options: file of the log, and console for what is wrong with it.
        loop: the loop.
        root: its context.
        what: name of the work.

    Raises:
        OutputError: the log cannot be written, or is not to be an MCAP file.
    """
    path = options.log
    if path is None:
        yield lambda _: None
        return
    if path.suffix != ".mcap":
        raise OutputError(
            f"--log {quoted_path(path)}: a log of hardware is an MCAP file, NAME.mcap", path
        )
    metadata = {
        "experiment": what,
        "parapod": version("parapod"),
        "scenario": dump_scenario(loop.station.scenario),
    }
    signals = loop.readings(root)
    units = {name: loop.machine.unit(name) for name in loop.ports}
    sizes = [port.size() for port in loop.ports.values()]

    def tell(text: str) -> None:
        options.console.print(text, markup=False, highlight=False, soft_wrap=True)

    with LiveLog(path, units, sizes, metadata, tell) as log:
        yield lambda t: log.write(t, [read() for read in signals.values()])


def punctuality_of(timing: Timing) -> str:
    """Line that tells how punctual a loop was."""
    late, cost = percentiles(timing.late), percentiles(timing.cost)
    tick_count = len(timing.cost)
    newest = f" of the last {tick_count}" if tick_count < timing.ticks else ""
    return (
        f"{timing.ticks} ticks of {1e3 * timing.period:g} ms, {timing.missed} missed; "
        f"late {_ms(late)}, cost {_ms(cost)} ms (median, 99 %, largest{newest})"
    )


def show_timing(timing: Timing, station: Station[Any], console: Console) -> None:
    """Says how punctual the loop was and how old measurements were when they had an effect."""
    lines = [f"{punctuality_of(timing)}{_unprivileged(timing)}"]
    if timing.clock is not None:
        physics, controllers = timing.waited
        lines.append(
            f"emulated time at rate {timing.clock.rate:g}; it has waited {physics:.2f} s for the "
            f"emulated machine and {controllers:.2f} s for this program"
        )
    if timing.disk_faults:
        lines.append(
            f"{timing.disk_faults} pages of the program were read from the disk meanwhile"
        )
    parts = station.behind.handle_as(Parts)
    for thread in parts.all_threads:
        ages = thread.write_ages
        if ages and thread.device.measures:
            over = sum(age > timing.period for age in ages)
            lines.append(
                f"{thread.device.name}: measurements were {_ms(percentiles(ages))} ms old when "
                f"commands made of them had been written, {over} of {len(ages)} above one period"
            )
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _ms(seconds: NDArray[np.float64]) -> str:
    return ", ".join(f"{1e3 * value:.2f}" for value in seconds)
