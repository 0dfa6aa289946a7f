"""Numbers of many runs side by side: a law written for floats, carried out once for all rows.

A `Rows` holds a number of each row and stands where a law expects a float. Arithmetic goes by
elements. Where a law asks which of two ways to go and the rows differ, the question raises
`Parted`, and who called the law calls it again for either part: so a law needs not a word about
rows, and a row goes the way that it would go alone, with the same operations in the same order.

NumPy takes a `Rows` for a scalar, as it takes Drake's AutoDiffXd: arrays of them are arrays of
objects. What insists on a float, such as `math.sin` or an array of floats, raises TypeError; the
rows are then handed over one at a time.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from types import MethodType
from typing import Any

import numpy as np
from numpy.typing import NDArray

type Floats = NDArray[np.float64]
type Flags = NDArray[np.bool_]
# Whether laws are being carried out for rows.
at_work = False
# Rows by their positions; None for all of them.
type Index = NDArray[np.intp] | None
# A float where all rows have the same number.
type Number = "float | Rows"


class OfRows(ABC):
    """An object of rows in place of numbers."""

    @abstractmethod
    def taken(self, index: "Index | int") -> Any:
        """That of the rows at some positions, or of one row."""


class Parted(Exception):
    """A question that rows answer differently.

    Attributes:
        flags: (n) answers.
    """

    def __init__(self, flags: Flags):
        super().__init__("rows differ")
        self.flags = flags


class Mask:
    """An answer of each row, where a law expects a bool; rows that differ part there."""

    __slots__ = ("flags",)
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, flags: Flags):
        self.flags = flags

    def __bool__(self) -> bool:
        flags = self.flags
        count = np.count_nonzero(flags)
        if count == flags.size:
            return True
        if count:
            raise Parted(flags)
        return False

    def __and__(self, other: Any) -> "Mask":
        return Mask(self.flags & flags_of(other))

    def __or__(self, other: Any) -> "Mask":
        return Mask(self.flags | flags_of(other))

    def __xor__(self, other: Any) -> "Mask":
        return Mask(self.flags ^ flags_of(other))

    def __invert__(self) -> "Mask":
        return Mask(~self.flags)

    def __eq__(self, other: Any) -> "Mask":  # type: ignore[override]
        return Mask(self.flags == flags_of(other))

    def __ne__(self, other: Any) -> "Mask":  # type: ignore[override]
        return Mask(self.flags != flags_of(other))

    __rand__, __ror__, __rxor__ = __and__, __or__, __xor__

    def logical_not(self) -> "Mask":
        """The opposite, by which NumPy calls it."""
        return Mask(~self.flags)


def flags_of(answer: Any) -> Any:
    """Answers of rows, or the one answer of all."""
    return answer.flags if type(answer) is Mask else bool(answer)


class Rows:
    """A number of each row.

    Attributes:
        values: (n) the numbers; not to be changed.
    """

    __slots__ = ("values",)
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, values: Floats):
        self.values = values

    def __repr__(self) -> str:
        return f"Rows({self.values})"

    def __add__(self, other: Any) -> "Rows":
        return Rows(self.values + (other.values if type(other) is Rows else _float(other)))

    def __radd__(self, other: Any) -> "Rows":
        return Rows(_float(other) + self.values)

    def __sub__(self, other: Any) -> "Rows":
        return Rows(self.values - (other.values if type(other) is Rows else _float(other)))

    def __rsub__(self, other: Any) -> "Rows":
        return Rows(_float(other) - self.values)

    def __mul__(self, other: Any) -> "Rows":
        return Rows(self.values * (other.values if type(other) is Rows else _float(other)))

    def __rmul__(self, other: Any) -> "Rows":
        return Rows(_float(other) * self.values)

    def __truediv__(self, other: Any) -> "Rows":
        return Rows(self.values / (other.values if type(other) is Rows else _float(other)))

    def __rtruediv__(self, other: Any) -> "Rows":
        return Rows(_float(other) / self.values)

    def __pow__(self, other: Any) -> "Rows":
        # One exponent for all would have NumPy multiply, which the C library's square of one in a
        # thousand numbers differs from.
        exponents = np.broadcast_to(_values(other), self.values.shape).copy()
        return Rows(by_library(math.pow, self.values, exponents))

    def __neg__(self) -> "Rows":
        return Rows(-self.values)

    def __pos__(self) -> "Rows":
        return self

    def __abs__(self) -> "Rows":
        return Rows(np.abs(self.values))

    def __mod__(self, other: Any) -> "Rows":
        return Rows(np.mod(self.values, _values(other)))

    def __lt__(self, other: Any) -> Mask:
        return Mask(self.values < (other.values if type(other) is Rows else other))

    def __le__(self, other: Any) -> Mask:
        return Mask(self.values <= (other.values if type(other) is Rows else other))

    def __gt__(self, other: Any) -> Mask:
        return Mask(self.values > (other.values if type(other) is Rows else other))

    def __ge__(self, other: Any) -> Mask:
        return Mask(self.values >= (other.values if type(other) is Rows else other))

    def __eq__(self, other: Any) -> Mask:  # type: ignore[override]
        return Mask(self.values == (other.values if type(other) is Rows else other))

    def __ne__(self, other: Any) -> Mask:  # type: ignore[override]
        return Mask(self.values != (other.values if type(other) is Rows else other))

    def __bool__(self) -> bool:
        return bool(Mask(self.values != 0.0))

    def __round__(self, digits: int | None = None) -> "Rows":
        if digits is not None:
            raise TypeError("rows are rounded to whole numbers only")
        return Rows(np.round(self.values) + 0.0)  # zero has no sign, as that of an int

    def __floor__(self) -> "Rows":
        return Rows(np.floor(self.values))

    def __ceil__(self) -> "Rows":
        return Rows(np.ceil(self.values))

    # Methods by which NumPy's functions of an array of objects ask for its elements.

    def sqrt(self) -> "Rows":
        """Square roots."""
        return Rows(np.sqrt(self.values))

    def sin(self) -> "Rows":
        """Sines."""
        return Rows(by_library(math.sin, self.values))

    def cos(self) -> "Rows":
        """Cosines."""
        return Rows(by_library(math.cos, self.values))

    def arcsin(self) -> "Rows":
        """Arc sines."""
        return Rows(by_library(math.asin, self.values))

    def arctan2(self, other: Any) -> "Rows":
        """Angles of points."""
        return Rows(by_library(math.atan2, self.values, _values(other)))

    def exp(self) -> "Rows":
        """Exponential functions."""
        return Rows(by_library(math.exp, self.values))

    def log(self) -> "Rows":
        """Natural logarithms."""
        return Rows(by_library(math.log, self.values))

    def isfinite(self) -> Mask:
        """Rows whose number is finite."""
        return Mask(np.isfinite(self.values))

    def isnan(self) -> Mask:
        """Rows whose number is NaN."""
        return Mask(np.isnan(self.values))


def _float(number: Any) -> Any:
    """A number beside rows, of any type that a float adds to itself."""
    if type(number) is float:
        return number
    if isinstance(number, int | float):
        return float(number)
    raise TypeError(f"rows cannot be combined with {type(number).__name__}")


def _values(number: Any) -> Any:
    return number.values if type(number) is Rows else _float(number)


def values_of(number: Any) -> Any:
    """A number of each row (n), or the one number of all."""
    return number.values if type(number) is Rows else number


# NumPy's functions beside the C library's, where both can be called with these numbers.
_BESIDE: dict[Callable[..., float], np.ufunc] = {
    math.sin: np.sin,
    math.cos: np.cos,
    math.asin: np.arcsin,
    math.atan2: np.arctan2,
    math.exp: np.exp,
    math.log: np.log,
    math.pow: np.power,
}
_SAMPLES = 4096
_agreeing: dict[Callable[..., float], np.ufunc | None] = {}


def by_library(function: Callable[..., float], *arguments: Any) -> Floats:
    """Values of a function of the C library, to the last bit.

    NumPy has functions of its own on processors with AVX-512, that are several times as fast and
    differ in the last bit from those that a law calls with one number; a quantizer or a switch
    in a closed loop makes more of it. They are taken where they agree: on other processors, and
    in processes that began with `LIBRARY_FUNCTIONS` in their environment.

    Args:
        function: function of `math`.
        arguments: (n) each, or a float.
    """
    if function not in _agreeing:
        _agreeing[function] = _agreement(function, len(arguments))
    if (ufunc := _agreeing[function]) is not None:
        values: Floats = ufunc(*arguments)
        return values
    columns = np.broadcast_arrays(*arguments)
    lists = (column.tolist() for column in columns)
    try:
        return np.fromiter(map(function, *lists), np.float64, columns[0].size)
    except ValueError:  # outside the domain of one of them, where NumPy gives NaN
        return np.array([_or_nan(function, *row) for row in zip(*columns, strict=True)])


# Has NumPy call the C library's functions if it is in the environment as NumPy is imported.
LIBRARY_FUNCTIONS = {"NPY_DISABLE_CPU_FEATURES": "X86_V4"}


def _agreement(function: Callable[..., float], count: int) -> np.ufunc | None:
    """NumPy's function if it has the same values, by samples of which one in 20 would differ."""
    ufunc = _BESIDE.get(function)
    if ufunc is None:
        return None
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    columns = [np.arange(1, _SAMPLES + 1) * (golden ** (k + 1)) % 1.0 for k in range(count)]
    lists = (column.tolist() for column in columns)
    expected = np.fromiter(map(function, *lists), np.float64, _SAMPLES)
    return ufunc if np.array_equal(ufunc(*columns), expected) else None


def _or_nan(function: Callable[..., float], *arguments: float) -> float:
    try:
        return function(*map(float, arguments))
    except ValueError:
        return math.nan


def shared[R](function: Callable[[float], R], number: Number) -> R:
    """Result of a function of a float, such as an index; rows whose results differ part."""
    if type(number) is not Rows:
        return function(number)  # type: ignore[arg-type]
    distinct, places = np.unique(number.values, return_inverse=True)
    first, *others = results = [function(value) for value in distinct.tolist()]
    if any(other != first for other in others):
        raise Parted(np.array([result == first for result in results])[places])
    return first


def answer_of(flags: Any) -> Any:
    """A flag as a bool, or flags (n) as the answer of each row."""
    return Mask(flags) if np.ndim(flags) else bool(flags)


def common[T: np.generic](batch: NDArray[T], ndim: int = 1) -> NDArray[T]:
    """The array (ndim) that all rows of a batch have; rows that differ from the first part."""
    if batch.ndim == ndim:
        return batch
    same = (batch == batch[0]).all(axis=tuple(range(1, batch.ndim)))
    if not same.all():
        raise Parted(same)
    first: NDArray[T] = batch[0]
    return first


def number_of(values: Any) -> Any:
    """A number as a float, or numbers (n) as those of rows.

    Raises:
        TypeError: something else, such as numbers of rows themselves.
    """
    if not np.ndim(values):
        return float(values)
    if values.dtype == object:
        raise TypeError("numbers of rows are not rows themselves")
    return Rows(values)


def batch_of(numbers: Sequence[Number]) -> Floats:
    """Numbers (k) as an array (k), or (rows, k) where rows are among them."""
    size = _size_of([numbers])
    return np.array(numbers) if size is None else matrix_of(numbers, size).T.copy()


def array_of(numbers: Sequence[Number]) -> NDArray[Any]:
    """Numbers as an array: of floats, or of objects where rows are among them."""
    for number in numbers:
        if type(number) is Rows:
            array = np.empty(len(numbers), dtype=object)
            array[:] = numbers
            return array
    return np.array(numbers)


def matrix_of(numbers: Sequence[Number], size: int) -> Floats:
    """Numbers (k) of rows as an array (k, size), whatever their kind."""
    matrix = np.empty((len(numbers), size))
    for i, number in enumerate(numbers):
        matrix[i] = values_of(number)
    return matrix


def numbers_of(values: Iterable[Any]) -> list[Number]:
    """Numbers that a law gives: floats, and those of rows; an array (rows, size) has both.

    Raises:
        TypeError: something else.
    """
    array = values if isinstance(values, np.ndarray) else np.asarray(values)
    if array.dtype == np.float64:
        if array.ndim == 2:
            return [Rows(column) for column in array.T.copy()]
        floats: list[Number] = array.tolist()
        return floats
    return [number if type(number) is Rows else _float(number) for number in array.tolist()]


def taken(number: Number, index: Index) -> Number:
    """A number of some rows."""
    if index is None or type(number) is not Rows:
        return number
    return Rows(number.values[index])


def carried_out(
    law: Callable[[Index], Sequence[Number]],
    one: Callable[[int], Sequence[Number]] | None,
    size: int,
) -> list[Number]:
    """Numbers that a law gives for all rows, in parts where it asks what they answer differently.

    A law that does not take rows, or fails in one of them, raises something: its rows are then
    taken one at a time, and the error of a row is what `one` raises.

    Args:
        law: law of the rows at these positions; None for all.
        one: the same for one row alone, with floats; None: what the law raises is raised.
        size: number of rows.
    """
    try:
        return list(law(None))
    except Parted as parted:
        waiting = [np.flatnonzero(~parted.flags), np.flatnonzero(parted.flags)]
    except Exception:
        if one is None:
            raise
        return of_rows([one(position) for position in range(size)])
    parts: list[tuple[NDArray[np.intp], Sequence[Number]]] = []
    while waiting:
        index = waiting.pop()
        try:
            parts.append((index, law(index)))
        except Parted as parted:
            waiting += [index[~parted.flags], index[parted.flags]]
        except Exception:
            if one is None:
                raise
            numbers = of_rows([one(position) for position in index.tolist()])
            parts.append((index, numbers))
    return _merged(parts, size)


def of_rows(rows: Sequence[Sequence[Any]]) -> list[Number]:
    """Numbers of a vector of which each row has one."""
    numbers: list[Number] = []
    for column in np.array(rows, dtype=float).T.copy():
        words = column.view(np.uint64)  # zeros have signs
        numbers.append(float(column[0]) if (words == words[0]).all() else Rows(column))
    return numbers


def _common(column: Sequence[Number]) -> float | None:
    """The float that all numbers are; None if they differ, or are zeros, which have signs."""
    first = column[0]
    same = type(first) is float and first and all(type(x) is float and x == first for x in column)
    return first if same and type(first) is float else None


def _merged(parts: Sequence[tuple[NDArray[np.intp], Sequence[Number]]], size: int) -> list[Number]:
    """Numbers of all rows from those of its parts, by the positions of their rows."""
    whole: list[Number] = []
    for column in zip(*(numbers for _, numbers in parts), strict=True):
        if (common := _common(column)) is not None:
            whole.append(common)
            continue
        values = np.empty(size)
        for (index, _), number in zip(parts, column, strict=True):
            values[index] = values_of(number)
        whole.append(Rows(values))
    return whole


def each(law: Callable[..., Any], *columns: Sequence[Any]) -> list[Any]:
    """Results of a law for each of several channels: `[law(*row) for row in zip(*columns)]`.

    Channels of rows are taken as further rows, so that a law is carried out once for all of them,
    and not once for each combination of the ways that they go. What the law raises is raised.

    Args:
        law: function of an element of each column, or a method of an object that rows share, or
            that stands for those of all rows; gives a number or a tuple of them.
        columns: sequences of one length; elements that are neither floats nor rows must be the
            same in all channels.
    """
    size = _size_of(columns)
    if size is None:
        return [law(*channel) for channel in zip(*columns, strict=True)]
    count = len(columns[0])
    flat: list[Any] = [_flat(column, size) for column in columns]

    is_tuple = True

    def as_tuple(result: Any) -> tuple[Any, ...]:
        nonlocal is_tuple
        is_tuple = isinstance(result, tuple)
        return result if is_tuple else (result,)

    owner = getattr(law, "__self__", None)
    rows = np.arange(count * size) % size

    def of_rows(index: Index) -> tuple[Any, ...]:
        own: Any = law
        if isinstance(owner, OfRows):
            there = owner.taken(rows if index is None else rows[index])
            own = MethodType(own.__func__, there)
        return as_tuple(own(*(taken(column, index) for column in flat)))

    numbers = carried_out(of_rows, None, count * size)
    channels = [
        tuple(
            Rows(number.values[i * size : (i + 1) * size]) if type(number) is Rows else number
            for number in numbers
        )
        for i in range(count)
    ]
    return channels if is_tuple else [channel[0] for channel in channels]


def _size_of(columns: Sequence[Sequence[Any]]) -> int | None:
    for column in columns:
        for element in column:
            if type(element) is Rows:
                return element.values.size
    return None


def _flat(column: Sequence[Any], size: int) -> Any:
    """A column of all channels: what they share, or their rows one after the other."""
    first = column[0]
    if type(first) is not Rows and all(element is first for element in column):
        return first
    return _common(column) or Rows(matrix_of(column, size).ravel())
