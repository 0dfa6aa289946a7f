"""Outcome of a search: designs that no other one beats, what they depend on, and one of them."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from parapod.sims.design.goals import front_of
from parapod.sims.design.search import Search
from parapod.sims.sheet.page import shown
from parapod.sims.sheet.sheet import AnySheet
from parapod.sims.study.records import Records
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.schema import checked

type Array = NDArray[np.float64]

# Part of a variable's range over which a derivative is taken, and reasons that are listed.
_STEP, _REASONS = 0.01, 5


@dataclass(frozen=True)
class Design:
    """One design of the front.

    Attributes:
        number: its place in the front, from 1.
        run: its number in the search.
        settings: values of the variables by their keys.
        values: values of objectives and constraints by their names.
    """

    number: int
    run: int
    settings: Mapping[str, Any]
    values: Mapping[str, float]


class SearchResult:
    """Everything that came out of a search."""

    def __init__(self, search: Search, records: Records):
        """Takes the records of a search."""
        self.search, self.records = search, records

    @cached_property
    def runs(self) -> NDArray[np.int_]:
        """Numbers of the designs that have been worked out."""
        return np.flatnonzero(self.records.done)

    @cached_property
    def scores(self) -> tuple[Array, Array]:
        """Objectives to be small, and violations, of `runs`."""
        return self.search.scores(self.records, self.runs.tolist())

    @cached_property
    def admissible(self) -> NDArray[np.bool_]:
        """Whether the designs of `runs` hold all constraints."""
        is_held: NDArray[np.bool_] = self.scores[1] == 0.0
        return is_held

    @cached_property
    def front(self) -> tuple[Design, ...]:
        """Admissible designs that no other one beats, by the first objective."""
        objectives, runs = self.scores[0][self.admissible], self.runs[self.admissible]
        best = runs[front_of(objectives)].tolist() if len(runs) else []
        return tuple(self._design(number, run) for number, run in enumerate(best, start=1))

    def _design(self, number: int, run: int) -> Design:
        keys = (variable.key for variable in self.search.sampling.variables)
        settings = dict(zip(keys, self.search.sampling.values(run), strict=True))
        values = {name: float(self.records[name][run]) for name in self.search.names}
        return Design(number, run, settings, values)

    @cached_property
    def nearest(self) -> Design | None:
        """Design that breaks constraints least, where none holds them; None: all are refused."""
        violations = self.scores[1]
        if not np.isfinite(violations).any():
            return None
        return self._design(0, int(self.runs[int(violations.argmin())]))

    @cached_property
    def compromise(self) -> Design | None:
        """Design of the front that is nearest to the best of each objective, each by its range."""
        if not self.front:
            return None
        goals = self.search.goals
        rows = np.array([[g.sign * d.values[g.name] for g in goals] for d in self.front])
        span = np.ptp(rows, axis=0)
        distances = np.linalg.norm((rows - rows.min(axis=0)) / np.where(span, span, 1.0), axis=1)
        return self.front[int(distances.argmin())]

    def pick(self, number: int) -> Design:
        """A design of the front.

        Raises:
            ParapodError: there is none of that number.
        """
        if not 1 <= number <= len(self.front):
            raise ParapodError(f"there is no design {number}; there are 1..{len(self.front)}")
        return self.front[number - 1]

    @cached_property
    def sensitivities(self) -> dict[str, dict[str, float]]:
        """Changes of each number by one hundredth of each variable's range, at the compromise.

        NaN where the designs beside it are refused, or where the variable is not a number.
        """
        centre = self.compromise
        if centre is None:
            return {}
        table = {}
        for variable in self.search.sampling.variables:
            beside = {}
            if variable.quantile is not None:
                low, high = variable.quantile(np.array([0.0, 1.0])).tolist()
                for step in (-_STEP, _STEP):
                    value = centre.settings[variable.key] + step * (high - low)
                    settings = {**centre.settings, variable.key: min(max(value, low), high)}
                    metrics = self.search.evaluate(list(settings.values())).metrics
                    if metrics:
                        share = settings[variable.key] - centre.settings[variable.key]
                        values = {metric.key: metric.value for metric in metrics}
                        beside[share / (high - low)] = values
            table[variable.key] = _slopes({0.0: centre.values, **beside})
        return table

    @cached_property
    def refusals(self) -> list[tuple[str, int]]:
        """Most frequent reasons for which designs were refused, numbers left out."""
        reasons = (_without_numbers(error) for error in self.records.errors.values())
        return Counter(reasons).most_common(_REASONS)

    def scenario(self, design: Design, settings: Mapping[str, Any] | None = None) -> Any:
        """The scenario of a design, with further settings by dotted keys."""
        values = {**design.settings, **(settings or {})}
        order = replace(self.search.order, keys=tuple(values))
        return order.scenario(self.search.entry.load().schema, tuple(values.values()))

    def sheet(self, design: Design) -> AnySheet:
        """The data sheet of a design."""
        experiment = self.search.entry.load()
        return self.search.sheet(experiment.machine_scenario(self.scenario(design)))

    def machine(self, design: Design) -> dict[str, Any]:
        """Keys below `machine` in which a design is not the default one, as plain data."""
        scenario = self.scenario(design)
        machine = checked(scenario.machine)
        changed: dict[str, Any] = _changed(checked(type(scenario.machine)()), machine)
        return changed

    def as_json(self) -> dict[str, Any]:
        """The front, sensitivities and refusals."""
        return {
            "search": self.search.as_json(),
            "designs": int(self.records.done.sum()),
            "admissible": int(self.admissible.sum()),
            "front": [
                {"number": d.number, "run": d.run, "settings": d.settings, "values": d.values}
                for d in self.front
            ],
            "sensitivities": {
                key: {n: v if math.isfinite(v) else None for n, v in row.items()}
                for key, row in self.sensitivities.items()
            },
            "refusals": [{"reason": reason, "designs": n} for reason, n in self.refusals],
        }

    def columns(self) -> tuple[list[str], list[list[str]]]:
        """Headings and rows of the front as a table."""
        goals = [goal.name for goal in self.search.goals]
        others = [name for name in self.search.names if name not in goals]
        keys = [variable.key for variable in self.search.sampling.variables]
        heads = ["design", *goals, *others, *map(_last, keys)]
        rows = [
            [
                str(design.number),
                *(shown(design.values[name]) for name in (*goals, *others)),
                *(_said(design.settings[key]) for key in keys),
            ]
            for design in self.front
        ]
        return heads, rows


def print_result(result: SearchResult, console: Console) -> None:
    """Prints as many designs of the front as fit, sensitivities and refusals."""
    designs, held = int(result.records.done.sum()), int(result.admissible.sum())
    refused = len(result.records.errors)
    counts = f"{held} admissible, {refused} refused, {len(result.front)} in front"
    console.print(Text(f"{designs} designs: {counts}"))
    heads, rows = result.columns()
    if rows:
        room = console.width - max(map(len, heads)) - 4
        most = max(1, room // (3 + max(len(cell) for row in rows for cell in row)))
        even = np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(int)
        chosen = [rows[place] for place in np.unique(even).tolist()]
        table = list(zip(heads, *chosen, strict=True))
        _print(console, table[0], table[1:])
    elif (near := result.nearest) is not None:
        values = ", ".join(f"{name} {shown(value)}" for name, value in near.values.items())
        settings = ", ".join(f"{key}={_said(value)}" for key, value in near.settings.items())
        console.print(Text(f"no design holds all constraints; nearest: {values}"))
        console.print(Text(f"  with {settings}"))
    if result.compromise is not None:
        number = result.compromise.number
        console.print(Text(f"Changes by 1 % of a variable's range, at design {number}:"))
        names = list(result.search.names)
        rows = [
            [_last(key), *(f"{row[name]:+.3g}" for name in names)]
            for key, row in result.sensitivities.items()
        ]
        _print(console, ["", *names], rows)
    for reason, count in result.refusals:
        console.print(Text(f"{count} refused: {reason}", style="dim"))


def _print(console: Console, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    grid = Grid(box=SIMPLE_HEAD, padding=(0, 1))
    for place, head in enumerate(heads):
        justify: Any = "right" if place else "left"
        grid.add_column(Text(head, overflow="fold"), justify=justify, no_wrap=not place)
    for row in rows:
        grid.add_row(*row)
    console.print(grid)


def _last(key: str) -> str:
    """Last parts of a key, which tell it from others."""
    return ".".join(key.split(".")[-2:])


def _slopes(values: Mapping[float, Mapping[str, float]]) -> dict[str, float]:
    """Changes of numbers by `_STEP`, from those at the outermost places; NaN from one place."""
    first, last = min(values), max(values)
    run = (last - first) / _STEP
    return {
        name: (values[last][name] - values[first][name]) / run if run else math.nan
        for name in values[first]
    }


def _said(value: Any) -> str:
    return shown(value) if isinstance(value, float) else str(value)


def _without_numbers(text: str) -> str:
    """A reason without the numbers in which designs differ."""
    words = text.split(" ")
    return " ".join("..." if any(c.isdigit() for c in word) else word for word in words)


def _changed(default: Any, tree: Any) -> Any:
    """Parts of a mapping in which it is not the default one."""

    def parts() -> Iterator[tuple[str, Any]]:
        for key, value in tree.items():
            if value == default[key]:
                continue
            is_part = isinstance(value, dict) and isinstance(default[key], dict)
            yield key, _changed(default[key], value) if is_part else value

    return dict(parts())
