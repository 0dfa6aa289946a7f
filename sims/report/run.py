"""Runs a chapter of the report: its experiments, their seeds, its checks and its pictures."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console

from parapod.sims.lab.discovery import find_entry
from parapod.sims.output.options import RunOptions
from parapod.sims.output.results import Result
from parapod.sims.report.chapter import Chapter, Check, Numbers, Part, Picture
from parapod.sims.study.seeds import results_of, run_seeds
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.installed import installed
from parapod.systems.core.scenario_file import load_scenario


@dataclass(frozen=True)
class PartRun:
    """An experiment that has been run for the report.

    Attributes:
        part: the part of the chapter.
        result: result; None if it could not be run.
        seeds: further results, one a seed; empty for none.
        elapsed: wall-clock time [s].
        problem: reason why it could not be run; empty if it could.
    """

    part: Part
    result: Result | None
    seeds: tuple[Result, ...] = ()
    elapsed: float = 0.0
    problem: str = ""

    @property
    def results(self) -> tuple[Result, ...]:
        """All results, that with the scenario's own seed first."""
        return self.seeds if self.result is None else (self.result, *self.seeds)

    @property
    def passed(self) -> bool:
        """Whether it was run and all bounds held, with every seed."""
        return self.result is not None and all(result.passed for result in self.results)


@dataclass(frozen=True)
class ChapterRun:
    """A chapter with everything that has been computed for it.

    Attributes:
        chapter: the chapter.
        parts: in the chapter's order.
        checks: checks of the chapter's errata, in their order; a failed one says why.
        pictures: pictures of the machine; empty where nothing can render.
        problem: reason why there are no pictures; empty if there are.
    """

    chapter: Chapter
    parts: tuple[PartRun, ...]
    checks: tuple[Check, ...]
    pictures: tuple[Picture, ...]
    problem: str = ""

    @property
    def numbers(self) -> Numbers:
        """Metrics of the experiments."""
        return _numbers(self.parts)

    @property
    def passed(self) -> bool:
        """Whether all experiments held their bounds and all errata are borne out."""
        return all(run.passed for run in self.parts) and all(c.passed for c in self.checks)


def list_chapters() -> tuple[Chapter, ...]:
    """All chapters, declared by the entry points `parapod.chapters`."""
    points = sorted(installed("parapod.chapters"), key=lambda point: point.name)
    return tuple(point.load() for point in points)


def run_chapter(chapter: Chapter, quick: bool, seeds: int, console: Console) -> ChapterRun:
    """Runs a chapter.

    Args:
        chapter: chapter to run.
        quick: shorter runs, and no seeds.
        seeds: number of seeds with which each random experiment is repeated; 0 for none.
        console: console for progress.
    """
    runs = []
    for i, part in enumerate(chapter.parts, start=1):
        console.print(f"[{i}/{len(chapter.parts)}] {part.name}", markup=False, highlight=False)
        run = _run_part(part, quick, seeds, console)
        outcome = run.problem or ("all bounds held" if run.passed else "a bound is BROKEN")
        console.print(f"    {outcome}, {run.elapsed:.0f} s", markup=False, highlight=False)
        runs.append(run)
    checks = tuple(erratum.check(_numbers(runs)) for erratum in chapter.errata)
    try:
        return ChapterRun(chapter, tuple(runs), checks, tuple(chapter.pictures()))
    except RuntimeError as error:
        return ChapterRun(chapter, tuple(runs), checks, (), f"no picture: {error}")


def _run_part(part: Part, quick: bool, seeds: int, console: Console) -> PartRun:
    started = time.monotonic()
    overrides = [*part.overrides, *(part.quick if quick else ())]
    try:
        entry = find_entry(part.experiment)
        experiment = entry.load()
        scenario: Any = load_scenario(experiment.schema, entry.default_scenario, None, overrides)
        result = experiment.execute(scenario, RunOptions(console=console))
        more: tuple[Result, ...] = ()
        if seeds and part.is_random and not quick:
            more = results_of(run_seeds(entry.name, scenario, seeds, console))
    except ParapodError as error:
        return PartRun(part, None, (), time.monotonic() - started, str(error))
    return PartRun(part, result, more, time.monotonic() - started)


def _numbers(runs: Sequence[PartRun]) -> Numbers:
    return Numbers(
        {run.part.name: run.result for run in runs if run.result is not None},
        {run.part.name: run.seeds for run in runs},
    )
