"""One object in place of many that are alike: where their numbers differ, it has those of rows.

Machines of other dimensions have systems of other attributes. A law that is carried out for the
rows of several systems sees one that has the attributes of all: floats that differ are `Rows`,
arrays of them arrays of objects, and so are the parts of tuples and dataclasses. Counts, texts and
whatever else differs raise TypeError as they are read; the rows are then taken one at a time, each
by its own system.
"""

import dataclasses
import enum
import functools
import types
import weakref
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.systems.framework import InputPort, OutputPort

from parapod.systems.core.rows import Index, OfRows, Rows

# Parts of its rows that an object remembers.
_MOST_PARTS = 16


class Mergeable(ABC):
    """An object that knows itself how it is one of many."""

    @classmethod
    @abstractmethod
    def of_rows(cls, objects: Sequence[Any]) -> Any:
        """The object in place of those of rows."""


class Merger:
    """Merges objects that know each other; those that have been merged are found again."""

    def __init__(self) -> None:
        self._merged: dict[tuple[int, ...], tuple[Sequence[Any], Any]] = {}

    def merge(self, objects: Sequence[Any]) -> Any:
        """One object in place of those of rows.

        Args:
            objects: one a row, of one type.

        Raises:
            TypeError: objects that are not alike.
        """
        first = objects[0]
        if all(other is first for other in objects):
            return first
        key = tuple(map(id, objects))
        if key not in self._merged:
            kind = type(first)
            if any(type(other) is not kind for other in objects):
                raise TypeError(f"rows differ: {kind.__name__} in one, not in another")
            # The objects are kept, so that no other has the number of one of them.
            self._merged[key] = objects, self._of_kind(kind, objects)
        return self._merged[key][1]

    def _of_kind(self, kind: type, objects: Sequence[Any]) -> Any:
        first = objects[0]
        if kind is float:
            values = np.array(objects)
            return first if _is_one(values) else Rows(values)
        if kind is np.ndarray:
            return self._array(objects)
        if kind in (tuple, list):
            return kind(self._parts(objects))
        if issubclass(kind, tuple):  # one with names
            return kind(*self._parts(objects))
        if kind is dict:
            if any(other.keys() != first.keys() for other in objects):
                raise TypeError("rows differ in the keys of a table")
            return {name: self.merge([one[name] for one in objects]) for name in first}
        if issubclass(kind, Mergeable):
            return kind.of_rows(objects)
        if dataclasses.is_dataclass(kind):
            return self._dataclass(kind, objects)
        if isinstance(first, functools.partial):
            function = self.merge([one.func for one in objects])
            arguments = self.merge([one.args for one in objects])
            keywords = self.merge([one.keywords for one in objects])
            return functools.partial(function, *arguments, **keywords)
        if kind is types.MethodType:
            bound = self.merge([one.__self__ for one in objects])
            return types.MethodType(self.merge([one.__func__ for one in objects]), bound)
        if kind is types.FunctionType:
            return self._function(objects)
        if isinstance(first, weakref.ref):
            target = self.merge([one() for one in objects])
            return lambda: target
        if isinstance(first, InputPort | OutputPort):
            if any(other.get_index() != first.get_index() for other in objects):
                raise TypeError("rows differ in their ports")
            return first
        if hasattr(first, "__dict__") and not isinstance(first, type | enum.Enum):
            return Alike(objects, self)
        if all(other == first for other in objects) or _is_made_alike(objects):
            return first
        raise TypeError(f"rows differ in a {kind.__name__}")

    def _parts(self, objects: Sequence[Any]) -> list[Any]:
        return [self.merge(parts) for parts in zip(*objects, strict=True)]

    def _dataclass(self, kind: type, objects: Sequence[Any]) -> Any:
        names = {field.name for field in dataclasses.fields(kind)}
        # Results that all of them keep, too.
        kept = set.intersection(*(set(getattr(one, "__dict__", ())) for one in objects))
        whole: Any = object.__new__(kind)
        for name in names | kept:
            value = self.merge([getattr(one, name) for one in objects])
            object.__setattr__(whole, name, value)
        return whole

    def _array(self, arrays: Sequence[Any]) -> Any:
        first = arrays[0]
        if any(other.shape != first.shape or other.dtype != first.dtype for other in arrays):
            raise TypeError("rows differ in the size of an array")
        stack = np.array(arrays)
        if _is_one(stack):
            return first
        if first.dtype != np.float64:
            raise TypeError("rows differ in an array that is not of floats")
        whole = np.empty(first.shape, dtype=object)
        for index in np.ndindex(first.shape):
            values = stack[(slice(None), *index)].copy()
            whole[index] = float(values[0]) if _is_one(values) else Rows(values)
        return whole

    def _function(self, functions: Sequence[Any]) -> Any:
        """A function with the variables of all that it was made with."""
        first = functions[0]
        if any(other.__code__ is not first.__code__ for other in functions):
            raise TypeError("rows differ in a function")
        variables = [[cell.cell_contents for cell in one.__closure__ or ()] for one in functions]
        cells = tuple(map(types.CellType, self._parts(variables)))
        whole = types.FunctionType(
            first.__code__,
            first.__globals__,
            first.__name__,
            self.merge([one.__defaults__ for one in functions]),
            cells,
        )
        whole.__kwdefaults__ = self.merge([one.__kwdefaults__ for one in functions])
        return whole


def _is_made_alike(objects: Sequence[Any]) -> bool:
    """Whether objects that do not compare, such as an itemgetter, are made from the same."""
    try:
        first, *others = (one.__reduce__() for one in objects)
    except TypeError:
        return False
    return all(other == first for other in others)


def _is_one(values: Any) -> bool:
    """Whether an array has the same in all rows, signs of zeros included."""
    first = values[:1]
    if values.dtype.kind == "f":
        values, first = values.view(np.uint64), first.view(np.uint64)
    return bool((values == first).all())


class Alike(OfRows):
    """An object in place of many: attributes are merged as they are read.

    Methods of their class are carried out with this object in place of theirs.
    """

    def __init__(self, objects: Sequence[Any], merger: Merger):
        vars(self).update(_objects=objects, _merger=merger, _parts={})

    def taken(self, index: Index | int) -> Any:
        """The object of some rows, or of one."""
        objects: Sequence[Any] = vars(self)["_objects"]
        if index is None or isinstance(index, int):
            return self if index is None else objects[index]
        parts: dict[bytes, Any] = vars(self)["_parts"]
        key = index.tobytes()
        if key not in parts:
            if len(parts) >= _MOST_PARTS:
                parts.clear()
            parts[key] = Alike([objects[position] for position in index.tolist()], Merger())
        return parts[key]

    def __getattr__(self, name: str) -> Any:
        objects: Sequence[Any] = vars(self)["_objects"]
        first = objects[0]
        if name in vars(first):
            value = vars(self)["_merger"].merge([vars(one)[name] for one in objects])
            vars(self)[name] = value
            return value
        kind = type(first)
        owner = next((one for one in kind.__mro__ if name in vars(one)), None)
        if owner is None:
            raise AttributeError(f"{kind.__name__} has no attribute {name}")
        attribute = vars(owner)[name]
        if isinstance(attribute, types.FunctionType):
            return types.MethodType(attribute, self)
        if isinstance(attribute, property | functools.cached_property):
            calculate: Any = attribute.fget if isinstance(attribute, property) else attribute.func
            return calculate(self)
        if not callable(attribute):  # a constant, or what a class keeps in another way
            return vars(self)["_merger"].merge([getattr(one, name) for one in objects])
        # Alike systems have alike ports; what else is written in another language is not known.
        is_of_drake = owner.__module__.startswith("pydrake") and owner is not kind
        if is_of_drake or isinstance(attribute, staticmethod | classmethod):
            return getattr(first, name)
        raise TypeError(f"rows differ, and {name} takes one of them at a time")

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Calls the objects, which are functions."""
        return self.__getattr__("__call__")(*arguments, **keywords)
