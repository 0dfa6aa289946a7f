"""Trajectories of feet."""

import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.walking_chair.checks import StrokeExceeded, check_speeds, check_strokes
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import up_branch
from parapod.systems.walking_chair.rates import leg_motion
from parapod.systems.walking_chair.trajectories import (
    FootCircle,
    FootTrajectory,
)

SWING = FootTrajectory()
S_0, H, T_M = 0.1027, 0.100, 5.0
TIMES = np.linspace(0.0, T_M, 2001)


def printed_position(t):
    """Eqs. (40) and (44), word for word."""
    y = S_0 * (t / T_M - math.sin(2.0 * math.pi * t / T_M) / (2.0 * math.pi))
    if t <= 0.25 * T_M:
        z = H / (4 + math.pi) * (4 * math.pi * t / T_M - math.sin(4 * math.pi * t / T_M))
    elif t <= 0.75 * T_M:
        z = 4 * H / (4 + math.pi) * (math.sin(2 * math.pi * t / T_M - math.pi / 2) + math.pi / 4)
    else:
        sine = math.sin(4 * math.pi * t / T_M - 3 * math.pi)
        z = 4 * math.pi * H / (4 + math.pi) * (1.0 - t / T_M - sine / (4 * math.pi))
    return 0.0, y, z


def test_positions_are_those_of_equations_40_and_44():
    expected = [printed_position(t) for t in TIMES]
    np.testing.assert_allclose(SWING.motion(TIMES).position, expected, rtol=0, atol=1e-15)


def test_foot_goes_from_rest_to_rest_by_one_step():
    start, end = (SWING.motion(t) for t in (0.0, T_M))
    np.testing.assert_allclose(start.position, 0.0, atol=1e-15)
    np.testing.assert_allclose(end.position, (0.0, S_0, 0.0), rtol=0, atol=1e-15)
    for motion in (start, end):
        np.testing.assert_allclose(motion.velocity, 0.0, atol=1e-15)
        np.testing.assert_allclose(motion.acceleration, 0.0, atol=1e-15)


def test_highest_point_is_halfway():
    z = SWING.motion(TIMES).position[:, 2]
    assert SWING.motion(0.5 * T_M).position[2] == pytest.approx(H, abs=1e-15)
    assert z.argmax() == 1000
    assert 1e3 * SWING.motion(0.25 * T_M).position[2] == pytest.approx(43.990, abs=5e-4)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75])
def test_sections_join_without_a_jump(share):
    before, after = (SWING.motion(share * T_M + e) for e in (-1e-10, 1e-10))
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)


def test_derivatives_of_a_step_agree_with_differences():
    dt = 1e-5
    inside = TIMES[1:-1] + 1e-4  # off the sections' ends, where the jerk jumps
    now, ahead, behind = (SWING.motion(inside + e) for e in (0.0, dt, -dt))
    numeric = (ahead.position - behind.position) / (2.0 * dt)
    np.testing.assert_allclose(now.velocity, numeric, rtol=0, atol=1e-9)
    numeric = (ahead.velocity - behind.velocity) / (2.0 * dt)
    np.testing.assert_allclose(now.acceleration, numeric, rtol=0, atol=1e-9)


def test_largest_velocities_and_accelerations():
    _, velocity, acceleration = (1e3 * values for values in SWING.motion(TIMES))
    assert np.abs(velocity[:, 2]).max() == pytest.approx(
        1e3 * 8.0 * math.pi * H / ((4.0 + math.pi) * T_M), abs=1e-4
    )
    assert np.abs(velocity[:, 2]).max() == pytest.approx(70.384, abs=5e-4)
    assert np.abs(velocity[:, 1]).max() == pytest.approx(41.08, abs=5e-3)
    assert np.linalg.norm(velocity, axis=1).max() == pytest.approx(73.59, abs=5e-3)
    assert np.abs(acceleration[:, 2]).max() == pytest.approx(88.447, abs=5e-4)
    assert np.abs(acceleration[:, 1]).max() == pytest.approx(25.811, abs=5e-4)


@pytest.mark.parametrize(("time", "y"), [(-1.0, 0.0), (6.0, S_0), (math.inf, S_0)])
def test_foot_rests_before_and_after_its_swing(time, y):
    motion = SWING.motion(time)
    np.testing.assert_allclose(motion.position, (0.0, y, 0.0), rtol=0, atol=1e-15)
    np.testing.assert_allclose(motion.velocity, 0.0, atol=1e-15)
    np.testing.assert_allclose(motion.acceleration, 0.0, atol=1e-15)


def test_a_step_back_is_the_step_run_backwards():
    back = replace(SWING, length=-S_0).motion(TIMES)
    forward = SWING.motion(T_M - TIMES)
    step = np.array((0.0, S_0, 0.0))
    np.testing.assert_allclose(back.position + step, forward.position, atol=1e-15)
    np.testing.assert_allclose(back.velocity, -forward.velocity, atol=1e-15)
    np.testing.assert_allclose(back.acceleration, forward.acceleration, atol=1e-15)


def test_times_may_have_any_shape():
    assert SWING.motion(np.zeros((2, 3))).velocity.shape == (2, 3, 3)


@pytest.mark.parametrize(
    ("name", "value"),
    [("height", 0.0), ("height", -0.1), ("duration", 0.0), ("duration", math.nan),
     ("length", math.inf)],
)  # fmt: skip
def test_a_swing_that_cannot_be_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        replace(SWING, **{name: value})


LEG, CIRCLE = LegGeometry(), FootCircle()
LAP = np.linspace(0.0, 5.0, 5001)[:-1]


def branches(circle, times):
    return leg_motion(LEG, circle.motion(times), "E1")


def check(circle):
    times = np.linspace(0.0, circle.duration, 5001)
    motion = branches(circle, times)
    check_strokes(LEG, motion.length[:, np.newaxis], times, legs=(1,))
    check_speeds(motion.velocity[:, np.newaxis], 0.080, times, legs=(1,))


def test_positions_are_those_of_equation_49():
    angle = 2.0 * math.pi / 5.0 * LAP - 0.5 * math.pi
    expected = 1e-3 * np.stack(
        (100.0 * np.cos(angle), 100.0 + 100.0 * np.sin(angle), np.full(LAP.shape, -675.4)), axis=-1
    )
    np.testing.assert_allclose(CIRCLE.motion(LAP).position, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("circle", [CIRCLE, FootCircle(laps=2, ramp=1.25)])
def test_derivatives_of_a_circle_agree_with_differences(circle):
    dt = 1e-5
    times = np.linspace(0.01, circle.duration - 0.01, 500)
    now, ahead, behind = (circle.motion(times + e) for e in (0.0, dt, -dt))
    numeric = (ahead.position - behind.position) / (2.0 * dt)
    np.testing.assert_allclose(now.velocity, numeric, rtol=0, atol=1e-9)
    numeric = (ahead.velocity - behind.velocity) / (2.0 * dt)
    np.testing.assert_allclose(now.acceleration, numeric, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("time", "lengths"),
    [
        (0.0, (601.400, 583.906, 583.906)),
        (1.25, (617.290, 641.600, 610.994)),
        (2.5, (632.792, 666.856, 666.856)),
        (3.75, (617.290, 610.994, 641.600)),
    ],
)
def test_table_of_lengths(time, lengths):
    np.testing.assert_allclose(1e3 * branches(CIRCLE, time).length, lengths, rtol=0, atol=1e-3)


def test_ranges_of_lengths_speeds_and_accelerations():
    length, velocity, acceleration = (1e3 * values for values in branches(CIRCLE, LAP))
    np.testing.assert_allclose(length.min(axis=0), (601.400, 581.081, 581.081), rtol=0, atol=1e-3)
    np.testing.assert_allclose(length.max(axis=0), (632.792, 669.523, 669.523), rtol=0, atol=1e-3)
    fastest = np.abs(velocity).max(axis=0)
    np.testing.assert_allclose(fastest, (19.724, 55.743, 55.743), rtol=0, atol=1e-3)
    np.testing.assert_allclose(
        np.abs(acceleration).max(axis=0), (25.4, 73.4, 73.4), rtol=0, atol=0.05
    )


def test_ups_branches_do_the_same_in_opposite_directions():
    later = branches(CIRCLE, 5.0 - LAP[1:]).length
    np.testing.assert_allclose(branches(CIRCLE, LAP[1:]).length[:, 2], later[:, 1], atol=1e-14)


def test_range_of_the_angles():
    _, alpha, beta = np.degrees(up_branch(LEG, CIRCLE.motion(LAP).position)).T
    assert (alpha.min(), alpha.max()) == pytest.approx((-9.14, 9.14), abs=5e-3)
    assert beta.min() == pytest.approx(0.0, abs=1e-6)
    assert beta.max() == pytest.approx(17.84, abs=5e-3)


def test_circle_starts_with_a_step_of_the_speed():
    velocity = 1e3 * branches(CIRCLE, 0.0).velocity
    np.testing.assert_allclose(velocity, (0.0, 20.032, -20.032), rtol=0, atol=1e-3)
    assert np.linalg.norm(CIRCLE.motion(0.0).velocity) == pytest.approx(0.1257, abs=5e-5)
    assert not CIRCLE.motion(-1e-9).velocity.any()
    assert not CIRCLE.motion(5.0).velocity.any()


def test_ramp_takes_the_step_away_and_keeps_the_path_and_the_speed():
    ramped = FootCircle(ramp=1.25)
    assert ramped.duration == 6.25
    for time in (0.0, 6.25 - 1e-9):
        np.testing.assert_allclose(ramped.motion(time).velocity, 0.0, atol=1e-8)
    times = np.linspace(0.0, 6.25, 6251)
    position, velocity, _ = ramped.motion(times)
    from_centre = position - (0.0, 0.100, -0.6754)
    np.testing.assert_allclose(np.linalg.norm(from_centre, axis=1), 0.100, rtol=1e-14)
    np.testing.assert_allclose(position[-1], position[0], rtol=0, atol=1e-15)
    speed = np.linalg.norm(velocity, axis=1)
    cruise = 0.2 * math.pi / 5.0
    np.testing.assert_allclose(speed[(times > 1.25) & (times < 5.0)], cruise, rtol=1e-12)
    assert speed.max() == pytest.approx(cruise, rel=1e-12)


def test_laps_follow_each_other_without_a_jump():
    three = FootCircle(laps=3)
    once, again = three.motion(LAP), three.motion(LAP + 10.0)
    for first, third in zip(once, again, strict=True):
        np.testing.assert_allclose(first, third, rtol=0, atol=1e-13)


def test_actuators_can_follow_the_circle():
    check(CIRCLE)
    check(FootCircle(laps=2, ramp=1.25))


def test_circle_at_the_retracted_height_is_out_of_the_stroke():
    with pytest.raises(StrokeExceeded, match=r"branch 13 ") as caught:
        check(FootCircle(z=-LEG.retracted_height))
    assert 1e3 * caught.value.length == pytest.approx(571.13, abs=5e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [("radius", 0.0), ("period", -1.0), ("period", math.nan), ("laps", 0), ("z", math.nan),
     ("centre_y", math.inf), ("ramp", -0.1), ("ramp", 5.1), ("ramp", math.nan)],
)  # fmt: skip
def test_a_circle_that_cannot_be_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        replace(CIRCLE, **{name: value})
