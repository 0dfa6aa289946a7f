"""Fast, typed access to vectors from Python callbacks, and cached results of calculations.

A controller's tick reads some forty short vectors. `InputPort.Eval` copies through numpy each
time; these readers go through a view to plain numbers, for floats and AutoDiffXd alike. In the
context of many rows they give numbers of rows: a law that reads its inputs by them is carried out
for any number of runs at once.

A bound method or a cache entry held by a system makes a cycle through C++ that Python's garbage
collector cannot see, and a diagram with one is never freed: hence `declare_cached`.
"""

import weakref
from collections.abc import Callable, Set
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import (
    BasicVector,
    CacheIndex,
    Context,
    DependencyTicket,
    InputPort,
    OutputPort,
    System,
    ValueProducer,
)

from parapod.systems.core.errors import WiringError
from parapod.systems.core.leaf_system import LeafSystem, RootOfRow, RowsContext, Vector
from parapod.systems.core.rows import array_of, matrix_of
from parapod.systems.core.switching import switched

# Takes the numbers of a vector one by one: up to this size that is faster than making a view.
_SHORT = 12
_PICK = {size: itemgetter(*range(size)) for size in range(2, _SHORT + 1)}


def read(port: InputPort, context: Context | RowsContext) -> list[Any]:
    """The numbers at an input port, which must be connected."""
    if type(context) is RowsContext:
        return _of_rows(port, context)
    vector = port.EvalBasicVector(context)
    if type(vector) is BasicVector and (pick := _PICK.get(vector.size())):
        return list(pick(vector))
    return elements(vector)


def has_value(port: InputPort, context: Context | RowsContext) -> bool:
    """Whether an input port is connected."""
    if type(context) is RowsContext:
        return context.input(int(port.get_index())) is not None
    return bool(port.HasValue(context))


def read_or_zeros(port: InputPort, context: Context | RowsContext) -> list[Any]:
    """The numbers at an input port; zeros if it is not connected."""
    return read(port, context) if has_value(port, context) else [0.0] * port.size()


def read_array(
    port: InputPort | OutputPort, context: Context | RowsContext
) -> NDArray[np.float64]:
    """The vector at a port of a system, copied; an object array for AutoDiffXd and for rows."""
    if type(context) is RowsContext:
        return array_of(_of_rows(port, context))
    array: Any = port.Eval(context)
    return array


def read_vector(port: InputPort, context: Context | RowsContext) -> Any:
    """The BasicVector at an input port, or one of rows, of which single numbers are wanted."""
    if type(context) is RowsContext:
        return Vector(_of_rows(port, context))
    return port.EvalBasicVector(context)


def read_object(port: InputPort, context: Context | RowsContext) -> Any:
    """The object at an abstract input port, or that of rows."""
    if type(context) is RowsContext:
        return context.object(int(port.get_index()))
    return port.Eval(context)


def read_batch(port: InputPort, context: Context | RowsContext) -> NDArray[np.float64]:
    """The vector at an input port, copied: (size), or that of each row (rows, size)."""
    if type(context) is RowsContext:
        return _batch(_of_rows(port, context), context)
    array: Any = port.Eval(context)
    return array


def batch(vector: Any, context: Context | RowsContext) -> NDArray[np.float64]:
    """A vector (size) of a context, or that of each row (rows, size)."""
    if type(context) is RowsContext:
        return _batch(vector.numbers, context)
    array: NDArray[np.float64] = vector.value()
    return array


def _batch(numbers: list[Any], context: RowsContext) -> NDArray[np.float64]:
    size = context.size
    return np.array(numbers) if size is None else matrix_of(numbers, size).T.copy()


def is_on(port: InputPort, context: Context | RowsContext) -> bool:
    """Whether the first number at an input port is above 0.5; NaN is off."""
    return bool(read_vector(port, context)[0] > 0.5)


def is_safe(port: InputPort, context: Context | RowsContext) -> bool:
    """Whether the first number at an input port has a switch on its safe side, 1.

    That is whatever is not near 0, NaN included, see `switched`.
    """
    return switched(read_vector(port, context)[0]) is not False


def _of_rows(port: InputPort | OutputPort, context: RowsContext) -> list[Any]:
    if isinstance(port, OutputPort):
        return context.output(int(port.get_index()))
    numbers = context.input(int(port.get_index()))
    if numbers is None:
        raise WiringError(f"nothing is connected to the input '{port.get_name()}'")
    return numbers


def elements(vector: Any) -> list[Any]:
    """The numbers of a BasicVector: floats, or AutoDiffXd; or those of rows."""
    if type(vector) is BasicVector and (pick := _PICK.get(vector.size())):
        return list(pick(vector))
    if type(vector) is Vector:
        return list(vector.numbers)
    try:
        return vector.value().tolist()
    except (RuntimeError, TypeError):  # scalars other than float have no view
        return vector.CopyToVector().tolist()


@dataclass(frozen=True)
class Cached:
    """A declared cache entry.

    Attributes:
        index: index of the entry in its system.
        ticket: for the prerequisites of what uses it.
    """

    index: CacheIndex
    ticket: DependencyTicket

    def value(self, system: Any, context: Context | RowsContext) -> Any:
        """The object, calculated anew if something it depends on has changed."""
        if type(context) is RowsContext:
            return context.cached(int(self.index))
        return system.get_cache_entry(self.index).Eval(context)


def declare_cached(
    system: Any,
    name: str,
    calc: Callable[[Context], Any],
    prerequisites_of_calc: Set[DependencyTicket],
) -> Cached:
    """Declares a cache entry for the object that the system's method `calc` returns."""
    reference = weakref.WeakMethod(calc)

    def produce(context: Any, value: Any) -> None:
        method = reference()
        assert method is not None
        value.set_value(method(context))

    producer = ValueProducer(Value[object], produce)
    entry = system.DeclareCacheEntry(name, producer, prerequisites_of_calc)
    if isinstance(system, LeafSystem):
        system.declare_cache_law(int(entry.cache_index()), calc, prerequisites_of_calc)
    return Cached(entry.cache_index(), entry.ticket())


def value_of(system: System, port: str, root_context: Context | RootOfRow) -> NDArray[np.float64]:
    """Present value of a system's output, or of its input, found by name in a whole diagram.

    Raises:
        WiringError: the system has no such port.
    """
    if isinstance(root_context, RootOfRow):
        return root_context.value(system, port)
    if system.HasOutputPort(port):
        port_found: Any = system.GetOutputPort(port)
    elif system.HasInputPort(port):
        port_found = system.GetInputPort(port)
    else:
        raise WiringError(f"'{system.get_name()}' has no port '{port}'")
    value: Any = port_found.Eval(system.GetMyContextFromRoot(root_context))
    return np.array(value, dtype=float)
