"""Searches for designs: fronts, files, refusals, and machines that come out."""

import io
import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from rich.console import Console

import parapod
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.side_by_side import LoopRows
from parapod.sims.cli.main import main
from parapod.sims.design.goals import Goal, Hold, front_of
from parapod.sims.design.result import SearchResult
from parapod.sims.design.search import Search, carry_out_designs
from parapod.sims.lab.work import Crew
from parapod.sims.levelling_platform.sheet import PlatformSheet
from parapod.sims.study.records import Records
from parapod.systems.core.errors import OutputError, ParapodError, ScenarioError
from parapod.systems.core.scenario_file import load_scenario

QUIET = Console(file=io.StringIO(), quiet=True)
VARY = {"machine.legs.l_c1_mm": "300:500", "machine.legs.l_4_mm": "420:480"}
SMALL = Goal("footprint_m2", 1.0)
STEEP = Goal("level_range_deg", -1.0)


def search_for(goals, holds=(), vary=VARY, **options):
    scenario = load_scenario(LevellingScenario)
    scenario.backend = "kinematic"
    return Search.make("level", scenario, vary, goals, holds, **options)


def carried_out(search, **options):
    records = Records(search.sampling)
    with ThreadPoolExecutor(1) as executor:
        search.carry_out(Crew(executor, 1), records, QUIET, **options)
    return SearchResult(search, records)


@pytest.fixture(scope="module")
def two_goals():
    return carried_out(search_for([STEEP, SMALL], designs=120, population=20))


# Designs with results of runs


def test_runs_of_designs_are_simulated_together_and_are_those_alone(monkeypatch):
    """Each with legs of its own."""
    simulated = []

    def made(loops, scenarios):
        simulated.append(len({id(loop) for loop in loops}))
        return LoopRows(loops, scenarios)

    monkeypatch.setattr("parapod.sims.output.together.LoopRows", made)
    scenario = parapod.scenario("level", "backend=kinematic", "job.estimate_at=0.5", "job.end=1.5",
                                "job.settled_after=0.5", "job.waypoints=[]",
                                "job.arm={start: 0.5, duration: 0.5}")  # fmt: skip
    goals = [Goal("level:roll_error_deg", 1.0), SMALL]
    search = Search.make("level", scenario, VARY, goals, designs=20, population=20)
    designs = [(i, (395.0 + i, 438.0 + 0.5 * i)) for i in range(9)] + [(9, (395.0, 2000.0))]
    together, alone = (carry_out_designs(search.order, rows, designs) for rows in (None, 1))
    assert together == alone
    assert simulated == [9]
    assert [bool(outcome.error) for outcome in alone] == [False] * 9 + [True]
    errors = [outcome.metrics[0].value for outcome in alone[:-1]]
    assert len(set(errors)) == len(errors)


# Fronts


def test_the_front_is_what_no_other_row_beats():
    rows = np.random.default_rng(0).integers(0, 12, (200, 3)).astype(float)
    front = set(front_of(rows).tolist())
    for place, row in enumerate(rows):
        is_beaten = ((rows <= row).all(axis=1) & (rows < row).any(axis=1)).any()
        is_like_one = any((rows[other] == row).all() for other in front)
        assert is_like_one != is_beaten, place


def test_designs_in_front_are_sorted_and_better_than_the_first_generation(two_goals):
    front = two_goals.front
    ranges = [design.values["level_range_deg"] for design in front]
    areas = [design.values["footprint_m2"] for design in front]
    assert ranges == sorted(ranges, reverse=True)
    assert areas == sorted(areas, reverse=True)
    assert max(design.run for design in front) >= 20


def test_the_values_of_a_design_are_those_of_its_sheet(two_goals):
    design = two_goals.compromise
    sheet = two_goals.sheet(design)
    assert isinstance(sheet, PlatformSheet)
    for name, value in design.values.items():
        assert sheet.value(name) == pytest.approx(value, rel=1e-12)


def test_sensitivities_are_slopes(two_goals):
    centre = two_goals.compromise
    steps = {}
    for side in (-1e-3, 1e-3):
        settings = {**centre.settings}
        settings["machine.legs.l_c1_mm"] += side * 200.0
        (metrics,) = [two_goals.search.evaluate(list(settings.values())).metrics]
        steps[side] = {metric.key: metric.value for metric in metrics}
    slopes = two_goals.sensitivities["machine.legs.l_c1_mm"]
    for name in ("level_range_deg", "footprint_m2"):
        slope = 5.0 * (steps[1e-3][name] - steps[-1e-3][name])
        assert slopes[name] == pytest.approx(slope, rel=0.05)


# One objective


def test_the_least_footprint_is_where_the_constraint_or_the_range_ends():
    hold = Hold("level_range_deg", ">=", 5.0)
    result = carried_out(search_for([SMALL], [hold], designs=400, population=20))
    (best,) = result.front
    assert best.values["level_range_deg"] >= 5.0
    assert best.settings["machine.legs.l_c1_mm"] == pytest.approx(300.0, abs=0.5)
    start = result.search.evaluate([400.0, 440.0]).metrics[0].value
    assert best.values["footprint_m2"] < 0.85 * start


def test_the_first_design_is_the_machine_as_it_is_set(two_goals):
    assert two_goals.search.sampling.values(0) == (400.0, 440.0)


# Files


class Killed(Exception):
    pass


class DyingCrew(Crew):
    """A crew that is killed after some generations."""

    def __init__(self, executor, generations):
        super().__init__(executor, 1)
        self._left = generations

    def begin(self):
        if not self._left:
            raise Killed
        self._left -= 1


def test_a_search_that_is_killed_goes_on_to_the_same_end(two_goals, tmp_path):
    path = tmp_path / "design.parquet"
    search = search_for([STEEP, SMALL], designs=120, population=20)
    with ThreadPoolExecutor(1) as executor, pytest.raises(Killed):
        search.carry_out(DyingCrew(executor, 3), Records(search.sampling), QUIET, path)
    search = search_for([STEEP, SMALL], designs=120, population=20)
    records = Records(search.sampling)
    with ThreadPoolExecutor(1) as executor:
        search.carry_out(Crew(executor, 1), records, QUIET, path, resume=True)
    assert SearchResult(search, records).front == two_goals.front
    with pytest.raises(OutputError, match="is there already"):
        carried_out(search_for([STEEP, SMALL], designs=120, population=20), path=path)
    with pytest.raises(OutputError, match="of another study"):
        carried_out(search_for([SMALL], designs=120, population=20), path=path, resume=True)


def test_a_picked_machine_is_one_that_can_be_run(tmp_path, capsys):
    mine, numbers = tmp_path / "mine.yaml", tmp_path / "design.json"
    texts = [f"{key}={values}" for key, values in VARY.items()]
    command = ["design", "level", "--vary", *texts, "--minimise", "footprint_m2", "--maximise",
               "level_range_deg", "--designs", "60", "--population", "20", "--workers", "1",
               "--pick", "1", "--into", str(mine), "--json", str(numbers)]  # fmt: skip
    assert main(command) == 0
    assert "designs: " in capsys.readouterr().out
    first, *_ = json.loads(numbers.read_text())["front"]
    machine = load_scenario(LevellingScenario, machine=mine)
    sheet = PlatformSheet(machine)
    for name, value in first["values"].items():
        assert sheet.value(name) == pytest.approx(value, rel=1e-9)
    assert mine.read_text().startswith("# Design 1: ")


# Mistakes


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"goals": []}, "needs an objective"),
        ({"goals": [Goal("mass", 1.0)]}, r"'mass' is not in the data sheet .*mass_kg"),
        ({"goals": [SMALL, SMALL]}, "given twice"),
        ({"vary": {"ground.roll_deg": "0:1"}}, "is not below machine"),
        ({"vary": {"machine.sensors.accel_bias_mg": "0:2"}}, "nothing of footprint_m2 depends"),
        ({"vary": {"machine.legs.l_7_mm": "190:220"}}, "nothing of footprint_m2 depends"),
        ({"designs": 10, "population": 20}, "fewer than one generation of 20"),
    ],
)
def test_a_search_for_nothing_is_refused(change, words):
    with pytest.raises(ScenarioError, match=words):
        search_for(**{"goals": [SMALL], **change})


@pytest.mark.parametrize("text", ["mass_kg", "mass_kg=60", "mass_kg<=heavy", "<=3", "mass_kg<60"])
def test_a_constraint_of_another_form_is_refused(text):
    with pytest.raises(ScenarioError, match="is not of the form NAME<=VALUE"):
        Hold.from_text(text)


def test_a_design_that_is_not_in_front_cannot_be_picked(two_goals):
    with pytest.raises(ParapodError, match=r"there is no design 99; there are 1\.\."):
        two_goals.pick(99)


def test_refused_designs_are_counted_by_their_reason():
    vary = {**VARY, "machine.legs.l_4_mm": "300:480"}
    result = carried_out(search_for([SMALL], vary=vary, designs=40, population=20))
    assert result.refusals
    assert sum(count for _, count in result.refusals) == len(result.records.errors)
    assert not any(design.run in result.records.errors for design in result.front)
