"""Postures followed with legs as drawn, as built, and with the outer inclination loop."""

from dataclasses import replace

import pytest
from rich.console import Console

from parapod.sims.lab.discovery import find_entry
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.track_posture import TrackPosture, _of_real_machine
from parapod.sims.output.options import RunOptions
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario

ONE_MOVE = (
    "job.settled_after=4",
    "job.waypoints=[{time: 5, pitch_deg: 1, roll_deg: -1, height_mm: 10}]",
    "job.end=14",
)


def test_the_outer_loop_brings_the_inclination_of_legs_as_built_within_its_bound(finished):
    found = finished("track-posture").values
    for axis in ("roll", "pitch"):
        assert found[f"outer_loop_{axis}_error_deg"] <= 0.05
    # It takes nearly half of what the legs leave while they move.
    assert found["outer_loop_moving_ratio"] < 0.6
    assert found["gain_margin_dB"] >= 6.0
    assert found["phase_margin_deg"] >= 45.0


def test_an_outer_loop_that_does_nothing_leaves_the_error_of_the_legs(execute):
    same = ("backend=kinematic", "machine.sensors.imu_delay_ms=0", "control.outer_loop_gain=1e-9")
    found = execute("track-posture", *ONE_MOVE, *same)
    assert found["outer_loop_moving_ratio"] == pytest.approx(1.0, abs=1e-3)


def test_postures_that_never_rest_are_refused_for_nothing_could_be_measured(execute):
    brief = ("backend=kinematic", "job.settled_after=2", "job.end=4")
    move = "job.waypoints=[{time: 2, height_mm: 1}]"
    with pytest.raises(
        ScenarioError, match=r"job\.end = 4 s: no posture rests for 4 s"
    ) as refused:
        execute("track-posture", *brief, move)
    assert refused.value.key == "job.end"


@pytest.fixture(scope="module")
def followed_twice():
    """The two runs of a real machine, here of one that is simulated."""
    overrides = ("backend=kinematic", *ONE_MOVE)
    entry = find_entry("track-posture")
    scenario = load_scenario(entry.load().schema, entry.default_scenario, None, overrides)

    class Unseen(TrackPosture):
        def needed(self, scenario):
            return super().needed(replace(scenario, backend="hardware"))

    experiment = Unseen("track-posture")
    bench = Runner("track-posture", RunOptions(console=Console(quiet=True)))
    return experiment, scenario, _of_real_machine(experiment, scenario, bench)


def test_a_real_machine_follows_twice_and_is_measured_by_its_own_sensors(followed_twice):
    experiment, scenario, data = followed_twice
    assert "truth.posture" not in data.run
    metrics = {metric.key: metric for metric in experiment.measure(scenario, data)}
    assert all(metric.passed for metric in metrics.values()), metrics
    bounded = {key for key, metric in metrics.items() if metric.is_bounded}
    assert {"roll_error_deg", "outer_loop_roll_error_deg", "extension_error_mm"} <= bounded
    assert "gain_margin_dB" not in metrics
    assert any("as measured" in note for note in experiment.note(scenario, data))
    names = [figure.name for figure in experiment.draw(scenario, data)]
    assert names == ["fig20_21", "fig22"]


def test_an_actuator_that_does_not_follow_breaks_its_bound(followed_twice):
    experiment, scenario, data = followed_twice
    data.perturbed.run["legs.extension"][-1, 1] += 6e-4
    metrics = {metric.key: metric for metric in experiment.measure(scenario, data)}
    data.perturbed.run["legs.extension"][-1, 1] -= 6e-4
    assert not metrics["extension_error_mm"].passed
