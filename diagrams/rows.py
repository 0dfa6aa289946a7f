"""Simulation of many contexts of one diagram side by side: each row provably the Drake run.

The diagram stays the only definition. Its wiring, periods, offsets and holds are read from it, and
its systems' own callbacks are carried out for all rows at once, see `systems.core.rows`; the order
of events is that of Drake's Simulator.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import (
    CacheIndex,
    Context,
    Diagram,
    DiscreteStateIndex,
    NumericParameterIndex,
    System,
)
from pydrake.systems.primitives import VectorLogSink

from parapod.diagrams.leaf import Leaf, check_numbers
from parapod.diagrams.leaves import flattened, inputs_of_leaves, output_of_leaf
from parapod.diagrams.primitives import find_laws
from parapod.diagrams.wiring import leaf_systems
from parapod.systems.core import rows as rows_module
from parapod.systems.core.leaf_system import (
    DiscreteValues,
    Law,
    Output,
    RowsContext,
    zeros_for,
)
from parapod.systems.core.rows import Number, Rows, carried_out

type Floats = NDArray[np.float64]

# Samples by which the memory of a signal grows, and rows that are taken out of it at once.
_CHUNK, _BLOCK = 256, 64
_TIME = "time"


class Signal:
    """Samples of a signal of all rows."""

    def __init__(self, size: int):
        self._size = size
        # Samples (chunk, size, rows), or (chunk, size, 1) where all rows have the same; the rows,
        # and the number of samples.
        self._chunks: list[tuple[Floats, NDArray[np.intp], int]] = []
        self._block: tuple[int, Floats] = (-1, np.empty(0))

    def add(self, numbers: Sequence[Number], rows: NDArray[np.intp]) -> None:
        """Adds a sample.

        Args:
            numbers: its elements.
            rows: the rows that they are of.
        """
        width = rows.size if any(type(number) is Rows for number in numbers) else 1
        last = self._chunks[-1] if self._chunks else None
        if last is None or last[2] == _CHUNK or last[1] is not rows or last[0].shape[2] != width:
            last = np.empty((_CHUNK, self._size, width)), rows, 0
            self._chunks.append(last)
        chunk, _, count = last
        for i, number in enumerate(numbers):
            values: Any = number.values if type(number) is Rows else number
            chunk[count, i] = values
        self._chunks[-1] = chunk, rows, count + 1

    def row(self, row: int) -> Floats:
        """Samples (n, size) of a row; those after its end mean nothing."""
        block, position = divmod(row, _BLOCK)
        if self._block[0] != block:
            self._block = block, self._rows(block * _BLOCK)
        return np.array(self._block[1][:, :, position])

    def _rows(self, first: int) -> Floats:
        """Samples (n, size, rows) of some rows, which are beside each other in memory."""
        block = np.arange(first, first + _BLOCK)
        parts = []
        for chunk, rows, count in self._chunks:
            if chunk.shape[2] == 1:
                part = np.broadcast_to(chunk[:count], (count, self._size, _BLOCK))
            else:  # some may have ended, and are not asked for
                places = np.searchsorted(rows, block)
                part = chunk[:count].take(places, axis=2, mode="clip")
            parts.append(part)
        return np.concatenate(parts) if parts else np.empty((0, self._size, _BLOCK))


# Looks at rows, by their numbers, and says which of them end.
type Look = Callable[[Sequence[int]], Sequence[int]]


@dataclass(frozen=True)
class End:
    """A row that has ended before the others.

    Attributes:
        time: time at its end [s].
        samples: number of samples that it has.
        state: groups of the state, system by system.
    """

    time: float
    samples: int
    state: Sequence[Sequence[Any]]


class RowsSimulator:
    """Simulator of many contexts of one diagram.

    Attributes:
        time: time that all rows share [s].
        rows: the rows that go on, by their numbers.
        errors: reasons for which rows have ended, by their numbers.
        one_by_one: paths of systems whose laws were carried out row by row.
    """

    def __init__(self, diagram: Diagram, beginnings: Iterable[tuple[Diagram, Context]]):
        """Takes the rows' beginnings.

        Args:
            diagram: the diagram, without continuous or abstract state.
            beginnings: for each row this diagram, or one of the same `leaves.wiring_of`, and a
                context of it; each is read before the next is asked for, so that they may be one
                context that is set anew.

        Raises:
            ParapodError: a system that rows cannot have.
        """
        systems, sources = flattened(diagram)
        self.time = 0.0
        self.errors: dict[int, Exception] = {}
        self.one_by_one: set[str] = set()
        self._failed: dict[int, Exception] = {}
        self._ends: dict[int, End] = {}
        self._ports: dict[tuple[int, str], tuple[Leaf, int, bool]] = {}
        self._leaves = [Leaf(system, find_laws(system), self) for system in systems]
        for (reader, port), (giver, output) in sources.items():
            self._leaves[reader].sources[port] = self._leaves[giver], output
            if self._leaves[giver].memory is None:
                check_numbers(systems[giver], systems[giver].get_output_port(output))
        self._logs: dict[str, tuple[Leaf, Signal]] = {}
        self._logged_at: list[float] = []
        self._leaf_of = {id(leaf.system): leaf for leaf in self._leaves}
        self.rows = np.arange(self._gather(diagram, beginnings))
        self._dependents = _dependents_of(self._leaves)
        self._events: dict[tuple[float, float], list[tuple[Leaf, Law]]] = {}
        for leaf in self._leaves:
            for sampled in leaf.laws.sampled:
                timing = sampled.period, sampled.offset
                self._events.setdefault(timing, []).append((leaf, sampled.law))
        self._is_initialized = False

    def log(self, sink: VectorLogSink, name: str) -> None:
        """Records what a sink of the diagram would log, under a name."""
        leaf = next(leaf for leaf in self._leaves if leaf.system is sink)
        self._logs[name] = leaf, Signal(sink.get_input_port().size())

    def advance_to(self, until: float, period: float, look: Look | None = None) -> None:
        """Simulates all rows that go on.

        Args:
            until: time at the end [s].
            period: time between two samples of the logs [s].
            look: called after each step, as a monitor of Drake's Simulator; gives the rows that
                end, by their numbers.
        """
        with _at_work():
            self._advance_to(until, period, look)

    def times(self, row: int) -> Floats:
        """Times of the samples of a row [s]."""
        return np.array(self._logged_at[: self._count(row)])

    def signal(self, name: str, row: int) -> Floats:
        """Samples (n, size) of a log in a row."""
        return self._logs[name][1].row(row)[: self._count(row)]

    def _count(self, row: int) -> int:
        return self._ends[row].samples if row in self._ends else len(self._logged_at)

    def value(self, system: System, port: str, row: int) -> Floats:
        """Present value of an output, or of an input, of a system of the diagram in a row.

        Raises:
            Exception: a law that fails in this row.
        """
        key = id(system), port
        if key not in self._ports:
            self._ports[key] = self._leaf_port(system, port)
        leaf, index, is_output = self._ports[key]
        position = int(np.searchsorted(self.rows, row))
        with _at_work():
            numbers = leaf.output(index) if is_output else leaf.input(index)
        if position in self._failed:
            raise self._failed[position]
        return np.array(RowsContext(leaf, position).taken(numbers or []))

    def _leaf_port(self, system: Any, port: str) -> tuple[Leaf, int, bool]:
        """The leaf system's port that a system's shows, and whether it is an output."""
        is_output = system.HasOutputPort(port)
        if is_output:
            owner, index = output_of_leaf(system, system.GetOutputPort(port).get_index())
        else:
            owner, index = inputs_of_leaves(system, system.GetInputPort(port).get_index())[0]
        return self._leaf_of[id(owner)], int(index), is_output

    def write(self, row: int, root: Context) -> None:
        """Puts a context, which has the row's parameters, to its present time and state."""
        end = self._ends.get(row) or self._end(int(np.searchsorted(self.rows, row)))
        root.SetTime(end.time)
        for leaf, groups in zip(self._leaves, end.state, strict=True):
            own = leaf.own(row).GetMyMutableContextFromRoot(root)
            for g, group in enumerate(groups):
                own.SetDiscreteState(g, np.array(group))

    def _end(self, position: int) -> "End":
        state = [leaf.state_of(position) for leaf in self._leaves]
        return End(self.time, len(self._logged_at), state)

    def _look(self, look: Look | None) -> None:
        if look is None or not self.rows.size:
            return
        ending = look(self.rows.tolist())
        positions = np.searchsorted(self.rows, ending).tolist()
        for row, position in zip(ending, positions, strict=True):
            self._ends[row] = self._end(position)
        if positions:
            self._drop(positions)

    def _advance_to(self, until: float, period: float, look: Look | None) -> None:
        if not self._is_initialized:
            self._is_initialized = True
            initial = [(leaf, law) for leaf in self._leaves for law in leaf.laws.initial]
            self._update(initial)
            self._record(period)
            self._look(look)
        while self.rows.size:
            if self.time >= until:
                return
            due = (laws for timing, laws in self._events.items() if _is_due(*timing, self.time))
            self._update([one for laws in due for one in laws])
            timings = (*self._events, (period, 0.0))
            following = min(_next_time(*timing, self.time) for timing in timings)
            self.time = min(following, until)
            self._forget(self._dependents.get(_TIME, ()))
            self._record(period)
            self._look(look)

    def _record(self, period: float) -> None:
        if not self._logs or not _is_due(period, 0.0, self.time):
            return
        while self.rows.size:
            samples = [leaf.input(0) for leaf, _ in self._logs.values()]
            if not self._drop_failed():
                break
        if not self.rows.size:
            return
        self._logged_at.append(self.time)
        for (_, signal), numbers in zip(self._logs.values(), samples, strict=True):
            assert numbers is not None
            signal.add(numbers, self.rows)

    def _update(self, laws: Sequence[tuple[Leaf, Law]]) -> None:
        """Carries out updates of the state that take place together."""
        ahead: dict[int, tuple[Leaf, list[list[Number]]]] = {}
        steps: list[tuple[Leaf, Callable[[], Mapping[int, Exception]]]] = []
        while self.rows.size:
            ahead, steps = {}, []
            for leaf, law in laws:
                if leaf.memory is not None:
                    steps.append((leaf, leaf.memory.update(RowsContext(leaf))))
                    continue
                _, groups = ahead.get(id(leaf), (leaf, leaf.state))
                ahead[id(leaf)] = leaf, self._updated(leaf, law, groups)
            if not self._drop_failed():
                break
            ahead, steps = {}, []
        for leaf, step in steps:  # which cannot be taken back
            self._failed |= step()
            for g in range(len(leaf.state)):
                self._forget(self._dependents.get((leaf, g), ()))
        for leaf, groups in ahead.values():
            for g, (before, after) in enumerate(zip(leaf.state, groups, strict=True)):
                if not _is_same(before, after):
                    leaf.state[g] = after
                    self._forget(self._dependents.get((leaf, g), ()))
        self._drop_failed()

    def _updated(self, leaf: Leaf, law: Law, groups: Sequence[list[Number]]) -> list[list[Number]]:
        """State of a system after one of its updates."""
        sizes = [len(group) for group in groups]

        def result(context: RowsContext) -> list[Number]:
            values = DiscreteValues([context.taken(group) for group in groups])
            leaf.carry_out(law, context, values)
            return [number for group in values.groups for number in group.numbers]

        numbers = self._carried_out(leaf, result, sum(sizes))
        after, begin = [], 0
        for size in sizes:
            after.append(numbers[begin : begin + size])
            begin += size
        return after

    def calculated(self, leaf: Leaf, law: Law, size: int) -> list[Number]:
        """Numbers of all rows at an output of a system."""

        def result(context: RowsContext) -> list[Number]:
            output = zeros_for(size)
            leaf.carry_out(law, context, output)
            return output.numbers

        return self._carried_out(leaf, result, size)

    def _carried_out(self, leaf: Leaf, law: Any, size: int) -> list[Number]:
        def of_one(position: int) -> list[Number]:
            self.one_by_one.add(leaf.name)
            try:
                numbers: list[Number] = law(RowsContext(leaf, position))
            except Exception as error:
                self._failed[position] = error
                numbers = [math.nan] * size
            return numbers

        if self.rows.size == 1:
            return of_one(0)
        return carried_out(lambda index: law(RowsContext(leaf, index)), of_one, self.rows.size)

    def _forget(self, dependents: Iterable[tuple[Leaf, int, bool]]) -> None:
        for leaf, index, is_output in dependents:
            if is_output:
                leaf.outputs[index] = None
            else:
                leaf.caches.clear()

    def _drop_failed(self) -> bool:
        """Ends rows that have failed; true if there were any, and what was calculated is void."""
        if not self._failed:
            return False
        for position, error in self._failed.items():
            self.errors[int(self.rows[position])] = error
        self._drop(list(self._failed))
        self._failed.clear()
        return True

    def _drop(self, positions: Sequence[int]) -> None:
        """Ends rows, the others go on.

        Args:
            positions: their positions among those that go on.
        """
        going_on = np.ones(self.rows.size, dtype=bool)
        going_on[list(positions)] = False
        kept = np.flatnonzero(going_on)
        self.rows = self.rows[kept]
        for leaf in self._leaves:
            leaf.state = [_kept(group, kept) for group in leaf.state]
            leaf.parameters = [_kept(group, kept) for group in leaf.parameters]
            leaf.fixed = {i: _kept(numbers, kept) for i, numbers in leaf.fixed.items()}
            leaf.abstract = [[values[i] for i in kept] for values in leaf.abstract]
            leaf.contexts = [leaf.contexts[i] for i in kept] if leaf.contexts else []
            if leaf.memory is not None:
                leaf.memory.keep(kept)
            leaf.forget()

    def _gather(self, diagram: Diagram, beginnings: Iterable[tuple[Diagram, Context]]) -> int:
        """Reads the rows' contexts; returns their number."""
        count = 0
        own_laws = [(leaf.system, leaf.laws.all()) for leaf in self._leaves]
        leaves_of = {id(diagram): (diagram, own_laws)}
        for own, root in beginnings:
            if id(own) not in leaves_of:
                systems = leaf_systems(own)
                leaves_of[id(own)] = own, [(system, find_laws(system).all()) for system in systems]
            self.time = root.get_time()
            for leaf, (system, laws) in zip(self._leaves, leaves_of[id(own)][1], strict=True):
                leaf.add(system, laws, system.GetMyContextFromRoot(root))
                self._leaf_of[id(system)] = leaf
            count += 1
        for leaf in self._leaves:
            leaf.begin()
        return count


@contextmanager
def _at_work() -> Iterator[None]:
    """Context in which laws are carried out for rows."""
    before, rows_module.at_work = rows_module.at_work, True
    try:
        with np.errstate(all="ignore", divide="raise"):
            yield
    finally:
        rows_module.at_work = before


def _kept(numbers: Sequence[Number], kept: NDArray[np.intp]) -> list[Number]:
    return [Rows(x.values[kept]) if type(x) is Rows else x for x in numbers]


def _is_same(before: Sequence[Number], after: Sequence[Number]) -> bool:
    """Whether numbers have not changed, as far as a glance tells."""
    return all(
        x is y or (type(x) is float and type(y) is float and x == y and x != 0.0)
        for x, y in zip(before, after, strict=True)
    )


def _next_time(period: float, offset: float, now: float) -> float:
    """The first instant of a sampled event after now, as Drake reckons it [s]."""
    if now < offset:
        return offset
    k = math.ceil((now - offset) / period)
    following = offset + k * period
    return following if following > now else offset + (k + 1) * period


def _is_due(period: float, offset: float, now: float) -> bool:
    """Whether an event takes place now: the next one after the moment before."""
    return now >= offset and _next_time(period, offset, math.nextafter(now, -math.inf)) == now


def _dependents_of(leaves: Sequence[Leaf]) -> dict[Any, list[tuple[Leaf, int, bool]]]:
    """By what may change (time, or a system's group of state), the results that depend on it."""
    roots: dict[tuple[int, int, bool], set[Any]] = {}

    def origins(leaf: Leaf, index: int, is_output: bool) -> set[Any]:
        key = id(leaf), index, is_output
        if key not in roots:
            roots[key] = set()  # no algebraic loops
            output = leaf.laws.outputs[index] if is_output else leaf.laws.caches[index]
            roots[key] = origins_of(leaf, output)
        return roots[key]

    def origins_of(leaf: Leaf, output: Output) -> set[Any]:
        if output.law is None:
            return {(leaf, output.group)}
        roots_of_it: set[Any] = set()
        for ticket in output.tickets:
            roots_of_it |= of_ticket(leaf, ticket)
        return roots_of_it

    def of_ticket(leaf: Leaf, ticket: int) -> set[Any]:
        system, groups = leaf.system, len(leaf.state)
        for k, source in enumerate(leaf.sources):
            if int(system.get_input_port(k).ticket()) == ticket:
                return origins(*source, True) if source is not None else set()
        for index in leaf.laws.caches:
            if int(system.get_cache_entry(CacheIndex(index)).ticket()) == ticket:
                return origins(leaf, index, False)
        if ticket in (int(system.nothing_ticket()), *_parameters(system, leaf)):
            return set()
        if ticket == int(system.time_ticket()):
            return {_TIME}
        for group in range(groups):
            if ticket == int(system.discrete_state_ticket(DiscreteStateIndex(group))):
                return {(leaf, group)}
        everything = {(leaf, group) for group in range(groups)}
        if ticket in (int(system.xd_ticket()), int(system.all_state_ticket())):
            return everything
        inputs: set[Any] = set()
        for source in leaf.sources:
            if source is not None:
                inputs |= origins(*source, True)
        if ticket == int(system.all_input_ports_ticket()):
            return inputs
        return everything | inputs | {_TIME}

    dependents: dict[Any, list[tuple[Leaf, int, bool]]] = {}
    for leaf in leaves:
        nodes = [(index, True) for index in range(len(leaf.laws.outputs))]
        nodes += [(index, False) for index in leaf.laws.caches]
        for index, is_output in nodes:
            for root in origins(leaf, index, is_output):
                dependents.setdefault(root, []).append((leaf, index, is_output))
    return dependents


def _parameters(system: Any, leaf: Leaf) -> list[int]:
    """Tickets of parameters, which never change in a simulation."""
    tickets = [system.all_parameters_ticket(), system.pn_ticket(), system.pa_ticket()]
    tickets += [
        system.numeric_parameter_ticket(NumericParameterIndex(k))
        for k in range(len(leaf.parameters))
    ]
    return [int(ticket) for ticket in tickets]
