"""Data sheets, and designs of the platform by closed forms."""

import time
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.factor import rate
from benchmarks.report import Measurement
from benchmarks.yardstick import PYTHON, seconds
from parapod.diagrams.machine import find_machine
from parapod.sims.design.goals import Goal, Hold
from parapod.sims.design.search import Search
from parapod.sims.lab.discovery import find_entry
from parapod.sims.lab.work import LocalCrew
from parapod.sims.sheet.drawing import drawings, outlines_of
from parapod.sims.sheet.page import make_page
from parapod.sims.sheet.sheet import GROUP, find_sheet
from parapod.sims.study.records import Records
from parapod.sims.study.runs import Outcome
from parapod.systems.core.installed import installed
from parapod.systems.core.scenario_file import load_scenario

_DESIGNS = 200
# Designs of a search and of its generations, and share of them in which workers import.
_SEARCHED, _POPULATION, _FIRST = 3000, 200, 0.2
_LONGEST = 5.0  # [s] of a sheet with its page
_FEWEST = 20_000 / 60.0  # designs a second on two cores: 20 000 in a minute
_VARY = {
    "machine.legs.l_c1_mm": "300:500",
    "machine.legs.l_3_mm": "76:84",
    "machine.legs.l_4_mm": "430:450",
    "machine.legs.alpha_deg": "55:65",
    "machine.legs.beta_deg": "40:60",
}


def run() -> list[Measurement]:
    return [*_designs(), *map(_sheet, sorted(point.name for point in installed(GROUP)))]


def _designs() -> list[Measurement]:
    """Designs by one process without any message, and by a search with two processes."""
    search = _search()
    random = np.random.default_rng(0)
    ranges = [[float(end) for end in text.split(":")] for text in _VARY.values()]

    def work() -> None:
        for _ in range(_DESIGNS):
            outcome = search.evaluate([float(random.uniform(low, high)) for low, high in ranges])
            assert not outcome.error

    one, pace_of_one = rate(work, _DESIGNS, PYTHON, runs=3)
    duration, pace = PYTHON.best_beside(_searched, 1)
    share = 1.0 - _FIRST
    return [
        Measurement("designs of the platform, one process", one, "1/s", pace=pace_of_one),
        Measurement(
            "designs of the platform, a search with two processes",
            *(share * _SEARCHED / duration, "1/s", _FEWEST),
            pace=pace,
        ),
    ]


def _search() -> Search:
    experiment = find_entry("level")
    scenario: Any = load_scenario(experiment.load().schema, experiment.default_scenario)
    goals = [Goal("level_range_deg", -1.0), Goal("footprint_m2", 1.0)]
    holds = [Hold("mass_kg", "<=", 60.0), Hold("parallelogram_deg", ">=", 25.0)]
    return Search.make("level", scenario, _VARY, goals, holds, _SEARCHED, _POPULATION)


def _searched() -> float:
    """Duration of a search but for its first designs, in which workers import [s]."""
    search = _search()
    times: list[float] = []

    class Watching(Records):
        """Notes the time whenever a design is worked out."""

        def add(self, outcome: Outcome) -> None:
            super().add(outcome)
            times.append(time.perf_counter())

    with LocalCrew(2) as crew:
        search.carry_out(crew, Watching(search.sampling), Console(quiet=True))
    return times[-1] - times[round(_FIRST * _SEARCHED)]


def _sheet(name: str) -> Measurement:
    entry = find_entry(find_machine(name).experiment)
    experiment = entry.load()
    kind = find_sheet(name)

    def work() -> None:
        scenario: Any = load_scenario(experiment.schema, entry.default_scenario)
        settings = experiment.machine_scenario(scenario)
        sheet = kind(settings)
        parts = outlines_of(experiment, scenario, sheet.signals())
        make_page(sheet, name, "", drawings(parts, sheet.dimensions()), settings.machine)

    best, pace = PYTHON.best_beside(lambda: seconds(work), 3)
    return Measurement(
        f"sheet with its page, {name}", best, "s", _LONGEST, at_most=True, pace=pace
    )
