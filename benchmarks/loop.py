"""Breakdown of a loop's tick: the time of each system, its calls and its reads of ports.

Without an experiment those of the levelling platform, and its controller alone.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, InputPort, LeafSystem, OutputPort
from rich.console import Console
from rich.table import Table

import parapod
from benchmarks.realtime import CASES, moving_controller, platform_loop
from benchmarks.report import make_console
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.discovery import find_experiment
from parapod.systems.core import ports

# Simulated time that passes before anything is counted, and that is counted [s].
_BEFORE, _COUNTED = 2.0, 6.0
_RUNS = 3
_DECLARE = (
    *("DeclareVectorOutputPort", "DeclareAbstractOutputPort"),
    *("DeclarePeriodicDiscreteUpdateEvent", "DeclarePerStepDiscreteUpdateEvent"),
    *("DeclarePeriodicUnrestrictedUpdateEvent", "DeclarePeriodicPublishEvent"),
    *("DeclarePerStepUnrestrictedUpdateEvent", "DeclarePerStepPublishEvent"),
)
_READ = ((InputPort, "Eval"), (InputPort, "EvalBasicVector"), (OutputPort, "Eval"))


@dataclass
class Callback:
    """Tally of one method that C++ calls.

    Attributes:
        system: to which it belongs.
        name: name of the output port, or of the method.
        calls: number of calls; for an output, of those that calculated it anew.
        reads: number of ports that it read.
        seconds: time in it, without the callbacks that its reads caused and without the reads.
        reading: time in its reads, without the callbacks that they caused.
    """

    system: Any
    name: str
    calls: int = 0
    reads: int = 0
    seconds: float = 0.0
    reading: float = 0.0


@dataclass
class Tally:
    """Calls from C++ into Python and reads of ports from there, while `counting`.

    Attributes:
        callbacks: those of the systems made while `counting`.
    """

    callbacks: list[Callback] = field(default_factory=list)
    # What is on the stack: a callback and the time at which its own began to count again.
    _stack: list[Callback] = field(default_factory=list)
    _since: float = 0.0

    def clear(self) -> None:
        for callback in self.callbacks:
            callback.calls = callback.reads = 0
            callback.seconds = callback.reading = 0.0

    def counted(self, system: Any, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, counted as a callback of a system."""
        tally = Callback(system, name)
        self.callbacks.append(tally)
        stack, clock = self._stack, time.perf_counter

        def call(*args: Any) -> Any:
            now = clock()
            if stack:
                stack[-1].reading += now - self._since
            stack.append(tally)
            tally.calls += 1
            self._since = clock()
            try:
                return function(*args)
            finally:
                now = clock()
                tally.seconds += now - self._since
                stack.pop()
                self._since = clock()

        return call

    def read(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The same method of a port, counted as a read by the callback that calls it."""
        stack, clock = self._stack, time.perf_counter

        def call(*args: Any) -> Any:
            if not stack:
                return function(*args)
            reader = stack[-1]
            now = clock()
            reader.seconds += now - self._since
            reader.reads += 1
            self._since = clock()
            try:
                return function(*args)
            finally:
                now = clock()
                reader.reading += now - self._since
                self._since = clock()

        return call


@contextmanager
def counting() -> Iterator[Tally]:
    """Counts the callbacks of systems that are made, and simulated, in this context."""
    tally = Tally()
    leaf: Any = LeafSystem
    of_ports: Any = ports
    before = [(leaf, name, getattr(leaf, name)) for name in _DECLARE]
    before += [(leaf, "DeclareCacheEntry", leaf.DeclareCacheEntry)]
    before += [(of_ports, "ValueProducer", of_ports.ValueProducer)]
    before += [(owner, name, getattr(owner, name)) for owner, name in _READ]
    try:
        for name in _DECLARE:
            setattr(leaf, name, _declaring(tally, getattr(leaf, name)))
        leaf.DeclareCacheEntry = _declaring_cache(tally, leaf.DeclareCacheEntry)
        of_ports.ValueProducer = _making_producers(tally, of_ports.ValueProducer)
        for owner, name in _READ:
            setattr(owner, name, tally.read(getattr(owner, name)))
        yield tally
    finally:
        for owner, name, original in before:
            setattr(owner, name, original)


def _declaring(tally: Tally, declare: Callable[..., Any]) -> Callable[..., Any]:
    is_output = "Output" in declare.__name__

    def call(system: Any, *args: Any, **kwargs: Any) -> Any:
        values = [*args, *kwargs.values()]
        name = next((x for x in values if isinstance(x, str)), "") if is_output else ""

        def counted(x: Any) -> Any:
            if not callable(x) or isinstance(x, type):
                return x
            return tally.counted(system, name or getattr(x, "__name__", "event"), x)

        return declare(
            system, *map(counted, args), **{key: counted(x) for key, x in kwargs.items()}
        )

    return call


def _making_producers(tally: Tally, make: Callable[..., Any]) -> Callable[..., Any]:
    def call(allocate: Any, calc: Callable[..., Any]) -> Any:
        return make(allocate, tally.counted(None, "", calc))  # named by what declares the entry

    return call


def _declaring_cache(tally: Tally, declare: Callable[..., Any]) -> Callable[..., Any]:
    def call(system: Any, name: str, *args: Any) -> Any:
        tally.callbacks[-1].system, tally.callbacks[-1].name = system, f"({name})"
        return declare(system, name, *args)

    return call


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser("python -m benchmarks loop", description=__doc__)
    parser.add_argument("experiment", nargs="?", metavar="EXPERIMENT", help="its loop instead")
    parser.add_argument("settings", nargs="*", metavar="KEY=VALUE", help="its scenario's")
    options, console = parser.parse_args(arguments), make_console()
    if options.experiment is not None:
        experiment: Any = find_experiment(options.experiment)
        scenario = parapod.scenario(options.experiment, *options.settings)
        make = partial(experiment.loop, scenario, log=())
        _report(console, options.experiment, make, experiment.machine_scenario(scenario))
        return 0
    for case in CASES:
        _report(console, case.name, partial(platform_loop, case), case.scenario())
    scenario = LevellingScenario()
    _report(console, "controller alone", partial(moving_controller, scenario), scenario)
    return 0


def _report(console: Console, title: str, make: Callable[[], Diagram], scenario: Any) -> None:
    period = scenario.control.period
    plain = min(_seconds(Simulator(make())) for _ in range(_RUNS)) * period / _COUNTED
    # Each callback is timed by the wall: the fastest run is the least disturbed one.
    counted, tally = min((_counted(make) for _ in range(_RUNS)), key=lambda result: result[0])
    counted *= period / _COUNTED
    ticks = _COUNTED / period
    of_systems: dict[str, list[Callback]] = {}
    for callback in tally.callbacks:
        if callback.calls:
            path = callback.system.GetSystemPathname().removeprefix("::").split("::", 1)[-1]
            of_systems.setdefault(path, []).append(callback)
    table = Table(title=title, title_justify="left", title_style="bold")
    table.add_column("system", no_wrap=True)
    for heading in ("own us", "reading us", "calls", "reads"):
        table.add_column(heading, justify="right")
    table.add_column("calculated")
    for path, callbacks in sorted(of_systems.items(), key=lambda item: -_own(item[1])):
        each = ", ".join(f"{c.name} {c.calls / ticks:.3g}" for c in callbacks)
        table.add_row(path, *_sums(callbacks, ticks), each)
    table.add_section()
    everything = [callback for callbacks in of_systems.values() for callback in callbacks]
    table.add_row("all of Python", *_sums(everything, ticks))
    console.print(table)
    in_python = 1e6 * sum(c.seconds + c.reading for c in everything) / ticks
    console.print(
        f"one tick of {1e3 * period:g} ms: {1e6 * plain:.4g} us "
        f"({period / plain:.4g} x real time); {1e6 * counted:.4g} us while it is counted, "
        f"of which {1e6 * counted - in_python:.4g} us are Drake's between the callbacks",
        highlight=False,
    )


def _counted(make: Callable[[], Diagram]) -> tuple[float, Tally]:
    with counting() as tally:
        return _seconds(Simulator(make()), tally), tally


def _sums(callbacks: Sequence[Callback], ticks: float) -> list[str]:
    """Columns of a row, each a tick: own time, time of reading, calls, reads."""
    sums = (
        1e6 * _own(callbacks),
        1e6 * sum(c.reading for c in callbacks),
        sum(c.calls for c in callbacks),
        sum(c.reads for c in callbacks),
    )
    return [f"{x / ticks:.3g}" for x in sums]


def _own(callbacks: Sequence[Callback]) -> float:
    return sum(callback.seconds for callback in callbacks)


def _seconds(simulator: Simulator, tally: Tally | None = None) -> float:
    """Seconds for the time that is counted."""
    system = simulator.get_system()
    if (monitor := getattr(system, "monitor", None)) is not None:
        simulator.set_monitor(monitor)
    simulator.Initialize()
    simulator.AdvanceTo(_BEFORE)
    if tally is not None:
        tally.clear()
    began = time.perf_counter()
    simulator.AdvanceTo(_BEFORE + _COUNTED)
    return time.perf_counter() - began
