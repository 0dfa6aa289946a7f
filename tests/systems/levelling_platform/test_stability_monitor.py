import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.systems.levelling_platform import stability_monitor
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY as GEOMETRY
from parapod.systems.levelling_platform.stability_monitor import (
    StabilityMonitor,
    StabilityMonitorParams,
)
from parapod.systems.levelling_platform.zero_moment_point import (
    ArmMotion,
    ArmMove,
    Footing,
    move_margin,
    tipping_margin,
)

PERIOD = 0.01
PARAMS = StabilityMonitorParams()
ATTITUDE, GROUND = (0.01, -0.015), (0.03, -0.02)
EXTENSION = inverse_kinematics(GEOMETRY, (*ATTITUDE, 0.475), GROUND)
FOOTING = Footing(EXTENSION, ATTITUDE, GROUND)
SIDEWAYS = (math.pi / 2, 1.2)
LIFTED = (1.0, 1.0, 0.0, 1.0)


class Monitor:
    """A monitor whose inputs are fixed by the test."""

    def __init__(self, fix, params=PARAMS, **inputs):
        self.params = params
        self.system = StabilityMonitor(GEOMETRY, params, PERIOD)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self._fix = fix
        given = {
            "extension": EXTENSION,
            "attitude": ATTITUDE,
            "ground": GROUND,
            "standing": (1.0,) * 4,
            "arm_request": (0.0, 0.0),
            "enable": (1.0,),
        }
        self.set(**(given | inputs))

    def set(self, **inputs):
        self._fix(self.system, self.context, **inputs)

    def run(self, duration, step=PERIOD):
        """Commands (n, 2) every step of a time."""
        begun = self.context.get_time()
        commands = []
        for i in range(1, round(duration / step) + 1):
            self.simulator.AdvanceTo(begun + i * step)
            commands.append(self.command)
        return np.array(commands)

    def _output(self, name):
        return self.system.GetOutputPort(name).Eval(self.context).copy()

    @property
    def command(self):
        return self._output("arm_command")

    @property
    def margin(self):
        return self._output("margin").item()

    @property
    def margin_requested(self):
        return self._output("margin_requested").item()

    @property
    def is_refused(self):
        return self._output("refused").item() > 0.5

    def move(self, start, goal):
        return ArmMove.within(
            start, goal, self.params.rate, self.params.acceleration, self.params.profile
        )


def along(move, with_acceleration=True, footing=FOOTING):
    return move_margin(GEOMETRY, PARAMS.platform, footing, move, with_acceleration)


def at_rest(angle, footing=FOOTING):
    return float(tipping_margin(GEOMETRY, PARAMS.platform, footing, ArmMotion(angle)))


# Moves that are admitted


def test_it_begins_at_zero_and_stays_there_until_asked(fix):
    monitor = Monitor(fix)
    np.testing.assert_array_equal(monitor.command, np.zeros(2))
    np.testing.assert_array_equal(monitor.run(0.2), np.zeros((20, 2)))
    assert not monitor.is_refused


@pytest.mark.parametrize("goal", [(0.0, math.radians(45.0)), SIDEWAYS, (-3.0, -0.7), (1e-7, 0.0)])
@pytest.mark.parametrize("profile", ["cubic", "quintic"])
def test_an_admitted_request_is_reached_exactly_when_its_move_ends(fix, goal, profile):
    monitor = Monitor(fix, replace(PARAMS, profile=profile), arm_request=goal)
    ticks = math.ceil(monitor.move((0.0, 0.0), goal).duration / PERIOD)
    monitor.run(PERIOD)
    assert not monitor.is_refused
    for _ in range(ticks - 2):
        assert (monitor.command != goal).any()
        monitor.run(PERIOD)
    monitor.run(2.0 * PERIOD)
    np.testing.assert_array_equal(monitor.command, goal)
    np.testing.assert_array_equal(monitor.run(0.1), np.tile(goal, (10, 1)))


def test_by_default_the_arm_swings_by_45_degrees_in_a_second():
    goal = (0.0, math.radians(45.0))
    move = ArmMove.within((0.0, 0.0), goal, PARAMS.rate, PARAMS.acceleration, PARAMS.profile)
    assert move.duration == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("profile", ["cubic", "quintic"])
def test_the_command_keeps_to_its_rates_and_accelerations_and_is_smooth(fix, profile):
    limits = {"rate": (1.0, 0.8), "acceleration": (3.0, 5.0)}
    monitor = Monitor(fix, replace(PARAMS, profile=profile, **limits))
    step = 1e-3
    commands = [np.zeros((1, 2)), monitor.run(0.1, step)]
    for request, duration in (((0.5, 0.6), 0.4), ((-1.0, 0.2), 2.0), (SIDEWAYS, 9.0)):
        monitor.set(arm_request=request)
        commands.append(monitor.run(duration, step))
    rate = np.diff(np.concatenate(commands), axis=0) / step
    acceleration = np.diff(rate, axis=0) / step
    assert (np.abs(rate) <= np.array(limits["rate"]) * (1.0 + 1e-9)).all()
    assert (np.abs(acceleration) <= np.array(limits["acceleration"]) * (1.0 + 1e-6)).all()
    assert np.abs(rate).max() > 0.5
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


def test_no_sample_jumps_whatever_is_asked_for(fix):
    random = np.random.default_rng(4)
    monitor = Monitor(fix)
    commands = [np.zeros((1, 2))]
    for _ in range(60):
        request = random.uniform(-1.8, 1.8, 2)
        if random.uniform() < 0.1:
            request[random.integers(2)] = math.nan
        standing = LIFTED if random.uniform() < 0.1 else (1.0,) * 4
        enable = (float(random.uniform() < 0.8),)
        monitor.set(arm_request=request, standing=standing, enable=enable)
        commands.append(monitor.run(random.uniform(0.05, 1.0)))
    steps = np.abs(np.diff(np.concatenate(commands), axis=0))
    assert (steps <= np.array(PARAMS.rate) * PERIOD * (1.0 + 1e-9)).all()
    assert steps.max() > 0.9 * PARAMS.rate[0] * PERIOD


def test_the_present_margin_is_that_of_the_commands_motion(fix):
    monitor = Monitor(fix, arm_request=SIDEWAYS)
    move = monitor.move((0.0, 0.0), SIDEWAYS)
    monitor.run(PERIOD)
    for _ in range(20):
        monitor.run(7.3 * PERIOD, 7.3 * PERIOD)
        moving = move.at(monitor.context.get_time())
        expected = float(tipping_margin(GEOMETRY, PARAMS.platform, FOOTING, moving))
        assert monitor.margin == pytest.approx(expected, abs=1e-14)
        assert monitor.margin >= monitor.margin_requested - 5e-5
    monitor.run(2.0)
    assert monitor.margin == pytest.approx(at_rest(SIDEWAYS), abs=1e-15)


def test_the_margin_of_a_request_is_the_smallest_along_its_move(fix):
    monitor = Monitor(fix, arm_request=SIDEWAYS)
    monitor.run(PERIOD)
    move = monitor.move((0.0, 0.0), SIDEWAYS)
    assert monitor.margin_requested == min(along(move), along(move, False))


# Moves that are refused


def assert_refused(monitor, request):
    before = monitor.command
    monitor.set(arm_request=request)
    commands = monitor.run(1.0)
    assert monitor.is_refused
    np.testing.assert_array_equal(commands, np.tile(before, (len(commands), 1)))


SLOW = replace(PARAMS, rate=(0.5, 0.5), acceleration=(0.02, 0.02))


def test_a_request_that_ends_outside_the_margin_is_refused(fix):
    margin = 0.5 * (at_rest((0.0, 0.0)) + at_rest(SIDEWAYS))
    monitor = Monitor(fix, replace(SLOW, margin=margin))
    assert_refused(monitor, SIDEWAYS)
    assert monitor.margin_requested == pytest.approx(at_rest(SIDEWAYS), abs=1e-3)
    assert monitor.margin_requested < margin < monitor.margin


def test_a_request_that_leaves_the_margin_only_on_its_way_is_refused(fix):
    ahead, behind, across = (0.0, 1.2), (math.pi, 1.2), (math.pi / 2, 1.2)
    level = {"extension": (0.405,) * 4, "attitude": (0.0, 0.0), "ground": (0.0, 0.0)}
    footing = Footing(*level.values())
    margin = 0.5 * (at_rest(behind, footing) + at_rest(across, footing))
    monitor = Monitor(fix, replace(SLOW, margin=margin), arm_request=ahead, **level)
    monitor.run(20.0, 1.0)
    np.testing.assert_array_equal(monitor.command, ahead)
    assert_refused(monitor, behind)
    monitor.set(arm_request=(0.2, 1.2))
    monitor.run(10.0, 1.0)
    np.testing.assert_array_equal(monitor.command, (0.2, 1.2))


def test_a_request_that_leaves_the_margin_only_by_its_acceleration_is_refused(fix):
    moves = {
        params: ArmMove.within((0.0, 0.0), SIDEWAYS, params.rate, params.acceleration)
        for params in (PARAMS, SLOW)
    }
    margin = 0.5 * (along(moves[PARAMS]) + along(moves[PARAMS], False))
    assert along(moves[PARAMS]) < margin < along(moves[SLOW])
    assert_refused(Monitor(fix, replace(PARAMS, margin=margin)), SIDEWAYS)
    slow = Monitor(fix, replace(SLOW, margin=margin), arm_request=SIDEWAYS)
    slow.run(moves[SLOW].duration + PERIOD, 1.0)
    assert not slow.is_refused


def test_at_the_margin_it_is_admitted_and_beyond_it_refused(fix):
    monitor = Monitor(fix, arm_request=SIDEWAYS)
    monitor.run(PERIOD)
    for margin, is_refused in (
        (monitor.margin_requested, False),
        (math.nextafter(monitor.margin_requested, 1.0), True),
    ):
        other = Monitor(fix, replace(PARAMS, margin=margin), arm_request=SIDEWAYS)
        other.run(PERIOD)
        assert other.is_refused == is_refused


def test_on_three_feet_the_arm_may_not_move(fix):
    monitor = Monitor(fix, standing=LIFTED)
    assert_refused(monitor, SIDEWAYS)
    assert monitor.margin < PARAMS.margin


def test_on_two_feet_there_is_no_margin(fix):
    monitor = Monitor(fix, standing=(1.0, 0.0, 1.0, 0.0))
    assert_refused(monitor, (0.0, 0.1))
    assert monitor.margin == monitor.margin_requested == -math.inf


@pytest.mark.parametrize("request_", [(2.0 * math.pi + 1e-6, 0.0), (0.0, -1.58), (0.0, 1e300)])
def test_a_request_beyond_the_largest_angles_is_refused(fix, request_):
    assert_refused(Monitor(fix), request_)


def test_the_largest_angles_themselves_are_admitted(fix):
    monitor = Monitor(fix, arm_request=(2.0 * math.pi, 0.5 * math.pi))
    monitor.run(12.0, 1.0)
    np.testing.assert_array_equal(monitor.command, (2.0 * math.pi, 0.5 * math.pi))


def test_after_a_refusal_another_request_is_obeyed(fix):
    monitor = Monitor(fix)
    assert_refused(monitor, (0.0, 2.0))
    monitor.set(arm_request=(0.3, 0.2))
    monitor.run(2.0)
    assert not monitor.is_refused
    np.testing.assert_array_equal(monitor.command, (0.3, 0.2))


def test_what_was_refused_stays_refused_until_it_is_asked_for_again(fix):
    monitor = Monitor(fix, standing=LIFTED)
    assert_refused(monitor, SIDEWAYS)
    monitor.set(standing=(1.0,) * 4)
    monitor.run(1.0)
    assert monitor.is_refused
    np.testing.assert_array_equal(monitor.command, np.zeros(2))
    for again in ({"enable": (0.0,)}, {"enable": (1.0,)}):
        monitor.set(**again)
        monitor.run(PERIOD)
    monitor.run(3.0)
    assert not monitor.is_refused
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


# Requests during a move


def test_a_request_during_a_move_waits_for_its_end_and_the_latest_counts(fix):
    first, second, third = (0.0, 0.8), (0.5, 0.3), (-0.4, 0.5)
    monitor = Monitor(fix, arm_request=first)
    monitor.run(0.3)
    for request in (second, third):
        monitor.set(arm_request=request)
        monitor.run(0.1)
        assert not monitor.is_refused
        assert monitor.margin_requested == along(monitor.move(first, request))
    commands = monitor.run(3.0, 1e-3)
    uninterrupted = monitor.move((0.0, 0.0), first)
    np.testing.assert_allclose(commands[99], uninterrupted.at(0.6).angle, atol=1e-12)
    assert (commands == first).all(axis=1).any()
    np.testing.assert_array_equal(monitor.command, third)
    # On the straight way to the third; the second was never approached.
    assert commands[:, 0].max() == 0.0


def test_a_refused_request_during_a_move_changes_nothing(fix):
    first = (0.0, 0.8)
    monitor = Monitor(fix, arm_request=first)
    monitor.run(0.3)
    monitor.set(arm_request=(0.0, 3.0))
    monitor.run(2.0)
    assert monitor.is_refused
    np.testing.assert_array_equal(monitor.command, first)


def test_a_request_that_waited_is_judged_again_before_it_begins(fix):
    first = (0.0, 0.8)
    monitor = Monitor(fix, arm_request=first)
    monitor.run(0.3)
    monitor.set(arm_request=SIDEWAYS)
    monitor.run(0.1)
    assert not monitor.is_refused
    monitor.set(standing=LIFTED)
    monitor.run(2.0)
    assert monitor.is_refused
    assert monitor.margin_requested < PARAMS.margin
    np.testing.assert_array_equal(monitor.command, first)


def test_a_foot_that_lifts_during_a_move_shows_in_the_margin_and_does_not_stop_it(fix):
    monitor = Monitor(fix, arm_request=SIDEWAYS)
    monitor.run(0.3)
    before = monitor.margin
    monitor.set(standing=LIFTED)
    assert monitor.margin < before - 0.4
    monitor.run(2.5)
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


# Enable


@pytest.mark.parametrize("off", [0.0, 0.5, math.nan])
def test_without_enable_nothing_begins_and_with_it_the_request_does(fix, off):
    monitor = Monitor(fix, arm_request=SIDEWAYS, enable=(off,))
    np.testing.assert_array_equal(monitor.run(0.5), np.zeros((50, 2)))
    monitor.set(enable=(1.0,))
    monitor.run(3.0)
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


def test_a_move_under_way_goes_on_to_its_end_without_enable_and_the_next_waits(fix):
    first = (0.0, 0.8)
    monitor = Monitor(fix, arm_request=first)
    monitor.run(0.3)
    monitor.set(enable=(0.0,), arm_request=SIDEWAYS)
    commands = monitor.run(3.0)
    undisturbed = Monitor(fix, arm_request=first)
    undisturbed.run(0.3)
    np.testing.assert_allclose(commands, undisturbed.run(3.0), atol=1e-12)
    monitor.set(enable=(1.0,))
    monitor.run(3.0)
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


# Bad input


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_request_that_is_not_finite_is_refused(fix, bad, axis):
    request = np.array(SIDEWAYS)
    request[axis] = bad
    monitor = Monitor(fix)
    monitor.run(0.1)
    assert_refused(monitor, request)
    assert monitor.margin_requested == -math.inf


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["extension", "attitude", "ground", "standing"])
def test_a_sensor_that_is_not_finite_refuses_every_request(fix, name, bad):
    value = np.array({"standing": np.ones(4)}.get(name, getattr(FOOTING, name)), dtype=float)
    value[1] = bad
    monitor = Monitor(fix, **{name: value})
    assert_refused(monitor, (0.0, 0.1))
    assert monitor.margin == monitor.margin_requested == -math.inf


def test_a_request_that_turns_good_again_is_obeyed(fix):
    monitor = Monitor(fix, arm_request=(math.nan, 0.0))
    monitor.run(0.1)
    monitor.set(arm_request=(0.2, 0.1))
    monitor.run(2.0)
    np.testing.assert_array_equal(monitor.command, (0.2, 0.1))


# Cost, dependencies, parameters


def test_the_way_is_looked_at_only_when_a_request_changes(fix, monkeypatch):
    calls = []

    def counted(*args):
        calls.append(args)
        return move_margin(*args)

    monkeypatch.setattr(stability_monitor, "move_margin", counted)
    monitor = Monitor(fix, arm_request=SIDEWAYS)
    monitor.run(4.0)
    assert len(calls) == 2  # with and without accelerations
    monitor.set(attitude=(0.011, -0.014), extension=EXTENSION + 1e-4)
    monitor.run(1.0)
    assert len(calls) == 2
    monitor.set(arm_request=(0.0, 2.0))
    monitor.run(1.0)
    assert len(calls) == 2  # beyond the largest angles
    monitor.set(arm_request=(0.0, 0.5))
    monitor.run(1.0)
    assert len(calls) == 4


def test_limits_are_those_of_the_context(fix):
    monitor = Monitor(fix)
    limits = monitor.context.get_mutable_numeric_parameter(0)
    expected = (PARAMS.margin, *PARAMS.rate, *PARAMS.acceleration, *PARAMS.reach)
    np.testing.assert_array_equal(limits.CopyToVector(), expected)
    limits.SetAtIndex(0, 0.6)
    assert_refused(monitor, (0.0, 0.1))
    limits.SetAtIndex(0, 0.05)
    limits.SetAtIndex(2, 0.1)
    monitor.set(arm_request=(0.0, 0.2))
    monitor.run(2.9)
    assert monitor.command[1] < 0.2
    monitor.run(0.15)
    assert monitor.command[1] == 0.2
    limits.SetAtIndex(6, 0.4)
    assert_refused(monitor, (0.0, 0.41))


def test_what_platform_and_arm_weigh_comes_from_the_params(fix):
    heavy = replace(PARAMS, platform=replace(PARAMS.platform, arm_mass=10.0))
    margins = []
    for params in (PARAMS, heavy):
        monitor = Monitor(fix, params, arm_request=SIDEWAYS)
        monitor.run(PERIOD)
        margins.append(monitor.margin_requested)
    assert margins[1] < margins[0] - 0.1


def test_the_default_context_is_at_rest_at_zero():
    system = StabilityMonitor()
    context = system.CreateDefaultContext()
    np.testing.assert_array_equal(system.GetOutputPort("arm_command").Eval(context), np.zeros(2))
    # Nothing has been judged yet.
    assert system.GetOutputPort("refused").Eval(context).item() == 1.0
    assert system.GetOutputPort("margin_requested").Eval(context).item() == -math.inf


def test_a_request_is_judged_without_enable_too_even_if_it_is_where_the_arm_is(fix):
    monitor = Monitor(fix, enable=(0.0,))
    monitor.run(0.1)
    assert not monitor.is_refused
    assert monitor.margin_requested == pytest.approx(at_rest((0.0, 0.0)), abs=1e-15)
