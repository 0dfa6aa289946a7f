"""Summary of a study: quantiles of each metric, how often its bound was held, the worst runs."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from parapod.sims.output.results import Metric, amount, plain_number
from parapod.sims.study.records import Column, Records
from parapod.sims.study.sensitivity import contributions
from parapod.sims.study.study import Study
from parapod.systems.core.scenario_file import inline

QUANTILES: Mapping[str, float] = {"min": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "max": 1.0}
# Width of a terminal from which on all quantiles have room [characters].
_WIDE = 110
# Runs whose commands are printed, and reasons for refusals.
_SHOWN = 5
# Metrics that the answer names.
_NAMED = 3
# Values of a key that are set side by side.
_COMPARED = 5


@dataclass(frozen=True)
class MetricSummary:
    """One metric over all runs that have measured it.

    Attributes:
        key: its name.
        unit: its unit.
        meaning: its meaning.
        quantiles: quantiles by the names of `QUANTILES`; NaN as soon as one value is.
        limits: its bounds as people write them; empty for none.
        held: number of runs in which the bounds were held.
        measured: number of runs that have measured it.
        worst: run that uses most of its bound; None without a bound.
        use: share of the bound that this run uses; more than 1 is broken.
        not_finite: number of runs whose value is not finite.
        undefined: reason for such a value; empty if it has none.
    """

    key: str
    unit: str
    meaning: str
    quantiles: Mapping[str, float]
    limits: str
    held: int
    measured: int
    worst: int | None
    use: float
    not_finite: int = 0
    undefined: str = ""

    @property
    def remark(self) -> str:
        """Meaning, and the reason for values that are not finite."""
        if not self.not_finite:
            return self.meaning
        reason = self.undefined or "the run gives no reason"
        return f"{self.meaning}; not finite in {self.not_finite} runs: {reason}"

    @classmethod
    def from_column(cls, column: Column) -> "MetricSummary":
        """Summary of one column."""
        there = column.is_there
        values = column.values[there]
        with np.errstate(invalid="ignore"):  # between two infinite values
            quantiles = np.quantile(values, list(QUANTILES.values()), method="inverted_cdf")
        if np.isnan(values).any():
            quantiles = np.full(len(QUANTILES), np.nan)
        use = column.use
        worst = None if np.isnan(use).all() else int(np.nanargmax(use))
        return cls(
            column.key,
            column.unit,
            column.meaning,
            dict(zip(QUANTILES, quantiles.tolist(), strict=True)),
            _limits(column),
            int((column.held & there).sum()),
            int(there.sum()),
            worst,
            np.nan if worst is None else float(use[worst]),
            int((~np.isfinite(values)).sum()),
            column.undefined,
        )


def _limits(column: Column) -> str:
    """Bounds; where they differ from run to run, the range of each."""
    if not column.is_bounded:
        return ""
    single = [column.limit(limits) for limits in (column.bound, column.at_least)]
    varying = [
        limits_in_use is None and not np.isnan(limits).all()
        for limits_in_use, limits in zip(single, (column.bound, column.at_least), strict=True)
    ]
    if not any(varying):
        return Metric(column.key, 0.0, bound=single[0], at_least=single[1]).limits
    texts = []
    for sign, limits in (("<=", column.bound), (">=", column.at_least)):
        if not np.isnan(limits).all():
            low, high = (amount(float(f"{f(limits):.3g}")) for f in (np.nanmin, np.nanmax))
            texts.append(f"{sign} {low}" if low == high else f"{sign} {low}..{high}")
    return ", ".join(texts)


@dataclass(frozen=True)
class Comparison:
    """Texts or switches that a key is set to, side by side, each over its runs.

    Attributes:
        key: the key.
        values: its values as people write them.
        passed: number of runs with all bounds held, and of all runs, by value.
        medians: medians of each metric, by value; NaN where no run has measured it.
    """

    key: str
    values: tuple[str, ...]
    passed: tuple[tuple[int, int], ...]
    medians: Mapping[str, tuple[float, ...]]

    @classmethod
    def from_records(cls, study: Study, records: Records) -> Iterator["Comparison"]:
        """Comparisons of all keys with two to five such values."""
        runs = np.flatnonzero(records.done)
        for i, variable in enumerate(study.variables):
            if variable.is_number or not 2 <= len(variable.values) <= _COMPARED:
                continue
            places = [
                variable.values.index(study.sampling.values(run)[i]) for run in runs.tolist()
            ]
            groups = [runs[np.array(places) == place] for place in range(len(variable.values))]
            medians = {
                column.key: tuple(_median(column, group) for group in groups)
                for column in records.columns
            }
            passed = tuple((int(records.passed[group].sum()), len(group)) for group in groups)
            yield cls(variable.key, tuple(map(inline, variable.values)), passed, medians)


def _median(column: Column, runs: NDArray[np.int_]) -> float:
    there = column.values[runs][column.is_there[runs]]
    return float(np.quantile(there, 0.5, method="inverted_cdf")) if there.size else np.nan


@dataclass(frozen=True)
class Summary:
    """Numbers that a study has shown.

    Attributes:
        study: the study.
        done: number of runs that have been carried out.
        passed: number of those in which all bounds were held.
        metrics: in the order in which the runs measure them.
        refusals: reasons for which runs were refused or failed, with their numbers of runs and
            the first of these; the most frequent first.
        decisive: variable with the largest part in whether all bounds are held, and its share of
            the variance; None where the sampling does not tell.
        comparisons: texts or switches that a key is set to, side by side.
    """

    study: Study
    done: int
    passed: int
    metrics: tuple[MetricSummary, ...]
    refusals: tuple[tuple[str, int, int], ...]
    decisive: tuple[str, float] | None = None
    comparisons: tuple[Comparison, ...] = ()

    @classmethod
    def from_records(cls, study: Study, records: Records) -> "Summary":
        """Summary of the runs that have been carried out."""
        return cls(
            study,
            int(records.done.sum()),
            int(records.passed.sum()),
            tuple(MetricSummary.from_column(column) for column in records.columns),
            _refusals(records.errors),
            _decisive(study, records),
            tuple(Comparison.from_records(study, records)),
        )

    @property
    def answer(self) -> str:
        """Outcome in a few sentences."""
        sentences = [f"All bounds held in {self.passed} of {self.done} runs."]
        if refused := sum(count for _, count, _ in self.refusals):
            sentences.append(f"{refused} were refused or failed.")
        broken = {m.key: m.measured - m.held for m in self.metrics if m.held < m.measured}
        broken = {m.key: broken[m.key] for m in self.worst if m.key in broken}
        if broken:
            keys = sorted(broken, key=lambda key: -broken[key])[:_NAMED]
            most = ", ".join(f"{key} ({broken[key]})" for key in keys)
            sentences.append(f"Broken most often: {most}.")
        if self.decisive:
            key, share = self.decisive
            text = f"{key} decides most: it has a part in {100.0 * share:.0f} % of the variance."
            sentences.append(text)
        return " ".join(sentences)

    @property
    def worst(self) -> tuple[MetricSummary, ...]:
        """Bounded metrics by their worst runs, the one that uses most of its bound first."""
        bounded = [metric for metric in self.metrics if metric.worst is not None]
        return tuple(sorted(bounded, key=lambda metric: -metric.use))

    @property
    def commands(self) -> dict[int, str]:
        """By run, the command that repeats it: the worst of each metric, and the first refused."""
        runs = [metric.worst for metric in self.worst] + [first for _, _, first in self.refusals]
        return {run: self.study.command(run) for run in dict.fromkeys(runs) if run is not None}

    def as_json(self) -> dict[str, Any]:
        """The study, and everything about its metrics, as JSON can say it."""
        return {
            "study": self.study.as_json(),
            "done": self.done,
            "passed": self.passed,
            "metrics": {
                metric.key: {
                    **{name: plain_number(x) for name, x in metric.quantiles.items()},
                    "unit": metric.unit,
                    "limits": metric.limits,
                    "held": metric.held,
                    "measured": metric.measured,
                    "worst_run": metric.worst,
                }
                for metric in self.metrics
            },
            "comparisons": {
                one.key: {
                    value: {
                        "passed": one.passed[i][0],
                        "runs": one.passed[i][1],
                        "medians": {key: plain_number(x[i]) for key, x in one.medians.items()},
                    }
                    for i, value in enumerate(one.values)
                }
                for one in self.comparisons
            },
            "refused": [
                {"reason": text, "runs": count, "first": first}
                for text, count, first in self.refusals
            ],
            "commands": {str(run): command for run, command in self.commands.items()},
        }


def _decisive(study: Study, records: Records) -> tuple[str, float] | None:
    shares = contributions(study.sampling, [records.verdict])
    if not shares:
        return None
    most = int(np.argmax(shares[0].total))
    return study.variables[most].key, float(shares[0].total[most])


def _refusals(errors: Mapping[int, str]) -> tuple[tuple[str, int, int], ...]:
    """Reasons that differ in their numbers only are one; the words are those of its first run."""
    first: dict[str, int] = {}
    counts: Counter[str] = Counter()
    for run in sorted(errors):
        kind = re.sub(r"-?[\d.]+(e[-+]?\d+)?", "#", errors[run])
        first.setdefault(kind, run)
        counts[kind] += 1
    return tuple((errors[first[kind]], n, first[kind]) for kind, n in counts.most_common())


def print_summary(summary: Summary, console: Console) -> None:
    """Prints quantiles and bounds, the worst runs and the refused ones, and one line in sum."""
    study = summary.study
    variables = ", ".join(str(variable) for variable in study.variables)
    backend = study.tree["backend"]
    title = f"{study.entry.name} ({backend}), {summary.done} runs ({study.sampling.kind}): "
    console.print(Text(title, style="bold").append(variables, style="not bold"))
    if summary.metrics:
        console.print(_table(summary, console.width))
        for comparison in summary.comparisons:
            console.print(_side_by_side(comparison))
    metrics_shown = [metric for metric in summary.worst if metric.use > 1.0] or list(summary.worst)
    commands = summary.commands
    for run in list(dict.fromkeys(metric.worst for metric in metrics_shown))[:_SHOWN]:
        of = [metric for metric in metrics_shown if metric.worst == run]
        style = "bold red" if any(metric.use > 1.0 for metric in of) else ""
        console.print(
            Text(f"run {run}, worst of {', '.join(metric.key for metric in of)}:", style=style)
        )
        console.print(Text(f"  {commands[run or 0]}"), soft_wrap=True)
    for text, count, first in summary.refusals[:_SHOWN]:
        console.print(Text(f"{count} refused or failed, run {first} with: {text}", "bold red"))
        console.print(Text(f"  {commands[first]}"), soft_wrap=True)
    more = len(summary.refusals) - _SHOWN
    if more > 0:
        console.print(f"and {more} more reasons", highlight=False)
    runs_left = study.sampling.runs - summary.done
    if runs_left:
        console.print(Text(f"{runs_left} of {study.sampling.runs} runs are not done", "bold red"))
    for metric in summary.metrics:
        if metric.not_finite:
            console.print(Text(f"{metric.key}: {metric.remark}"))
    style = "green" if summary.passed == summary.done else "bold red"
    console.print(Text(summary.answer, style=style))


def _side_by_side(comparison: Comparison) -> Table:
    table = Table(box=SIMPLE_HEAD, title=f"medians by {comparison.key}", title_justify="left")
    table.add_column("metric", overflow="fold")
    for value in comparison.values:
        table.add_column(Text(value), justify="right", overflow="fold")
    passed = (f"{count}/{runs}" for count, runs in comparison.passed)
    table.add_row("runs with all bounds held", *passed, style="bold")
    for key, medians in comparison.medians.items():
        table.add_row(Text(key), *(f"{median:.3g}" for median in medians))
    return table


def _table(summary: Summary, width: int) -> Table:
    table = Table(box=SIMPLE_HEAD)
    names = [name for name in QUANTILES if width >= _WIDE or "%" not in name]
    longest = max(len(metric.key) + len(metric.unit) + 3 for metric in summary.metrics)
    table.add_column("metric", overflow="fold", min_width=min(longest, width // 4))
    for name in names:
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("bound", justify="right", overflow="fold", min_width=8)
    widest = max(len(f"{metric.held}/{metric.measured}") for metric in summary.metrics)
    table.add_column("held", no_wrap=True, min_width=widest)
    for metric in summary.metrics:
        style = "green" if metric.held == metric.measured else "bold red"
        held_share = f"{metric.held}/{metric.measured}" if metric.limits else "-"
        table.add_row(
            Text(f"{metric.key} [{metric.unit}]" if metric.unit else metric.key),
            *(f"{metric.quantiles[name]:.3g}" for name in names),
            metric.limits,
            Text(held_share, style=style if metric.limits else ""),
        )
    return table
