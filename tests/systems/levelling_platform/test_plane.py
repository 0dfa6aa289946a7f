import math

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from parapod.systems.core.triples import cross, dot, minus, plus, scaled
from parapod.systems.levelling_platform.plane import (
    attitude_derivatives,
    attitude_seeing,
    dot4,
    mismatch,
    normal_of,
    normal_through,
    seen_moving,
    to_platform,
    to_world,
    upwards,
    upwards_seeing,
)

ROUND = np.array([(0.7, -0.5), (0.8, 0.6), (-0.7, 0.5), (-0.6, -0.55)])


def rotation(roll, pitch):
    return RollPitchYaw(roll, pitch, 0.0).ToRotationMatrix().matrix()


def on_plane(xy, slope=(0.1, -0.2), height=0.4):
    return [(x, y, height + slope[0] * x + slope[1] * y) for x, y in xy.tolist()]


def attitudes(count=50, seed=0, limit=0.6):
    return np.random.default_rng(seed).uniform(-limit, limit, (count, 2)).tolist()


def test_vector_products_are_those_of_linear_algebra():
    a, b = np.random.default_rng(0).normal(size=(2, 3))
    assert dot(a.tolist(), b.tolist()) == pytest.approx(a @ b, rel=1e-15)
    np.testing.assert_allclose(cross(a.tolist(), b.tolist()), np.cross(a, b), atol=1e-15)
    np.testing.assert_array_equal(minus(a.tolist(), b.tolist()), a - b)
    np.testing.assert_array_equal(plus(a.tolist(), b.tolist()), a + b)
    np.testing.assert_array_equal(scaled(a.tolist(), 3.0), 3.0 * a)
    assert dot4((1.0, 2.0, 3.0, 4.0), (5.0, 6.0, 7.0, 8.0)) == 70.0


def test_normal_points_up_whatever_the_order_of_the_points():
    p, q, r = on_plane(ROUND)[:3]
    expected = np.array((-0.1, 0.2, 1.0)) / math.sqrt(1.05)
    for points in ((p, q, r), (q, p, r), (r, q, p), (q, r, p)):
        normal, length = normal_through(*points)
        np.testing.assert_allclose(np.array(normal) / length, expected, atol=1e-15)


def test_length_of_the_normal_is_twice_the_triangles_area():
    _, length = normal_through((0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 4.0, 0.0))
    assert abs(length) == 12.0


def test_weights_are_the_affine_dependency_of_the_points():
    rng = np.random.default_rng(1)
    for _ in range(20):
        points = rng.normal(size=(4, 3))
        weights = np.array(mismatch(points.tolist())[0])
        np.testing.assert_allclose(weights.sum(), 0.0, atol=1e-14)
        np.testing.assert_allclose(weights @ points[:, :2], 0.0, atol=1e-14)


def test_weights_of_a_square_are_equal_and_their_signs_those_of_the_diagonals():
    square = np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
    # Each is twice the area of the triangle of the other three corners: 2 * 2.
    np.testing.assert_allclose(mismatch(on_plane(square))[0], (4.0, -4.0, 4.0, -4.0))


def test_mismatch_is_the_weighted_height_of_a_point_lifted_off_the_plane_of_the_others():
    points = on_plane(ROUND)
    weights, excess = mismatch(points)
    assert excess == pytest.approx(0.0, abs=1e-15)
    for i in range(4):
        lifted = list(points)
        lifted[i] = (*points[i][:2], points[i][2] + 0.01)
        assert mismatch(lifted)[1] == pytest.approx(0.01 * weights[i], rel=1e-12)


def test_subtracting_the_mismatch_gives_the_plane_of_least_squares():
    rng = np.random.default_rng(2)
    for _ in range(20):
        points = rng.normal(size=(4, 3))
        weights, excess = mismatch(points.tolist())
        fitted = points[:, 2] - np.array(weights) * excess / dot4(weights, weights)
        columns = np.column_stack([points[:, :2], np.ones(4)])
        solution = np.linalg.lstsq(columns, points[:, 2], rcond=None)[0]
        np.testing.assert_allclose(fitted, columns @ solution, atol=1e-12)


def test_normal_of_a_plane_is_the_third_column_of_its_rotation():
    for roll, pitch in attitudes():
        np.testing.assert_allclose(normal_of(roll, pitch), rotation(roll, pitch)[:, 2], atol=1e-15)


def test_vectors_turn_into_the_platforms_frame_and_back_as_by_the_rotation_matrix():
    v = (0.3, -0.7, 1.1)
    for roll, pitch in attitudes():
        R = rotation(roll, pitch)
        np.testing.assert_allclose(to_platform(v, roll, pitch), R.T @ v, atol=1e-15)
        np.testing.assert_allclose(to_world(v, roll, pitch), R @ v, atol=1e-15)
        np.testing.assert_allclose(upwards(roll, pitch), R.T[:, 2], atol=1e-15)
        back = to_world(to_platform(v, roll, pitch), roll, pitch)
        np.testing.assert_allclose(back, v, atol=1e-15)


def test_attitude_is_recovered_from_how_the_ground_is_seen():
    for (roll, pitch), ground in zip(attitudes(seed=3), attitudes(seed=4), strict=True):
        n = normal_of(*ground)
        seen = attitude_seeing(to_platform(n, roll, pitch), n)
        np.testing.assert_allclose(seen, (roll, pitch), atol=1e-14)


def test_direction_that_no_attitude_can_see_gives_nan():
    # The y component of g cannot be turned away by pitch: n_2 = 1 needs g in the yz plane.
    roll, _ = attitude_seeing((0.8, 0.0, 0.6), (0.0, 1.0, 0.0))
    assert math.isnan(roll)


def test_attitude_derivatives_agree_with_differences():
    step = 1e-6
    for (roll, pitch), ground in zip(attitudes(seed=5), attitudes(seed=6), strict=True):
        n = normal_of(*ground)
        g = to_platform(n, roll, pitch)
        by_roll, by_pitch = attitude_derivatives(n, g, roll, pitch)
        for exact, (dr, dp) in ((by_roll, (step, 0.0)), (by_pitch, (0.0, step))):
            ahead = np.array(to_platform(n, roll + dr, pitch + dp))
            behind = np.array(to_platform(n, roll - dr, pitch - dp))
            np.testing.assert_allclose(exact, (ahead - behind) / (2.0 * step), atol=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_angles_that_are_not_finite_give_nan(bad):
    assert all(math.isnan(c) for c in to_platform((0.1, 0.2, 1.0), 0.0, bad)[::2])
    assert all(math.isnan(c) for c in normal_of(bad, 0.0))


def test_vertical_without_angles_is_that_of_the_angles():
    for (roll, pitch), ground in zip(attitudes(), attitudes(seed=1, limit=0.3), strict=True):
        n = normal_of(*ground)
        g = to_platform(n, roll, pitch)
        np.testing.assert_allclose(upwards_seeing(g, n), upwards(roll, pitch), atol=1e-15)


def test_vector_seen_by_a_turning_platform_moves_as_its_derivatives_say():
    for (roll, pitch), ground in zip(attitudes(), attitudes(seed=1, limit=0.3), strict=True):
        n = normal_of(*ground)
        g, g_rate = seen_moving(n, roll, pitch, 0.3, -0.2)
        np.testing.assert_allclose(g, to_platform(n, roll, pitch), atol=1e-16)
        by_roll, by_pitch = attitude_derivatives(n, g, roll, pitch)
        expected = 0.3 * np.array(by_roll) - 0.2 * np.array(by_pitch)
        np.testing.assert_allclose(g_rate, expected, atol=1e-16)
