"""The experiment `slip`: its numbers and what they are made of, its refusals."""

import numpy as np
import pytest
from rich.console import Console

from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.slip.experiment import Slip
from parapod.sims.levelling_platform.slip.scenario import (
    SlipScenario,
    control_trajectory,
    lift_trajectory,
    swing_trajectory,
)
from parapod.sims.levelling_platform.slip.simulated import (
    Recording,
    lift_and_swing,
    lift_metrics,
    slip_metrics,
)
from parapod.sims.output.options import RunOptions
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.levelling_platform.leg import foot_to_centre


def scenario_with(*overrides):
    return load_scenario(SlipScenario, overrides=overrides)


@pytest.fixture(scope="module")
def logged(finished):
    return finished("slip")


def bench(scenario):
    return Runner("", RunOptions(console=Console(quiet=True)))


def test_displacement_is_measured_in_the_ground_s_plane():
    normal = np.array([0.6, 0.0, 0.8])
    feet = np.zeros((3, 4, 3))
    feet[1] = 5.0 * normal + [0.8, 0.0, -0.6]
    feet[2] = [0.0, 2.0, 0.0]
    unused = feet[..., 0]
    time = np.array([0.0, 1.0, 2.0])
    recording = Recording(time, feet, feet[:, 0], unused, unused[:, 0], normal)
    assert np.allclose(recording.displacement(0.0), [[0.0] * 4, [1.0] * 4, [2.0] * 4])
    assert np.allclose(recording.displacement(1.0)[-1], np.hypot(1.0, 2.0))


def test_actuators_are_braked_once_the_lift_has_had_its_time_to_settle():
    scenario = scenario_with()
    lift, control = lift_trajectory(scenario), control_trajectory(scenario)
    arrived = scenario.braked_at - scenario.lift.settle
    assert np.allclose(lift.value(arrived), lift.value(scenario.end))
    assert control.value(scenario.braked_at - 1e-6)[0, 0] == 1.0
    assert control.value(scenario.braked_at)[0, 0] == 0.0
    assert control.value(scenario.end)[0, 0] == 0.0


def test_braked_actuators_do_not_move_while_the_arm_swings(logged):
    log, scenario = logged.log, logged.scenario
    extension = log.signals["truth.extension"][log.time >= scenario.braked_at + 0.1]
    assert np.ptp(extension, axis=0).max() < 1e-9


def test_the_lift_ends_at_the_commanded_height_and_stays_there(logged):
    log, scenario = logged.log, logged.scenario
    rests = (log.time >= scenario.braked_at) & (log.time <= scenario.swing_at)
    height = 1e3 * log.signals["truth.posture"][rests, 2]
    assert np.allclose(height, 1e3 * scenario.height, rtol=0.0, atol=0.1)


def test_the_seed_decides_how_the_legs_move():
    coarse = ("plant.leg_model=reduced", "plant.time_step=0.01", "lift.duration=1")
    first, again, other = (
        lift_and_swing(scenario, bench(scenario)).extension
        for scenario in (scenario_with(*coarse, f"seed={seed}") for seed in (0, 0, 1))
    )
    assert np.array_equal(first, again)
    assert np.abs(first - other).max() > 1e-5


@pytest.mark.parametrize("height", [590, 599.5])
def test_a_height_out_of_reach_is_refused_by_its_key_and_by_the_leg(height):
    scenario = scenario_with(f"lift.height_mm={height}")
    with pytest.raises(ScenarioError, match=rf"^lift\.height_mm = {height} .*: leg \d") as refused:
        Slip("slip").check(scenario)
    assert refused.value.key == "lift.height_mm"


def test_lift_and_swing_go_from_rest_to_rest():
    scenario = scenario_with()
    lift, swing = lift_trajectory(scenario), swing_trajectory(scenario)
    assert np.allclose(lift.value(0.0), 0.41)
    for trajectory in (lift.MakeDerivative(), swing.MakeDerivative()):
        assert np.allclose(trajectory.value(scenario.end), 0.0)
    assert swing.value(scenario.swing_at).ravel().tolist() == pytest.approx([0.0, 0.0])
    assert swing.value(scenario.end).ravel().tolist() == pytest.approx([0.0, np.pi / 4])


def test_all_bounds_hold_and_the_platform_stays_level(logged):
    values = logged.values
    assert values["lift_tilt_deg"] < 0.01
    assert values["arm_slip_left_mm"] <= values["arm_slip_mm"]
    assert values["creep_mm_s"] < values["creep_2ms_mm_s"] < values["creep_4ms_mm_s"]


def test_the_slip_of_the_actuators_is_that_of_the_legs_kinematics(logged):
    log, scenario = logged.log, logged.scenario
    feet = log.signals["truth.support_points"]
    lifted = log.time <= scenario.braked_at
    moved = np.linalg.norm((feet[lifted] - feet[0])[..., :2], axis=-1)[-1]
    extension = log.signals["truth.extension"][lifted][-1]
    expected = [
        np.subtract(foot_to_centre(leg, extension[i]), foot_to_centre(leg, 0.41))[:2]
        for i, leg in enumerate(DRAWN.legs)
    ]
    assert np.allclose(moved, np.linalg.norm(expected, axis=1), atol=2e-4)


def test_a_platform_that_stops_below_the_height_breaks_the_bound_of_the_lift(logged):
    scenario, log = logged.scenario, logged.log
    feet, arm = (log.signals[f"truth.{name}"] for name in ("support_points", "arm_position"))
    posture, extension = (log.signals[f"truth.{name}"] for name in ("posture", "extension"))

    def broken(below):
        lower = posture - np.array([0.0, 0.0, below])
        recording = Recording(log.time, feet, lower, extension, arm, np.array([0.0, 0.0, 1.0]))
        metrics = (*slip_metrics(scenario, recording), *lift_metrics(scenario, recording))
        return [metric.key for metric in metrics if not metric.passed]

    assert broken(0.0) == []
    assert broken(2e-4) == ["lift_height_error_mm"]
