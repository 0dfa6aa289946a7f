"""Jobs that lead the legs of a real machine, here on a simulated one in its place."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.drivers.not_fitted import NotFittedPart
from parapod.diagrams.guard import Tripped
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.real import PlatformGuard
from parapod.diagrams.levelling_platform.scenario import JobScenario
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.calibrate import led
from parapod.sims.levelling_platform.calibrate.experiment import Calibrate, identified_values
from parapod.sims.levelling_platform.calibrate.led import (
    PoseWatch,
    parsed_answer,
    pose_commands,
    record_poses,
)
from parapod.sims.levelling_platform.calibrate.recording import pose_signals
from parapod.sims.levelling_platform.calibrate.scenario import CalibrateScenario
from parapod.sims.levelling_platform.identify import measured
from parapod.sims.levelling_platform.identify.experiment import (
    Identified,
    IdentifyActuators,
    IdentifyActuatorsScenario,
    Recordings,
)
from parapod.sims.levelling_platform.identify.measured import record_in_turn
from parapod.sims.levelling_platform.identify.steps import find_steps, separate_friction
from parapod.sims.levelling_platform.slip.experiment import Slip, Slipped
from parapod.sims.levelling_platform.slip.measured import (
    Times,
    measure_lift,
)
from parapod.sims.levelling_platform.slip.scenario import BEGIN, SlipScenario
from parapod.sims.output.options import RunOptions
from parapod.systems.core.errors import OutputError, RefusedRequest, ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.calibration.solve import calibrate

QUICK = ("steps.lowering_mm_s=6",)


def quiet_bench(name, scenario):
    return Runner(name, RunOptions(console=Console(quiet=True)))


def identify(*overrides):
    return load_scenario(IdentifyActuatorsScenario, overrides=("backend=kinematic", *overrides))


def true_gains(scenario):
    error = scenario.machine.actuators.gain_error
    return 0.01 * (1.0 + np.random.default_rng(scenario.seed).uniform(-error, error, 4))


class Guarded:
    """A watch as a real machine's, whose guard looks at every tick."""

    def __init__(self, loop, **options):
        super().__init__(loop, **options)
        self.guard = PlatformGuard(loop.scenario)

    def look(self, root):
        is_new = super().look(root)
        if is_new:
            readings = self._loop.readings(root, self.guard.signals)
            values = {name: read() for name, read in readings.items()}
            trip = self.guard.check(root.get_time(), values)
            assert trip is None, (root.get_time(), trip)
        return is_new


class GuardedSteps(Guarded, measured._StepsWatch):
    pass


@pytest.fixture(scope="module")
def identified():
    """A run with gains that are off by up to 15 %, under the guard."""
    scenario = identify(*QUICK, "machine.actuators.gain_error=0.15")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measured, "_StepsWatch", GuardedSteps)
        pair = record_in_turn(scenario.plan, scenario.on_wheels, quiet_bench("x", scenario))
    steps = tuple(find_steps(case, scenario.steps.transient_s) for case in pair)
    data = Identified(Recordings(*pair, None), steps, tuple(map(separate_friction, steps)))
    return scenario, data


# Identified actuators


def test_both_cases_in_turn_give_the_true_gains_within_the_bound(identified):
    scenario, data = identified
    unloaded, loaded = (case.gain / true_gains(scenario) - 1.0 for case in data.separated)
    assert np.abs(unloaded).max() < 1e-3
    assert np.abs(loaded).max() < 1e-2
    assert all(len(case.voltage) == 10 for case in data.steps)


def test_metrics_of_a_real_machine_need_no_truth_and_hold_their_bounds(identified):
    scenario, data = identified
    metrics = {m.key: m for m in IdentifyActuators("identify-actuators").measure(scenario, data)}
    assert not any(key.startswith("gain_error") for key in metrics)
    assert metrics["gain_difference_percent"].passed
    # What the actuators are is no fault of the identification.
    assert not metrics["step_deviation_loaded_percent"].is_bounded
    assert metrics["gain_unloaded"].is_bounded
    for key in ("smallest_lifted_extension_mm", "largest_lifted_extension_mm"):
        assert metrics[key].passed
    assert metrics["largest_extension_mm"].value < 425.0
    notes = list(IdentifyActuators("identify-actuators").note(scenario, data))
    assert any("K of legs 1 to 4" in note for note in notes)


def test_a_wrong_gain_of_one_case_breaks_the_bound(identified):
    scenario, data = identified
    unloaded, loaded = data.separated
    wrong = replace(data, separated=(unloaded, replace(loaded, gain=1.05 * loaded.gain)))
    metrics = {m.key: m for m in IdentifyActuators("x").measure(scenario, wrong)}
    assert not metrics["gain_difference_percent"].passed


def test_identified_values_are_those_of_the_scenario_s_keys(identified):
    scenario, data = identified
    found = IdentifyActuators("x").identified(scenario, data)
    assert found["control.actuator_gains"] == pytest.approx(true_gains(scenario), rel=1e-3)
    extending, retracting = found["control.friction_feedforward"]
    assert 0.03 < extending < 0.09
    assert 0.09 < retracting < 0.16


def test_the_legs_end_where_they_stand(identified):
    scenario, data = identified
    extension = data.recordings.loaded.extension
    assert extension[0] == pytest.approx(scenario.plan.initial_extension, abs=1e-4)
    assert np.ptp(extension[-10:], axis=0).max() < 2e-5


@pytest.mark.parametrize(
    ("job", "words"),
    [
        (JobScenario(initial_extension_mm=405.0), "leg 1 touches the ground; begin on the wheels"),
        (JobScenario(start="wheels"), ""),
    ],
)
def test_a_machine_that_stands_on_its_feet_is_refused_before_anything_moves(job, words):
    scenario = identify(*QUICK)
    machine = replace(scenario.on_wheels, job=job)
    watches = []

    class Watch(measured._StepsWatch):
        def __init__(self, loop):
            super().__init__(loop)
            watches.append(self)

        def look(self, root):
            is_new = super().look(root)
            self.is_over = len(self.rows["t"]) > 40
            return is_new

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measured, "_StepsWatch", Watch)
        patch.setattr(Watch, "recording", lambda *arguments, **options: None)
        if not words:
            record_in_turn(scenario.plan, machine, quiet_bench("x", scenario))
            return
        with pytest.raises(RefusedRequest, match=words):
            record_in_turn(scenario.plan, machine, quiet_bench("x", scenario))
    assert not np.any(watches[0].column("legs.voltage"))


def test_steps_that_would_leave_the_lifted_stroke_are_refused_on_hardware_only():
    overrides = ("steps.lifted_extension_mm=450", "steps.travel_mm=12")
    experiment = IdentifyActuators("identify-actuators")
    experiment.check(identify(*overrides))
    with pytest.raises(ScenarioError, match=r"to 464\.2 mm, outside 428\.\.458 mm"):
        experiment.check(identify(*overrides, "backend=hardware"))


# Slip


def slip(*overrides):
    return load_scenario(SlipScenario, overrides=overrides)


@pytest.fixture(scope="module")
def lifted():
    """A lift as a real machine measures it, on the kinematic plant."""
    scenario = slip()
    machine = replace(
        scenario.levelling,
        backend="kinematic",
        machine=replace(scenario.machine, sensors=SensorScenario()),
    )
    times = Times.from_scenario(scenario, BEGIN)
    return scenario, measure_lift(scenario, machine, times, quiet_bench("x", scenario))


def test_encoders_tell_how_far_the_feet_move_against_each_other(lifted):
    scenario, data = lifted
    metrics = {m.key: m for m in Slip("slip").measure(scenario, Slipped(data, []))}
    # By the truth of the multibody plant it is 3.51 mm.
    assert metrics["actuator_slip_mm"].value == pytest.approx(3.51, abs=0.03)
    assert all(metric.passed for metric in metrics.values())
    assert "arm_slip_mm" not in metrics
    assert "creep_mm_s" not in metrics


def test_an_actuator_that_moves_while_braked_breaks_its_bound(lifted):
    scenario, data = lifted
    extension = data.extension.copy()
    extension[-5:, 2] += 5e-5
    metrics = {
        m.key: m
        for m in Slip("slip").measure(scenario, Slipped(replace(data, extension=extension), []))
    }
    assert not metrics["braked_motion_mm"].passed


def test_a_foot_off_the_plane_of_the_others_breaks_its_bound(lifted):
    scenario, data = lifted
    extension = data.extension + np.array([0.0, 0.0, 0.0, 1e-3])
    wrong = Slipped(replace(data, extension=extension), [])
    metrics = {m.key: m for m in Slip("slip").measure(scenario, wrong)}
    assert not metrics["foot_residual_mm"].passed


def test_a_platform_that_drifts_as_a_whole_is_said_to_be_unseen(lifted):
    scenario, data = lifted
    notes = " ".join(Slip("slip").note(scenario, Slipped(data, [])))
    assert "moves no encoder" in notes


def test_without_an_arm_the_swing_s_metrics_are_left_out(lifted):
    scenario, data = lifted
    hardware = slip("backend=hardware").levelling
    assert any(isinstance(driver, NotFittedPart) for driver in hardware.hardware.drivers)
    assert not hardware.has_arm
    bare = Slipped(replace(data, has_arm=False), [])
    keys = {metric.key for metric in Slip("slip").measure(scenario, bare)}
    assert not any(key.startswith("arm_") for key in keys)
    assert any("no arm" in note for note in Slip("slip").note(scenario, bare))


def test_a_platform_on_its_wheels_is_not_lifted():
    scenario = slip()
    machine = replace(scenario.levelling, backend="kinematic", job=JobScenario(start="wheels"))
    times = Times.from_scenario(scenario, BEGIN)
    with pytest.raises(RefusedRequest, match="leg 1 does not touch the ground"):
        measure_lift(scenario, machine, times, quiet_bench("x", scenario))


def test_a_platform_that_tilts_ends_the_job():
    scenario = slip()
    machine = replace(scenario.levelling, backend="kinematic")
    machine.ground.roll_deg = 5.0
    times = Times.from_scenario(scenario, BEGIN)
    with pytest.raises(Tripped, match=r"tilt: a platform that is inclined by 5\.0 deg"):
        measure_lift(scenario, machine, times, quiet_bench("x", scenario))


# Poses


def poses(*overrides):
    brief = "measuring={rest_s: 1.5, average_s: 1.0, rate_mm_s: 4}"
    return load_scenario(CalibrateScenario, overrides=(brief, *overrides))


class Truthful:
    """Answers with what an instrument tells, after nonsense."""

    def __init__(self, nonsense=()):
        self.nonsense, self.asked, self.said, self.watch = list(nonsense), [], [], None

    def open(self):
        return nullcontext()

    def ask(self, number, question):
        self.asked.append(number)

    def say(self, text):
        self.said.append(text)

    def take(self):
        if self.nonsense:
            return self.nonsense.pop(0)
        station, root = self.watch._loop.station, self.watch.root
        port = station.GetOutputPort("truth.posture")
        roll, pitch, height = port.Eval(station.GetMyContextFromRoot(root))
        return f"{1e3 * height:.2f} {np.degrees(roll):.2f} {np.degrees(pitch):.2f}"


@pytest.fixture
def lead(tmp_path, monkeypatch):
    """lead(scenario, answers): the recording, and its file."""

    def run(scenario, answers):
        class Watch(Guarded, PoseWatch):
            def look(self, root):
                answers.watch, self.root = self, root
                return super().look(root)

        monkeypatch.setattr(led, "PoseWatch", Watch)
        path = tmp_path / "poses.csv"
        bench = quiet_bench("calibrate", scenario)

        def write(recording):
            Calibrate("calibrate").write_log(path, scenario, *pose_signals(recording))

        return record_poses(scenario, scenario.levelling, answers, write, bench), path

    return run


@pytest.mark.slow
def test_a_machine_that_is_led_through_the_poses_is_calibrated_by_its_recording(lead):
    scenario = poses("poses.count=20", "noise={inclination_deg: 0.02, height_mm: 0.1}")
    recording, path = lead(scenario, Truthful())
    assert len(recording) == 20
    assert recording.contact.all()
    again = replace(scenario, recording=str(path))
    result = Calibrate("calibrate").execute(again, RunOptions(console=Console(quiet=True)))
    assert result.broken == ()
    assert result["improvement_factor"] > 5.0
    bias = result.identified["control.inclination_bias_deg"]
    # 1 mg of each sign is .057 deg.
    assert np.abs(bias) == pytest.approx(0.057, abs=0.02)


def test_the_legs_have_no_command_while_it_waits_and_rest(lead):
    scenario = poses("poses.count=1")
    answers = Truthful()
    lead(scenario, answers)
    assert not np.any(answers.watch.column("legs.voltage"))
    assert np.ptp(answers.watch.column("legs.extension"), axis=0).max() == 0.0


def test_an_answer_that_cannot_be_is_asked_again(lead):
    answers = Truthful(["", "high", "47 0 0", "nan 0 0", "450"])
    recording, _ = lead(poses("poses.count=1"), answers)
    assert len(recording) == 1
    assert answers.asked == [1] * 6
    assert len(answers.said) == 5
    assert "is not height [mm], roll [deg], pitch [deg]" in answers.said[0]
    assert "is not within 15 mm" in answers.said[2]


def test_poses_before_an_interruption_are_in_the_file(lead, tmp_path):
    class Tired(Truthful):
        def take(self):
            if len(self.asked) > 2:
                raise KeyboardInterrupt
            return super().take()

    with pytest.raises(KeyboardInterrupt):
        lead(poses("poses.count=5"), Tired())
    scenario = poses("poses.count=5")
    from parapod.sims.levelling_platform.calibrate.recording import read_recording

    assert len(read_recording(tmp_path / "poses.csv", scenario)) == 2


EXPECTED = np.array([0.01, -0.02, 0.455])


def test_answers_are_in_millimetres_and_degrees():
    outside = parsed_answer("455.5 0.60 -1.1", EXPECTED, True)
    assert outside.height == pytest.approx(0.4555)
    assert outside.inclination == pytest.approx(np.radians([0.60, -1.1]))
    assert np.isnan(parsed_answer("455.5", EXPECTED, False).inclination).all()


@pytest.mark.parametrize("text", ["455", "455 1", "455 0.6 -1.1 3", "455 0.6 2.0", "455 x 1"])
def test_answers_that_cannot_be_are_errors(text):
    with pytest.raises(ValueError, match="is not"):
        parsed_answer(text, EXPECTED, True)


def test_commands_are_what_encoders_have_to_tell():
    plain = poses("poses.count=3")
    offset = poses("poses.count=3", "control.encoder_offsets_mm=[1, 0, 0, 0]")
    commands = [pose_commands(scenario, scenario.levelling) for scenario in (plain, offset)]
    assert commands[1][:, 0] == pytest.approx(commands[0][:, 0] - 1e-3)


def test_a_recording_that_is_there_is_not_written_over(tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text("kept\n")
    scenario = poses("backend=hardware", f"measuring.poses_file={path}")
    with pytest.raises(OutputError, match=r"is there already; calibrate with it by recording="):
        Calibrate("calibrate").check(scenario)
    Calibrate("calibrate").check(replace(scenario, recording=str(path)))
    with pytest.raises(ScenarioError, match=r"poses\.turns_deg must be \[0\]"):
        Calibrate("calibrate").check(poses("backend=hardware", "poses.turns_deg=[0, 180]"))


def test_identified_values_make_the_machine_that_was_calibrated():
    scenario = poses()
    from parapod.sims.levelling_platform.calibrate.recording import draw_machine, record

    random = np.random.default_rng(0)
    recorded, _ = record(scenario, draw_machine(scenario, random), random)
    found = calibrate(recorded.recording, DRAWN, scenario.tolerances.tolerances)
    values = identified_values(found)
    overrides = [f"{key}={value}" for key, value in values.items()]
    found_scenario = load_scenario(CalibrateScenario, overrides=overrides)
    control = found_scenario.control
    known = found_scenario.levelling.geometry_as_known
    for leg, other in zip(known.legs, found.geometry.legs, strict=True):
        assert leg.p_MF == pytest.approx(other.p_MF, abs=1e-7)
        assert leg.l_4 == pytest.approx(other.l_4, abs=1e-7)
        assert leg.alpha == pytest.approx(other.alpha, abs=1e-6)
    assert control.encoder_offsets == pytest.approx(found.offsets, abs=1e-7)
    assert control.inclination_bias == pytest.approx(found.bias, abs=1e-7)
