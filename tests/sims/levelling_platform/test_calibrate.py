"""The experiment `calibrate`: its bounds, its recordings, and what it refuses."""

import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from parapod.sims.cli.main import main
from parapod.sims.lab.experiment import ENTRIES, RunOptions
from parapod.sims.lab.figures import render
from parapod.sims.lab.files import read_log, write_log
from parapod.sims.levelling_platform.calibrate import EXPERIMENT, CalibrateScenario, run
from parapod.sims.levelling_platform.poses import (
    drawn_commands,
    read_recording,
    spread_commands,
)
from parapod.systems.core.errors import OutputError, UndeterminedCalibration
from parapod.systems.core.scenario_file import load_scenario

KEYS = {
    "improvement_factor",
    "foot_error_mm",
    "nominal_foot_error_mm",
    "height_error_mm",
    "roll_error_deg",
    "pitch_error_deg",
    "nominal_height_error_mm",
    "nominal_roll_error_deg",
    "nominal_pitch_error_deg",
    "chi2_per_dof",
    "length_std_mm",
    "angle_std_deg",
    "offset_std_mm",
    "accel_bias_std_mg",
    "accel_bias_roll_mg",
    "accel_bias_pitch_mg",
    "condition",
}
TRUTH_KEYS = {"sensed_improvement_factor", "accel_bias_error_mg", "offset_error_mm"}
UNKNOWN_GROUND = ("ground={known: false, roll_deg: 2, pitch_deg: 3}", "poses.turns_deg=[0, 180]")


def scenario_with(*overrides):
    return load_scenario(CalibrateScenario, overrides=overrides)


@pytest.fixture
def options():
    return RunOptions(console=Console(file=io.StringIO()))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A simulated recording."""
    path = tmp_path_factory.mktemp("recorded") / "poses.npz"
    run(scenario_with(), RunOptions(log=path, console=Console(quiet=True)))
    return path


def values(result):
    return {metric.key: metric.value for metric in result.metrics}


def test_the_experiment_is_listed_as_it_describes_itself():
    (entry,) = [entry for entry in ENTRIES if entry.name == EXPERIMENT.name]
    assert entry.load() is EXPERIMENT
    assert entry.summary == EXPERIMENT.summary


@pytest.mark.parametrize("seed", range(5))
def test_the_default_calibration_holds_its_bounds(options, seed):
    result = run(scenario_with(f"seed={seed}"), options)
    assert result.broken == ()
    assert set(values(result)) == KEYS | TRUTH_KEYS
    assert values(result)["improvement_factor"] >= 5.0


def test_the_same_seed_gives_the_same_result(options):
    assert run(scenario_with(), options) == run(scenario_with(), options)
    assert run(scenario_with(), options) != run(scenario_with("seed=1"), options)


def test_without_the_tracker_the_bias_is_known_to_the_legs_tolerances_only(options):
    result = run(scenario_with("poses.tracked=false"), options)
    assert result.broken == ()
    assert values(result)["sensed_improvement_factor"] >= 5.0
    assert values(result)["accel_bias_std_mg"] > 0.5
    assert any("no reference of the inclination" in note for note in result.notes)


def test_unknown_ground_is_found_by_turning_on_it(options):
    result = run(scenario_with(*UNKNOWN_GROUND), options)
    assert result.broken == ()
    (note,) = [note for note in result.notes if note.startswith("ground: ")]
    roll, pitch, sure = (float(x) for x in re.findall(r"\d+\.\d+", note))
    assert (roll, pitch) == (pytest.approx(2.0, abs=0.01), pytest.approx(3.0, abs=0.01))
    assert sure < 0.01


def test_figures_can_be_drawn(options, recorded):
    for scenario in (scenario_with(), scenario_with(f"recording={recorded}")):
        result = run(scenario, options)
        assert [figure.name for figure in result.figures] == [
            "calibrate_parameters",
            "calibrate_residuals",
        ]
        for figure in result.figures:
            assert render(figure).startswith(b"<?xml")


def test_commanded_poses_are_different_and_use_the_whole_stroke():
    design = spread_commands(30, 7)
    assert len(np.unique(design, axis=0)) == 30
    assert (design.min(axis=0) == 0.39).all()
    assert (design.max(axis=0) == 0.42).all()
    drawn = drawn_commands(200, np.random.default_rng(0))
    assert drawn.shape == (200, 3)
    for commands in (design, drawn):
        assert commands.min() >= 0.39
        assert commands.max() <= 0.42


@pytest.mark.parametrize("overrides", [(), UNKNOWN_GROUND])
def test_a_recording_is_calibrated_like_the_simulation_that_it_was_written_by(
    options, tmp_path, overrides
):
    path = tmp_path / "poses.npz"
    simulated = run(scenario_with(*overrides), replace(options, log=path))
    found = run(scenario_with(*overrides, f"recording={path}"), options)
    assert found.broken == ()
    assert set(values(found)) == KEYS
    same = [key for key in KEYS if "error" not in key and key != "improvement_factor"]
    assert {k: values(found)[k] for k in same} == {k: values(simulated)[k] for k in same}
    assert values(found)["improvement_factor"] > 3.0
    assert found.notes == simulated.notes


def test_the_command_writes_a_recording_and_calibrates_it(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["run", "calibrate", "--log", "poses.npz"]) == 0
    command = ["run", "calibrate", "--set", "recording=poses.npz", "--json", "found.json"]
    assert main(command) == 0
    assert "all bounds held" in capsys.readouterr().out
    assert set(json.loads(Path("found.json").read_text())) >= KEYS
    assert sorted(path.name for path in tmp_path.iterdir()) == ["found.json", "poses.npz"]


def test_the_log_says_its_units_and_how_it_was_made(recorded, tmp_path):
    log = read_log(recorded)
    assert set(log.metadata["units"]) == set(log.signals)
    assert log.signals["legs.extension"].shape == (30, 4)
    assert log.signals["height_measured"].shape == (30, 1)
    (tmp_path / "again.yaml").write_text(log.metadata["scenario"])
    assert load_scenario(CalibrateScenario, tmp_path / "again.yaml") == scenario_with()


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


def test_poses_with_a_foot_in_the_air_are_used(options, recorded, tmp_path):
    def lift(contact):
        contact = contact.copy()
        contact[::4, 2] = False
        contact[1, :2] = False
        return contact

    path = changed(recorded, tmp_path / "lifted.npz", **{"legs.contact": lift})
    assert run(scenario_with(f"recording={path}"), options).broken == ()


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
def test_unusable_recordings_are_refused_in_one_line(
    recorded, tmp_path, capsys, signal, change, message
):
    path = changed(recorded, tmp_path / "poses.npz", **{signal: change})
    assert main(["run", "calibrate", "--set", f"recording={path}"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"parapod: error: cannot calibrate with '{path}': ")
    assert message in err
    assert err.count("\n") == 1


def test_all_missing_signals_are_named_at_once(tmp_path):
    write_log(tmp_path / "none.npz", np.arange(3.0), {"other": np.zeros(3)}, {})
    with pytest.raises(OutputError, match=r"'legs.extension', 'attitude_estimated', 'height_"):
        read_recording(tmp_path / "none.npz", scenario_with())


def test_a_recording_without_poses_is_refused(recorded, tmp_path):
    signals = {name: signal[:0] for name, signal in read_log(recorded).signals.items()}
    write_log(tmp_path / "empty.npz", np.zeros(0), signals, {})
    with pytest.raises(OutputError, match="there are no poses"):
        read_recording(tmp_path / "empty.npz", scenario_with())


def test_a_file_that_is_not_there_is_refused(options):
    with pytest.raises(OutputError, match="No such file"):
        run(scenario_with("recording=nowhere.npz"), options)


def test_degenerate_recordings_are_refused_by_what_they_leave_open(
    options, recorded, tmp_path, capsys
):
    log = read_log(recorded)
    path = tmp_path / "alike.npz"
    signals = {name: np.repeat(signal[:1], 30, axis=0) for name, signal in log.signals.items()}
    write_log(path, log.time, signals, log.metadata)
    assert main(["run", "calibrate", "--set", f"recording={path}"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert re.search(r"does not determine leg \d: .* \(what helps: .*poses that differ", err)
    with pytest.raises(UndeterminedCalibration, match="15 poses or more"):
        run(scenario_with("poses.count=2"), options)
    with pytest.raises(UndeterminedCalibration, match="the ground's roll"):
        run(scenario_with("ground.known=false"), options)


@pytest.mark.parametrize("option", ["html", "graphviz"])
def test_outputs_that_there_is_nothing_for_are_refused(options, tmp_path, option):
    with pytest.raises(OutputError, match=f"--{option} has nothing to show"):
        run(scenario_with(), replace(options, **{option: tmp_path / "x"}))


def test_a_recording_is_not_written_again(options, recorded, tmp_path):
    with pytest.raises(OutputError, match="--log has nothing to write"):
        run(scenario_with(f"recording={recorded}"), replace(options, log=tmp_path / "x.npz"))


def test_perfect_instruments_are_taken_to_be_fine_but_not_perfect(options):
    none = (
        "noise={encoder_resolution_mm: 0, inclination_deg: 0, height_mm: 0, "
        "tracked_inclination_deg: 0}"
    )
    result = run(scenario_with(none), options)
    assert result.broken == ()
    assert values(result)["foot_error_mm"] < 1e-3
