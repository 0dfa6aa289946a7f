"""A leaf system of a diagram with its numbers of all rows."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, PortDataType

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.leaf_system import Law, Laws, RowsContext
from parapod.systems.core.merged import Merger
from parapod.systems.core.rows import Number, of_rows

# Parts of rows for which systems that differ are kept as one.
_MOST_MERGED = 16


class Leaf:
    """A leaf system with its numbers of all rows.

    Attributes:
        system: the system, or that of the first row where rows have systems of their own.
        laws: its laws.
        name: its path in the diagram.
        state: groups of its discrete state.
        parameters: its numeric parameters.
        abstract: values of its abstract parameters, one a row.
        contexts: Drake's contexts of the rows, where its laws need them.
        memory: keeps the rows in place of all this, where the system has one.
    """

    def __init__(self, system: Any, laws: Laws, simulator: Any):
        self.system, self.laws, self.name = system, laws, system.GetSystemPathname()
        self.sizes = [system.get_output_port(i).size() for i in range(len(laws.outputs))]
        self.state: list[list[Number]] = []
        self.parameters: list[list[Number]] = []
        self.abstract: list[list[Any]] = []
        self.contexts: list[Context] = []
        self.memory = laws.memory() if laws.memory is not None else None
        self.sources: list[tuple[Leaf, int] | None] = [None] * system.num_input_ports()
        self.fixed: dict[int, list[Number]] = {}
        self.outputs: list[list[Number] | None] = [None] * len(laws.outputs)
        self.caches: dict[tuple[int, Any], Any] = {}
        self._simulator = simulator
        self._added: list[list[list[float]]] = []
        self._places = {law: place for place, law in enumerate(laws.all())}
        # Systems and laws of all rows, those that have ended too; and what stands for several.
        self._own: list[tuple[Any, Sequence[Law]]] = []
        self._differ = False
        self._merged: dict[Any, tuple[Merger, dict[Law, tuple[Law, Any]]]] = {}

    def own(self, row: int) -> Any:
        """System of a row."""
        return self._own[row][0]

    def carry_out(self, law: Law, context: RowsContext, *arguments: Any) -> Any:
        """Result of a law of the system, for the rows of a context."""
        if not self._differ:
            return law(self.system, context, *arguments)
        index, rows, place = context.index, self._simulator.rows, self._places[law]
        if type(index) is int:
            system, own = self._own[int(rows[index])]
            return own[place](system, context, *arguments)
        positions: Any = index
        key = None if positions is None else positions.tobytes()
        if key not in self._merged:
            if len(self._merged) >= _MOST_MERGED:
                self._merged.clear()
            self._merged[key] = Merger(), {}
        merger, laws = self._merged[key]
        if law not in laws:
            chosen = (rows if positions is None else rows[positions]).tolist()
            systems, functions = zip(*(self._own[row] for row in chosen), strict=True)
            whole = merger.merge(systems)
            laws[law] = merger.merge([own[place] for own in functions]), whole
        of_all, whole = laws[law]
        return of_all(whole, context, *arguments)

    def add(self, system: Any, laws: Sequence[Law], context: Any) -> None:
        """Reads the beginning of a further row.

        Args:
            system: this system, or one like it.
            laws: all of its laws.
            context: its context.
        """
        self._own.append((system, laws))
        self._differ = self._differ or system is not self.system
        fixed = [
            k
            for k, source in enumerate(self.sources)
            if source is None and system.get_input_port(k).HasValue(context)
        ]
        states = range(context.num_discrete_state_groups())
        parameters = range(context.num_numeric_parameter_groups())
        for k in fixed:
            check_numbers(system, system.get_input_port(k))
        if not self._added:
            self.state, self.parameters = [[] for _ in states], [[] for _ in parameters]
            self.abstract = [[] for _ in range(context.num_abstract_parameters())]
            self.fixed = {k: [] for k in fixed}
        if self.memory is not None:
            self.memory.add(system, context)
            states = range(0)
        self._added.append(
            [
                *(context.get_discrete_state(k).value().tolist() for k in states),
                *(context.get_numeric_parameter(k).CopyToVector().tolist() for k in parameters),
                *(system.get_input_port(k).Eval(context).tolist() for k in fixed),
            ]
        )
        for k, values in enumerate(self.abstract):
            values.append(context.get_abstract_parameter(k).Clone())
        if self.laws.needs_contexts:
            own = system.CreateDefaultContext()
            own.SetTimeStateAndParametersFrom(context)
            self.contexts.append(own)

    def forget(self) -> None:
        """Forgets what was calculated, for other rows."""
        self.outputs = [None] * len(self.outputs)
        self.caches.clear()
        self._merged.clear()

    def begin(self) -> None:
        """Takes the numbers of all rows together."""
        groups = [of_rows(group) for group in zip(*self._added, strict=True)]
        self._added.clear()
        if self.memory is not None:
            self.memory.begin()
        else:
            self.state, groups = groups[: len(self.state)], groups[len(self.state) :]
        self.parameters, groups = groups[: len(self.parameters)], groups[len(self.parameters) :]
        self.fixed = dict(zip(self.fixed, groups, strict=True))

    @property
    def time(self) -> float:
        """Time [s]."""
        return self._simulator.time

    @property
    def size(self) -> int:
        """Number of rows."""
        return self._simulator.rows.size

    def input(self, index: int) -> list[Number] | None:
        """Numbers at an input; None if nothing is connected to it."""
        source = self.sources[index]
        if source is None:
            return self.fixed.get(index)
        leaf, port = source
        return leaf.output(port)

    def output(self, index: int) -> list[Number]:
        """Numbers at an output."""
        numbers = self.outputs[index]
        if numbers is None and self.memory is not None:
            numbers = self.outputs[index] = self.memory.output(index)
        elif numbers is None:
            output = self.laws.outputs[index]
            if output.law is None:
                return self.state[output.group]
            numbers = self._simulator.calculated(self, output.law, self.sizes[index])
            self.outputs[index] = numbers
        return numbers

    def state_of(self, position: int) -> list[list[Any]]:
        """Groups of the state of a row."""
        if self.memory is not None:
            return self.memory.state(position)
        return [RowsContext(self, position).taken(group) for group in self.state]

    def cached(self, index: int, rows: Any) -> Any:
        """The object of a cache entry for some of the rows."""
        key = index, rows.tobytes() if isinstance(rows, np.ndarray) else rows
        if key not in self.caches:
            law: Any = self.laws.caches[index].law
            self.caches[key] = self.carry_out(law, RowsContext(self, rows))
        return self.caches[key]


def check_numbers(system: Any, port: Any) -> None:
    """Raises ParapodError for a port that has no numbers."""
    if port.get_data_type() == PortDataType.kAbstractValued:
        name = system.get_name()
        raise ParapodError(f"'{name}' has no laws over rows: the port '{port.get_name()}'")
