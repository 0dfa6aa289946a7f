"""The job `level`: where its errors come from, what stops it, and what is said about it."""

import json
import re
from functools import cache

import numpy as np
import pytest

PERFECT = (
    "machine.sensors={encoder_resolution_mm: 0, imu_noise: false, accel_bias_mg: 0, "
    "gyro_bias_deg_s: 0}"
)
# As little as passes for a job: ground that is almost level, found out by perfect sensors.
BRIEF = (
    "backend=kinematic",
    "ground.roll_deg=0.3",
    "ground.pitch_deg=0.2",
    PERFECT,
    "job.initial_extension_mm=405",
    "job.estimate_at=1.5",
    "job.settled_after=1.5",
    "job.waypoints=[]",
    "job.arm={start: 0.5, duration: 0.5}",
    "job.end=2",
)
# A job without its pauses.
SHORT = (
    "job.settled_after=3.5",
    "job.waypoints=[{time: 3.5, roll_deg: -0.7, pitch_deg: 0.7, height_mm: -10}]",
    "job.arm={start: 5.5}",
    "job.end=7",
)


def test_legs_with_closed_loops_are_told_how_well_they_are_closed(finished):
    assert 0.0 < finished("level").values["closure_error_um"] < 100.0


def test_a_job_holds_its_bounds_on_the_kinematic_backend_with_another_seed(execute):
    result = execute("level", *SHORT, "backend=kinematic", "seed=1")
    assert result.broken == ()
    assert result.notes == ()


def test_without_imperfections_the_errors_are_those_of_the_method(execute):
    perfect = ("machine.actuators.gain_error=0", "job.estimate_at=1.5", PERFECT)
    result = execute("level", *SHORT, *perfect, "plant.time_step=0.004")
    assert result["roll_error_deg"] < 0.02
    assert result["pitch_error_deg"] < 0.02
    assert result["height_error_mm"] < 0.3
    assert result["ground_roll_error_deg"] < 0.01
    assert result["ground_pitch_error_deg"] < 0.01


def test_the_accelerometer_s_bias_tilts_the_platform_by_as_much(execute):
    overrides = ("machine.sensors.accel_bias_mg=10", "job.estimate_at=3", "job.arm.angle_deg=0")
    result = execute("level", *BRIEF, *overrides)
    tilt = np.degrees(np.arcsin(0.01))
    # A turn-on bias of the sample reaches ground and platform alike.
    assert result["ground_roll_error_deg"] == pytest.approx(tilt, rel=0.05)
    assert result["roll_error_deg"] == pytest.approx(tilt, rel=0.05)


def test_an_estimate_of_the_ground_that_is_late_or_does_not_come_is_told(execute):
    # A gyro's bias of 3 deg/s is not believed, and keeps the attitude away from gravity.
    result = execute("level", *BRIEF, "machine.sensors.gyro_bias_deg_s=3")
    assert result.notes == ("the ground was not estimated: the attitude did not settle",)
    shift = "faults=[{at: 1, duration: 0.2, target: imu.gyro, kind: wrong, scale: 1, value: 0.01}]"
    result = execute("level", *BRIEF, shift)
    (note,) = result.notes
    words = r"the ground was estimated (.*) s late: the attitude had not settled"
    assert 0.1 < float(re.fullmatch(words, note)[1]) < 2.0
    assert result["ground_roll_error_deg"] < 0.1


@pytest.fixture(scope="module")
def steep(execute):
    """steep(roll, pitch): result of a job on that ground, with fewer postures than usual."""

    @cache
    def run(roll, pitch):
        ground = (f"ground.roll_deg={roll}", f"ground.pitch_deg={pitch}")
        highest, lowest = "{time: 7, height_mm: 15}", "{time: 10, roll_deg: -0.7, height_mm: -10}"
        postures = f"job.waypoints=[{highest}, {lowest}, {{time: 13}}]"
        end = ("job.arm={start: 15, duration: 1}", "job.end=17")
        return execute("level", "backend=kinematic", *ground, postures, *end)

    return run


def test_waypoints_that_had_to_shrink_are_reported(steep):
    result = steep(3.0, 4.0)
    assert result.broken == ()
    share = result["posture_scale"]
    assert 0.0 < share < 1.0
    (note,) = result.notes
    assert note.startswith(f"waypoints scaled to {100 * share:.0f} %: ")
    assert re.search(r"leaves leg \d only \d\.\d mm of stroke$", note)


@pytest.mark.parametrize(("roll", "pitch"), [(-6.2, 0.0), (0.0, 6.6)])
def test_the_further_the_way_to_the_level_posture_the_longer_it_may_take(steep, roll, pitch):
    result = steep(roll, pitch)
    (settling,) = (m for m in result.metrics if m.key == "settling_time_s")
    # The paper's bound of the rate: 15/8 of its mean is 1.5 deg/s, and the loops' five constants.
    furthest = max(abs(roll), abs(pitch))
    assert settling.bound == pytest.approx(1.875 * furthest / 1.5 + 0.5, abs=0.05)
    assert 6.0 < settling.value < settling.bound
    assert result.broken == ()


def test_waypoints_that_shrank_to_nothing_do_not_end_the_way_to_the_level_posture(steep):
    result = steep(0.0, 6.6)
    assert result["posture_scale"] < 0.1
    assert result["settling_time_s"] > 7.0  # the first waypoint comes before


def test_waypoints_smaller_than_the_bounds_do_not_undo_a_level_posture(steep):
    result = steep(-6.0, -2.0)
    assert 0.1 < result["posture_scale"] < 0.2  # waypoints of 0.17 deg, bounds of 0.2 deg
    assert 6.0 < result["settling_time_s"] < 7.0
    assert result.broken == ()


def test_a_platform_that_never_gets_level_has_no_settling_time(execute):
    weak = ("control.voltage_limit=0.5", "machine.actuators.coulomb_friction=1e4")
    result = execute("level", *BRIEF, *weak)
    assert result["settling_time_s"] == np.inf
    assert "settling_time_s" in [metric.key for metric in result.broken]
    assert result.as_json()["settling_time_s"] is None
    assert json.dumps(result.as_json(), allow_nan=False)


def test_waypoints_are_taken_relative_to_the_level_posture(execute, tmp_path):
    path = tmp_path / "level.npz"
    there = "{time: 1.5, roll_deg: 0.5, pitch_deg: -0.5, height_mm: 5}"
    execute("level", *BRIEF, f"job.waypoints=[{there}]", "job.end=3.5", log=path)
    # By numpy alone, which is how people read it.
    with np.load(path, allow_pickle=False) as log:
        assert log["t"][-1] == pytest.approx(5.0)
        last = log["truth.posture"][-1]
    np.testing.assert_allclose(last, [np.radians(0.5), np.radians(-0.5), 0.482], atol=5e-4)
