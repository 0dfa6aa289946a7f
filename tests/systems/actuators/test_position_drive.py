import math

import numpy as np
import pytest
from pydrake.systems.primitives import StateInterpolatorWithDiscreteDerivative

from parapod.systems.actuators.position_drive import PositionDrive, PositionDriveParams

PERIOD = 0.01
LIMITED = PositionDriveParams(max_velocity=2.0, max_acceleration=30.0, lower=-0.5, upper=1.0)


@pytest.fixture
def follow(stand):
    """follow(params, command): values of a drive's ports every period, of commands in time."""

    class Drive(stand):
        def follow(self, commands, port="position"):
            values = []
            for command in commands:
                self.set(position_command=np.atleast_1d(command))
                values.append(self[port].copy())
                self.tick()
            return np.array(values)

    def begin(params, position=0.0):
        count = len(params) if isinstance(params, tuple) else 1
        drives = PositionDrive(params if count > 1 else (params,), PERIOD)
        drive = Drive(drives, position_command=[position] * count)
        drives.set_position(drive.context, [position] * count)
        return drive

    return begin


def rates(positions):
    """Velocities and accelerations between samples, from rest at zero on."""
    velocity = np.diff(positions, axis=0, prepend=0.0 * positions[:1]) / PERIOD
    return velocity, np.diff(velocity, axis=0, prepend=0.0 * velocity[:1]) / PERIOD


def swing(times, way=0.8, duration=1.0):
    s = np.clip(times / duration, 0.0, 1.0)
    return way * s * s * (3.0 - 2.0 * s)


def test_a_command_within_the_limits_is_followed_as_without_any(follow):
    commands = swing(PERIOD * np.arange(130))
    assert np.abs(rates(commands)[1]).max() == pytest.approx(4.8, rel=0.05)
    for params in (PositionDriveParams(), LIMITED):
        np.testing.assert_array_equal(follow(params).follow(commands)[:, 0], commands)


def test_state_is_that_of_an_interpolator_with_a_discrete_derivative(stand, follow):
    drive = follow(LIMITED)
    drake = stand(StateInterpolatorWithDiscreteDerivative(1, PERIOD))
    for command in swing(PERIOD * np.arange(120)):
        for each, port in ((drive, "position_command"), (drake, "position")):
            each.set(**{port: [command]}).tick()
        np.testing.assert_array_equal(drive["state"], drake["state"])


@pytest.mark.parametrize("goal", [1.0, -0.5, 0.013, 1e-4])
def test_a_command_that_jumps_is_reached_within_the_limits(follow, goal):
    positions = follow(LIMITED).follow([goal] * 200)[:, 0]
    velocity, acceleration = rates(positions)
    assert np.abs(velocity).max() <= LIMITED.max_velocity * (1.0 + 1e-6)
    most = LIMITED.max_acceleration * (1.0 + 1e-5)
    arrived = int(np.argmax(positions == goal))
    assert np.abs(acceleration[: arrived + 1]).max() <= most
    assert np.abs(acceleration).max() <= 3.0 * most
    assert (positions[arrived:] == goal).all()
    assert (np.diff(positions[: arrived + 1]) * goal > 0.0).all()


def test_a_far_goal_is_reached_as_fast_as_the_limits_let_it(follow):
    positions = follow(LIMITED).follow([1.0] * 80)[:, 0]
    least = 1.0 / LIMITED.max_velocity + LIMITED.max_velocity / LIMITED.max_acceleration
    arrived = PERIOD * int(np.argmax(positions == 1.0))
    assert least - 4.0 * PERIOD <= arrived <= least + 4.0 * PERIOD


def test_positions_end_at_the_stops(follow):
    for goal, end in ((3.0, LIMITED.upper), (-3.0, LIMITED.lower)):
        positions = follow(LIMITED).follow([goal] * 200)[:, 0]
        assert positions[-1] == end
        assert LIMITED.lower <= positions.min() <= positions.max() <= LIMITED.upper


def test_a_time_constant_is_that_of_the_lag(follow):
    params = PositionDriveParams(time_constant=0.1)
    positions = follow(params).follow([1.0] * 40)[:, 0]
    expected = 1.0 - np.exp(-PERIOD * np.arange(1, 41) / 0.1)
    np.testing.assert_allclose(positions, expected, rtol=0.0, atol=1e-12)


def test_encoders_show_the_last_sample_and_its_rate(follow):
    drive = follow(PositionDriveParams())
    drive.follow([0.1, 0.3])
    np.testing.assert_allclose(drive["position_measured"], 0.3, atol=1e-15)
    np.testing.assert_allclose(drive["velocity_measured"], 20.0, atol=1e-12)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_command_that_is_not_finite_brakes_its_own_drive(follow, bad):
    drive = follow((LIMITED, LIMITED))
    drive.follow([(0.1 * k * k * PERIOD, 0.0) for k in range(4)])
    positions = drive.follow([(bad, 0.02)] * 30)
    velocity, acceleration = rates(positions)
    assert np.abs(acceleration[2:, 0]).max() <= LIMITED.max_acceleration * (1.0 + 2e-6)
    assert velocity[-1, 0] == 0.0
    assert positions[-1, 1] == pytest.approx(0.02, abs=1e-12)
