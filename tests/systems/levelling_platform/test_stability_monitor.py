import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.diagrams.levelling_platform.model import DRAWN as GEOMETRY
from parapod.systems.levelling_platform import stability_monitor
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.stability_monitor import (
    StabilityMonitor,
    StabilityMonitorParams,
    usual_margin,
)
from parapod.systems.levelling_platform.statics import rod_arm
from parapod.systems.levelling_platform.zero_moment_point import (
    ArmMotion,
    ArmMove,
    Footing,
    move_margin,
    tipping_margin,
)

PERIOD = 0.01
PARAMS = StabilityMonitorParams(margin=usual_margin(GEOMETRY))
ATTITUDE, GROUND = (0.01, -0.015), (0.03, -0.02)
EXTENSION = inverse_kinematics(GEOMETRY, (*ATTITUDE, 0.475), GROUND)
FOOTING = Footing(EXTENSION, ATTITUDE, GROUND)
SIDEWAYS = (math.pi / 2, 1.2)
LIFTED = (1.0, 1.0, 0.0, 1.0)


@pytest.fixture
def watch(stand):
    """watch(params, **inputs): a monitor of an arm that is upright, but for these inputs."""

    class Monitor(stand):
        def commands(self, duration, step=PERIOD):
            """Commands (n, 2) every step of a time from now on."""
            begun = self.context.get_time()
            times = begun + step * np.arange(1, round(duration / step) + 1)
            return np.array([self.run(t)["arm_command"] for t in times.tolist()])

        @property
        def command(self):
            return self["arm_command"]

        @property
        def margin(self):
            return self["margin"].item()

        @property
        def margin_requested(self):
            return self["margin_requested"].item()

        @property
        def is_refused(self):
            return self["refused"].item() > 0.5

    def begin(params=PARAMS, **inputs):
        given = {
            "extension": EXTENSION,
            "attitude": ATTITUDE,
            "ground": GROUND,
            "standing": (1.0,) * 4,
            "arm_request": (0.0, 0.0),
            "enable": 1.0,
        }
        return Monitor(StabilityMonitor(GEOMETRY, params, PERIOD), **(given | inputs))

    return begin


def move_of(start, goal, params=PARAMS):
    return ArmMove.within(start, goal, params.rate, params.acceleration, params.profile)


def along(move, with_acceleration=True, footing=FOOTING):
    return move_margin(GEOMETRY, PARAMS.platform, footing, move, with_acceleration)


def at_rest(angle, footing=FOOTING):
    return float(tipping_margin(GEOMETRY, PARAMS.platform, footing, ArmMotion(angle)))


# Moves that are admitted


def test_it_begins_at_zero_and_stays_there_until_asked(watch):
    monitor = watch()
    # Nothing has been judged yet.
    assert monitor.is_refused
    assert monitor.margin_requested == -math.inf
    np.testing.assert_array_equal(monitor.command, np.zeros(2))
    np.testing.assert_array_equal(monitor.commands(0.2), np.zeros((20, 2)))
    assert not monitor.is_refused


@pytest.mark.parametrize(
    ("goal", "profile"),
    [((0.0, math.radians(45.0)), "cubic"), ((-3.0, -0.7), "quintic"), ((1e-7, 0.0), "cubic")],
)
def test_an_admitted_request_is_reached_exactly_when_its_move_ends(watch, goal, profile):
    params = replace(PARAMS, profile=profile)
    monitor = watch(params, arm_request=goal)
    ticks = math.ceil(move_of((0.0, 0.0), goal, params).duration / PERIOD)
    commands = monitor.commands((ticks + 10) * PERIOD)
    assert not monitor.is_refused
    assert (commands[: ticks - 1] != goal).any(axis=1).all()
    np.testing.assert_array_equal(commands[ticks:], np.tile(goal, (10, 1)))


def test_by_default_the_arm_swings_by_45_degrees_in_a_second():
    goal = (0.0, math.radians(45.0))
    assert move_of((0.0, 0.0), goal).duration == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("profile", ["cubic", "quintic"])
def test_the_command_keeps_to_its_rates_and_accelerations_and_is_smooth(watch, profile):
    limits = {"rate": (1.0, 0.8), "acceleration": (3.0, 5.0)}
    monitor = watch(replace(PARAMS, profile=profile, **limits))
    step = 2e-3
    commands = [np.zeros((1, 2)), monitor.commands(0.1, step)]
    for request, duration in (((0.5, 0.6), 0.4), ((-1.0, 0.2), 2.0), (SIDEWAYS, 7.0)):
        monitor.set(arm_request=request)
        commands.append(monitor.commands(duration, step))
    rate = np.diff(np.concatenate(commands), axis=0) / step
    acceleration = np.diff(rate, axis=0) / step
    assert (np.abs(rate) <= np.array(limits["rate"]) * (1.0 + 1e-9)).all()
    assert (np.abs(acceleration) <= np.array(limits["acceleration"]) * (1.0 + 1e-6)).all()
    assert np.abs(rate).max() > 0.5
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


def test_no_sample_jumps_whatever_is_asked_for(watch):
    random = np.random.default_rng(4)
    monitor = watch()
    commands = [np.zeros((1, 2))]
    for _ in range(60):
        request = random.uniform(-1.8, 1.8, 2)
        if random.uniform() < 0.1:
            request[random.integers(2)] = math.nan
        standing = LIFTED if random.uniform() < 0.1 else (1.0,) * 4
        enable = (float(random.uniform() < 0.8),)
        monitor.set(arm_request=request, standing=standing, enable=enable)
        commands.append(monitor.commands(random.uniform(0.05, 1.0)))
    steps = np.abs(np.diff(np.concatenate(commands), axis=0))
    assert (steps <= np.array(PARAMS.rate) * PERIOD * (1.0 + 1e-9)).all()
    assert steps.max() > 0.9 * PARAMS.rate[0] * PERIOD


def test_the_present_margin_is_that_of_the_commands_motion_and_the_requests_its_smallest(watch):
    monitor = watch(arm_request=SIDEWAYS)
    move = move_of((0.0, 0.0), SIDEWAYS)
    monitor.tick()
    assert monitor.margin_requested == min(along(move), along(move, False))
    for _ in range(20):
        monitor.run(monitor.context.get_time() + 7.3 * PERIOD)
        moving = move.at(monitor.context.get_time())
        expected = float(tipping_margin(GEOMETRY, PARAMS.platform, FOOTING, moving))
        assert monitor.margin == pytest.approx(expected, abs=1e-14)
        assert monitor.margin >= monitor.margin_requested - 5e-5
    monitor.wait(2.0)
    assert monitor.margin == pytest.approx(at_rest(SIDEWAYS), abs=1e-15)


# Moves that are refused


def assert_refused(monitor, request):
    before = monitor.command
    monitor.set(arm_request=request)
    commands = monitor.commands(1.0)
    assert monitor.is_refused
    np.testing.assert_array_equal(commands, np.tile(before, (len(commands), 1)))


SLOW = replace(PARAMS, rate=(0.5, 0.5), acceleration=(0.02, 0.02))


def test_a_request_that_ends_outside_the_margin_is_refused(watch):
    margin = 0.5 * (at_rest((0.0, 0.0)) + at_rest(SIDEWAYS))
    monitor = watch(replace(SLOW, margin=margin))
    assert_refused(monitor, SIDEWAYS)
    assert monitor.margin_requested == pytest.approx(at_rest(SIDEWAYS), abs=1e-3)
    assert monitor.margin_requested < margin < monitor.margin


def test_a_request_that_leaves_the_margin_only_on_its_way_is_refused(watch):
    ahead, behind, across = (0.0, 1.2), (math.pi, 1.2), (math.pi / 2, 1.2)
    level = {"extension": (0.405,) * 4, "attitude": (0.0, 0.0), "ground": (0.0, 0.0)}
    footing = Footing(*level.values())
    margin = 0.5 * (at_rest(behind, footing) + at_rest(across, footing))
    monitor = watch(replace(SLOW, margin=margin), arm_request=ahead, **level).wait(20.0)
    np.testing.assert_array_equal(monitor.command, ahead)
    assert_refused(monitor, behind)
    monitor.wait(10.0, arm_request=(0.2, 1.2))
    np.testing.assert_array_equal(monitor.command, (0.2, 1.2))


def test_a_request_that_leaves_the_margin_only_by_its_acceleration_is_refused(watch):
    moves = {
        params: ArmMove.within((0.0, 0.0), SIDEWAYS, params.rate, params.acceleration)
        for params in (PARAMS, SLOW)
    }
    margin = 0.5 * (along(moves[PARAMS]) + along(moves[PARAMS], False))
    assert along(moves[PARAMS]) < margin < along(moves[SLOW])
    assert_refused(watch(replace(PARAMS, margin=margin)), SIDEWAYS)
    slow = watch(replace(SLOW, margin=margin), arm_request=SIDEWAYS)
    slow.wait(moves[SLOW].duration + PERIOD)
    assert not slow.is_refused


def test_at_the_margin_it_is_admitted_and_beyond_it_refused(watch):
    monitor = watch(arm_request=SIDEWAYS).tick()
    for margin, is_refused in (
        (monitor.margin_requested, False),
        (math.nextafter(monitor.margin_requested, 1.0), True),
    ):
        other = watch(replace(PARAMS, margin=margin), arm_request=SIDEWAYS)
        other.tick()
        assert other.is_refused == is_refused


def test_on_three_feet_the_arm_may_not_move_and_on_two_there_is_no_margin(watch):
    monitor = watch(standing=LIFTED)
    assert_refused(monitor, SIDEWAYS)
    assert -math.inf < monitor.margin < PARAMS.margin
    monitor.set(standing=(1.0, 0.0, 1.0, 0.0))
    assert_refused(monitor, (0.0, 0.1))
    assert monitor.margin == monitor.margin_requested == -math.inf


def test_a_request_beyond_the_largest_angles_is_refused_and_the_next_one_obeyed(watch):
    monitor = watch()
    for request in ((2.0 * math.pi + 1e-6, 0.0), (0.0, -1.58), (0.0, 1e300)):
        assert_refused(monitor, request)
    largest = (2.0 * math.pi, 0.5 * math.pi)
    monitor.wait(12.0, arm_request=largest)
    assert not monitor.is_refused
    np.testing.assert_array_equal(monitor.command, largest)


def test_what_was_refused_stays_refused_until_it_is_asked_for_again(watch):
    monitor = watch(standing=LIFTED)
    assert_refused(monitor, SIDEWAYS)
    monitor.wait(1.0, standing=(1.0,) * 4)
    assert monitor.is_refused
    np.testing.assert_array_equal(monitor.command, np.zeros(2))
    for again in ({"enable": (0.0,)}, {"enable": (1.0,)}):
        monitor.tick(**again)
    monitor.wait(3.0)
    assert not monitor.is_refused
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


# Requests during a move


def test_a_request_during_a_move_waits_for_its_end_and_the_latest_counts(watch):
    first, second, third = (0.0, 0.8), (0.5, 0.3), (-0.4, 0.5)
    monitor = watch(arm_request=first).wait(0.3)
    for request in (second, third):
        monitor.set(arm_request=request)
        monitor.wait(0.1)
        assert not monitor.is_refused
        assert monitor.margin_requested == along(move_of(first, request))
    commands = monitor.commands(3.0, 1e-3)
    uninterrupted = move_of((0.0, 0.0), first)
    np.testing.assert_allclose(commands[99], uninterrupted.at(0.6).position, atol=1e-12)
    assert (commands == first).all(axis=1).any()
    np.testing.assert_array_equal(monitor.command, third)
    # On the straight way to the third; the second was never approached.
    assert commands[:, 0].max() == 0.0


@pytest.mark.parametrize("is_refused_at_once", [True, False])
def test_a_request_during_a_move_that_is_refused_at_once_or_in_the_end_changes_nothing(
    watch, is_refused_at_once
):
    first = (0.0, 0.8)
    monitor = watch(arm_request=first).wait(0.3)
    monitor.wait(0.1, arm_request=(0.0, 3.0) if is_refused_at_once else SIDEWAYS)
    assert monitor.is_refused == is_refused_at_once
    # One that waited is judged again before it begins.
    monitor.wait(2.0, standing=LIFTED)
    assert monitor.is_refused
    assert monitor.margin_requested < PARAMS.margin
    np.testing.assert_array_equal(monitor.command, first)


def test_a_foot_that_lifts_during_a_move_shows_in_the_margin_and_does_not_stop_it(watch):
    monitor = watch(arm_request=SIDEWAYS).wait(0.3)
    before = monitor.margin
    monitor.set(standing=LIFTED)
    assert monitor.margin < before - 0.4
    monitor.wait(2.5)
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


# Enable


@pytest.mark.parametrize("off", [0.5, math.nan])
def test_without_enable_nothing_begins_and_with_it_the_request_does(watch, off):
    monitor = watch(arm_request=SIDEWAYS, enable=off)
    np.testing.assert_array_equal(monitor.commands(0.5), np.zeros((50, 2)))
    monitor.wait(3.0, enable=1.0)
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


def test_a_move_under_way_goes_on_to_its_end_without_enable_and_the_next_waits(watch):
    first = (0.0, 0.8)
    monitor = watch(arm_request=first).wait(0.3)
    monitor.set(enable=0.0, arm_request=SIDEWAYS)
    commands = monitor.commands(3.0)
    undisturbed = watch(arm_request=first).wait(0.3)
    np.testing.assert_allclose(commands, undisturbed.commands(3.0), atol=1e-12)
    monitor.wait(3.0, enable=1.0)
    np.testing.assert_array_equal(monitor.command, SIDEWAYS)


# Bad input


@pytest.mark.parametrize("axis", [0, 1])
def test_a_request_that_is_not_finite_is_refused_until_it_turns_good(watch, axis):
    for bad in (math.nan, math.inf):
        monitor = watch().wait(0.1)
        assert_refused(monitor, np.where(np.arange(2) == axis, bad, SIDEWAYS))
        assert monitor.margin_requested == -math.inf
    monitor.wait(2.0, arm_request=(0.2, 0.1))
    np.testing.assert_array_equal(monitor.command, (0.2, 0.1))


@pytest.mark.parametrize("name", ["extension", "attitude", "ground", "standing"])
def test_a_sensor_that_is_not_finite_refuses_every_request(watch, name):
    value = np.array({"standing": np.ones(4)}.get(name, getattr(FOOTING, name)), dtype=float)
    value[1] = math.nan
    monitor = watch(**{name: value})
    assert_refused(monitor, (0.0, 0.1))
    assert monitor.margin == monitor.margin_requested == -math.inf


# Cost, dependencies, parameters


def test_the_way_is_looked_at_only_when_a_request_changes(watch, monkeypatch):
    calls = []

    def counted(*args):
        calls.append(args)
        return move_margin(*args)

    monkeypatch.setattr(stability_monitor, "move_margin", counted)
    monitor = watch(arm_request=SIDEWAYS).wait(4.0)
    assert len(calls) == 2  # with and without accelerations
    monitor.wait(1.0, attitude=(0.011, -0.014), extension=EXTENSION + 1e-4)
    assert len(calls) == 2
    monitor.wait(1.0, arm_request=(0.0, 2.0))
    assert len(calls) == 2  # beyond the largest angles
    monitor.wait(1.0, arm_request=(0.0, 0.5))
    assert len(calls) == 4


def test_limits_are_those_of_the_context(watch):
    monitor = watch()
    limits = monitor.context.get_mutable_numeric_parameter(0)
    lower, upper = zip(*PARAMS.reach, strict=True)
    expected = (PARAMS.margin, *PARAMS.rate, *PARAMS.acceleration, *lower, *upper)
    np.testing.assert_array_equal(limits.CopyToVector(), expected)
    limits.SetAtIndex(0, 0.6)
    assert_refused(monitor, (0.0, 0.1))
    limits.SetAtIndex(0, 0.05)
    limits.SetAtIndex(2, 0.1)
    monitor.wait(2.9, arm_request=(0.0, 0.2))
    assert monitor.command[1] < 0.2
    monitor.wait(0.15)
    assert monitor.command[1] == 0.2
    limits.SetAtIndex(8, 0.4)
    assert_refused(monitor, (0.0, 0.41))


def test_what_platform_and_arm_weigh_comes_from_the_params(watch):
    heavy = replace(PARAMS, platform=replace(PARAMS.platform, arm=rod_arm(mass=10.0)))
    margins = []
    for params in (PARAMS, heavy):
        monitor = watch(params, arm_request=SIDEWAYS)
        monitor.tick()
        margins.append(monitor.margin_requested)
    assert margins[1] < margins[0] - 0.1


def test_a_request_is_judged_without_enable_too_even_if_it_is_where_the_arm_is(watch):
    monitor = watch(enable=0.0).wait(0.1)
    assert not monitor.is_refused
    assert monitor.margin_requested == pytest.approx(at_rest((0.0, 0.0)), abs=1e-15)
