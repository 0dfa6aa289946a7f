"""Variables of a study: the keys of a scenario that differ from run to run, and their values.

    ground.pitch_deg=-5:5:11               11 values from -5 to 5
    seed=0:200                             the seeds 0 to 199
    control.pole=8:12                      between 8 and 12, if the key need not be whole
    plant.leg_model=full,reduced           these values
    plant.length_error_mm=normal(0, 0.3)   mean and standard deviation
    machine.sensors.imu_delay_ms=loguniform(1, 100)  as likely in every octave

A distribution counts as far as the scenario admits its values: of a normal one, the part within
the admissible range.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy import stats  # type: ignore[import-untyped]

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import quoted, show
from parapod.systems.core.scenario_file import inline, parse
from parapod.systems.core.schema import Range, Reader, Rule

type Array = NDArray[np.float64]

# Share of a distribution that has to be admissible.
_LEAST_SHARE = 0.01
# Longest list of values of which each is tried; of a range only the ends decide.
_LONGEST = 10_000
_FORMS = (
    "FIRST:LAST:NUMBER, FIRST:END, VALUE,VALUE,..., normal(MEAN, DEVIATION), uniform(LOW, HIGH) "
    "or loguniform(LOW, HIGH)"
)
# Distributions by their names: that of their two parameters.
_LAWS: dict[str, Callable[[float, float], Any]] = {
    "normal": stats.norm,
    "uniform": lambda low, high: stats.uniform(low, high - low),
    "loguniform": stats.loguniform,
}


@dataclass(frozen=True)
class Variable:
    """One key of a scenario, with the values that it takes.

    Attributes:
        key: dotted key.
        text: the values as they were asked for.
        values: the values; empty for a distribution.
        quantile: values (n) of a distribution below which shares (n) of it lie; None for values.
    """

    key: str
    text: str
    values: Sequence[Any] = ()
    quantile: Callable[[Array], Array] | None = None

    def __str__(self) -> str:
        return f"{self.key}={self.text}"

    def at(self, shares: Array) -> list[Any]:
        """Values at shares (n) of the distribution, or of the list of values; shares in 0..1."""
        if self.quantile is not None:
            values: list[Any] = self.quantile(shares).tolist()
            return values
        last = len(self.values) - 1
        places = np.minimum((len(self.values) * shares).astype(int), last)
        return [self.values[place] for place in places.tolist()]

    @property
    def is_number(self) -> bool:
        """Whether its values are numbers."""
        return self.quantile is not None or all(
            isinstance(value, int | float) and not isinstance(value, bool)
            for value in (self.values[:1] if isinstance(self.values, range) else self.values)
        )


def split_variable(text: str) -> tuple[str, str]:
    """Key and values of `key=values`.

    Raises:
        ScenarioError: it is not of that form.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    if not (key and equals and values):
        raise ScenarioError(f"{quoted(text)} is not of the form KEY=VALUES, with VALUES {_FORMS}")
    return key, values


def read_variables(
    schema: type, tree: Mapping[str, Any], texts: Mapping[str, str | Sequence[Any]]
) -> tuple[Variable, ...]:
    """The variables of a study, checked against what a scenario admits.

    Args:
        schema: the scenario's dataclass.
        tree: the scenario that they change, as plain data.
        texts: values by key: a sequence, or a text as above.

    Raises:
        ScenarioError: a key that does not exist, values that are not admissible, or none.
    """
    if not texts:
        raise ScenarioError("a study varies at least one key, as in ground.pitch_deg=-5:5:11")
    variables = tuple(_Reading(schema, tree, key).read(values) for key, values in texts.items())
    for inner in texts:
        for outer in texts:
            if inner.startswith(f"{outer}."):
                raise ScenarioError(f"{inner} is a part of {outer}: vary only one of them", inner)
    return variables


class _Reading:
    """Reading of one variable."""

    def __init__(self, schema: type, tree: Mapping[str, Any], key: str):
        self._schema, self._tree, self._key = schema, tree, key
        self._reader = Reader(schema)
        self._kind, self._rule = self._reader.locate(schema, tree, key.split("."))

    def read(self, text: str | Sequence[Any]) -> Variable:
        if isinstance(text, str):
            return self._from_text(text.strip())
        values = [item.item() if isinstance(item, np.generic) else item for item in text]
        return self._of_values(inline(values), values)

    def _from_text(self, text: str) -> Variable:
        call = re.fullmatch(r"(\w+)\s*\((.*)\)", text)
        if call is not None:
            return self._of_law(text, call[1], call[2].split(","))
        parts = [_as_number(part) for part in text.split(":")]
        numbers = [part for part in parts if part is not None]
        if 2 <= len(numbers) == len(parts) <= 3:
            return self._of_range(text, numbers)
        if self._kind is str and not re.search(r"[][{}'\"]", text):
            return self._of_values(text, [part.strip() for part in text.split(",")])
        listed = parse(text if text.startswith("[") else f"[{text}]", f"values of {self._key}")
        return self._of_values(text, listed)

    def _of_range(self, text: str, parts: list[float]) -> Variable:
        first, last = parts[:2]
        if len(parts) == 3:
            if parts[2] != int(parts[2]) or not 1 <= parts[2] <= _LONGEST:
                self._refuse(text, f"the number of values must be whole, 1..{_LONGEST}")
            # As people write them: -1.4, and not -1.4000000000000004.
            evenly = np.linspace(first, last, int(parts[2])).tolist()
            values = [float(f"{value:.15g}") for value in evenly]
            if self._kind is int:
                return self._of_values(text, [int(x) if x == int(x) else x for x in values])
            return self._of_values(text, values)
        if not first < last:
            self._refuse(text, "the end must be above the beginning")
        if self._kind is not int:
            return self._of_law(text, "uniform", [str(first), str(last)])
        if first != int(first) or last != int(last):
            self._refuse(text, "both ends must be whole numbers")
        return self._of_values(text, range(int(first), int(last)))

    def _of_values(self, text: str, values: Sequence[Any]) -> Variable:
        if len(values) == 0:
            self._refuse(text, "it has no values")
        if isinstance(values, range):
            ends: Sequence[Any] = (values[0], values[-1])
        elif len(values) > _LONGEST:
            self._refuse(text, f"it has more than {_LONGEST} values")
        else:
            ends = values
        for value in ends:
            self._reader.assign(self._schema, self._tree, self._key.split("."), value)
        return Variable(self._key, text, values)

    def _of_law(self, text: str, name: str, parameters: list[str]) -> Variable:
        numbers = [_as_number(parameter) for parameter in parameters]
        if name not in _LAWS or len(numbers) != 2 or None in numbers:
            self._refuse(text, f"values are {_FORMS}")
        if self._kind is not float:
            self._refuse(text, "a distribution is for keys whose numbers need not be whole")
        one, other = map(float, parameters)
        if name == "normal" and not other > 0.0:
            self._refuse(text, "the deviation must be above 0")
        if name != "normal" and not one < other:
            self._refuse(text, "the first number must be below the second")
        if name == "loguniform" and not one > 0.0:
            self._refuse(text, "the numbers must be above 0")
        if name != "normal":
            for end in (one, other):
                self._reader.assign(self._schema, self._tree, self._key.split("."), end)
        law = _LAWS[name](one, other)
        low, high = _limits(self._rule)
        # Upwards from the nearer tail: shares near 1 have no digits left.
        below, above = float(law.cdf(low)), float(law.sf(high))
        if 1.0 - below - above < _LEAST_SHARE:
            self._refuse(text, f"almost nothing of it is within {show(low)}..{show(high)}")

        def quantile(shares: Array) -> Array:
            values = law.ppf(below + shares * (1.0 - below - above))
            return np.clip(values, low, high)

        return Variable(self._key, text, quantile=quantile)

    def _refuse(self, text: str, why: str) -> NoReturn:
        raise ScenarioError(f"{self._key}={text}: {why}", self._key)


def _limits(rule: Rule) -> tuple[float, float]:
    return (rule.low, rule.high) if isinstance(rule, Range) else (-np.inf, np.inf)


def _as_number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if np.isfinite(number) else None
