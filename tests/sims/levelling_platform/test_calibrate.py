"""The experiment `calibrate`: its bounds, its recordings, and what it refuses."""

import re

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.sims.levelling_platform.calibrate.recording import (
    drawn_commands,
    read_recording,
    spread_commands,
)
from parapod.sims.levelling_platform.calibrate.scenario import CalibrateScenario
from parapod.sims.output.figures import render
from parapod.sims.output.logs.files import read_log, write_log
from parapod.systems.core.errors import OutputError, UndeterminedCalibration
from parapod.systems.core.scenario_file import load_scenario

UNKNOWN_GROUND = ("ground={known: false, roll_deg: 2, pitch_deg: 3}", "poses.turns_deg=[0, 180]")


def scenario_with(*overrides):
    return load_scenario(CalibrateScenario, overrides=overrides)


@pytest.fixture(scope="module")
def recorded(finished, tmp_path_factory):
    """A simulated recording."""
    path, log = tmp_path_factory.mktemp("recorded") / "poses.npz", finished("calibrate").log
    write_log(path, log.time, log.signals, log.metadata)
    return path


def values(result):
    return {metric.key: metric.value for metric in result.metrics}


@pytest.mark.parametrize("seed", [1, 2])
def test_machines_of_other_seeds_are_identified_too(execute, seed):
    result = execute("calibrate", f"seed={seed}")
    assert result.broken == ()
    assert result["improvement_factor"] >= 5.0


def test_without_the_tracker_the_bias_is_known_to_the_legs_tolerances_only(execute):
    result = execute("calibrate", "poses.tracked=false")
    assert result.broken == ()
    assert result["sensed_improvement_factor"] >= 5.0
    assert result["accel_bias_std_mg"] > 0.5
    assert any("no reference of the inclination" in note for note in result.notes)


def test_unknown_ground_is_found_by_turning_on_it(execute):
    result = execute("calibrate", *UNKNOWN_GROUND)
    assert result.broken == ()
    (note,) = [note for note in result.notes if note.startswith("ground: ")]
    roll, pitch, sure = (float(x) for x in re.findall(r"\d+\.\d+", note))
    assert (roll, pitch) == (pytest.approx(2.0, abs=0.01), pytest.approx(3.0, abs=0.01))
    assert sure < 0.01


def test_commanded_poses_are_different_and_use_the_whole_stroke():
    design = spread_commands(DRAWN, 30, 7)
    assert len(np.unique(design, axis=0)) == 30
    assert (design.min(axis=0) == 0.39).all()
    assert (design.max(axis=0) == 0.42).all()
    drawn = drawn_commands(DRAWN, 200, np.random.default_rng(0))
    assert drawn.shape == (200, 3)
    for commands in (design, drawn):
        assert commands.min() >= 0.39
        assert commands.max() <= 0.42


@pytest.mark.parametrize(("overrides", "suffix"), [((), ".csv"), (UNKNOWN_GROUND, ".npz")])
def test_a_recording_is_calibrated_like_the_simulation_that_it_was_written_by(
    execute, tmp_path, overrides, suffix
):
    path = tmp_path / f"poses{suffix}"
    simulated = execute("calibrate", *overrides, log=path)
    found = execute("calibrate", *overrides, f"recording={path}")
    assert found.broken == ()
    assert found["improvement_factor"] > 3.0
    assert found.notes == simulated.notes
    same = [k for k in values(found) if "error" not in k and k != "improvement_factor"]
    assert len(same) > 5
    assert {k: found[k] for k in same} == {k: simulated[k] for k in same}
    # What is true is known of simulated machines only.
    assert set(values(found)) < set(values(simulated))
    assert all(render(figure).startswith(b"<?xml") for figure in found.figures)


def changed(recorded, path, **changes):
    """A copy of a recording in which signals are changed, or left out for None."""
    log = read_log(recorded)
    signals = {
        name: changes.get(name, lambda value: value)(value) for name, value in log.signals.items()
    }
    signals = {name: value for name, value in signals.items() if value is not None}
    write_log(path, log.time, signals, log.metadata)
    return path


def test_ground_and_contact_are_those_of_the_recording_if_it_has_them(recorded, tmp_path):
    sloping = scenario_with("ground.pitch_deg=4")
    assert (read_recording(recorded, sloping).ground == 0.0).all()
    bare = {"ground_measured": lambda value: None, "legs.contact": lambda value: None}
    path = changed(recorded, tmp_path / "bare.npz", **bare)
    recording = read_recording(path, sloping)
    np.testing.assert_allclose(recording.ground, [[0.0, np.radians(4.0)]] * 30, atol=1e-15)
    assert recording.contact.all()
    assert read_recording(path, scenario_with("ground.known=false")).ground is None


def test_poses_with_a_foot_in_the_air_are_used(execute, recorded, tmp_path):
    def lift(contact):
        contact = contact.copy()
        contact[::4, 2] = False
        contact[1, :2] = False
        return contact

    path = changed(recorded, tmp_path / "lifted.npz", **{"legs.contact": lift})
    assert execute("calibrate", f"recording={path}").broken == ()


def test_a_height_may_be_a_column_or_a_plain_list(recorded, tmp_path):
    path = changed(recorded, tmp_path / "list.npz", height_measured=np.ravel)
    again, first = (read_recording(p, scenario_with()) for p in (path, recorded))
    np.testing.assert_array_equal(again.height, first.height)


@pytest.mark.parametrize(
    ("signal", "change", "message"),
    [
        ("height_measured", lambda v: None, "it has no signal 'height_measured'"),
        (
            "legs.extension",
            lambda v: v[:, :3],
            r"'legs.extension' must be (n, 4) [m], not (30, 3)",
        ),
        ("attitude_estimated", lambda v: v[:, 0], "'attitude_estimated' must be (n, 2) [rad]"),
        ("height_measured", lambda v: v * np.nan, "height of pose 1 is not finite"),
        ("legs.extension", lambda v: 1e3 * v, "in pose 1 leg 1 is"),
        ("attitude_estimated", lambda v: np.degrees(v), "the platform is inclined by"),
        ("legs.extension", lambda v: v * 1j, "is not numeric"),
    ],
)
def test_unusable_recordings_are_refused(execute, recorded, tmp_path, signal, change, message):
    path = changed(recorded, tmp_path / "poses.npz", **{signal: change})
    with pytest.raises(OutputError, match=re.escape(message)) as refused:
        execute("calibrate", f"recording={path}")
    assert str(refused.value).startswith(f"cannot calibrate with '{path}': ")


def test_all_missing_signals_are_named_at_once(tmp_path):
    write_log(tmp_path / "none.npz", np.arange(3.0), {"other": np.zeros(3)}, {})
    with pytest.raises(OutputError, match=r"'legs.extension', 'attitude_estimated', 'height_"):
        read_recording(tmp_path / "none.npz", scenario_with())


def test_a_recording_without_poses_is_refused(recorded, tmp_path):
    signals = {name: signal[:0] for name, signal in read_log(recorded).signals.items()}
    write_log(tmp_path / "empty.npz", np.zeros(0), signals, {})
    with pytest.raises(OutputError, match="there are no poses"):
        read_recording(tmp_path / "empty.npz", scenario_with())


def test_a_recording_of_poses_that_are_alike_is_refused_by_what_it_leaves_open(
    execute, recorded, tmp_path
):
    log = read_log(recorded)
    path = tmp_path / "alike.npz"
    signals = {name: np.repeat(signal[:1], 30, axis=0) for name, signal in log.signals.items()}
    write_log(path, log.time, signals, log.metadata)
    words = r"does not determine leg \d: .* \(what helps: .*poses that differ"
    with pytest.raises(UndeterminedCalibration, match=words):
        execute("calibrate", f"recording={path}")


def test_a_recording_is_not_written_again(execute, recorded, tmp_path):
    with pytest.raises(OutputError, match="--log has nothing to write"):
        execute("calibrate", f"recording={recorded}", log=tmp_path / "x.npz")


def test_perfect_instruments_are_taken_to_be_fine_but_not_perfect(execute):
    none = (
        "noise={encoder_resolution_mm: 0, inclination_deg: 0, height_mm: 0, "
        "tracked_inclination_deg: 0}"
    )
    result = execute("calibrate", none)
    assert result.broken == ()
    assert result["foot_error_mm"] < 1e-3
