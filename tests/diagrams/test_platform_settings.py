"""Settings of the levelling platform: each has its effect, with its sign and its unit."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.beginning import Beginning
from parapod.diagrams.levelling_platform.controller import posture_loop_params
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.machine import PLATFORM, make_job_sources
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.position_loops import pi_params
from parapod.diagrams.levelling_platform.scenario import (
    ControlScenario,
    LevellingScenario,
    PlatformFault,
)
from parapod.diagrams.wiring import outputs_of
from parapod.systems.core.physics import STANDARD_GRAVITY
from parapod.systems.core.scenario_file import load_scenario

SEEDS = range(64)


def beginnings(**sensors):
    scenario = LevellingScenario(machine=PlatformDesign(sensors=SensorScenario(**sensors)))
    return [Beginning.from_scenario(DRAWN, replace(scenario, seed=seed)) for seed in SEEDS]


# Drawn from the seed


def test_biases_have_the_scenarios_sizes_and_signs_of_their_own_on_every_axis():
    found = beginnings(gyro_bias_deg_s=0.5, accel_bias_mg=2.0)
    gyro, accel = (
        np.array([getattr(b, name) for b in found]) for name in ("gyro_bias", "accel_bias")
    )
    np.testing.assert_allclose(np.abs(gyro), math.radians(0.5))
    np.testing.assert_allclose(np.abs(accel), 2e-3 * STANDARD_GRAVITY)
    signs = np.sign(np.hstack([gyro, accel]))
    # Independent fair signs: no axis is one-sided, and no two axes go together.
    correlation = signs.T @ signs / len(SEEDS)
    assert np.abs(signs.mean(axis=0)).max() < 0.5
    assert np.abs(correlation - np.eye(6)).max() < 0.5


def test_gains_are_off_to_both_sides_and_by_no_more_than_the_scenario_says():
    error = np.array([b.gain_scale - 1.0 for b in beginnings()])
    largest = LevellingScenario().machine.actuators.gain_error
    assert -largest <= error.min() < -0.9 * largest
    assert 0.9 * largest < error.max() <= largest
    assert abs(error.mean()) < 0.1 * largest


# Controllers


def test_the_outer_loop_compares_with_the_reference_as_old_as_the_sensors_samples():
    late, prompt = (
        posture_loop_params(
            LevellingScenario(machine=PlatformDesign(sensors=SensorScenario(imu_delay_ms=delay)))
        )
        for delay in (40.0, 0.0)
    )
    assert late.lag - prompt.lag == pytest.approx(0.040)


def test_position_controllers_take_limit_pole_and_friction_of_the_scenario():
    control = ControlScenario(pole=7.0, voltage_limit=6.0, friction_feedforward=[0.3, 0.7])
    params = pi_params(LevellingScenario(control=control))
    assert (params.pole, params.voltage_limit) == (7.0, 6.0)
    assert params.friction_feedforward == (0.3, 0.7)  # extending, retracting


def test_commands_stay_within_the_voltage_limit_of_the_scenario(record):
    control = ControlScenario(voltage_limit=0.8)
    scenario = LevellingScenario(backend="kinematic", control=control)
    scenario.job.estimate_at = 0.5
    loop = ClosedLoop(PLATFORM, scenario, log=("legs.voltage",))
    voltage = record(loop, 2.0)["legs.voltage"]
    assert np.abs(voltage).max() == pytest.approx(0.8)


# The job


def test_the_arm_swings_to_the_angle_that_is_said_in_degrees():
    scenario = LevellingScenario()
    scenario.job.arm.angle_deg = 30.0
    _, swing = make_job_sources(scenario)
    simulator = Simulator(swing)
    port = outputs_of(swing)["arm.position_command"]
    begin = scenario.job.estimate_at + scenario.job.arm.start
    for time, angle in ((begin, 0.0), (begin + scenario.job.arm.duration, math.radians(30.0))):
        simulator.AdvanceTo(time)
        assert port.Eval(simulator.get_context()).tolist() == pytest.approx(
            [0.0, angle], abs=1e-12
        )


# Sensors


@pytest.mark.parametrize("period", [0.01, 0.02])
def test_the_quasi_static_plant_shows_its_motion_once_a_period(period):
    scenario = LevellingScenario(backend="kinematic", control=ControlScenario(period=period))
    loop = ClosedLoop(PLATFORM, scenario, log=())
    hold = loop.station.GetSubsystemByName("held_motion")
    assert hold.GetUniquePeriodicDiscreteUpdateAttribute().period_sec() == period


# Faults


def test_a_wrong_encoder_misleads_the_controller_by_as_much(record):
    """The controller leads what it sees to where it should be, and the leg 5 mm past it."""
    scenario = LevellingScenario(backend="kinematic")
    scenario.machine.actuators.gain_error = 0.0
    scenario.job.estimate_at = 0.5
    scenario.faults = [PlatformFault(at=4.0, target="legs.extension", index=1, kind="wrong")]
    names = ("truth.extension", "legs.extension", "extension_desired_state")
    found = record(ClosedLoop(PLATFORM, scenario, log=names), 8.0)
    seen, true = (found[name][-1, 1] for name in ("legs.extension", "truth.extension"))
    assert seen == pytest.approx(found["extension_desired_state"][-1, 1], abs=2e-4)
    assert seen - true == pytest.approx(5e-3, abs=2e-5)


def test_only_legs_that_damp_may_turn_the_platform_fast():
    flexible = "machine.arm=!FlexibleRod {}"
    usual, damping = (
        load_scenario(LevellingScenario, overrides=(flexible, f"control.arm_damping_by_legs={k}"))
        for k in ("none", "both")
    )
    assert usual.fault_detector == usual.machine.fault_detector
    # The arm's swing takes 14 deg/s.
    assert damping.fault_detector.turn_rate > 1.5 * math.radians(14.0)
    assert damping.fault_detector.tilt == usual.fault_detector.tilt
