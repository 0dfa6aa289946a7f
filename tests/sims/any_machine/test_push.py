"""Tests of the search for the hardest push, on the platform's kinematic backend."""

import io
import math
import re

import pytest
from rich.console import Console

from parapod.sims.any_machine.push import Border, PushScenario, Way, broken_by
from parapod.sims.lab.discovery import find_entry
from parapod.sims.output.options import RunOptions
from parapod.sims.output.results import Metric
from parapod.sims.study.runs import Outcome
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.scenario_file import load_scenario

LEVEL = find_entry("level")
JOB = (
    *("job.estimate_at=1.5", "job.settled_after=1.5", "job.waypoints=[]", "job.end=6"),
    "job.arm={start: 0.5, duration: 0.5}",
)
BRIEF = {"backend": "kinematic", "settings": list(JOB), "directions": 2, "at": 3.0}
AHEAD = Way("0 deg", (1.0, 0.0, 0.0))


@pytest.fixture
def console():
    return Console(file=io.StringIO(), quiet=True)


def run_push(console, **settings):
    experiment = find_entry("push").load()
    scenario = PushScenario(**(BRIEF | settings))
    return experiment.execute(scenario, RunOptions(console=console)), scenario


def broken_bounds(disturbances):
    settings = [*JOB, "backend=kinematic", f"disturbances={disturbances}"]
    level = LEVEL.load()
    return level.execute(
        load_scenario(level.schema, LEVEL.default_scenario, None, settings), RunOptions()
    ).broken


@pytest.mark.parametrize("true_border", [3.0, 140.0, 333.0, 4999.0])
@pytest.mark.parametrize("share", [0.5, 0.05, 0.001])
def test_the_border_is_found_to_the_share_that_is_asked_for(true_border, share):
    scenario = PushScenario(first_N=10.0, most_N=5000.0, share=share)
    border, runs = Border(AHEAD), 0
    most = border.runs_left(scenario)
    while (force := border.next(scenario)) is not None:
        border = border.learn(force, ("it",) if force > true_border else ())
        runs += 1
        assert border.runs_left(scenario) <= most - runs
    assert border.held <= true_border < border.broken
    assert border.broken - border.held <= share * max(border.held, scenario.first_N)


def test_nothing_is_tried_beyond_the_largest_force():
    scenario, border, forces = PushScenario(first_N=100.0, most_N=700.0), Border(AHEAD), []
    while (force := border.next(scenario)) is not None:
        border = border.learn(force, ())
        forces.append(force)
    assert forces == [100.0, 200.0, 400.0, 700.0]
    assert border.held == 700.0
    assert math.isinf(border.broken)


def test_directions_are_spread_evenly_and_none_is_the_vertical():
    assert [way.along for way in PushScenario(directions=4).ways] == [
        *((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        *((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),
    ]
    assert [way.along[2] for way in PushScenario(directions=0).ways] == [1.0, -1.0]


def test_bounds_that_are_named_count_alone_and_errors_always():
    metrics = Metric("tilt", 2.0, "deg", 1.0), Metric("lift", 0.0, "mm", 1.0), Metric("x", 3.0)
    assert broken_by(Outcome(0, metrics)) == ("tilt = 2 deg for <= 1",)
    assert broken_by(Outcome(0, metrics), ("lift",)) == ()
    assert broken_by(Outcome(0, error="it falls"), ("lift",)) == ("it falls",)
    with pytest.raises(ScenarioError, match="'x' has no bound; those that have one: tilt, lift"):
        broken_by(Outcome(0, metrics), ("x",))


def test_the_platform_holds_what_is_held_and_breaks_a_bound_with_what_is_not(console):
    result, _ = run_push(console, share=0.5, directions=1, asked_N=0.0)
    (found,) = re.findall(r"--set \"disturbances=(\[.*\])\" ", result.notes[-1])
    (least,) = map(float, re.findall(r"force_N: \[([0-9.]+),", found))
    held = result["held_0_deg_N"]
    assert 0.0 < held < least
    assert broken_bounds(found)
    assert not broken_bounds(found.replace(f"[{least}", f"[{held}"))


def refused(console, **settings):
    with pytest.raises(ParapodError) as error:
        run_push(console, **settings)
    return str(error.value)


def test_what_cannot_be_pushed_is_refused_before_anything_runs(console):
    assert "'chair-gait' cannot be pushed" in refused(console, experiment="chair-gait")
    assert "no experiment 'levl'" in refused(console, experiment="levl")
    assert "backend = 'mujoco'" in refused(
        console, experiment="bench-walk", backend="mujoco", settings=[]
    )
    assert "job.nothing" in refused(console, settings=["job.nothing=1"])
    unknown = {"experiment": "bench-walk", "backend": "multibody", "settings": [], "body": "sail"}
    assert "'sail'" in refused(console, **unknown)


def test_an_experiment_that_holds_no_bound_alone_is_not_pushed(console):
    settings = [*JOB, "disturbances=[!Push {at: 3.2, force_N: [5000, 0, 0]}]"]
    assert "does not hold its bounds without a push" in refused(console, settings=settings)


def test_a_bound_that_no_run_has_is_refused(console):
    assert "'joy' has no bound" in refused(console, bounds=["joy"])
