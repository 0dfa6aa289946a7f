"""Closed loops of many scenarios, simulated together."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, Diagram, EventStatus, System

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

    def __init__(self, loops: ClosedLoop[S] | Sequence[ClosedLoop[S]], scenarios: Sequence[S]):
        """Puts every row at its beginning.

        Args:
            loops: the loop of any of the scenarios, if it serves all; or a loop for each of them,
                wired alike. The signals of the first one's logs are recorded.
            scenarios: a scenario of the loop's machine for each row.

        Raises:
            ScenarioError: a scenario of another structure than the one loop, or one whose loop
                is wired otherwise; names the key.
            ParapodError: a system that rows cannot have, or more rows than memory.
        """
        if not scenarios:
            raise ParapodError("rows need at least one scenario")
        if isinstance(loops, ClosedLoop):
            _check_structures(loops, scenarios)
            loops = [loops] * len(scenarios)
        self.loop, self.scenarios, self._loops = loops[0], scenarios, loops
        _check_forms(loops)
        roots: dict[int, Context] = {}

        def beginnings() -> Iterator[tuple[Diagram, Context]]:
            for own, scenario in zip(self._loops, scenarios, strict=True):
                if id(own) not in roots:
                    roots.clear()  # each is large
                    roots[id(own)] = own.CreateDefaultContext()
                own.reset(roots[id(own)], scenario)
                yield own, roots[id(own)]

        self._simulator = RowsSimulator(self.loop, beginnings())
        for name, sink in self.loop.logs.items():
            self._simulator.log(sink, name)

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
        self._simulator.advance_to(until, self.loop.sampling_period, look)

    def context(self, row: int) -> Context:
        """A root context of a row's loop as it is at the end."""
        root = self._loops[row].CreateDefaultContext()
        self._loops[row].reset(root, self.scenarios[row])
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
    samples = duration / loop.sampling_period + 1
    return int(8 * samples * sum(sink.get_input_port().size() for sink in loop.logs.values()))


def _check_structures(loop: ClosedLoop[Any], scenarios: Sequence[Any]) -> None:
    structure = loop.machine.structure(loop.scenario)
    for row, scenario in enumerate(scenarios):
        if loop.machine.structure(scenario) != structure:
            examples = ", ".join(list(loop.machine.resets(loop.scenario))[:4])
            raise _differing(
                loop,
                row,
                scenario,
                f"it is built in: rows of one loop differ only in what it is reset to, such as "
                f"{examples}",
            )


def _check_forms(loops: Sequence[ClosedLoop[Any]]) -> None:
    first = loops[0]
    for row, loop in enumerate(loops):
        if loop is not first and loop.form != first.form:
            raise _differing(
                first,
                row,
                loop.scenario,
                "its loop is wired otherwise: rows of one simulation may differ in numbers, not "
                "in their systems, ports and periods",
            )


def _differing(loop: ClosedLoop[Any], row: int, scenario: Any, reason: str) -> ScenarioError:
    """Error that names the first key in which a scenario is not that of a loop."""
    resets = loop.machine.resets(loop.scenario)
    keys = (key for key, _ in differing(plain(loop.scenario), plain(scenario)))
    key = next((key for key in keys if key not in resets), "")
    return ScenarioError(f"{key} of row {row} is not that of the loop, and {reason}", key)
