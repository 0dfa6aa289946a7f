import math

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.leg import (
    diagonal_angle,
    extension_on_moving_plane,
    extension_on_plane,
    extension_rate_on_plane,
    foot_to_centre,
    foot_to_centre_rate,
    long_side,
    swing_angle,
    swing_rate,
)
from parapod.systems.levelling_platform.plane import normal_of, to_platform

GEOMETRY = PlatformGeometry()
LEGS = GEOMETRY.legs
STROKE = np.linspace(0.370, 0.500, 27)
PARALLELOGRAM = STROKE.tolist()


def paper_eq_4(leg, d):
    z = leg.alpha + np.arccos((d**2 + leg.l_3**2 - leg.l_4**2) / (2.0 * d * leg.l_3))
    return (
        (leg.l_6 + leg.l_3) * math.cos(leg.alpha) - d * np.cos(z),
        leg.l_7 + (leg.l_6 + leg.l_3) * math.sin(leg.alpha) - d * np.sin(z),
    )


def difference(function, d, step=1e-6):
    return (np.array(function(d + step)) - np.array(function(d - step))) / (2.0 * step)


def ground_seen(seed):
    rng = np.random.default_rng(seed)
    ground, attitude = rng.uniform(-0.09, 0.09, (2, 2)).tolist()
    return to_platform(normal_of(*ground), *attitude)


def test_table_2_and_the_legs_yaw():
    l_c = (0.400, 0.170, 0.113)
    signs = [(1, -1), (1, 1), (-1, 1), (-1, -1)]
    yaws = np.radians((-49.0, 49.0, 131.0, 229.0))
    for leg, (sign_x, sign_y), yaw in zip(LEGS, signs, yaws, strict=True):
        assert (leg.l_x, leg.l_y, leg.l_z) == (sign_x * l_c[0], sign_y * l_c[1], l_c[2])
        assert leg.beta == pytest.approx(yaw, abs=1e-15)
        np.testing.assert_allclose(leg.e_b, (math.cos(yaw), math.sin(yaw)), atol=1e-15)


def test_sides_and_diagonal_make_a_triangle():
    leg = LEGS[0]
    x, z = long_side(leg, STROKE)
    np.testing.assert_allclose(np.hypot(x, z), leg.l_4, rtol=1e-14)
    k_x, k_z = x + leg.l_3 * leg.e_a[0], z + leg.l_3 * leg.e_a[1]
    np.testing.assert_allclose(np.hypot(k_x, k_z), STROKE, rtol=1e-14)


def test_swing_angle_is_the_direction_of_the_long_side_on_the_working_branch():
    leg = LEGS[0]
    psi = swing_angle(leg, STROKE)
    x, z = long_side(leg, STROKE)
    np.testing.assert_allclose((leg.l_4 * np.cos(psi), leg.l_4 * np.sin(psi)), (x, z), atol=1e-15)
    assert (psi > 0.5 * math.pi).all()
    assert (psi < 1.5 * math.pi).all()


def test_swing_rate_agrees_with_differences_and_is_negative():
    for d in PARALLELOGRAM:
        rate = swing_rate(LEGS[0], d)
        assert rate < 0.0
        assert rate == pytest.approx(difference(lambda d: swing_angle(LEGS[0], d), d), rel=1e-7)


def test_diagonal_angle_is_that_of_equations_2_and_29():
    leg = LEGS[2]
    cosine = (STROKE**2 + leg.l_3**2 - leg.l_4**2) / (2.0 * STROKE * leg.l_3)
    np.testing.assert_allclose(diagonal_angle(leg, STROKE), leg.alpha + np.arccos(cosine))


@pytest.mark.parametrize("leg", LEGS)
def test_foot_is_where_equations_4_and_8_put_it(leg):
    p_x, p_z = paper_eq_4(leg, STROKE)
    expected = (
        leg.l_x + p_x * math.cos(leg.beta),
        leg.l_y + p_x * math.sin(leg.beta),
        leg.l_z + p_z,
    )
    np.testing.assert_allclose(foot_to_centre(leg, STROKE), expected, atol=1e-14)


def test_roller_raises_the_foot_point_by_its_radius():
    rolling = PlatformGeometry(foot_radius=0.025).legs[3]
    points = np.array(foot_to_centre(LEGS[3], STROKE)) - np.array(foot_to_centre(rolling, STROKE))
    np.testing.assert_allclose(points, np.outer((0.0, 0.0, 0.025), np.ones(STROKE.size)))


@pytest.mark.parametrize("leg", LEGS)
def test_foots_rate_agrees_with_differences(leg):
    for d in PARALLELOGRAM:
        numeric = difference(lambda d: foot_to_centre(leg, d), d)
        np.testing.assert_allclose(foot_to_centre_rate(leg, d), numeric, atol=1e-6)


def test_rate_grows_without_bound_towards_the_dead_points():
    leg = LEGS[0]
    for dead, inwards in ((leg.l_4 - leg.l_3, 1.0), (leg.l_4 + leg.l_3, -1.0)):
        near, nearer = (abs(swing_rate(leg, dead + inwards * gap)) for gap in (1e-4, 1e-6))
        # The transmission ratio goes with the inverse root of the gap.
        assert nearer / near == pytest.approx(10.0, rel=0.02)


@pytest.mark.parametrize("d", [0.3599, 0.5201, 0.0, math.nan, math.inf])
def test_extension_with_which_the_triangle_cannot_close_gives_nan(d):
    assert all(math.isnan(c) for c in foot_to_centre(LEGS[0], d))
    assert math.isnan(swing_angle(LEGS[0], d))


@pytest.mark.parametrize("leg", LEGS)
def test_extension_on_a_plane_is_recovered(leg):
    for seed, d in enumerate(PARALLELOGRAM):
        g = ground_seen(seed)
        height = np.dot(g, foot_to_centre(leg, d))
        assert extension_on_plane(leg, g, height) == pytest.approx(d, abs=1e-14)


def test_plane_out_of_reach_gives_nan():
    for height in (0.0, 1.0, -1.0, math.nan, math.inf):
        assert math.isnan(extension_on_plane(LEGS[0], (0.0, 0.0, 1.0), height))


def test_rate_on_a_moving_plane_agrees_with_differences():
    step = 1e-6
    ground, attitude, rate = (0.03, -0.05), np.array((0.02, 0.04)), np.array((0.3, -0.2))
    height, height_rate = 0.47, 0.1
    n = normal_of(*ground)

    def extension(leg, t):
        g = to_platform(n, *(attitude + t * rate))
        return extension_on_plane(leg, g, height + t * height_rate)

    g = to_platform(n, *attitude)
    ahead, behind = (np.array(to_platform(n, *(attitude + t * rate))) for t in (step, -step))
    g_rate = tuple(((ahead - behind) / (2.0 * step)).tolist())
    for leg in LEGS:
        exact = extension_rate_on_plane(leg, extension(leg, 0.0), g, g_rate, height_rate)
        numeric = (extension(leg, step) - extension(leg, -step)) / (2.0 * step)
        assert exact == pytest.approx(numeric, rel=1e-7)


def test_extension_and_rate_in_one_go_are_those_of_their_own():
    g = to_platform(normal_of(0.03, -0.05), 0.02, 0.04)
    g_rate, height, height_rate = (0.2, -0.3, 0.05), 0.45, 0.1
    for leg in LEGS:
        d, v = extension_on_moving_plane(leg, g, g_rate, height, height_rate)
        assert d == pytest.approx(extension_on_plane(leg, g, height), rel=1e-15)
        expected = extension_rate_on_plane(leg, d, g, g_rate, height_rate)
        assert v == pytest.approx(expected, rel=1e-13)
    assert all(map(math.isnan, extension_on_moving_plane(LEGS[0], g, g_rate, 1.0, 0.0)))


def test_arrays_give_what_floats_give():
    for function in (swing_angle, diagonal_angle, swing_rate):
        one_by_one = [function(LEGS[0], d) for d in PARALLELOGRAM]
        np.testing.assert_allclose(function(LEGS[0], STROKE), one_by_one, rtol=1e-14)
