import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.actuators.position_servo import PositionServo, make_position_loop
from parapod.systems.actuators.velocity_servo import VelocityServoParams

PERIOD = 0.01


def params(time_constant=0.002, **limits):
    usual = {"resolution": 0.0, "max_velocity": 10.0} | limits
    return VelocityServoParams(time_constant=time_constant, **usual)


class Drives:
    """Drives that are commanded every period, by position."""

    def __init__(self, params, position=(0.5, 0.6), **options):
        channels = len(position)
        self.servo = PositionServo(params, channels, PERIOD, position=position, **options)
        self.simulator = Simulator(self.servo)
        self.context = self.simulator.get_mutable_context()
        self.command(position)
        self.set("brake", (0.0,))
        self.simulator.Initialize()
        self.periods = 0

    def set(self, name, value):
        self.servo.GetInputPort(name).FixValue(self.context, np.asarray(value, dtype=float))

    def command(self, position):
        self.set("position_command", position)

    def wait(self, periods=1):
        self.periods += periods
        self.simulator.AdvanceTo(self.periods * PERIOD)
        return self

    def read(self, name="position"):
        return self.servo.GetOutputPort(name).Eval(self.context).copy()


def follow(drives, positions):
    """Commands positions, one a period; where the drives are when the next one comes."""
    found = []
    for position in positions:
        drives.command(position)
        drives.wait()
        found.append(drives.read())
    return np.array(found)


@pytest.mark.parametrize("time_constant", [1e-9, 1e-4, 1e-3, 2e-3])
def test_a_command_is_reached_after_exactly_one_period_whatever_the_lag(time_constant):
    drives = Drives(params(time_constant))
    t = PERIOD * np.arange(1, 60)
    wanted = np.stack((0.5 + 0.02 * np.sin(5.0 * t), 0.6 - 0.05 * t**2), axis=-1)
    assert np.abs(follow(drives, wanted) - wanted).max() < 1e-12


def test_what_is_measured_is_where_the_drives_are_in_whole_counts():
    drives = Drives(params(resolution=1e-3))
    found = follow(drives, [(0.5104, 0.5888)])[0]
    assert np.allclose(found, (0.5104, 0.5888), atol=1e-12)
    counts = drives.read("position_measured") / 1e-3
    assert np.allclose(counts, np.round(counts), atol=1e-9)
    assert np.abs(drives.read("position_measured") - found).max() <= 1e-3


def test_a_lag_in_small_steps_comes_a_little_later_and_then_is_there():
    drives = Drives(params(), time_step=1e-3)
    drives.command((0.52, 0.55))
    left = []
    for _ in range(8):
        drives.wait()
        left.append(np.abs(drives.read() - (0.52, 0.55)).max())
    assert left[0] < 0.2 * 0.05
    assert left[-1] < 1e-5


def test_a_longer_arrival_makes_up_for_what_is_missing_in_that_time():
    # Of what is missing each period makes up for about its share of the arrival.
    drives = Drives(params(1e-9), arrival=0.04)
    drives.command((0.51, 0.6))
    left = []
    for _ in range(10):
        drives.wait()
        left.append(0.51 - drives.read()[0])
    assert np.allclose(left, 0.01 * 0.75 ** np.arange(1, 11), rtol=1e-6)


def test_a_drive_that_moves_already_is_stopped_where_it_is_to_be():
    drives = Drives(params())
    follow(drives, [(0.505, 0.6), (0.51, 0.6)])
    for _ in range(5):
        drives.wait()
        assert np.allclose(drives.read(), (0.51, 0.6), atol=1e-12)
    assert np.allclose(drives.read("state")[2:], 0.0, atol=0.05)


def test_drives_are_no_faster_than_they_can():
    drives = Drives(params(max_velocity=0.2))
    found = follow(drives, [(0.6, 0.0)] * 30)
    speeds = np.diff(found, axis=0) / PERIOD
    assert np.abs(speeds).max() <= 0.2 + 1e-12
    assert speeds[5:20, 0] == pytest.approx(0.2)
    assert speeds[5:20, 1] == pytest.approx(-0.2)


def test_drives_stay_within_their_stroke():
    drives = Drives(params(stop_min=0.45, stop_max=0.65))
    found = follow(drives, [(0.9, 0.1)] * 20)
    assert found.max() <= 0.65 + 1e-12
    assert found.min() >= 0.45 - 1e-12
    assert np.allclose(found[-1], (0.65, 0.45), atol=1e-6)


def test_a_brake_stops_drives_and_holds_them_whatever_is_commanded():
    drives = Drives(params())
    follow(drives, [(0.505, 0.59), (0.51, 0.58)])
    drives.set("brake", (1.0,))
    drives.command((0.7, 0.4))
    drives.wait(3)
    held = drives.read()
    assert np.abs(held - (0.51, 0.58)).max() < 5e-3
    drives.wait(20)
    assert np.abs(drives.read() - held).max() < 1e-6
    drives.set("brake", (0.0,))
    drives.wait(3)
    assert np.allclose(drives.read(), (0.7, 0.4), atol=1e-9)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_command_that_is_no_number_is_not_followed_by_its_drive_alone(bad):
    drives = Drives(params())
    follow(drives, [(0.505, 0.6)])
    found = follow(drives, [(bad, 0.61)] * 10)
    assert np.allclose(found[:, 1], 0.61, atol=1e-9)
    assert np.abs(found[:, 0] - 0.505).max() < 2e-3
    assert found[-1, 0] == pytest.approx(found[-2, 0], abs=1e-6)


def test_drives_are_put_at_rest_elsewhere():
    drives = Drives(params())
    follow(drives, [(0.505, 0.6)])
    drives.servo.set_position(drives.context, (0.3, 0.4))
    assert np.allclose(drives.read("state"), (0.3, 0.4, 0.0, 0.0))


def test_what_comes_next_is_where_the_drives_are_a_step_later():
    drives = Drives(params(), time_step=1e-3)
    drives.command((0.52, 0.55))
    for k in range(1, 40):
        ahead = drives.read("next_state")
        drives.simulator.AdvanceTo(k * 1e-3)
        if k % 10 != 1:  # a new goal is taken at the controllers' instants
            assert np.allclose(drives.read("state"), ahead, atol=1e-12)


@pytest.mark.parametrize("time_constant", [0.0005, 0.002])
def test_the_loop_asks_for_the_velocity_that_arrives_in_its_time(stand, time_constant):
    # By integration: v' = (u - v) / tau over T from where the drive is, as fast as it is.
    T = 0.02
    machine = stand(make_position_loop(time_constant, 1, T), position_command=0.53)
    machine.set(state=(0.5, -0.3))
    (u,) = machine["velocity_command"]
    steps = 20000
    t = (np.arange(steps) + 0.5) * T / steps
    velocity = u + (-0.3 - u) * np.exp(-t / time_constant)
    assert 0.5 + velocity.mean() * T == pytest.approx(0.53, abs=1e-8)


def test_a_command_that_is_no_number_stays_with_its_drive(stand):
    machine = stand(make_position_loop(0.002, 3, PERIOD), position_command=(np.nan, 0.5, np.inf))
    machine.set(state=np.zeros(6))
    velocity = machine["velocity_command"]
    assert np.isfinite(velocity).tolist() == [False, True, False]
    assert velocity[1] > 0.0
