"""Closed loops of many scenarios, simulated together."""

import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydrake.systems.framework import Context

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.recording import Recording
from parapod.diagrams.rows import RowsSimulator
from parapod.systems.core.errors import ParapodError, ScenarioError
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

    def bytes_for(self, duration: float) -> int:
        """Memory that the recording of a row needs [B].

        Args:
            duration: time that is recorded [s].
        """
        return bytes_of_row(self.loop, duration)

    def advance_to(self, until: float) -> None:
        """Simulates all rows that go on.

        Args:
            until: time at the end [s].

        Raises:
            ParapodError: more rows than memory.
        """
        needed = len(self.scenarios) * self.bytes_for(until - self._simulator.time)
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        if needed > free:
            raise ParapodError(
                f"{len(self.scenarios)} rows need {needed / 2**30:.1f} GiB to record "
                f"{until:g} s, and {free / 2**30:.1f} GiB are free: record fewer signals, or take "
                f"at most {int(free * len(self.scenarios) / needed)} rows at a time"
            )
        self._simulator.advance_to(until, self.period)

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
        return Recording(self._simulator.times(), signals, units)


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
