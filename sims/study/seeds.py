"""The same experiment with many seeds: a study with one variable."""

import math
import os
from typing import Any

from rich.console import Console

from parapod.sims.lab.work import LocalCrew
from parapod.sims.output.results import Metric, Result
from parapod.sims.study.records import Column, Records
from parapod.sims.study.result import StudyResult
from parapod.sims.study.study import Study
from parapod.systems.core.errors import ParapodError


def run_seeds(experiment: str, scenario: Any, count: int, console: Console) -> StudyResult:
    """Runs an experiment with consecutive seeds, beginning with the scenario's, on all cores.

    Args:
        experiment: name of the experiment.
        scenario: a scenario with a `seed`.
        count: number of seeds.
        console: console for progress.
    """
    first = scenario.seed
    study = Study.make(experiment, scenario, {"seed": f"{first}:{first + count}"})
    records = Records(study.sampling)
    with LocalCrew(min(count, os.cpu_count() or 1)) as crew:
        study.carry_out(crew, records, console)
    return StudyResult(study, records)


def results_of(seeds: StudyResult) -> tuple[Result, ...]:
    """Results of each seed, in their order, without figures.

    Raises:
        ParapodError: a seed that was refused or failed; says why.
    """
    study, records = seeds.study, seeds.records
    if records.errors:
        run = min(records.errors)
        raise ParapodError(f"seed {study.sampling.values(run)[0]}: {records.errors[run]}")
    columns = records.columns
    return tuple(
        Result(
            study.entry.name,
            study.tree["backend"],
            study.sampling.values(run)[0],
            tuple(_metric(column, run) for column in columns if column.is_there[run]),
        )
        for run in range(study.sampling.runs)
    )


def _metric(column: Column, run: int) -> Metric:
    bound, at_least = (
        None if math.isnan(limits[run]) else float(limits[run])
        for limits in (column.bound, column.at_least)
    )
    return Metric(
        column.key,
        float(column.values[run]),
        column.unit,
        bound,
        at_least=at_least,
        meaning=column.meaning,
        undefined=column.undefined,
    )
