"""Metrics of an experiment with their bounds, and the ways in which they are shown."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from parapod.sims.output.figures import Figure
from parapod.systems.core.schema import plain

# Keys of `Result.as_json`, and columns of a study's table, that no metric may take.
_RESERVED = (
    "run",
    "broken",
    "error",
    "experiment",
    "backend",
    "seed",
    "passed",
    "parapod",
    "bounds",
    "scenario",
    "identified",
)


@dataclass(frozen=True)
class Metric:
    """One number that an experiment measured.

    Attributes:
        key: name in JSON, for machines.
        value: the number, in `unit`.
        unit: unit of value and bound; "" for none.
        bound: largest admissible |value|; None for none.
        at_least: smallest admissible value; None for none.
        is_timing: true if the clock has measured it: the same run gives another value each time.
        paper: value of the paper, in the same unit, or in words; None if it has none.
        meaning: meaning of the number, for people.
        undefined: reason for which there may be no finite number, for people.
    """

    key: str
    value: float
    unit: str = ""
    bound: float | None = None
    paper: float | str | None = None
    meaning: str = ""
    at_least: float | None = None
    is_timing: bool = False
    undefined: str = ""

    @property
    def remark(self) -> str:
        """Meaning, and the reason for a value that is not finite."""
        if not self.undefined or math.isfinite(self.value):
            return self.meaning
        return f"{self.meaning}; {amount(self.value)}: {self.undefined}"

    @property
    def is_bounded(self) -> bool:
        """Whether there is a bound, and the number is not only reported."""
        return self.bound is not None or self.at_least is not None

    @property
    def passed(self) -> bool:
        """Whether the value is finite and within its bounds."""
        return (
            math.isfinite(self.value)
            and (self.bound is None or abs(self.value) <= self.bound)
            and (self.at_least is None or self.value >= self.at_least)
        )

    @property
    def limits(self) -> str:
        """The bounds as people write them: "<= 2", ">= 5" or "1..3"; empty for none."""
        if self.at_least is None:
            return "" if self.bound is None else f"<= {amount(self.bound)}"
        if self.bound is None:
            return f">= {amount(self.at_least)}"
        return f"{amount(self.at_least)}..{amount(self.bound)}"

    @property
    def verdict(self) -> str:
        """One word for the table: held, BROKEN, or - for a number that is only reported."""
        if not self.passed:
            return "BROKEN"
        return "held" if self.is_bounded else "-"

    def as_json(self) -> dict[str, Any]:
        """Unit, bounds, verdict and meaning, as JSON can say them."""
        return {
            "unit": self.unit,
            "bound": None if self.bound is None else plain_number(self.bound),
            "at_least": None if self.at_least is None else plain_number(self.at_least),
            "verdict": self.verdict,
            "meaning": self.meaning,
        }

    def __str__(self) -> str:
        bound = f"bound {self.limits.removeprefix('<= ')} {self.unit}".rstrip()
        bound = bound if self.is_bounded else "no bound"
        reason = "" if not self.undefined or math.isfinite(self.value) else f": {self.undefined}"
        return f"{self.key} = {amount(self.value, self.unit)} ({bound}){reason}"


@dataclass(frozen=True)
class Result:
    """Outcome of one run of an experiment.

    Attributes:
        experiment: name of the experiment.
        backend: backend that stood in for the machine.
        seed: seed of every random number in the run.
        metrics: numbers, in the order in which they are shown.
        notes: sentences shown below the metrics.
        figures: figures of the run.
        afterwards: work that goes on once the result has been shown and written, or None.
        details: further content of the JSON document.
        scenario: the scenario that was run, or None.
        identified: parameters of the machine that the run has identified, by keys of its scenario.
    """

    experiment: str
    backend: str
    seed: int
    metrics: tuple[Metric, ...]
    notes: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = field(default=(), compare=False)
    afterwards: Callable[[], None] | None = field(default=None, compare=False)
    details: Mapping[str, Any] = field(default_factory=dict)
    scenario: Any = field(default=None, compare=False)
    identified: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        keys = [*_RESERVED, *(metric.key for metric in self.metrics), *self.details]
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
        """Plain Python values; a number that is not finite is None.

        Metrics stand by their keys, and their units, bounds and verdicts under "bounds".
        """
        head: dict[str, Any] = {
            "experiment": self.experiment,
            "backend": self.backend,
            "seed": int(self.seed),
            "passed": self.passed,
            "parapod": version("parapod"),
        }
        numbers = {metric.key: plain_number(metric.value) for metric in self.metrics}
        bounds = {metric.key: metric.as_json() for metric in self.metrics}
        scenario = {} if self.scenario is None else {"scenario": plain(self.scenario)}
        record = {"identified": dict(self.identified)} if self.identified else {}
        return head | numbers | dict(self.details) | {"bounds": bounds} | scenario | record

    def __repr__(self) -> str:
        broken = ", ".join(str(metric) for metric in self.broken)
        verdict = f"broken: {broken}" if broken else "all bounds held"
        return f"<{self.experiment} ({self.backend}, seed {self.seed}): {verdict}>"

    def __getitem__(self, key: str) -> float:
        """Value of a metric.

        Raises:
            KeyError: no such metric; names those that there are.
        """
        values = {metric.key: metric.value for metric in self.metrics}
        if key not in values:
            raise KeyError(f"no metric '{key}'; there are: {', '.join(values)}")
        return values[key]

    def _repr_html_(self) -> str:
        """The table and the figures, for notebooks."""
        from html import escape

        rows = "".join(
            f"<tr><td style='text-align:left'>{escape(m.key)}<br>"
            f"<small>{escape(m.remark)}</small></td>"
            f"<td>{amount(m.value, m.unit)}</td><td>{escape(m.limits)}</td>"
            f"<td>{escape(as_words(m.paper))}</td><td>{m.verdict}</td></tr>"
            for m in self.metrics
        )
        cells = ("metric", "value", "bound", "paper reports", "verdict")
        head = "".join(f"<th>{cell}</th>" for cell in cells)
        title = f"{self.experiment} ({self.backend}, seed {self.seed})"
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        figures = "".join(
            f"<figure>{figure._repr_svg_()}<figcaption>{escape(figure.caption)}</figcaption>"
            "</figure>"
            for figure in self.figures
        )
        return (
            f"<table><caption>{escape(title)}</caption><tr>{head}</tr>{rows}</table>"
            f"{notes}{figures}"
        )


def print_table(result: Result, console: Console) -> None:
    """Prints the metrics with bounds and verdicts, then the notes, then one line in sum."""
    title = f"{result.experiment} ({result.backend}, seed {result.seed})"
    console.print(Text(title, style="bold"))
    table = Table(box=SIMPLE_HEAD)
    heads = ["metric", "value", "bound", "paper reports", "verdict"]
    rows = [_row(metric) for metric in result.metrics]
    if all(metric.paper is None for metric in result.metrics):
        column = heads.index("paper reports")
        del heads[column]
        for cells in rows:
            del cells[column]
    widths = [
        max(_width(cell) for cell in (head, *cells))
        for head, *cells in zip(heads, *rows, strict=True)
    ]
    # Names stay whole where the terminal has room; the meanings below them wrap.
    room = console.width - sum(widths[1:]) - 2 * (len(heads) + 2)
    table.add_column(heads[0], overflow="fold", min_width=max(1, min(widths[0], room)))
    for head in heads[1:-1]:
        table.add_column(head, justify="right", overflow="fold")
    table.add_column(heads[-1], no_wrap=True, min_width=widths[-1])
    for row in rows:
        table.add_row(*row)
    console.print(table)
    for note in result.notes:
        console.print(Text(note))
    bounded = sum(metric.is_bounded for metric in result.metrics)
    for metric in result.broken:
        console.print(Text(f"broken: {metric}", style="bold red"))
    if result.passed:
        console.print(Text(f"all bounds held: {bounded} of {bounded}", style="green"))


def _width(cell: Text | str) -> int:
    """Width of the first line of a cell [characters]."""
    return len(str(cell).split("\n")[0])


def _row(metric: Metric) -> list[Text]:
    name = Text(f"{metric.key} [{metric.unit}]" if metric.unit else metric.key)
    if metric.remark:
        name.append(f"\n{metric.remark}", style="dim")
    style = {"held": "green", "BROKEN": "bold red"}.get(metric.verdict, "")
    verdict = Text(metric.verdict, style=style)
    paper = Text(as_words(metric.paper))
    return [name, Text(amount(metric.value)), Text(metric.limits), paper, verdict]


def as_words(paper: float | str | None) -> str:
    """Value that a paper reports, as it is shown."""
    return amount(paper) if isinstance(paper, float | int) else paper or ""


def amount(value: float, unit: str = "") -> str:
    """A number with its unit, as it is shown."""
    return f"{value:.5g} {unit}".rstrip()


def plain_number(value: float) -> float | int | None:
    """A number as JSON can say it; None if it is not finite."""
    number = float(value)
    if not math.isfinite(number):
        return None
    return number if isinstance(value, float) or number != int(number) else int(number)
