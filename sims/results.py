"""What an experiment measured, the bounds it had to hold, and how both are shown."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

# Keys of `Result.as_json` that no metric may take.
_RESERVED = ("experiment", "backend", "seed", "passed")


@dataclass(frozen=True)
class Metric:
    """One number that an experiment measured.

    Attributes:
        key: name in JSON, for machines.
        value: the number, in `unit`.
        unit: unit of value and bound; "" for none.
        bound: largest admissible |value|; None for a number that is only reported.
        paper: what the paper reports, in the same unit, or in words; None if it does not.
        meaning: what was measured, for people.
    """

    key: str
    value: float
    unit: str = ""
    bound: float | None = None
    paper: float | str | None = None
    meaning: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value is finite and within its bound."""
        return math.isfinite(self.value) and (self.bound is None or abs(self.value) <= self.bound)

    @property
    def verdict(self) -> str:
        """One word for the table: held, BROKEN, or - for a number that is only reported."""
        if not self.passed:
            return "BROKEN"
        return "-" if self.bound is None else "held"

    def __str__(self) -> str:
        bound = "no bound" if self.bound is None else f"bound {_amount(self.bound, self.unit)}"
        return f"{self.key} = {_amount(self.value, self.unit)} ({bound})"


@dataclass(frozen=True)
class Result:
    """Outcome of one run of an experiment.

    Attributes:
        experiment: name of the experiment.
        backend: what stood in for the machine.
        seed: seed of every random number in the run.
        metrics: what was measured, in the order in which it is shown.
        notes: sentences shown below the metrics.
        afterwards: what goes on once the result has been shown and written, or None.
    """

    experiment: str
    backend: str
    seed: int
    metrics: tuple[Metric, ...]
    notes: tuple[str, ...] = ()
    afterwards: Callable[[], None] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        keys = [*_RESERVED, *(metric.key for metric in self.metrics)]
        twice = sorted({key for key in keys if keys.count(key) > 1})
        if twice:
            raise ValueError(f"keys of metrics must differ, also from {_RESERVED}: {twice}")

    @property
    def passed(self) -> bool:
        """Whether every metric is finite and within its bound."""
        return not self.broken

    @property
    def broken(self) -> tuple[Metric, ...]:
        """The metrics that are not finite or not within their bound."""
        return tuple(metric for metric in self.metrics if not metric.passed)

    def as_json(self) -> dict[str, Any]:
        """Flat dict of plain Python values; a number that is not finite is None."""
        head = dict(zip(_RESERVED, self._head(), strict=True))
        return head | {metric.key: _plain_number(metric.value) for metric in self.metrics}

    def _head(self) -> tuple[str, str, int, bool]:
        return self.experiment, self.backend, int(self.seed), self.passed


def print_table(result: Result, console: Console) -> None:
    """Prints the metrics with bounds and verdicts, then the notes, then one line in sum."""
    title = f"{result.experiment} ({result.backend}, seed {result.seed})"
    console.print(Text(title, style="bold"))
    table = Table(box=SIMPLE_HEAD)
    table.add_column("metric", overflow="fold")
    for column in ("value", "bound", "paper reports"):
        table.add_column(column, justify="right", overflow="fold")
    table.add_column("verdict", no_wrap=True, min_width=len("verdict"))
    for metric in result.metrics:
        table.add_row(*_row(metric))
    console.print(table)
    for note in result.notes:
        console.print(Text(note))
    bounded = sum(metric.bound is not None for metric in result.metrics)
    for metric in result.broken:
        console.print(Text(f"broken: {metric}", style="bold red"))
    if result.passed:
        console.print(Text(f"all bounds held: {bounded} of {bounded}", style="green"))


def _row(metric: Metric) -> tuple[Text, ...]:
    name = Text(f"{metric.key} [{metric.unit}]" if metric.unit else metric.key)
    if metric.meaning:
        name.append(f"\n{metric.meaning}", style="dim")
    bound = "" if metric.bound is None else f"<= {_amount(metric.bound)}"
    if metric.paper is None or isinstance(metric.paper, str):
        paper = metric.paper or ""
    else:
        paper = _amount(metric.paper)
    style = {"held": "green", "BROKEN": "bold red"}.get(metric.verdict, "")
    verdict = Text(metric.verdict, style=style)
    return name, Text(_amount(metric.value)), Text(bound), Text(paper), verdict


def _amount(value: float, unit: str = "") -> str:
    return f"{value:.5g} {unit}".rstrip()


def _plain_number(value: float) -> float | int | None:
    number = float(value)
    if not math.isfinite(number):
        return None
    return number if isinstance(value, float) or number != int(number) else int(number)
