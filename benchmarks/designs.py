"""Data sheets, and designs of the platform by closed forms."""

from typing import Any

import numpy as np

from benchmarks.factor import rate
from benchmarks.report import Measurement
from benchmarks.yardstick import PYTHON, seconds
from parapod.diagrams.machine import find_machine
from parapod.sims.design.goals import Goal, Hold
from parapod.sims.design.search import Search
from parapod.sims.lab.discovery import find_entry
from parapod.sims.sheet.drawing import drawings, outlines_of
from parapod.sims.sheet.page import make_page
from parapod.sims.sheet.sheet import GROUP, find_sheet
from parapod.systems.core.installed import installed
from parapod.systems.core.scenario_file import load_scenario

_DESIGNS = 200
_LONGEST = 5.0  # [s] of a sheet with its page
# 20 000 designs in a minute on two cores, without what the processes say to each other.
_FEWEST = 20_000 / 60.0 / 2.0
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
    experiment = find_entry("level")
    scenario: Any = load_scenario(experiment.load().schema, experiment.default_scenario)
    search = Search.make(
        "level",
        scenario,
        _VARY,
        [Goal("level_range_deg", -1.0), Goal("footprint_m2", 1.0)],
        [Hold("mass_kg", "<=", 60.0), Hold("parallelogram_deg", ">=", 25.0)],
    )
    random = np.random.default_rng(0)
    ranges = [[float(end) for end in text.split(":")] for text in _VARY.values()]
    count = 0

    def work() -> None:
        nonlocal count
        count = 0
        for _ in range(_DESIGNS):
            outcome = search.evaluate([float(random.uniform(low, high)) for low, high in ranges])
            count += not outcome.error

    pace_here, pace = rate(work, _DESIGNS, PYTHON, runs=3)
    return [
        Measurement("designs of the platform, one core", pace_here, "1/s", _FEWEST, pace=pace),
        Measurement("  share of them that is admissible", 100.0 * count / _DESIGNS, "%"),
    ]


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
