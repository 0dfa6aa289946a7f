"""Postures followed with legs as drawn, as built, and with the outer inclination loop."""

import pytest

from parapod.systems.core.errors import ScenarioError

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
    same = ("backend=kinematic", "sensors.imu_delay_ms=0", "control.outer_loop_gain=1e-9")
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
