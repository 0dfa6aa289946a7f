"""Fast, typed access to vectors from Python callbacks.

A controller's tick reads some forty short vectors. `InputPort.Eval` copies through numpy each
time; these go through a view to plain numbers, for floats and AutoDiffXd alike.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, InputPort

# Up to this size reading number by number is faster than making a view.
_SHORT = 6


def read(port: InputPort, context: Context) -> list[Any]:
    """The numbers at an input port, which must be connected."""
    return elements(port.EvalBasicVector(context))


def read_or_zeros(port: InputPort, context: Context) -> list[Any]:
    """The numbers at an input port; zeros if it is not connected."""
    return read(port, context) if port.HasValue(context) else [0.0] * port.size()


def read_array(port: InputPort, context: Context) -> NDArray[np.float64]:
    """The vector at an input port, copied; an object array for AutoDiffXd."""
    array: Any = port.Eval(context)
    return array


def is_on(port: InputPort, context: Context) -> bool:
    """Whether the first number at an input port is above 0.5; NaN is off."""
    signal: Any = port.EvalBasicVector(context)
    return bool(signal[0] > 0.5)


def elements(vector: Any) -> list[Any]:
    """The numbers of a BasicVector: floats, or AutoDiffXd."""
    if type(vector) is BasicVector and (size := vector.size()) <= _SHORT:
        return [vector[i] for i in range(size)]
    try:
        return vector.value().tolist()
    except (RuntimeError, TypeError):  # scalars other than float have no view
        return vector.CopyToVector().tolist()
