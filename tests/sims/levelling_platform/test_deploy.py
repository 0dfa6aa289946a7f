"""The whole operation by the command: what it measures, refuses, finds and shows."""

import base64
import json
import re

import numpy as np
import pytest
import umsgpack
from pydrake.geometry import Meshcat

from parapod.sims.cli.main import main
from parapod.sims.lab.experiment import ENTRIES
from parapod.sims.levelling_platform.deploy import EXPERIMENT, DeployScenario, PhaseLabel
from parapod.sims.signal_units import unit_of
from parapod.systems.core.scenario_file import dump_scenario, load_scenario
from parapod.systems.levelling_platform.supervisor import Phase

# As little as is an operation: hardly any way there and back, and work without pauses.
BRIEF = ("drive.distance_m=0.05", "work.hold_s=0.5")
ORDER = ["transport", "brake", "lower", "touchdown", "estimate", "posture", "hold", "retract"]


def deploy(*overrides, options=()):
    """Exit code of a brief operation."""
    return main(["run", "deploy", "--backend", "kinematic", *options, "--set", *BRIEF, *overrides])


def read_json(path):
    """What a file says, in strict JSON."""

    def refuse(constant):
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def test_the_experiment_is_listed_as_it_describes_itself():
    (entry,) = [entry for entry in ENTRIES if entry.name == EXPERIMENT.name]
    assert entry.load() is EXPERIMENT
    assert entry.summary == EXPERIMENT.summary


def test_a_brief_operation_holds_its_bounds(tmp_path, capsys):
    path = tmp_path / "deploy.json"
    assert deploy(options=("--json", str(path))) == 0
    out = capsys.readouterr().out
    assert re.search(r"all bounds held: (\d+) of \1\b", out)
    data = read_json(path)
    assert data["passed"] is True
    assert (data["experiment"], data["backend"], data["seed"]) == ("deploy", "kinematic", 0)
    assert list(data["phase_times_s"]) == ORDER
    assert min(data["phase_times_s"].values()) > 0.4
    # As their feet stand: 20, 12, 5 and 0 mm high.
    assert data["contact_order"] == [1, 3, 4, 2]
    assert 0.0 < data["roll_error_deg"] < 0.2
    assert 0.0 < data["pitch_error_deg"] < 0.2
    assert 0.0 < data["height_error_mm"] < 2.0
    assert data["smallest_margin_mm"] > 300.0
    assert data["wheel_clearance_mm"] > 20.0
    assert data["findings"] == data["steps_left"] == 0.0


# Refusals


@pytest.mark.parametrize(
    ("overrides", "pattern"),
    [
        (
            ("ground.roll_deg=5", "ground.pitch_deg=6"),
            r"leg [1-4] would need .* mm outside its stroke 390\.0\.\.420\.0 mm.*"
            r"stays in estimate",
        ),
        (
            ("work.height_mm=570",),
            r"leg [1-4] would need .* mm outside its stroke .*"
            r"height must be \d{3}\.\d\.\.\d{3}\.\d mm; the machine stays in estimate",
        ),
        # The operator asks for less before the operation ends, and that is not refused.
        (
            ("work.arm_deg=100",),
            r"the arm's move goes beyond 90 deg of the arm .*; the machine stays in hold",
        ),
        (
            ("ground.foot_heights_mm=[0, -5, 0, 0]",),
            r"ground\.foot_heights_mm must be 0 or more .*",
        ),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(capsys, overrides, pattern):
    assert deploy(*overrides) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = [line for line in err.splitlines() if line.startswith("parapod: error: ")]
    assert len(lines) == 1
    assert err.endswith(lines[0] + "\n")
    assert re.fullmatch(f"parapod: error: {pattern}", lines[0])


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (
            "{kind: of}",
            "faults.0.kind = 'of' is not one of off, stuck, garbage, wrong, slow, delayed, "
            "intermittent (did you mean off?)",
        ),
        (
            "{target: legs.extensio}",
            "faults.0.target = 'legs.extensio' is not one of legs.extension, imu.gyro, "
            "imu.accel, legs.limits, legs.voltage, supply, posture_command "
            "(did you mean legs.extension?)",
        ),
        (
            "{target: legs.extension, index: 4}",
            "faults.0.index = 4 is outside -1..3; legs.extension has elements 0..3, "
            "-1 is all of them",
        ),
    ],
)
def test_a_misspelt_fault_is_refused_with_what_there_is(capsys, fault, said):
    assert deploy(f"faults=[{fault}]") == 2
    assert capsys.readouterr() == ("", f"parapod: error: {said}\n")


# Faults


@pytest.fixture(scope="module")
def faulty(tmp_path_factory):
    """Exit code, log and numbers of an operation whose encoder of a leg falls silent."""
    folder = tmp_path_factory.mktemp("faulty")
    fault = "{at: 20, target: legs.extension, index: 2, kind: off}"
    log, numbers = folder / "deploy.npz", folder / "deploy.json"
    code = deploy(
        f"faults=[{fault}]", "longest=22", options=("--log", str(log), "--json", str(numbers))
    )
    with np.load(log, allow_pickle=False) as loaded:
        signals = dict(loaded)
    return code, signals, read_json(numbers)


def test_a_fault_ends_the_operation_and_breaks_bounds(faulty):
    code, signals, data = faulty
    assert code == 1
    assert data["passed"] is False
    phase, time = signals["phase"][:, 0], signals["t"]
    first = int(np.argmax(phase == Phase.FAULT))
    assert 20.0 < time[first] < 20.06
    assert (phase[:first] != Phase.FAULT).all()
    assert (phase[first:] == Phase.FAULT).all()
    assert signals["findings"][-1].any()


def test_a_fault_leaves_nothing_that_acts_without_a_number(faulty):
    _, signals, _ = faulty
    acting = ("legs.voltage", "wheels.velocity_command", "wheels.brake", "arm_command")
    for name in (*acting, "extension_desired_state", "findings", "severity", "attitude_estimated"):
        assert np.isfinite(signals[name]).all(), name
    for name in signals:
        if name.startswith("truth."):
            assert np.isfinite(signals[name]).all(), name
    # When nothing is known of a leg the drives are cut, and the screws hold the platform.
    stopped = signals["legs.stop"][:, 0] > 0.5
    assert stopped[-1]
    assert not signals["legs.voltage"][stopped][1:].any()
    assert np.ptp(signals["truth.extension"][stopped][10:], axis=0).max() < 1e-9


def test_the_log_says_what_was_run(faulty, tmp_path):
    _, signals, _ = faulty
    metadata = json.loads(str(signals["metadata"]))
    path = tmp_path / "again.yaml"
    path.write_text(metadata["scenario"])
    again = load_scenario(DeployScenario, None, path)
    assert dump_scenario(again) == metadata["scenario"]
    (fault,) = again.faults
    assert (fault.at, fault.target, fault.index, fault.kind) == (20.0, "legs.extension", 2, "off")
    assert set(metadata["units"]) == set(signals) - {"t", "metadata"}
    assert metadata["units"]["legs.stop"] == unit_of("legs.stop") == "-"


# Label


def messages_of(html):
    """What a recording tells the browser."""
    blobs = re.findall(r"data:application/octet-binary;base64,([A-Za-z0-9+/=]+)", html)
    return [umsgpack.unpackb(base64.b64decode(blob)) for blob in blobs]


def visible_of(html):
    """Frames and visibility of each word in a recording."""
    (animation,) = [m for m in messages_of(html) if m["type"] == "set_animation"]
    return {
        each["path"].rpartition("/")[2]: [
            (key["time"], key["value"])
            for track in each["clip"]["tracks"]
            if track["name"] == ".visible"
            for key in track["keys"]
        ]
        for each in animation["animations"]
        if each["path"].startswith("/phase/")
    }


def test_one_word_after_the_other_is_shown_in_a_recording():
    meshcat = Meshcat()
    label = PhaseLabel(meshcat)
    meshcat.StartRecording(10.0)
    for word, time in (("LOWER", 0.0), ("HOLD", 0.5), ("LOWER", 1.0)):
        label.show(word, time)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    assert visible_of(meshcat.StaticHtml()) == {
        "LOWER": [(0, True), (5, False), (10, True)],
        "HOLD": [(0, False), (5, True), (10, False)],
    }


def test_each_word_is_drawn_once():
    meshcat = Meshcat()
    label = PhaseLabel(meshcat)
    for time in range(3):
        for phase in Phase:
            label.show(phase.name, float(time))
    drawn = [m["path"] for m in messages_of(meshcat.StaticHtml()) if m["type"] == "set_object"]
    assert sorted(path for path in drawn if path.startswith("/phase/")) == sorted(
        f"/phase/{phase.name}" for phase in Phase
    )


def test_a_recording_names_the_phases_that_were_reached(tmp_path):
    path = tmp_path / "deploy.html"
    # It ends on the way down, and its bounds are broken.
    assert deploy("longest=3", options=("--html", str(path))) == 1
    shown = visible_of(path.read_text())
    assert set(shown) == {"TRANSPORT", "BRAKE", "LOWER"}
    begins = {word: [time for time, visible in keys if visible] for word, keys in shown.items()}
    assert begins["TRANSPORT"] == [0]
    (brake,), (lower,) = begins["BRAKE"], begins["LOWER"]
    assert 0 < brake < lower < 90  # frames, 30 a second
    assert shown["TRANSPORT"] == [(0, True), (brake, False)]
