"""Outcomes of the runs of a study, column by column."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from parapod.sims.output.results import Metric
from parapod.sims.study.runs import Outcome
from parapod.sims.study.sampling import Sampling

type Array = NDArray[np.float64]

# Name of the verdict on a run among its metrics.
ALL_HELD = "all bounds held"


@dataclass
class Column:
    """One metric over the runs; NaN where a run did not measure it, or where it has no bound.

    Attributes:
        key: name of the metric.
        unit: its unit.
        meaning: its meaning.
        values: its values (runs).
        bound: largest admissible |value| (runs).
        at_least: smallest admissible value (runs).
        is_there: true where a run measured it (runs); a measured value may be NaN.
        place: first run that measured it, and its place among that run's metrics.
        undefined: reason for which it may have no finite value.
    """

    key: str
    unit: str
    meaning: str
    values: Array
    bound: Array
    at_least: Array
    is_there: NDArray[np.bool_]
    place: tuple[int, int]
    undefined: str = ""

    @classmethod
    def empty(cls, metric: Metric, runs: int) -> "Column":
        """Before any run."""
        values, bound, at_least = (np.full(runs, np.nan) for _ in range(3))
        there, place = np.zeros(runs, bool), (runs, 0)
        words, arrays = (metric.key, metric.unit, metric.meaning), (values, bound, at_least, there)
        return cls(*words, *arrays, place, metric.undefined)

    def put(self, run: int, place: int, metric: Metric) -> None:
        """Takes the metric of a run."""
        self.values[run], self.is_there[run] = metric.value, True
        self.bound[run] = math.nan if metric.bound is None else metric.bound
        self.at_least[run] = math.nan if metric.at_least is None else metric.at_least
        self.place = min(self.place, (run, place))

    @property
    def is_bounded(self) -> bool:
        """Whether any run has a bound for it."""
        return not (np.isnan(self.bound) & np.isnan(self.at_least)).all()

    @property
    def held(self) -> NDArray[np.bool_]:
        """Whether the runs (runs) measured it, finite and within their bounds."""
        values = self.values
        within = ~(np.abs(values) > self.bound) & ~(values < self.at_least)
        held: NDArray[np.bool_] = self.is_there & np.isfinite(values) & within
        return held

    @property
    def use(self) -> Array:
        """Share of the bound that is used (runs): 1 at the bound, above where it is broken.

        Of a smallest admissible value it is that value by the measured one; infinite where the
        value is not finite, NaN where there is no bound or no value.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            above = np.where(self.bound > 0.0, np.abs(self.values) / self.bound, np.nan)
            # A bound of 0: what is above it is out of it by as much as it likes.
            above = np.where(self.bound == 0.0, np.where(self.values == 0.0, 0.0, np.inf), above)
            span = self.values - self.at_least
            below = np.where(
                self.at_least > 0.0,
                np.where(self.values > 0.0, self.at_least / self.values, np.inf),
                np.where(span >= 0.0, 0.0, np.inf),
            )
        below = np.where(np.isnan(self.at_least), np.nan, below)
        use: Array = np.fmax(above, below)
        has_bound = ~(np.isnan(self.bound) & np.isnan(self.at_least))
        use[self.is_there & ~np.isfinite(self.values) & has_bound] = np.inf
        return use

    def limit(self, of: Array) -> float | None:
        """The bound of all runs that have measured it; None if it has none, or several."""
        limits = of[self.is_there]
        if not limits.size or np.isnan(limits).any() or (limits != limits[0]).any():
            return None
        return float(limits[0])


@dataclass
class Records:
    """Everything that came out of a study.

    Attributes:
        sampling: the runs.
        done: true where a run has been carried out (runs).
        errors: reasons for which runs were refused or failed, by their numbers.
    """

    sampling: Sampling
    done: NDArray[np.bool_] = field(init=False)
    errors: dict[int, str] = field(default_factory=dict)
    _columns: dict[str, Column] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.done = np.zeros(self.sampling.runs, bool)

    def add(self, outcome: Outcome) -> None:
        """Takes the outcome of a run."""
        self.done[outcome.run] = True
        if outcome.error:
            self.errors[outcome.run] = outcome.error
        for place, metric in enumerate(outcome.metrics):
            column = self._columns.get(metric.key)
            if column is None:
                column = self._columns[metric.key] = Column.empty(metric, self.sampling.runs)
            column.put(outcome.run, place, metric)

    def add_column(self, column: Column) -> None:
        """Takes a metric of all runs."""
        self._columns[column.key] = column

    @property
    def columns(self) -> list[Column]:
        """The metrics, in the order in which the runs measure them, whichever was done first."""
        return sorted(self._columns.values(), key=lambda column: column.place)

    def __getitem__(self, key: str) -> Array:
        """Values (runs) of a metric.

        Raises:
            KeyError: no such metric; names those that there are.
        """
        if key not in self._columns:
            keys = ", ".join(column.key for column in self.columns)
            raise KeyError(f"no metric '{key}'; there are: {keys}")
        return self._columns[key].values

    @property
    def refused(self) -> NDArray[np.bool_]:
        """Whether a run was refused or failed (runs)."""
        refused = np.zeros(self.sampling.runs, bool)
        refused[list(self.errors)] = True
        return refused

    @property
    def passed(self) -> NDArray[np.bool_]:
        """Whether a run was carried out with all bounds held (runs)."""
        passed = self.done & ~self.refused
        for column in self._columns.values():
            passed &= column.held | ~column.is_there
        return passed

    @property
    def verdict(self) -> Column:
        """Whether all bounds were held, as a metric: 1 or 0; a run that was refused held none."""
        column = Column.empty(Metric(ALL_HELD, 0.0), self.sampling.runs)
        column.values[:], column.is_there[:] = self.passed, self.done
        return column

    def broken(self) -> list[str]:
        """By run, the keys of the metrics that it measured out of their bounds, with commas."""
        reasons = [""] * self.sampling.runs
        for column in self.columns:
            for run in np.flatnonzero(column.is_there & ~column.held).tolist():
                reasons[run] += f", {column.key}" if reasons[run] else column.key
        return reasons
