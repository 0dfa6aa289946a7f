import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.walking_chair.trajectories import FootTrajectory

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


def test_derivatives_agree_with_differences():
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
