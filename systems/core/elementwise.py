"""Functions of one number that serve floats, numpy arrays and Drake's AutoDiff alike.

A formula written with these runs as plain Python floats inside a controller's tick (some ten
times faster than numpy on four elements), on arrays in a batch, and on AutoDiffXd in a
gradient. Outside their domain floats give NaN, as numpy does (with its usual warning, which a
caller who expects NaN silences with `nan_without_warning`), instead of raising.
"""

import math
from typing import Any

import numpy as np

# A float, an array of floats, or an AutoDiffXd (or an object array of them).
type Elementwise = Any

# Decorates a function whose result is NaN by contract where nothing can be built or reached.
nan_without_warning = np.errstate(invalid="ignore", divide="ignore")


def sqrt(x: Elementwise) -> Elementwise:
    """Square root; NaN for negative numbers."""
    if type(x) is float:
        return math.sqrt(x) if x >= 0.0 else math.nan
    return np.sqrt(x)


def quotient(x: Elementwise, y: Elementwise) -> Elementwise:
    """Quotient x / y; NaN for a float by zero."""
    if type(y) is float and not y:
        return math.nan
    return x / y


def sin_cos(x: Elementwise) -> tuple[Elementwise, Elementwise]:
    """Sine and cosine of an angle; NaN for infinite ones."""
    if type(x) is float:
        try:
            return math.sin(x), math.cos(x)
        except ValueError:  # of an infinite number
            return math.nan, math.nan
    return np.sin(x), np.cos(x)


def asin(x: Elementwise) -> Elementwise:
    """Arc sine; NaN outside [-1, 1]."""
    if type(x) is float:
        return math.asin(x) if -1.0 <= x <= 1.0 else math.nan
    return np.arcsin(x)


def atan2(y: Elementwise, x: Elementwise) -> Elementwise:
    """Angle of the point (x, y)."""
    if type(y) is float and type(x) is float:
        return math.atan2(y, x)
    return np.arctan2(y, x)


def exp(x: Elementwise) -> Elementwise:
    """Exponential function."""
    if type(x) is float:
        return math.exp(x)
    return np.exp(x)


def clamp(x: Elementwise, low: float, high: float) -> Elementwise:
    """The number of [low, high] nearest to the scalar x; `low` if x is NaN."""
    if x > low:
        return x if x < high else high
    return low


def log(x: Elementwise) -> Elementwise:
    """Natural logarithm; NaN for numbers that have none."""
    if type(x) is float:
        return math.log(x) if x > 0.0 else math.nan
    return np.log(x)
