"""Short runs of the experiments that are made of levelling jobs."""

import json

import pytest

from parapod.sims.cli.main import main

COARSE = ("plant.leg_model=reduced", "plant.time_step=0.005")
ONE_MOVE = "job.waypoints=[{time: 9, pitch_deg: 1, roll_deg: -1, height_mm: 10}]"


@pytest.fixture
def metrics(tmp_path, capsys):
    """Runs an experiment; returns its metrics, and has it draw its figures."""

    def run(name, *overrides, code=0):
        file = tmp_path / f"{name}.json"
        figures = tmp_path / "figures"
        arguments = ["run", name, "--json", str(file), "--figures", str(figures)]
        assert main([*arguments, "--set", *overrides]) == code, capsys.readouterr().out
        assert all(path.read_bytes().startswith(b"<?xml") for path in figures.iterdir())
        return json.loads(file.read_text())

    return run


@pytest.mark.parametrize("heights", ["[20, -20, 20, -20]", "[-20, 10, 5, 20]", "[0, 0, 0, 40]"])
def test_uneven_ground_is_levelled_to_the_bounds_of_a_plane(metrics, heights):
    found = metrics(
        "uneven-ground",
        "backend=kinematic",
        f"ground.foot_heights_mm={heights}",
        "job.waypoints=[]",
        "job.end=8",
        "job.arm.start=0",
    )
    assert found["passed"]
    assert found["unevenness_mm"] == pytest.approx(40.0)
    assert found["roll_error_deg"] <= 0.2
    assert found["pitch_error_deg"] <= 0.2
    assert found["height_error_mm"] <= 2.0


def test_uneven_ground_on_bodies_is_levelled_with_all_feet_down(metrics):
    found = metrics("uneven-ground", *COARSE, "job.waypoints=[]", "job.end=8", "job.arm.start=0")
    assert found["passed"]
    assert found["foot_lift_mm"] < 0.1


def test_ground_too_uneven_for_the_stroke_is_refused_naming_the_leg(capsys):
    arguments = ["run", "uneven-ground", "--backend", "kinematic"]
    code = main([*arguments, "--set", "ground.foot_heights_mm=[50, -50, 50, -50]"])
    assert code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "leg" in error


def test_model_and_plant_agree_as_drawn_and_differ_as_built(metrics):
    found = metrics("validate-kinematics", *COARSE, ONE_MOVE.replace("9", "5"), "job.end=9")
    assert found["passed"]
    worse = [
        found[f"perturbed_{key}"] / found[key]
        for key in ("roll_error_deg", "pitch_error_deg", "height_error_mm")
    ]
    assert max(worse) > 5.0


def test_outer_loop_brings_the_inclination_within_its_bound(metrics):
    found = metrics("track-posture", ONE_MOVE, "job.end=24", "plant.time_step=0.01")
    assert found["outer_loop_roll_error_deg"] <= 0.05
    assert found["outer_loop_pitch_error_deg"] <= 0.05
    assert found["gain_margin_dB"] >= 6.0
    assert found["phase_margin_deg"] >= 45.0


def test_outer_loop_that_does_nothing_leaves_the_error_of_the_legs(metrics):
    same = ("sensors.imu_delay_ms=0", "control.outer_loop_gain=1e-9", "plant.time_step=0.01")
    found = metrics("track-posture", ONE_MOVE, "job.end=20", *same)
    assert found["outer_loop_moving_ratio"] == pytest.approx(1.0, abs=1e-3)
