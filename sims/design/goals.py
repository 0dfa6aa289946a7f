"""Goals of a search for designs: objectives and constraints by the names of what they are about.

A name is an entry of the machine's data sheet, such as `level_range_deg`, or a metric of an
experiment, such as `level:settling_time_s`, which costs a run for each design.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from parapod.sims.lab.discovery import find_entry
from parapod.sims.sheet.sheet import AnySheet
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import did_you_mean, quoted

type Array = NDArray[np.float64]

_HOLD = re.compile(r"\s*([\w:.-]+?)\s*(<=|>=)\s*([^\s<>=]+)\s*")


@dataclass(frozen=True)
class Goal:
    """An objective.

    Attributes:
        name: name of the number.
        sign: 1.0 to make it small, -1.0 to make it large.
    """

    name: str
    sign: float

    def __str__(self) -> str:
        return f"{'minimise' if self.sign > 0.0 else 'maximise'} {self.name}"


@dataclass(frozen=True)
class Hold:
    """A constraint.

    Attributes:
        name: name of the number.
        relation: side on which it has to stay.
        limit: admissible value nearest to the others.
    """

    name: str
    relation: Literal["<=", ">="]
    limit: float

    def __str__(self) -> str:
        return f"{self.name}{self.relation}{self.limit:g}"

    @classmethod
    def from_text(cls, text: str) -> "Hold":
        """The constraint that a text such as `mass_kg<=60` says.

        Raises:
            ScenarioError: it is not of that form.
        """
        match = _HOLD.fullmatch(text)
        try:
            limit = float(match[3]) if match else np.nan
        except ValueError:
            limit = np.nan
        if match is None or not np.isfinite(limit):
            raise ScenarioError(
                f"{quoted(text)} is not of the form NAME<=VALUE or NAME>=VALUE, as in mass_kg<=60"
            )
        relation: Any = match[2]
        return cls(match[1], relation, limit)

    def violation(self, values: Array) -> Array:
        """Amount by which values (n) break it, by the size of its limit; zero where it holds."""
        beyond = values - self.limit if self.relation == "<=" else self.limit - values
        return np.maximum(beyond, 0.0) / max(abs(self.limit), 1e-9)


def check_names(names: Sequence[str], sheet: type[AnySheet]) -> None:
    """Refuses names that are neither entries of a sheet nor metrics of an experiment.

    Raises:
        ScenarioError: says which there are.
        UnknownExperiment: there is no experiment of that name.
    """
    entries = sheet.entries()
    for name in names:
        experiment, colon, metric = name.partition(":")
        if colon and metric:
            find_entry(experiment)
        elif name not in entries:
            hint = did_you_mean(name, entries)
            raise ScenarioError(
                f"{quoted(name)} is not in the data sheet{hint}; there are: "
                f"{', '.join(entries)}; a metric is written EXPERIMENT:METRIC"
            )


def front_of(objectives: Array) -> NDArray[np.int_]:
    """Places of the rows (n, m) that no other row beats, sorted by the first objective.

    A row beats another one if none of its objectives is larger and one is smaller. Of rows that
    are alike the first one counts.
    """
    order = np.lexsort(objectives.T[::-1])
    front: list[int] = []
    for place in order.tolist():
        row = objectives[place]
        before = objectives[front]
        if not len(front) or not (before <= row).all(axis=1).any():
            front.append(place)
    return np.array(front, dtype=int)
