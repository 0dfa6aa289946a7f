import math

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.actuators.velocity_servo import ServoGoal, VelocityServo, VelocityServoParams
from parapod.systems.levelling_platform.wheels import WHEEL_DRIVE as PARAMS

STOPPED = VelocityServoParams(
    0.0, time_constant=0.04, max_velocity=0.08, stop_min=0.5, stop_max=(0.6, 0.7)
)


def make_drive(channels=4, period=0.01, params=PARAMS, time_step=None):
    return VelocityServo(params, channels, period, time_step)


def put(drive, context, position, velocity):
    """Puts a drive's lag into a state."""
    lag = drive.GetSubsystemByName("lag").GetMyMutableContextFromRoot(context)
    lag.SetDiscreteState(np.concatenate((np.atleast_1d(position), np.atleast_1d(velocity))))


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
    drive = make_drive()
    _, context = start(drive, fix, 0.0)
    for value in read(drive, context).values():
        assert not value.any()


@pytest.mark.parametrize("command", [3.0, -3.0, 0.5, -20.0])
def test_velocity_reaches_the_command_without_overshoot(fix, command):
    drive = make_drive(channels=1)
    simulator, context = start(drive, fix, command)
    velocity = velocities_over(drive, simulator, context, np.arange(1, 300) * 0.01 + 0.005)
    along = np.sign(command) * velocity[:, 0]
    assert (np.diff(along) >= 0.0).all()
    assert along[-1] <= abs(command) * (1.0 + 1e-15)  # rounding
    assert along[-1] == pytest.approx(abs(command), rel=1e-6)


def test_small_step_is_a_first_order_lag(fix):
    drive = make_drive(channels=1, period=0.01)
    simulator, context = start(drive, fix, 0.5)
    for k in (1, 5, 20):
        simulator.AdvanceTo(0.01 * k - 0.005)
        expected = 0.5 * -math.expm1(-0.01 * k / PARAMS.time_constant)
        assert state_of(drive, context)[1][0] == pytest.approx(expected, rel=1e-12)


def test_acceleration_is_limited(fix):
    drive = make_drive(channels=2)
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
    drive = make_drive(channels=1)
    simulator, context = start(drive, fix, command)
    simulator.AdvanceTo(5.0)
    velocity = state_of(drive, context)[1][0]
    assert velocity == pytest.approx(math.copysign(PARAMS.max_velocity, command), rel=1e-6)
    assert abs(velocity) <= PARAMS.max_velocity


@pytest.mark.parametrize("command", [0.5, 3.0])
def test_angle_is_the_integral_of_the_velocity(fix, command):
    # Below the limit of the acceleration, and above it.
    drive = make_drive(channels=1)
    simulator, context = start(drive, fix, command)
    times = np.arange(200) * 0.01 + 0.005
    velocity = velocities_over(drive, simulator, context, times)[:, 0]
    before = np.concatenate(([0.0], velocity[:-1]))
    # The goal of each period, from the change of velocity that its lag made.
    tau, h = PARAMS.time_constant, 0.01
    goal = before + (velocity - before) / -math.expm1(-h / tau)
    exact = goal * h - tau * (velocity - before)
    assert state_of(drive, context)[0][0] == pytest.approx(exact.sum(), rel=1e-12)


def test_lag_is_exact_whatever_the_period(fix):
    states = []
    for period in (0.01, 0.005, 0.001):
        drive = make_drive(channels=1, period=period)
        simulator, context = start(drive, fix, 0.5)
        simulator.AdvanceTo(0.1 - 0.25 * period)
        states.append(np.concatenate(state_of(drive, context)))
    share = -math.expm1(-0.1 / PARAMS.time_constant)
    expected = (0.5 * (0.1 - PARAMS.time_constant * share), 0.5 * share)
    np.testing.assert_allclose(states, [expected] * 3, rtol=1e-12)


@pytest.mark.parametrize("time_step", [None, 0.001])
def test_drives_come_to_rest_at_the_ends_of_their_stroke(fix, time_step):
    drive = make_drive(2, params=STOPPED, time_step=time_step)
    simulator, context = start(drive, fix, 0.08)
    drive.set_position(context, (0.55, 0.55))
    positions = []
    for time in np.arange(1, 400) * 0.01:
        simulator.AdvanceTo(time)
        positions.append(state_of(drive, context)[0])
    assert (np.array(positions) <= np.array((0.6, 0.7)) + 1e-12).all()
    np.testing.assert_allclose(positions[-1], (0.6, 0.7), rtol=0.0, atol=1e-6)
    fix(drive, context, velocity_command=(-0.08, -0.08))
    simulator.AdvanceTo(8.0)
    np.testing.assert_allclose(state_of(drive, context)[0], 0.5, rtol=0.0, atol=1e-6)


def test_imperfect_drive_runs_off_its_command(fix):
    drive = make_drive(2)
    simulator, context = start(drive, fix, 1.0)
    drive.set_imperfection(context, (1.02, 0.985), (-0.001, 0.002))
    simulator.AdvanceTo(3.0)
    np.testing.assert_allclose(state_of(drive, context)[1], (1.019, 0.987), rtol=1e-9)


def test_next_state_is_the_state_one_period_on(fix):
    drive = make_drive()
    simulator, context = start(drive, fix, (1.0, -2.0, 0.3, 40.0))
    simulator.AdvanceTo(0.095)
    ahead = drive.GetOutputPort("next_state").Eval(context).copy()
    simulator.AdvanceTo(0.105)
    assert drive.GetOutputPort("state").Eval(context).tolist() == ahead.tolist()


def test_brake_stops_the_wheels_and_holds_them(fix):
    drive = make_drive()
    simulator, context = start(drive, fix, (5.0, -5.0, 1.0, 0.0))
    simulator.AdvanceTo(1.0)
    fix(drive, context, brake=(1.0,))
    simulator.AdvanceTo(4.0)
    angles, velocities = state_of(drive, context)
    np.testing.assert_allclose(velocities, 0.0, atol=1e-9)
    simulator.AdvanceTo(5.0)
    np.testing.assert_allclose(state_of(drive, context)[0], angles, atol=1e-9)


def test_wheels_turn_independently(fix):
    drive = make_drive()
    simulator, context = start(drive, fix, (1.0, -2.0, 0.0, 3.0))
    simulator.AdvanceTo(2.0)
    np.testing.assert_allclose(state_of(drive, context)[1], (1.0, -2.0, 0.0, 3.0), rtol=1e-6)


def test_measured_position_is_the_nearest_count(fix):
    drive = make_drive()
    simulator, context = start(drive, fix, (1.234, -0.777, 0.01, 5.0))
    for time in (0.1, 0.5, 1.1):
        simulator.AdvanceTo(time)
        measured = drive.GetOutputPort("position_measured").Eval(context)
        counts = measured / PARAMS.resolution
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
        error = measured - state_of(drive, context)[0]
        assert np.abs(error).max() <= 0.5 * PARAMS.resolution * (1.0 + 1e-9)


def test_measured_velocity_is_whole_counts_per_period(fix):
    drive = make_drive(channels=2, period=0.01)
    simulator, context = start(drive, fix, (1.234, -0.777))
    simulator.AdvanceTo(1.0)
    measured = drive.GetOutputPort("velocity_measured").Eval(context)
    counts = measured / (PARAMS.resolution / 0.01)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    np.testing.assert_allclose(measured, (1.234, -0.777), atol=0.5 * PARAMS.resolution / 0.01)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_command_that_is_not_finite_counts_as_zero(fix, bad):
    drive = make_drive(channels=2)
    simulator, context = start(drive, fix, (bad, 2.0))
    simulator.AdvanceTo(2.0)
    assert state_of(drive, context)[1][0] == 0.0
    assert state_of(drive, context)[1][1] == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1.0, 1e300])
def test_brake_that_is_neither_on_nor_off_brakes(fix, bad):
    drive = make_drive(channels=1)
    simulator, context = start(drive, fix, 2.0, brake=bad)
    simulator.AdvanceTo(1.0)
    assert state_of(drive, context)[1][0] == 0.0


def test_a_finer_step_of_the_lag_changes_nothing_but_when_commands_arrive(fix):
    # The held goal is one step of the lag late.
    states = []
    for time_step, late in ((None, 0.0), (0.001, 0.001), (0.002, 0.002)):
        drive = make_drive(channels=1, time_step=time_step)
        simulator, context = start(drive, fix, 0.5)
        simulator.AdvanceTo(0.2 + late - 1e-4)
        states.append(drive.GetOutputPort("state").Eval(context).tolist())
    np.testing.assert_allclose(states, [states[0]] * 3, rtol=1e-12)


def test_goals_are_computed_once_a_period_however_fine_the_lag(fix, monkeypatch):
    calls = []
    wanted = ServoGoal._wanted
    monkeypatch.setattr(ServoGoal, "_wanted", lambda *args: calls.append(0) or wanted(*args))
    drive = make_drive(channels=1, time_step=0.001)
    simulator, _ = start(drive, fix, 1.0)
    simulator.AdvanceTo(1.0)
    assert len(calls) == pytest.approx(100, abs=1)


def test_commands_are_taken_once_a_period(fix):
    drive = make_drive(channels=1, time_step=0.001)
    simulator, context = start(drive, fix, 0.0)
    simulator.AdvanceTo(0.0505)
    fix(drive, context, velocity_command=(1.0,))
    simulator.AdvanceTo(0.0605)
    assert state_of(drive, context)[1][0] == 0.0
    simulator.AdvanceTo(0.0615)
    assert state_of(drive, context)[1][0] > 0.0


def test_state_moves_all_outputs(moved, fix):
    drive = make_drive(channels=1)
    _, context = start(drive, fix, 1.0)
    names = moved(drive, context, lambda: put(drive, context, 1.0, 2.0))
    assert names == {
        "position_measured",
        "velocity_measured",
        "position",
        "state",
        "next_state",
    }


def test_imperfection_moves_the_state_ahead(moved, fix):
    drive = make_drive(channels=1)
    _, context = start(drive, fix, 0.1)

    def change():
        drive.set_imperfection(context, 0.9, 0.0)

    assert moved(drive, context, change) == {"next_state"}
