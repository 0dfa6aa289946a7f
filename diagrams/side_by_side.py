"""Closed loops of many scenarios, simulated together."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, EventStatus, System

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.recording import Recording
from parapod.diagrams.rows import RowsSimulator
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.leaf_system import RootOfRow
from parapod.systems.core.schema import differing, plain


class LoopRows[S]:
    """Closed loops of many scenarios of one structure, simulated together.

    Use it as a Simulator: after `rows.advance_to(30.0)`, `rows.recording(i)` is what
    `loop.recording` is after Drake's run of scenario i. A row that fails ends alone.
    """

    def __init__(self, loop: ClosedLoop[S], scenarios: Sequence[S]):
        """Puts every row at its beginning.

        Args:
            loop: loop of any of the scenarios; it records the signals of its logs.
            scenarios: a scenario of the loop's machine for each row.

        Raises:
            ScenarioError: a scenario of another structure; names the key.
            ParapodError: a system that rows cannot have, or more rows than memory.
        """
        if not scenarios:
            raise ParapodError("rows need at least one scenario")
        self.loop, self.scenarios = loop, scenarios
        _check_structures(loop, scenarios)
        root = loop.CreateDefaultContext()

        def beginnings() -> Iterator[Context]:
            for scenario in scenarios:
                loop.reset(root, scenario)
                yield root

        self._simulator = RowsSimulator(loop, beginnings())
        for name, sink in loop.logs.items():
            self._simulator.log(sink, name)
        settings: Any = loop.scenario
        self.period: float = loop.machine.view.log_every * settings.control.period

    @property
    def errors(self) -> Mapping[int, Exception]:
        """Reasons why rows have ended, by their numbers."""
        return self._simulator.errors

    @property
    def one_by_one(self) -> Sequence[str]:
        """Paths of systems whose laws were carried out row by row, which is slow."""
        return sorted(self._simulator.one_by_one)

    def advance_to(
        self, until: float, monitors: Sequence[Callable[[Any], EventStatus] | None] = ()
    ) -> None:
        """Simulates all rows that go on.

        Args:
            until: time at the end [s].
            monitors: for each row one as Drake's Simulator has it, which may end the row, or None;
                called with a `RowOfLoop`.

        Raises:
            ParapodError: more rows than memory.
        """
        needed = len(self.scenarios) * bytes_of_row(self.loop, until - self._simulator.time)
        free = _free_memory()
        if needed > free:
            raise ParapodError(
                f"{len(self.scenarios)} rows need {needed / 2**30:.1f} GiB to record "
                f"{until:g} s, and {free / 2**30:.1f} GiB are free: record fewer signals, or take "
                f"at most {int(free * len(self.scenarios) / needed)} rows at a time"
            )
        look = None
        if any(monitors):
            watched = {
                row: (monitor, RowOfLoop(self._simulator, row))
                for row, monitor in enumerate(monitors)
                if monitor is not None
            }
            look = partial(_ending, watched, self._simulator.errors)
        self._simulator.advance_to(until, self.period, look)

    def context(self, row: int) -> Context:
        """A root context of the loop as it is at the end of a row."""
        root = self.loop.CreateDefaultContext()
        self.loop.reset(root, self.scenarios[row])
        self._simulator.write(row, root)
        return root

    def recording(self, row: int) -> Recording:
        """Signals of a row.

        Raises:
            Exception: the reason why it has failed.
        """
        if (error := self.errors.get(row)) is not None:
            raise error
        names = self.loop.logs
        signals = {name: self._simulator.signal(name, row) for name in names}
        units = {name: self.loop.machine.unit(name) for name in names}
        return Recording(self._simulator.times(row), signals, units)


class RowOfLoop(RootOfRow):
    """A row in place of its root context: time, and values of ports by `value_of`."""

    def __init__(self, simulator: RowsSimulator, row: int):
        self._simulator, self._row = simulator, row

    def get_time(self) -> float:
        """Time [s]."""
        return self._simulator.time

    def value(self, system: System, port: str) -> NDArray[np.float64]:
        """Present value of a port of a system of the loop."""
        return self._simulator.value(system, port, self._row)


_GOING_ON = (EventStatus.Severity.kDidNothing, EventStatus.Severity.kSucceeded)


def _ending(
    watched: Mapping[int, tuple[Callable[[Any], EventStatus], RowOfLoop]],
    errors: dict[int, Exception],
    rows: Sequence[int],
) -> list[int]:
    """Rows that their monitors end, or fail at."""
    ending = []
    for row in rows:
        if row in watched:
            monitor, root = watched[row]
            try:
                is_over = monitor(root).severity() not in _GOING_ON
            except Exception as error:
                errors[row], is_over = error, True
            if is_over:
                ending.append(row)
    return ending


def _free_memory() -> int:
    """Memory that programs can have, files that are kept in it included [B]."""
    with suppress(OSError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            name, _, amount = line.partition(":")
            if name == "MemAvailable":
                return 1024 * int(amount.split()[0])
    return sys.maxsize  # unknown, not on Linux


def bytes_of_row(loop: ClosedLoop[Any], duration: float) -> int:
    """Memory that the recording of a row of a loop needs at most [B].

    Args:
        loop: the loop, with its logs.
        duration: time that is recorded [s].
    """
    settings: Any = loop.scenario
    samples = duration / (loop.machine.view.log_every * settings.control.period) + 1
    return int(8 * samples * sum(sink.get_input_port().size() for sink in loop.logs.values()))


def _check_structures(loop: ClosedLoop[Any], scenarios: Sequence[Any]) -> None:
    machine = loop.machine
    structure = machine.structure(loop.scenario)
    for row, scenario in enumerate(scenarios):
        if machine.structure(scenario) != structure:
            resets = machine.resets(loop.scenario)
            keys = (key for key, _ in differing(plain(loop.scenario), plain(scenario)))
            key = next((key for key in keys if key not in resets), "")
            raise ScenarioError(
                f"{key} of row {row} is not that of the loop: it is built in, and rows of one "
                f"simulation differ only in what a loop is reset to, such as "
                f"{', '.join(list(resets)[:4])}",
                key,
            )
