import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.actuators.wheel_drive import WheelDrive, WheelDriveParams

PARAMS = WheelDriveParams()


def start(drive, fix, command, brake=0.0):
    simulator = Simulator(drive)
    context = simulator.get_mutable_context()
    n = drive.GetInputPort("velocity_command").size()
    fix(drive, context, velocity_command=np.broadcast_to(command, n), brake=(brake,))
    return simulator, context


def state_of(drive, context):
    angles, velocities = np.split(drive.GetOutputPort("state").Eval(context), 2)
    return angles.copy(), velocities.copy()


def velocities_over(drive, simulator, context, times):
    samples = []
    for time in times:
        simulator.AdvanceTo(time)
        samples.append(state_of(drive, context)[1])
    return np.array(samples)


def test_one_count_is_a_turn_over_gear_and_counts():
    # 500 lines, four edges, gear 26: 52 000 counts a turn.
    assert PARAMS.resolution == pytest.approx(2.0 * math.pi / 52_000.0, rel=1e-15)


def test_drive_starts_at_rest(fix, read):
    drive = WheelDrive()
    _, context = start(drive, fix, 5.0)
    for value in read(drive, context).values():
        assert not value.any()


@pytest.mark.parametrize("command", [3.0, -3.0, 0.5, -20.0])
def test_velocity_reaches_the_command_without_overshoot(fix, command):
    drive = WheelDrive(channels=1)
    simulator, context = start(drive, fix, command)
    velocity = velocities_over(drive, simulator, context, np.arange(1, 300) * 0.01 + 0.005)
    along = np.sign(command) * velocity[:, 0]
    assert (np.diff(along) >= 0.0).all()
    assert along[-1] <= abs(command)
    assert along[-1] == pytest.approx(abs(command), rel=1e-6)


def test_small_step_is_a_first_order_lag(fix):
    drive = WheelDrive(channels=1, period=0.01)
    simulator, context = start(drive, fix, 0.5)
    for k in (1, 5, 20):
        simulator.AdvanceTo(0.01 * k - 0.005)
        expected = 0.5 * -math.expm1(-0.01 * k / PARAMS.time_constant)
        assert state_of(drive, context)[1][0] == pytest.approx(expected, rel=1e-12)


def test_lag_does_not_depend_on_the_period(fix):
    velocities = []
    for period in (0.01, 0.005, 0.002):
        drive = WheelDrive(channels=1, period=period)
        simulator, context = start(drive, fix, 0.5)
        simulator.AdvanceTo(0.1 - 0.25 * period)
        velocities.append(state_of(drive, context)[1][0])
    np.testing.assert_allclose(velocities, velocities[0], rtol=1e-12)


def test_acceleration_is_limited(fix):
    drive = WheelDrive(channels=2)
    simulator, context = start(drive, fix, (25.0, -25.0))
    velocity = velocities_over(drive, simulator, context, np.arange(100) * 0.01 + 0.005)
    change = np.abs(np.diff(velocity, axis=0))
    limit = PARAMS.acceleration * 0.01
    assert change.max() <= limit * (1.0 + 1e-12)
    assert change[0] == pytest.approx(limit, rel=1e-12)


@pytest.mark.parametrize("command", [1e9, -1e9])
def test_velocity_is_limited_to_that_of_the_motor(fix, command):
    # 8000 rpm behind a gear of 26: 32.2 rad/s.
    assert PARAMS.max_velocity == pytest.approx(32.22, abs=5e-3)
    drive = WheelDrive(channels=1)
    simulator, context = start(drive, fix, command)
    simulator.AdvanceTo(5.0)
    velocity = state_of(drive, context)[1][0]
    assert velocity == pytest.approx(math.copysign(PARAMS.max_velocity, command), rel=1e-6)
    assert abs(velocity) <= PARAMS.max_velocity


def test_angle_is_the_integral_of_the_velocity(fix):
    drive = WheelDrive(channels=1)
    simulator, context = start(drive, fix, 3.0)
    times = np.arange(200) * 0.01 + 0.005
    velocity = velocities_over(drive, simulator, context, times)[:, 0]
    integral = 0.5 * 0.01 * (velocity[0] + np.sum(velocity[1:] + velocity[:-1]))
    assert state_of(drive, context)[0][0] == pytest.approx(integral, rel=1e-12)


def test_brake_stops_the_wheels_and_holds_them(fix):
    drive = WheelDrive()
    simulator, context = start(drive, fix, (5.0, -5.0, 1.0, 0.0))
    simulator.AdvanceTo(1.0)
    fix(drive, context, brake=(1.0,))
    simulator.AdvanceTo(4.0)
    angles, velocities = state_of(drive, context)
    np.testing.assert_allclose(velocities, 0.0, atol=1e-9)
    simulator.AdvanceTo(5.0)
    np.testing.assert_allclose(state_of(drive, context)[0], angles, atol=1e-9)


def test_wheels_turn_independently(fix):
    drive = WheelDrive()
    simulator, context = start(drive, fix, (1.0, -2.0, 0.0, 3.0))
    simulator.AdvanceTo(2.0)
    np.testing.assert_allclose(state_of(drive, context)[1], (1.0, -2.0, 0.0, 3.0), rtol=1e-6)


def test_measured_position_is_the_nearest_count(fix):
    drive = WheelDrive()
    simulator, context = start(drive, fix, (1.234, -0.777, 0.01, 5.0))
    for time in (0.1, 0.5, 1.1):
        simulator.AdvanceTo(time)
        measured = drive.GetOutputPort("position_measured").Eval(context)
        counts = measured / PARAMS.resolution
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
        error = measured - state_of(drive, context)[0]
        assert np.abs(error).max() <= 0.5 * PARAMS.resolution * (1.0 + 1e-9)


def test_measured_velocity_is_whole_counts_per_period(fix):
    drive = WheelDrive(channels=2, period=0.01)
    simulator, context = start(drive, fix, (1.234, -0.777))
    simulator.AdvanceTo(1.0)
    measured = drive.GetOutputPort("velocity_measured").Eval(context)
    counts = measured / (PARAMS.resolution / 0.01)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    np.testing.assert_allclose(measured, (1.234, -0.777), atol=0.5 * PARAMS.resolution / 0.01)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_command_that_is_not_finite_counts_as_zero(fix, bad):
    drive = WheelDrive(channels=2)
    simulator, context = start(drive, fix, (bad, 2.0))
    simulator.AdvanceTo(2.0)
    assert state_of(drive, context)[1][0] == 0.0
    assert state_of(drive, context)[1][1] == pytest.approx(2.0, rel=1e-6)


def test_brake_that_is_nan_does_not_brake(fix):
    drive = WheelDrive(channels=1)
    simulator, context = start(drive, fix, 2.0, brake=math.nan)
    simulator.AdvanceTo(1.0)
    assert state_of(drive, context)[1][0] > 1.9


@pytest.mark.parametrize(("name", "value"), [("velocity_command", (2.0,)), ("brake", (1.0,))])
def test_each_input_moves_the_next_state(fix, name, value):
    drive = WheelDrive(channels=1)
    states = []
    for change in ({}, {name: value}):
        simulator, context = start(drive, fix, 1.0)
        fix(drive, context, **change)
        simulator.AdvanceTo(0.1)
        states.append(drive.GetOutputPort("state").Eval(context).tolist())
    assert states[0] != states[1]


def test_state_moves_all_outputs(moved, fix):
    drive = WheelDrive(channels=1)
    _, context = start(drive, fix, 1.0)
    names = moved(drive, context, lambda: context.SetDiscreteState(0, (1.0, 2.0)))
    assert names == {"position_measured", "velocity_measured", "state"}


def test_no_output_depends_on_an_input_directly():
    assert not WheelDrive().HasAnyDirectFeedthrough()
