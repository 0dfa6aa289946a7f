"""The guard before the sliders: checked paths pass unchanged, all else stops short of a limit."""

import numpy as np
import pytest

from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.guard import SingularityGuard, SingularityGuardParams
from parapod.systems.terrain_simulator.kinematics import (
    LIMITS,
    inverse_kinematics,
    margins,
    slider_places,
)
from parapod.systems.terrain_simulator.path import Gait, PathLimits, PlatePath
from parapod.systems.terrain_simulator.terrain import Level, Slope, Stairs
from parapod.systems.terrain_simulator.walk import BenchWalk, check_walk

PEDAL, PERIOD = BenchGeometry.pedal(), 2e-3
LINE = LIMITS.index("line P T A_3")
START = (0.5, 0.28, 0.0)


def led(asked, start=START, duration=1.0, geometry=PEDAL, stop=lambda time: False):
    """States (k, 11) and commands (k, 3) where `asked` gives the pose by the time."""
    guard = SingularityGuard(geometry, period=PERIOD)
    context = guard.CreateDefaultContext()
    sliders = inverse_kinematics(geometry, start)
    guard.GetInputPort("position_measured").FixValue(context, sliders)
    states, commands = [], []
    for number in range(round(duration / PERIOD)):
        time = number * PERIOD
        if commands:  # the sliders are where they were led to
            guard.GetInputPort("position_measured").FixValue(context, commands[-1])
        guard.GetInputPort("emergency_stop").FixValue(context, [float(stop(time))])
        guard.GetInputPort("pose_asked").FixValue(context, asked(time + PERIOD))
        commands.append(guard.GetOutputPort("position_command").Eval(context))
        states.append(np.array(guard.next_state(context)))
        context.SetDiscreteState(0, states[-1])
    return np.array(states), np.array(commands)


def left(poses, geometry=PEDAL):
    """Least margins of poses, with the least sin mu taken off."""
    found = margins(geometry, poses)
    found[:, LINE] -= PathLimits().sin_mu
    return found.min(axis=1)


@pytest.mark.parametrize(
    "path",
    [
        PlatePath(Level(), Gait(1.5, ramp=0.28), 0.513, 0.30),
        PlatePath(Slope(np.radians(30.0)), Gait(0.8), 0.582, 0.24),
        PlatePath(Slope(np.radians(-30.0)), Gait(0.8), 0.458, 0.24),
        PlatePath(Stairs(0.17, 0.29, 0.19), Gait(0.435, 1.5), 0.561, 0.25),
    ],
    ids=["trot", "uphill", "downhill", "stairs"],
)
def test_a_path_that_keeps_the_limits_passes_unchanged(path):
    walk = BenchWalk(path, 30.0, 0.58, begin=0.02, shift=0.02, strides=1, run_up=0)
    check_walk(PEDAL, walk)
    start = walk.at(0.0).pose[0]
    states, commands = led(lambda t: walk.at(t).pose[0], start, walk.duration)
    asked = walk.at(PERIOD * np.arange(1, len(states) + 1)).pose[0]
    np.testing.assert_allclose(states[:, :3], asked, atol=1e-15, rtol=1e-15)
    np.testing.assert_allclose(commands, slider_places(PEDAL, asked), atol=1e-14)
    assert (states[1:, 9] == 1.0).all()


@pytest.mark.parametrize(
    ("target", "limit"),
    [
        ((0.5, 0.28, 1.2), "line P T A_3"),
        ((0.5, 0.5, 0.0), "gap of A_1 and A_2"),
        ((0.5, -0.2, 0.0), "height of P"),
        ((2.0, 0.28, 0.0), "front end of slider 3"),
        ((-1.0, 0.28, 0.0), "rear end of slider 1"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_whatever_is_asked_it_stops_just_short_of_the_limit(target, limit):
    states, commands = led(lambda t: np.array(target), duration=3.0)
    poses = states[:, :3]
    assert left(poses).min() > -1e-12
    near = margins(PEDAL, poses[-1])
    near[LINE] -= PathLimits().sin_mu
    assert LIMITS[int(np.argmin(near))] == limit
    assert near.min() < 1e-3
    rates = np.diff(commands, axis=0) / PERIOD
    # It is no motion that leads there: it is approached slowly.
    assert np.abs(rates).max() <= SingularityGuardParams().approach * 1.05
    # It slows down before it stops, and does not run against the limit.
    changes = np.abs(np.diff(rates, axis=0)) / PERIOD
    assert changes.max() < 2.5 * PathLimits().slider_acceleration


def test_the_plate_comes_back_from_a_limit_and_catches_up():
    target = np.array((0.5, 0.28, 1.2))
    states, _ = led(lambda t: target if t < 2.0 else np.array(START), duration=6.0)
    assert states[990, 9] < 1e-3
    np.testing.assert_allclose(states[-1, :3], START, atol=1e-4)
    assert states[-1, 9] == 1.0


def test_it_begins_where_the_sliders_are_measured():
    states, commands = led(lambda t: np.array((0.6, 0.3, 0.2)), duration=2.0)
    np.testing.assert_allclose(commands[0], inverse_kinematics(PEDAL, START), atol=1e-12)
    assert states[0, 9] == 0.0
    np.testing.assert_allclose(states[-1, :3], (0.6, 0.3, 0.2), atol=5e-3)


def test_it_stays_while_the_emergency_stop_is_pressed_and_brakes():
    guard = SingularityGuard(PEDAL, period=PERIOD)
    context = guard.CreateDefaultContext()
    sliders = inverse_kinematics(PEDAL, START)
    for name, value in (
        ("position_measured", sliders),
        ("emergency_stop", [1.0]),
        ("pose_asked", [0.6, 0.3, 0.1]),
    ):
        guard.GetInputPort(name).FixValue(context, value)
    assert guard.GetOutputPort("brake").Eval(context)[0] == 1.0
    command = guard.GetOutputPort("position_command").Eval(context)
    np.testing.assert_allclose(command, sliders, atol=1e-12)
    guard.GetInputPort("emergency_stop").FixValue(context, [0.0])
    guard.GetInputPort("position_measured").FixValue(context, [0.9, 0.2, 0.5])
    assert guard.GetOutputPort("brake").Eval(context)[0] == 1.0, "no pose belongs to these"


def test_it_holds_the_plate_where_what_is_asked_is_no_number():
    bad = np.full(3, np.nan)
    states, _ = led(lambda t: np.array(START) if t < 0.1 else bad, duration=0.2)
    np.testing.assert_allclose(states[-1, :3], START, atol=1e-12)


def test_after_a_stop_the_plate_approaches_its_walk_slowly():
    """It has gone on meanwhile: nobody beside the bench is to be surprised."""

    def moves(time):
        return np.array((0.5 + 0.08 * np.sin(2.0 * np.pi * time), 0.28, 0.0))

    states, commands = led(moves, duration=2.5, stop=lambda time: 0.6 < time < 0.75)
    speed = np.abs(np.diff(commands, axis=0)).max(axis=1) / PERIOD
    own = 0.08 * 2.0 * np.pi
    assert speed.max() <= (own + SingularityGuardParams().approach) * 1.01
    asked = np.array([moves(PERIOD * (k + 1)) for k in range(len(states))])
    np.testing.assert_allclose(states[-1, :3], asked[-1], atol=1e-3)
