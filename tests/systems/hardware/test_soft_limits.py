"""Velocities with which axes stay within their limits."""

import math

import pytest

from parapod.systems.hardware.soft_limits import SoftLimits

LIMITS = SoftLimits(lower=(0.5, 0.5), upper=(0.8, 0.9), lead=0.15, deceleration=2.0)


def allowed(velocity, position):
    return LIMITS.allowed((velocity, 0.0), (position, 0.6))[0]


def test_the_allowed_velocity_takes_lead_and_ramp_to_the_limit():
    # 10 mm: v 0.15 + v^2 / 4 = 0.01.
    v = allowed(1.0, 0.79)
    assert v == pytest.approx((-0.15 + math.sqrt(0.0225 + 0.01)) * 2.0, rel=1e-12)
    assert v * 0.15 + v**2 / 4.0 == pytest.approx(0.01, rel=1e-12)
    assert allowed(-1.0, 0.51) == pytest.approx(-v, rel=1e-12)


@pytest.mark.parametrize("velocity", [0.0, 0.01, -0.01])
def test_far_from_the_limits_velocities_are_as_wanted(velocity):
    assert allowed(velocity, 0.65) == velocity


@pytest.mark.parametrize("beyond", [0.0, 1e-9, 0.1, math.inf])
def test_at_a_limit_and_beyond_it_nothing_moves_outwards_and_the_way_back_is_free(beyond):
    assert allowed(0.08, 0.8 + beyond) == 0.0
    assert allowed(-0.08, 0.8 + beyond) == -0.08
    assert allowed(-0.08, 0.5 - beyond) == 0.0
    assert allowed(0.08, 0.5 - beyond) == 0.08


def test_each_axis_has_its_own_limits():
    first, second = LIMITS.allowed((0.08, 0.08), (0.8, 0.8))
    assert (first, second) == (0.0, 0.08)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_zero(bad):
    assert allowed(bad, 0.65) == 0.0


@pytest.mark.parametrize("velocity", [0.08, -0.08])
def test_an_axis_whose_position_is_not_known_is_not_moved(velocity):
    assert allowed(velocity, math.nan) == 0.0


@pytest.mark.parametrize("distance", [1e-12, 1e-7, 1e-4])
def test_close_to_a_limit_it_is_the_lead_that_counts(distance):
    assert allowed(1.0, 0.8 - distance) == pytest.approx(distance / 0.15, rel=5e-2)


@pytest.mark.parametrize("period", [0.01, 0.1])
def test_an_axis_that_is_looked_at_in_time_comes_to_the_limit_and_never_beyond(period):
    position, velocity, h = 0.7, 0.0, 1e-3
    since, target = math.inf, 0.0
    for _ in range(3000):
        if since >= period:
            since, target = 0.0, LIMITS.allowed((0.5, 0.0), (position, 0.6))[0]
        step = 2.0 * h
        velocity += min(max(target - velocity, -step), step)
        position += velocity * h
        since += h
        assert position <= 0.8
    assert position == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"lower": (0.5,)}, "1 lower limits and 2 upper ones"),
        ({"lower": (0.5, 0.9)}, "axis 2 must be finite and in order"),
        ({"lower": (math.nan, 0.5)}, "axis 1 must be finite and in order"),
        ({"upper": (math.inf, 0.9)}, "axis 1 must be finite and in order"),
        ({"lead": 0.0}, "lead must be above 0"),
        ({"deceleration": math.inf}, "deceleration must be above 0"),
    ],
)
def test_limits_that_make_no_sense_are_refused(changes, words):
    settings = {"lower": (0.5, 0.5), "upper": (0.8, 0.9), "lead": 0.1, "deceleration": 1.0}
    with pytest.raises(ValueError, match=words):
        SoftLimits(**settings | changes)
