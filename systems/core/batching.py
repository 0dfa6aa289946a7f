"""Batches of vectors for elementwise functions: taken apart into columns, put together again."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.elementwise import Elementwise

# Types of numbers that are taken as they are.
_TAKEN = (np.dtype(np.float64), np.dtype(object))


def of_width(value: ArrayLike, width: int, name: str) -> NDArray[Any]:
    """The value as an array (..., width).

    Raises:
        ValueError: another shape; calls the value by its name.
    """
    array = np.asarray(value)
    if array.ndim == 0 or array.shape[-1] != width:
        raise ValueError(f"{name} must have shape (..., {width}), not {array.shape}")
    return array


def _numbers(value: ArrayLike, width: int, name: str) -> NDArray[Any]:
    array = of_width(value, width, name)
    return array if array.dtype in _TAKEN else array.astype(np.float64)


def columns(
    *blocks: tuple[ArrayLike, int, str],
) -> tuple[list[list[Elementwise]], tuple[int, ...]]:
    """Components of each block as floats (single) or contiguous vectors (batch), and the shape.

    A block without leading dimensions stays a list of floats inside a batch: its sines are then
    taken once.

    Args:
        blocks: a value, its width and its name each.

    Raises:
        ValueError: wrong shapes.
    """
    arrays = [_numbers(*block) for block in blocks]
    if all(array.ndim == 1 for array in arrays):
        return [array.tolist() for array in arrays], ()
    shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
    columns_of: list[list[Elementwise]] = []
    for array in arrays:
        if array.ndim == 1:
            columns_of.append(array.tolist())
        else:
            array = np.broadcast_to(array, (*shape, array.shape[-1]))
            rows = array.reshape(math.prod(shape), array.shape[-1])
            columns_of.append([np.ascontiguousarray(rows[:, i]) for i in range(rows.shape[1])])
    return columns_of, shape


def row_by_row(law: Callable[..., Any], ndim: int, *batches: NDArray[Any]) -> NDArray[np.float64]:
    """Results of a law that takes one row at a time, such as a solver of SciPy.

    Args:
        law: function of arrays; gives an array.
        ndim: number of dimensions of its first argument.
        batches: its arguments, or those of each row (rows, ...).
    """
    if batches[0].ndim == ndim:
        result: NDArray[np.float64] = law(*batches)
        return result
    return np.array([law(*row) for row in zip(*batches, strict=True)])


def first_of_largest(values: ArrayLike, tolerance: float) -> tuple[int, ...]:
    """Index of the first value that is as large as the largest, NaN being larger than all.

    Values of mirrored legs or of repeated cycles are equal but for rounding, which differs from
    one processor to another: what is named must not.

    Args:
        values: (...), not empty.
        tolerance: difference from the largest that is taken for rounding.
    """
    ranked = np.nan_to_num(np.asarray(values, dtype=float), nan=np.inf)
    first = int(np.argmax(ranked >= ranked.max() - tolerance))
    return tuple(int(i) for i in np.unravel_index(first, ranked.shape))


def stack(columns: Sequence[Elementwise], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Columns as the last dimension of an array of the batch's shape."""
    if not shape:
        return np.array(columns)
    size = int(np.prod(shape))
    stacked = np.stack([np.broadcast_to(column, (size,)) for column in columns], axis=-1)
    return stacked.reshape(*shape, len(columns))
