"""Shares of the variables in the variance of a metric: Sobol indices.

The first-order index of a variable is the share that it has alone, the total one the share in
which it has a part. From a design of Saltelli they are estimated by `scipy.stats.sobol_indices`;
from a whole grid they are exact for the grid: variances of means over the other variables.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import sobol_indices  # type: ignore[import-untyped]

from parapod.sims.study.records import Column
from parapod.sims.study.sampling import Sampling

type Array = NDArray[np.float64]

# A metric that varies by less than this share of its size does not vary.
_CONSTANT = 1e-9
_RESAMPLES = 200  # resamples of the bootstrap


@dataclass(frozen=True)
class Contributions:
    """Indices of one metric, an element for each variable.

    Attributes:
        key: name of the metric.
        first: shares that the variables have alone.
        total: shares in which they have a part.
        low: lower end of the 95 % confidence interval of `total`; `total` where that is exact.
        high: upper end of it.
    """

    key: str
    first: Array
    total: Array
    low: Array
    high: Array


def contributions(sampling: Sampling, columns: Sequence[Column]) -> list[Contributions]:
    """Indices of those metrics that all runs have measured, finite, and that vary.

    Args:
        sampling: the runs, all of which must have been carried out.
        columns: the metrics.

    Returns:
        None of a sampling from which there are none to be had.
    """
    if sampling.kind == "grid" and min(sampling.shape) > 1:
        count = sampling.runs
    elif sampling.base:
        count = sampling.base * (len(sampling.variables) + 2)
    else:
        return []
    results = []
    for column in columns:
        values = column.values[:count]
        if not (column.is_there[:count] & np.isfinite(values)).all():
            continue
        if np.ptp(values) <= _CONSTANT * np.abs(values).max():
            continue
        of = _of_grid if sampling.kind == "grid" else _of_design
        results.append(of(sampling, column.key, values))
    return results


def _of_design(sampling: Sampling, key: str, values: Array) -> Contributions:
    a, b, mixed = sampling.split(values)
    # Differences from the mean: the estimate is less noisy.
    mean = float(np.mean(np.concatenate((a, b))))
    design = {"f_A": a[None] - mean, "f_B": b[None] - mean, "f_AB": mixed[:, None] - mean}
    indices = sobol_indices(func=design, n=sampling.base, rng=0)
    spread = indices.bootstrap(n_resamples=_RESAMPLES).total_order.confidence_interval
    shapes = (indices.first_order, indices.total_order, spread.low, spread.high)
    return Contributions(key, *(np.ravel(shape) for shape in shapes))


def _of_grid(sampling: Sampling, key: str, values: Array) -> Contributions:
    table = values.reshape(sampling.shape)
    axes = range(table.ndim)
    variance = float(table.var())
    first = [table.mean(axis=tuple(j for j in axes if j != i)).var() for i in axes]
    rest = [table.mean(axis=i).var() for i in axes]
    total = 1.0 - np.array(rest) / variance
    return Contributions(key, np.array(first) / variance, total, total, total)
