"""LeafSystem that remembers what it declares, so that its laws can be carried out for many rows.

Drake keeps a system's callbacks to itself and calls them with one context at a time. This base
class has them written down as they are declared; each is then a law: a function of what it reads
through its context, which may just as well be a `RowsContext`, where every number is that of many
runs. Derive from it in place of pydrake's, and read inputs through `parapod.systems.core.ports`;
nothing else changes.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from pydrake.systems import framework
from pydrake.systems.framework import Context, System

from parapod.systems.core.rows import Index, Number, Rows, array_of, numbers_of, taken

# A callback without the system that it is of, which must not keep itself alive.
type Law = Callable[..., Any]


@dataclass(frozen=True)
class Output:
    """Output port of a system.

    Attributes:
        law: calculates it; None for a group of the state.
        tickets: tickets of all that it depends on.
        group: group of the state that it shows.
    """

    law: Law | None
    tickets: frozenset[int] = frozenset()
    group: int = -1


@dataclass(frozen=True)
class Sampled:
    """Update of the discrete state once a period.

    Attributes:
        period: [s].
        offset: first instant [s].
        law: the update.
    """

    period: float
    offset: float
    law: Law


@dataclass
class Laws:
    """Everything that a system has declared, in the order of its indices.

    Attributes:
        outputs: its output ports.
        caches: entries of `declare_cached` by their index in the system.
        sampled: its periodic updates.
        initial: updates at an initialization.
        refusals: declarations that rows cannot have.
        needs_contexts: true if its laws need a context of Drake's for each row.
        memory: class of the memory in which it keeps rows itself; None: they are numbers.
    """

    outputs: list[Output] = field(default_factory=list)
    caches: dict[int, Output] = field(default_factory=dict)
    sampled: list[Sampled] = field(default_factory=list)
    initial: list[Law] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)
    needs_contexts: bool = False
    memory: "type[RowsMemory] | None" = None

    def all(self) -> list[Law]:
        """All functions among them, in an order that systems of one kind share."""
        calculations = (one.law for one in (*self.outputs, *self.caches.values()))
        updates = (one.law for one in self.sampled)
        return [*(law for law in calculations if law is not None), *updates, *self.initial]


def laws_of(system: System) -> Laws | None:
    """Laws of a system that is derived from `LeafSystem`; None of another."""
    return getattr(system, "_laws", None)


def _unbound(system: Any, callback: Any) -> Law:
    """A callback as a function of the system and the rest."""
    if getattr(callback, "__self__", None) is system:
        law: Law = callback.__func__
        return law

    def without(_system: Any, *arguments: Any) -> Any:
        return callback(*arguments)

    return without


def _tickets(prerequisites: Iterable[Any]) -> frozenset[int]:
    return frozenset(int(ticket) for ticket in prerequisites)


class _Declared:
    """Declarations, as pydrake has them, that are written down."""

    _laws: Laws

    def _written(self) -> Laws:
        if "_laws" not in self.__dict__:
            self._laws = Laws()
        return self._laws

    def DeclareVectorOutputPort(
        self, name: str, model_value: Any, calc: Any, prerequisites_of_calc: Any = None
    ) -> Any:
        system: Any = super()
        tickets = self._note_output(calc, prerequisites_of_calc)
        return system.DeclareVectorOutputPort(name, model_value, calc, tickets)

    def _note_output(self, calc: Any, prerequisites_of_calc: Any) -> Any:
        """Writes an output down; returns what it depends on."""
        own: Any = self
        if prerequisites_of_calc is None:
            prerequisites_of_calc = {own.all_sources_ticket()}
        output = Output(_unbound(self, calc), _tickets(prerequisites_of_calc))
        self._written().outputs.append(output)
        return prerequisites_of_calc

    def DeclareStateOutputPort(self, name: str, state_index: Any) -> Any:
        system: Any = super()
        port = system.DeclareStateOutputPort(name, state_index)
        self._written().outputs.append(Output(None, group=int(state_index)))
        return port

    def DeclareAbstractOutputPort(
        self, name: str, alloc: Any, calc: Any, prerequisites_of_calc: Any = None
    ) -> Any:
        system: Any = super()
        tickets = self._note_output(calc, prerequisites_of_calc)
        return system.DeclareAbstractOutputPort(name, alloc, calc, tickets)

    def DeclarePeriodicDiscreteUpdateEvent(
        self, period_sec: float, offset_sec: float, update: Any
    ) -> Any:
        system: Any = super()
        system.DeclarePeriodicDiscreteUpdateEvent(period_sec, offset_sec, update)
        self._written().sampled.append(Sampled(period_sec, offset_sec, _unbound(self, update)))

    def DeclareInitializationDiscreteUpdateEvent(self, update: Any) -> Any:
        system: Any = super()
        system.DeclareInitializationDiscreteUpdateEvent(update)
        self._written().initial.append(_unbound(self, update))

    def DeclarePeriodicUnrestrictedUpdateEvent(
        self, period_sec: float, offset_sec: float, update: Any
    ) -> Any:
        system: Any = super()
        system.DeclarePeriodicUnrestrictedUpdateEvent(period_sec, offset_sec, update)
        self._written().refusals.append("an unrestricted update")

    def declare_memory(self, memory: "type[RowsMemory]") -> None:
        """Has a memory of the system's own keep its rows."""
        self._written().memory = memory

    def declare_cache_law(self, index: int, calc: Any, prerequisites_of_calc: Any) -> None:
        """Notes a cache entry; for `declare_cached`."""
        tickets = _tickets(prerequisites_of_calc)
        self._written().caches[index] = Output(_unbound(self, calc), tickets)


class LeafSystem(_Declared, framework.LeafSystem):  # type: ignore[misc]
    """pydrake's LeafSystem, with its declarations written down, see the module."""


class RowsMemory(ABC):
    """Rows of a system that something else than numbers in Python keeps and calculates.

    Such as an engine that steps many machines in threads of its own. A class of this kind stands
    in for all of the system's laws; it is made empty, and `add` then gives it row by row.
    """

    @abstractmethod
    def add(self, system: Any, context: Context) -> None:
        """Takes the beginning of a further row from a system and its context."""

    @abstractmethod
    def begin(self) -> None:
        """Is called once all rows have been added."""

    @abstractmethod
    def output(self, index: int) -> Any:
        """Numbers of all rows at an output, as a list; or `rows.OfRows`."""

    @abstractmethod
    def update(self, context: "RowsContext") -> Callable[[], Mapping[int, Exception]]:
        """Reads what the system's periodic update reads.

        Returns:
            The update. It gives the errors of rows that fail, by their positions.
        """

    @abstractmethod
    def keep(self, positions: NDArray[np.intp]) -> None:
        """Goes on with the rows at these positions alone."""

    @abstractmethod
    def state(self, position: int) -> list[list[float]]:
        """Groups of a row's discrete state."""


class _LeafSystems:
    """`LeafSystem_[T]`: that of floats has its declarations written down."""

    def __getitem__(self, scalar: Any) -> Any:
        templates: Any = framework
        return LeafSystem if scalar is float else templates.LeafSystem_[scalar]


LeafSystem_: Any = _LeafSystems()


class Vector:
    """Numbers of rows, read as a BasicVector is."""

    __slots__ = ("numbers",)

    def __init__(self, numbers: list[Any]):
        self.numbers = numbers

    def __getitem__(self, position: int) -> Number:
        return self.numbers[position]

    def __len__(self) -> int:
        return len(self.numbers)

    def __iter__(self) -> Iterator[Number]:
        return iter(self.numbers)

    def size(self) -> int:
        """Number of elements."""
        return len(self.numbers)

    def value(self) -> NDArray[Any]:
        """The numbers as an array."""
        return array_of(self.numbers)

    get_value = CopyToVector = value

    def GetAtIndex(self, index: int) -> Number:
        """A number."""
        return self.numbers[index]

    def SetFromVector(self, value: Any) -> None:
        """Sets all numbers.

        Raises:
            ValueError: another number of them.
        """
        numbers = numbers_of(value)
        if len(numbers) != len(self.numbers):
            raise ValueError(f"there must be {len(self.numbers)} numbers, not {len(numbers)}")
        self.numbers = numbers

    set_value = SetFromVector

    def SetZero(self) -> None:
        """Sets all numbers to zero."""
        self.numbers = [0.0] * len(self.numbers)

    def SetAtIndex(self, index: int, value: Any) -> None:
        """Sets a number."""
        self.numbers[index] = value if type(value) is Rows else float(value)

    __setitem__ = SetAtIndex


class DiscreteValues:
    """Groups of a discrete state, read and set as Drake's are."""

    __slots__ = ("groups",)

    def __init__(self, groups: list[list[Number]]):
        self.groups = [Vector(list(group)) for group in groups]

    def get_vector(self, index: int = 0) -> Vector:
        """A group."""
        return self.groups[index]

    get_mutable_vector = get_vector

    def __getitem__(self, index: int) -> Number:
        """A number of the only group."""
        return self.groups[0][index]

    def __setitem__(self, index: int, value: Any) -> None:
        """Sets a number of the only group."""
        self.groups[0][index] = value

    def size(self) -> int:
        """Number of elements of the only group."""
        return len(self.groups[0])

    def value(self, index: int = 0) -> NDArray[Any]:
        """Numbers of a group."""
        return self.groups[index].value()

    def num_groups(self) -> int:
        """Number of groups."""
        return len(self.groups)

    def set_value(self, *arguments: Any) -> None:
        """Sets a group: by its index, or the only one.

        Raises:
            ValueError: another number of elements.
        """
        index, value = arguments if len(arguments) == 2 else (0, arguments[0])
        self.groups[index].SetFromVector(value)


@final
class RowsContext:
    """Context of a system as its laws see it, for some of the rows or for one of them.

    Attributes:
        leaf: numbers of all rows.
        index: positions of the rows that the law is carried out for; None for all; an int for one
            alone, whose numbers are floats.
    """

    __slots__ = ("index", "leaf")

    def __init__(self, leaf: Any, index: Index | int = None):
        self.leaf, self.index = leaf, index

    @property
    def size(self) -> int | None:
        """Number of these rows; None for one alone."""
        if type(self.index) is int:
            return None
        positions: Any = self.index
        size: int = self.leaf.size if positions is None else positions.size
        return size

    def taken(self, numbers: Sequence[Number]) -> list[Number]:
        """Numbers of these rows."""
        index = self.index
        if index is None:
            return list(numbers)
        if type(index) is int:
            return [
                float(number.values[index]) if type(number) is Rows else number
                for number in numbers
            ]
        positions: Any = index
        return [taken(number, positions) for number in numbers]

    def input(self, index: int) -> list[Number] | None:
        """Numbers at an input port; None if nothing is connected to it."""
        numbers = self.leaf.input(index)
        return None if numbers is None else self.taken(numbers)

    def object(self, index: int) -> Any:
        """The object at an input port without numbers, which must be connected."""
        return self.leaf.input(index).taken(self.index)

    def output(self, index: int) -> list[Number]:
        """Numbers at an output port of the system."""
        return self.taken(self.leaf.output(index))

    def cached(self, index: int) -> Any:
        """The object of a cache entry."""
        return self.leaf.cached(index, self.index)

    def get_time(self) -> float:
        """Time [s], which all rows share."""
        time: float = self.leaf.time
        return time

    def get_discrete_state(self, index: int | None = None) -> Any:
        """A group of the state, or all groups."""
        groups = self.leaf.state
        if index is None:
            return DiscreteValues([self.taken(group) for group in groups])
        return Vector(self.taken(groups[index]))

    def get_discrete_state_vector(self) -> Vector:
        """The state's only group."""
        return Vector(self.taken(self.leaf.state[0]))

    def get_numeric_parameter(self, index: Any) -> Vector:
        """A parameter."""
        return Vector(self.taken(self.leaf.parameters[int(index)]))

    def get_abstract_parameter(self, index: Any) -> Any:
        """A parameter of any type, which must be the same object for all rows at once.

        Raises:
            TypeError: the rows have several; they are taken one at a time.
        """
        values = self.leaf.abstract[int(index)]
        if type(self.index) is int:
            return values[self.index]
        positions: Any = self.index
        first, *others = values if positions is None else [values[i] for i in positions]
        if any(other is not first and other.get_value() != first.get_value() for other in others):
            raise TypeError("rows with different objects are taken one at a time")
        return first


class RootOfRow(ABC):
    """A row of many runs where a root context is looked at, see `ports.value_of`."""

    @abstractmethod
    def get_time(self) -> float:
        """Time [s]."""

    @abstractmethod
    def value(self, system: System, port: str) -> NDArray[np.float64]:
        """Present value of a port."""


def zeros_for(size: int) -> Vector:
    """A vector that a law of an output is to set."""
    return Vector(np.zeros(size).tolist())
