"""The whole operation: its phases, its faults, and the label that names the phase."""

import base64
import re
from functools import partial

import numpy as np
import pytest
import umsgpack
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from parapod.diagrams.guard import Tripped
from parapod.diagrams.levelling_platform import controller
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.sims.levelling_platform.deploy import Deploy, DeployScenario
from parapod.sims.levelling_platform.operation import OperationWatch, PhaseLabel, read_operation
from parapod.sims.output.logs.files import read_log
from parapod.systems.core.errors import RefusedRequest
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.ground_estimator import GroundEstimator
from parapod.systems.levelling_platform.supervisor import Phase

# As little as is an operation: hardly any way there and back, and work without pauses.
BRIEF = ("drive.distance_m=0.05", "work.hold_s=0.5")
ORDER = ["transport", "brake", "lower", "touchdown", "estimate", "posture", "hold", "retract"]


@pytest.fixture(scope="module")
def broken_off(execute, tmp_path_factory):
    """Result and picture of an operation that is ended on its way."""
    path = tmp_path_factory.mktemp("broken_off") / "deploy.html"
    return execute("deploy", "backend=kinematic", *BRIEF, "longest=3", html=path), path


def test_an_operation_goes_through_all_phases_and_holds_its_bounds(finished):
    result, values = finished("deploy").result, finished("deploy").values
    assert list(result.details["phase_times_s"]) == ORDER
    assert min(result.details["phase_times_s"].values()) > 0.4
    # As their feet stand: 20, 12, 5 and 0 mm high.
    assert result.details["contact_order"] == [1, 3, 4, 2]
    assert 0.0 < values["roll_error_deg"] < 0.2
    assert 0.0 < values["pitch_error_deg"] < 0.2
    assert 0.0 < values["height_error_mm"] < 2.0
    assert values["smallest_margin_mm"] > 300.0
    assert values["wheel_clearance_mm"] > 20.0
    assert values["findings"] == values["steps_left"] == 0.0


def test_on_bodies_nothing_that_is_asked_for_jumps_and_all_feet_stand_in_the_end(finished):
    log = finished("deploy").log
    period = float(np.diff(log.time).min())
    desired = log.signals["extension_desired_state"][:, :4]
    fastest = PlatformDesign().supervisor.raising_rate
    assert np.abs(np.diff(desired, axis=0)).max() <= 1.1 * fastest * period
    assert np.abs(np.diff(log.signals["legs.voltage"], axis=0)).max() < 0.5
    holding = log.signals["phase"][:, 0] == Phase.HOLD
    assert log.signals["legs.limits"][holding][-1, 8:].min() == 1.0


def test_an_operation_that_does_not_come_to_its_end_breaks_its_bounds(broken_off):
    result, _ = broken_off
    assert "steps_left" in {metric.key for metric in result.broken}
    assert result["steps_left"] > 0.0


# Faults


@pytest.fixture(scope="module")
def faulty(execute, tmp_path_factory):
    """Result and log of an operation whose encoder of a leg falls silent."""
    path = tmp_path_factory.mktemp("faulty") / "deploy.npz"
    fault = "faults=[{at: 20, target: legs.extension, index: 2, kind: off}]"
    result = execute("deploy", "backend=kinematic", *BRIEF, fault, "longest=21", log=path)
    return result, read_log(path)


def test_a_fault_ends_the_operation_and_breaks_bounds(faulty):
    result, log = faulty
    assert not result.passed
    phase, time = log.signals["phase"][:, 0], log.time
    first = int(np.argmax(phase == Phase.FAULT))
    assert 20.0 < time[first] < 20.06
    assert (phase[:first] != Phase.FAULT).all()
    assert (phase[first:] == Phase.FAULT).all()
    assert log.signals["findings"][-1].any()
    assert result["findings"] > 0.0


def test_a_fault_leaves_nothing_that_acts_without_a_number(faulty):
    signals = faulty[1].signals
    acting = ("legs.voltage", "wheels.velocity_command", "wheels.brake", "arm.position_command")
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


def test_where_nobody_resets_it_a_fault_ends_the_job_and_is_named():
    fault = "faults=[{at: 1.0, target: legs.extension, index: 2, kind: off}]"
    scenario = load_scenario(DeployScenario, overrides=("backend=kinematic", fault))
    loop = Deploy("deploy").loop(scenario, log=())
    watch = OperationWatch(loop, len(scenario.steps()), None, ends_at_fault=True)
    simulator = Simulator(loop)
    simulator.set_monitor(watch.look)
    simulator.AdvanceTo(6.0)
    assert 3.0 < simulator.get_context().get_time() < 3.1  # it is seen to stand for 2 s
    with pytest.raises(Tripped, match=r"^(legs_stale|encoder_invalid): .*; the job has "):
        watch.raise_refusal(simulator.get_context())


def test_the_log_says_which_fault_was_injected_and_when(faulty, tmp_path):
    log, path = faulty[1], tmp_path / "again.yaml"
    path.write_text(log.metadata["scenario"])
    (fault,) = load_scenario(DeployScenario, None, path).faults
    assert (fault.at, fault.target, fault.index, fault.kind) == (20.0, "legs.extension", 2, "off")
    assert log.signals["fault.legs.extension.changed"][-1] == 1.0
    units = log.metadata["units"]
    assert units["fault.legs.extension.extra_age"] == "s"
    assert units["legs.stop"] == PLATFORM.unit("legs.stop")
    assert set(units) == set(log.signals)


def test_an_attitude_that_does_not_settle_ends_the_job_and_is_named(monkeypatch):
    never = partial(GroundEstimator, settled=-1.0)
    monkeypatch.setattr(controller, "GroundEstimator", never)
    scenario = load_scenario(DeployScenario, overrides=("backend=kinematic", *BRIEF))
    loop = Deploy("deploy").loop(scenario, log=())
    watch = OperationWatch(loop, len(scenario.steps()), None)
    simulator = Simulator(loop)
    simulator.set_monitor(watch.look)
    simulator.AdvanceTo(60.0)
    assert simulator.get_context().get_time() < 40.0
    words = r"the ground could not be estimated: the attitude has not settled in 10 s"
    with pytest.raises(RefusedRequest, match=words):
        watch.raise_refusal(simulator.get_context())
    shown = read_operation(loop, simulator.get_context())
    assert (
        "refused: the attitude does not settle, so that the ground is not known" in shown.remarks
    )


# Label


def messages_of(html):
    """Commands of a recording to the browser."""
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


def test_a_recording_names_the_phases_that_were_reached(broken_off):
    shown = visible_of(broken_off[1].read_text())
    assert set(shown) == {"TRANSPORT", "BRAKE", "LOWER"}
    begins = {word: [time for time, visible in keys if visible] for word, keys in shown.items()}
    assert begins["TRANSPORT"] == [0]
    (brake,), (lower,) = begins["BRAKE"], begins["LOWER"]
    assert 0 < brake < lower < 90  # frames, 30 a second
    assert shown["TRANSPORT"] == [(0, True), (brake, False)]
