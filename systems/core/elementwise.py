"""Functions of numbers that serve floats, rows, numpy arrays and Drake's AutoDiff alike.

A formula written with these runs as plain Python floats inside a controller's tick (some ten
times faster than numpy on four elements), on the rows of many runs, on arrays in a batch, and on
AutoDiffXd in a gradient. Outside their domain floats give NaN, as numpy does (with its usual
warning, which a caller who expects NaN silences with `nan_without_warning`), instead of raising.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from parapod.systems.core.rows import Mask, Rows, by_library, matrix_of, values_of

# A float, a number of each row, an array of floats, or an AutoDiffXd (or an object array of them).
type Elementwise = Any

# Decorates a function whose result is NaN by contract where nothing can be built or reached.
nan_without_warning = np.errstate(invalid="ignore", divide="ignore")


def sqrt(x: Elementwise) -> Elementwise:
    """Square root; NaN for negative numbers."""
    if type(x) is float:
        return math.sqrt(x) if x >= 0.0 else math.nan
    return Rows(np.sqrt(x.values)) if type(x) is Rows else np.sqrt(x)


def quotient(x: Elementwise, y: Elementwise) -> Elementwise:
    """Quotient x / y; NaN for a float by zero."""
    if type(y) is float and not y:
        return math.nan
    if type(y) is Rows:
        values = np.full(y.values.size, math.nan)
        np.divide(values_of(x), y.values, out=values, where=y.values != 0.0)
        return Rows(values)
    return x / y


def sin_cos(x: Elementwise) -> tuple[Elementwise, Elementwise]:
    """Sine and cosine of an angle; NaN for infinite ones."""
    if type(x) is float:
        try:
            return math.sin(x), math.cos(x)
        except ValueError:  # of an infinite number
            return math.nan, math.nan
    if type(x) is Rows:
        return x.sin(), x.cos()
    return np.sin(x), np.cos(x)


def sin(x: Elementwise) -> Elementwise:
    """Sine of an angle, which is finite."""
    if type(x) is float:
        return math.sin(x)
    return x.sin() if type(x) is Rows else np.sin(x)


def asin(x: Elementwise) -> Elementwise:
    """Arc sine; NaN outside [-1, 1]."""
    if type(x) is float:
        return math.asin(x) if -1.0 <= x <= 1.0 else math.nan
    return x.arcsin() if type(x) is Rows else np.arcsin(x)


def atan2(y: Elementwise, x: Elementwise) -> Elementwise:
    """Angle of the point (x, y)."""
    if type(y) is float and type(x) is float:
        return math.atan2(y, x)
    if type(y) is Rows:
        return y.arctan2(x)
    if type(x) is Rows:
        return Rows(by_library(math.atan2, y, x.values))
    return np.arctan2(y, x)


def exp(x: Elementwise) -> Elementwise:
    """Exponential function."""
    if type(x) is float:
        return math.exp(x)
    return x.exp() if type(x) is Rows else np.exp(x)


def log(x: Elementwise) -> Elementwise:
    """Natural logarithm; NaN for numbers that have none."""
    if type(x) is float:
        return math.log(x) if x > 0.0 else math.nan
    return x.log() if type(x) is Rows else np.log(x)


def length_of(x: Elementwise, y: Elementwise, z: Elementwise = 0.0) -> Elementwise:
    """Length of a vector, whose squares are neither too large nor too small for floats."""
    return sqrt(x * x + y * y + z * z)


def total(numbers: Iterable[Elementwise]) -> Elementwise:
    """Sum as the builtin `sum` has it: what rounding takes from floats is added at the end.

    That is Neumaier's method, "Rundungsfehleranalyse einiger Verfahren zur Summation endlicher
    Summen", 1974, which Python has from 3.12 on.
    """
    numbers = list(numbers)
    if not any(type(number) is Rows for number in numbers):
        return sum(numbers)
    result: Any = 0.0
    lost: Any = 0.0
    for number in numbers:
        after = result + number
        is_larger = abs(result) >= abs(number)
        lost = lost + where(is_larger, (result - after) + number, (number - after) + result)
        result = after
    return where(is_finite(lost), result + lost, result)


def sumprod(p: Sequence[Elementwise], q: Sequence[Elementwise]) -> Elementwise:
    """Sum of products as `math.sumprod` has it, which rounds once."""
    size = next((x.values.size for x in (*p, *q) if type(x) is Rows), None)
    if size is None:
        return math.sumprod(p, q)
    rows = (matrix_of(vector, size).T.tolist() for vector in (p, q))
    return Rows(np.fromiter(map(math.sumprod, *rows), np.float64, size))


def copysign(x: Elementwise, sign: Elementwise) -> Elementwise:
    """Magnitude of x with another number's sign, of floats or rows."""
    if type(x) is Rows or type(sign) is Rows:
        return Rows(np.copysign(values_of(x), values_of(sign)))
    return math.copysign(x, sign)


def is_finite(x: Elementwise) -> Any:
    """Whether a number is finite: a bool, or that of each row."""
    return x.isfinite() if type(x) is Rows else math.isfinite(x)


def all_finite(numbers: Any) -> bool:
    """Whether all numbers of an array, or of a sequence, are finite; rows that differ part."""
    array = np.asarray(numbers)
    if array.dtype == object:
        return all(map(is_finite, array.ravel().tolist()))
    return bool(np.isfinite(array).all())


def where(condition: Any, x: Elementwise, y: Elementwise) -> Elementwise:
    """The number x where a condition holds, else y, of floats or rows.

    Both are calculated: a law that asks `if` parts rows that differ, which this does not.
    """
    if type(condition) is Mask:
        return Rows(np.where(condition.flags, values_of(x), values_of(y)))
    return x if condition else y


def least(x: Elementwise, y: Elementwise) -> Elementwise:
    """The number that is not larger, as `min` of two has it: x if they are equal or NaN."""
    return where(y < x, y, x)


def greatest(x: Elementwise, y: Elementwise) -> Elementwise:
    """The number that is not smaller, as `max` of two has it: x if they are equal or NaN."""
    return where(y > x, y, x)


def first_least(numbers: Sequence[Elementwise]) -> tuple[Any, ...]:
    """Answers, one of which is yes: that of the first of the smallest of several numbers."""
    if not any(type(number) is Rows for number in numbers):
        least_at = numbers.index(min(numbers))
        return tuple(i == least_at for i in range(len(numbers)))
    size = next(number.values.size for number in numbers if type(number) is Rows)
    at = np.argmin(matrix_of(numbers, size), axis=0)
    return tuple(Mask(np.equal(at, i)) for i in range(len(numbers)))


def both(x: Any, y: Any) -> Any:
    """Whether two answers are yes, of all or of each row."""
    if type(x) is Mask or type(y) is Mask:
        return x & y
    return x and y


def either(x: Any, y: Any) -> Any:
    """Whether one of two answers is yes, of all or of each row."""
    if type(x) is Mask or type(y) is Mask:
        return x | y
    return x or y


def negated(x: Any) -> Any:
    """The opposite answer, of all or of each row."""
    return ~x if type(x) is Mask else not x


def clamp(x: Elementwise, low: Elementwise, high: Elementwise) -> Elementwise:
    """The number of [low, high] nearest to x; `low` if x is NaN."""
    if type(x) is Rows:
        return where(x > low, where(x < high, x, high), low)
    if x > low:
        return x if x < high else high
    return low
