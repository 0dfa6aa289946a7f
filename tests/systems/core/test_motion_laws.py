import numpy as np
import pytest

from parapod.systems.core.motion_laws import MOTION_LAWS, blended, quintic, s_curve

LAWS = pytest.mark.parametrize("name", MOTION_LAWS)
SMOOTH = pytest.mark.parametrize("name", sorted(set(MOTION_LAWS) - {"linear"}))
X = np.linspace(0.0, 1.0, 2001)


@LAWS
def test_all_the_way_is_done_in_the_whole_duration(name):
    way, speed, _ = MOTION_LAWS[name](np.array((0.0, 0.5, 1.0)))
    np.testing.assert_allclose(way, (0.0, 0.5, 1.0), rtol=0, atol=1e-15)
    assert (MOTION_LAWS[name](X)[1] >= 0.0).all()
    assert speed[0] == speed[2]


@LAWS
def test_second_half_is_the_first_one_backwards(name):
    law = MOTION_LAWS[name]
    way, speed, acceleration = law(X)
    np.testing.assert_allclose(way, 1.0 - way[::-1], rtol=0, atol=1e-14)
    np.testing.assert_allclose(speed, speed[::-1], rtol=0, atol=1e-13)
    np.testing.assert_allclose(acceleration, -acceleration[::-1], rtol=0, atol=1e-12)


@LAWS
def test_derivatives_agree_with_differences(name):
    law, dx = MOTION_LAWS[name], 1e-5
    inside = X[10:-10]
    _, speed, acceleration = law(inside)
    ahead, behind = law(inside + dx), law(inside - dx)
    np.testing.assert_allclose(speed, (ahead[0] - behind[0]) / (2.0 * dx), rtol=0, atol=1e-8)
    numeric = (ahead[1] - behind[1]) / (2.0 * dx)
    np.testing.assert_allclose(acceleration, numeric, rtol=0, atol=1e-3)


@SMOOTH
def test_smooth_laws_begin_and_end_at_rest_without_a_jerk_at_the_ends(name):
    _, speed, acceleration = MOTION_LAWS[name](np.array((0.0, 1.0)))
    np.testing.assert_allclose(speed, 0.0, atol=1e-14)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-13)


def test_linear_law_has_one_speed():
    way, speed, acceleration = MOTION_LAWS["linear"](X)
    np.testing.assert_array_equal(way, X)
    np.testing.assert_array_equal(speed, 1.0)
    np.testing.assert_array_equal(acceleration, 0.0)


@pytest.mark.parametrize(
    ("name", "top"), [("linear", 1.0), ("ramped", 1.25), ("cycloid", 2.0), ("quintic", 1.875)]
)
def test_top_speeds(name, top):
    assert MOTION_LAWS[name](X)[1].max() == pytest.approx(top, abs=1e-12)


def test_longest_blend_has_no_constant_speed():
    speed = blended(X, 0.5)[1]
    assert speed.max() == pytest.approx(2.0, abs=1e-12)
    assert np.count_nonzero(speed > 2.0 - 1e-9) == 1


def test_quintic_is_the_polynomial():
    np.testing.assert_allclose(quintic(X)[0], 10 * X**3 - 15 * X**4 + 6 * X**5, atol=1e-15)


@pytest.mark.parametrize("ramp", [0.1, 0.3, 0.5])
def test_s_curve_has_its_top_speed_its_top_acceleration_and_no_jumps(ramp):
    way, speed, acceleration = s_curve(X, ramp)
    assert speed.max() == pytest.approx(1.0 / (1.0 - ramp), abs=1e-12)
    assert acceleration.max() == pytest.approx(1.5 / (ramp * (1.0 - ramp)), rel=1e-4)
    np.testing.assert_allclose(np.gradient(way, X)[1:-1], speed[1:-1], rtol=0, atol=3e-5)
    np.testing.assert_allclose(np.gradient(speed, X)[1:-1], acceleration[1:-1], rtol=0, atol=0.1)
    np.testing.assert_allclose(way, 1.0 - way[::-1], rtol=0, atol=1e-14)
    for values in (way[:1], 1.0 - way[-1:], speed[[0, -1]], acceleration[[0, -1]]):
        np.testing.assert_allclose(values, 0.0, atol=1e-13)
    assert np.abs(np.diff(acceleration)).max() < 6.0 / ramp**2 / (1.0 - ramp) * 5.1e-4
