"""Feedforward of a base: the first modes of a rod on it are at rest after each move."""

import math

import numpy as np
import pytest

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.rod_motion import ClampMotion, RodMotion
from parapod.systems.arm.vibration import (
    LumpedRod,
    VibrationFeedforward,
    at_once,
    cancelling_taps,
)
from parapod.systems.levelling_platform.statics import PAPER_ARM

PERIOD = 0.01
ROD = LumpedRod(1.9, (14.0, 12.0), 0.01)


def lagging(z):
    """A base that goes to what it is asked for with a time constant of three samples."""
    return 0.25 / (z - 0.75)


def shown_by(system, stand, commands):
    """Displacements (k, 4) at the times of the commands (k, n)."""
    shown, displacements = stand(system), []
    for command in commands:
        displacements.append(shown.set(arm_command=command)["displacement"])
        shown.tick()
    return np.array(displacements)


def swing(turn=0.0, lean=0.7, begin=10, count=60, rest=120):
    """Commands (k, 2) of a swing whose acceleration jumps, a cubic."""
    s = np.clip((np.arange(begin + count + rest) - begin) / count, 0.0, 1.0)
    return np.outer(3.0 * s**2 - 2.0 * s**3, (turn, lean))


def lumped(omega, damping, motion):
    """Deflections and rates (k, 2) of a mode whose place moves in straight lines by samples."""
    x, states, damped = np.zeros(2), [], omega * math.sqrt(1.0 - damping**2)
    decay, turn = math.exp(-damping * omega * PERIOD), damped * PERIOD
    c, s = math.cos(turn), math.sin(turn)
    step = decay * np.array(
        [
            [c + damping * omega / damped * s, s / damped],
            [-(omega**2) / damped * s, c - damping * omega / damped * s],
        ]
    )
    # The place's velocity jumps at each sample.
    jumps = np.diff(motion, 2, prepend=[motion[0]] * 2) / PERIOD
    for jump in jumps:
        x = step @ (x - (0.0, jump))
        states.append(x)
    return np.array(states)


@pytest.mark.parametrize("response", [at_once, lagging])
@pytest.mark.parametrize("plane", [0, 1])
def test_a_lumped_mode_is_at_rest_once_the_base_is(stand, response, plane):
    """After a lean in the plane of x, or a turn while it leans in that of y."""
    system = VibrationFeedforward(ROD, PAPER_ARM, PERIOD, response=response)
    commands = swing() if plane == 0 else swing(turn=0.4, lean=0.0) + np.array((0.0, 0.5))
    asked = shown_by(system, stand, commands)[:, plane]
    moved = asked.copy()
    if response is lagging:
        moved[0] = 0.0
        for k in range(1, len(moved)):
            moved[k] = 0.75 * moved[k - 1] + 0.25 * asked[k - 1]
    places = [ROD.places(PAPER_ARM, command)[plane] for command in commands.tolist()]
    # Motion along the axis, whose direction turns with the rod.
    steps = np.diff([place for place, _ in places], axis=0)
    axes = np.array([axis for _, axis in places])
    by_arm = [0.0, 0.0]
    for k in range(2, len(places)):
        change = axes[k - 1] @ (steps[k - 1] - steps[k - 2])
        by_arm.append(2.0 * by_arm[-1] - by_arm[-2] + change)
    alone, both = (
        lumped(ROD.frequencies[plane], ROD.damping_ratio, np.array(motion))
        for motion in (by_arm, by_arm + moved)
    )
    ends = 70 + round(system.delay / PERIOD) + (60 if response is lagging else 0)
    assert np.abs(alone[ends:, 0]).max() > 5e-3
    np.testing.assert_allclose(both[ends + 1 :, 0], 0.0, atol=1e-6)
    assert system.residual(ROD.frequencies[plane], plane) < 1e-9


def test_rest_and_steady_motion_ask_for_nothing_and_a_swing_ends_with_its_delay(stand):
    system = VibrationFeedforward(ROD, PAPER_ARM, PERIOD)
    assert not shown_by(system, stand, np.tile((0.3, -0.2), (100, 1))).any()
    moved = shown_by(system, stand, swing())
    ends = 70 + round(system.delay / PERIOD)
    assert not moved[ends:].any()
    assert np.abs(moved[ends - 3]).max() > 0.0
    sliding = shown_by(system, stand, np.outer(np.arange(100), (0.01, 0.0)))
    np.testing.assert_allclose(sliding[60:], 0.0, atol=1e-12)


def test_displacements_of_small_moves_add_up(stand):
    moves = swing(lean=1e-4), swing(lean=1e-4, begin=30, count=40, rest=120)
    one, other, both = (
        shown_by(VibrationFeedforward(ROD, PAPER_ARM, PERIOD), stand, commands)
        for commands in (*moves, moves[0] + moves[1])
    )
    np.testing.assert_allclose(both, one + other, atol=1e-8)
    assert np.abs(one).max() > 1e-7


def test_rates_are_those_of_the_displacements(stand):
    moved = shown_by(VibrationFeedforward(ROD, PAPER_ARM, PERIOD), stand, swing())
    middle = (moved[2:, :2] - moved[:-2, :2]) / (2.0 * PERIOD)
    np.testing.assert_allclose(moved[1:-1, 2:], middle, atol=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_command_that_is_not_finite_leaves_the_last_one(stand, bad):
    commands = swing()
    held = np.vstack([commands[:40], np.tile(commands[39], (5, 1)), commands[45:]])
    broken = held.copy()
    broken[40:45, 0] = bad
    ignoring, holding = (
        shown_by(VibrationFeedforward(ROD, PAPER_ARM, PERIOD), stand, each)
        for each in (broken, held)
    )
    np.testing.assert_array_equal(ignoring, holding)


def test_the_lumped_rod_moves_as_the_first_mode_of_the_whole_one():
    """A translation of the clamp, and a rotation about it, bend both alike."""
    rod = FlexibleRod(damping_ratio=0.0, modes=1)
    known = LumpedRod.of(rod)
    motion = RodMotion(rod, 1e-3)
    for across, turning in ((1.0, 0.0), (0.0, 1.0)):
        state, gravity, angle, rate = motion.rest((0.0, 0.0, 9.81)), 9.81, 0.0, 0.0
        places, expected, x, v = [], [], 0.0, 0.0
        omega = known.frequencies[0]
        for k in range(1000):
            pulse = math.sin(math.pi * min(k, 200) / 200) * (1.0 if k < 400 else 0.0)
            spin = turning * pulse * 1e-2
            angle, rate = angle + 1e-3 * rate, rate + 1e-3 * spin
            force = across * 1e-2 * pulse - gravity * angle, 0.0, gravity
            state = motion.step(state, ClampMotion(force, (0.0, rate, 0.0), (0.0, spin, 0.0)))
            load = -across * 1e-2 * pulse - known.straight_distance * spin + gravity * angle
            v += 1e-3 * (load - omega**2 * x)
            x += 1e-3 * v
            places.append(state[0] / rod.translation[0])
            expected.append(x)
        np.testing.assert_allclose(places, expected, atol=0.02 * np.abs(expected).max())


def test_modes_that_no_taps_can_cancel_are_refused():
    with pytest.raises(ValueError, match=r"80 Hz needs more than 3 taps and a period below"):
        cancelling_taps(2.0 * math.pi * 80.0, 0.0, 0.01, 10)
    with pytest.raises(ValueError, match="not 3 taps"):
        cancelling_taps(14.0, 0.0, 0.01, 3)
