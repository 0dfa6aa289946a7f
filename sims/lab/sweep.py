"""The same experiment with many seeds: how far its numbers spread."""

import math
import os
import statistics
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from parapod.sims.lab.experiment import Experiment
from parapod.sims.lab.work import LocalCrew, WorkerDied, carry_out
from parapod.sims.output.options import RunOptions
from parapod.sims.output.progress import counted
from parapod.sims.output.results import Metric, Result, plain_number

type _Middle = Callable[[Sequence[float]], float]


def _or_nan(value: _Middle) -> _Middle:
    """The same of numbers; NaN as soon as one of them is."""
    return lambda values: math.nan if any(map(math.isnan, values)) else value(values)


_SPREAD: dict[str, _Middle] = {
    "min": _or_nan(min),
    "median": _or_nan(statistics.median),
    "max": _or_nan(max),
}


def run_seeds(
    experiment: Experiment[Any, Any], scenario: Any, count: int, console: Console
) -> tuple[Result, ...]:
    """Runs an experiment with consecutive seeds, beginning with the scenario's, on all cores.

    Args:
        experiment: the experiment; its class must be one of a module.
        scenario: a scenario with a `seed`.
        count: number of seeds.
        console: console for progress.

    Returns:
        The results in the order of the seeds, without figures.

    Raises:
        WorkerDied: a run ends the process that carries it out.
    """
    scenarios = [replace(scenario, seed=scenario.seed + i) for i in range(count)]
    results: dict[int, Result] = {}
    what = f"{experiment.name}, {count} seeds"
    crew = LocalCrew(min(count, os.cpu_count() or 1))
    with crew, counted(console, what, count) as report:
        for number, result in carry_out(crew, partial(_run, experiment), scenarios):
            if isinstance(result, WorkerDied):
                raise WorkerDied(f"seed {scenarios[number].seed}: {result}")
            results[number] = result
            report(len(results))
    return tuple(results[number] for number in range(count))


def _run(experiment: Experiment[Any, Any], scenario: Any) -> Result:
    result = experiment.execute(scenario, RunOptions(console=Console(quiet=True)))
    return replace(result, figures=(), afterwards=None)


def print_spread(results: Sequence[Result], console: Console) -> None:
    """Prints smallest, middle and largest value of each metric, and whether all bounds held."""
    seeds = f"seeds {results[0].seed}..{results[-1].seed}"
    console.print(Text(f"{results[0].experiment} ({results[0].backend}, {seeds})", style="bold"))
    table = Table(box=SIMPLE_HEAD)
    table.add_column("metric", overflow="fold")
    for column in (*_SPREAD, "bound"):
        table.add_column(column, justify="right")
    table.add_column("held", no_wrap=True)
    for same in _by_metric(results):
        first, values = same[0], [metric.value for metric in same]
        held_count = sum(metric.passed for metric in same)
        style = "green" if held_count == len(same) else "bold red"
        name = f"{first.key} [{first.unit}]" if first.unit else first.key
        table.add_row(
            Text(name),
            *(f"{f(values):.3g}" for f in _SPREAD.values()),
            first.limits,
            Text(f"{held_count} of {len(same)}" if first.is_bounded else "-", style=style),
        )
    console.print(table)
    broken = [result for result in results if not result.passed]
    for result in broken:
        for metric in result.broken:
            console.print(Text(f"broken with seed {result.seed}: {metric}", style="bold red"))
    if not broken:
        console.print(Text(f"all bounds held with all {len(results)} seeds", style="green"))


def as_json(results: Sequence[Result]) -> dict[str, Any]:
    """Experiment, seeds and whether all held; of each metric min, median, max."""
    first = results[0]
    summary: dict[str, Any] = {
        "experiment": first.experiment,
        "backend": first.backend,
        "seeds": [result.seed for result in results],
        "passed": all(result.passed for result in results),
    }
    for same in _by_metric(results):
        values = [metric.value for metric in same]
        summary[same[0].key] = {name: plain_number(f(values)) for name, f in _SPREAD.items()}
    return summary


def _by_metric(results: Sequence[Result]) -> list[tuple[Metric, ...]]:
    return list(zip(*(result.metrics for result in results), strict=True))
