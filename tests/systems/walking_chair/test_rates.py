import math

import numpy as np
import pytest

from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import (
    CORNERS,
    foot_rotation,
    leg_corners,
    leg_inverse,
    ups_vectors,
)
from parapod.systems.walking_chair.rates import leg_jacobian, leg_jacobian_rate, leg_motion
from parapod.systems.walking_chair.trajectories import Motion

LEG = LegGeometry()
REFERENCES = pytest.mark.parametrize("reference", CORNERS)
STEP = 1e-5


def skew(v):
    return np.array(((0.0, -v[2], v[1]), (v[2], 0.0, -v[0]), (-v[1], v[0], 0.0)))


def jacobian_of_equations_24_to_27(up, reference, spin):
    """J_1i = J_1m (J'_1i)^-1, with the foot's spin about the UP branch or, as printed, without."""
    rotation, (length, alpha, _) = foot_rotation(up), up
    n = -rotation[:, 2]
    k = np.array((-math.sin(alpha), 0.0, -math.cos(alpha)))
    angular = skew(n) / length
    if spin:
        angular = (np.eye(3) - np.outer(n, k) / (n @ k)) @ angular
    b = (LEG.lower_joints[1:] - LEG.lower_joints[0]) @ rotation.T
    vectors = ups_vectors(LEG, up)
    directions = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    rows = directions + np.cross(b, directions) @ angular
    corner = rotation @ (LEG.corners[CORNERS.index(reference)] - LEG.lower_joints[0])
    to_corner = np.eye(3) - skew(corner) @ angular
    return np.vstack([n, rows]) @ np.linalg.inv(to_corner)


def random_points(reference, count=200, seed=0, angle=0.4):
    rng = np.random.default_rng(seed)
    up = rng.uniform((0.6, -angle, -angle), (0.88, angle, angle), (count, 3))
    return leg_corners(LEG, up)[:, CORNERS.index(reference)], up


def curve(point, velocity, acceleration, jerk):
    """A smooth motion of a point, and its value at a time."""

    def at(t):
        position = point + t * velocity + 0.5 * t**2 * acceleration + t**3 / 6.0 * jerk
        return Motion(
            position,
            velocity + t * acceleration + 0.5 * t**2 * jerk,
            acceleration + t * jerk,
        )

    return at


@REFERENCES
def test_jacobian_agrees_with_differences(reference):
    points, _ = random_points(reference)
    columns = [
        (leg_inverse(LEG, points + e, reference) - leg_inverse(LEG, points - e, reference))
        / (2.0 * STEP)
        for e in STEP * np.eye(3)
    ]
    numeric = np.stack(columns, axis=-1)
    np.testing.assert_allclose(leg_jacobian(LEG, points, reference), numeric, rtol=0, atol=1e-7)


@REFERENCES
def test_jacobian_is_that_of_the_paper_with_the_spin_added(reference):
    points, ups = random_points(reference, count=50, seed=1)
    expected = [jacobian_of_equations_24_to_27(up, reference, spin=True) for up in ups]
    np.testing.assert_allclose(leg_jacobian(LEG, points, reference), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("reference", "error"), [("E1", 1.2e-3), ("E2", 2.2e-2), ("E3", 2.2e-2)])
def test_jacobian_as_printed_is_wrong_where_the_leg_swings_both_ways(reference, error):
    points, ups = random_points(reference, count=1000, seed=2)
    printed = [jacobian_of_equations_24_to_27(up, reference, spin=False) for up in ups]
    found = np.abs(leg_jacobian(LEG, points, reference) - printed).max()
    assert 0.5 * error < found < 1.5 * error


@REFERENCES
def test_jacobian_as_printed_is_right_for_motions_without_side_swing_alone(reference):
    up = np.array((0.7, 0.0, 0.3))
    point = leg_corners(LEG, up)[CORNERS.index(reference)]
    printed = jacobian_of_equations_24_to_27(up, reference, spin=False)
    exact = leg_jacobian(LEG, point, reference)
    ahead_and_up = np.array((0.0, 1.0, 1.0))
    np.testing.assert_allclose(exact @ ahead_and_up, printed @ ahead_and_up, rtol=0, atol=1e-12)
    assert np.abs(exact - printed)[:, 0].max() > 1e-4


def test_jacobian_of_a_leg_that_hangs_straight():
    expected = [
        (0.0, 0.0, -1.0),
        (0.136787, 0.236922, -0.993212),
        (-0.136787, 0.236922, -0.993212),
    ]
    jacobian = leg_jacobian(LEG, (0.0, 0.0, -0.7801))
    np.testing.assert_allclose(jacobian, expected, rtol=0, atol=5e-7)


@pytest.mark.parametrize(("z", "number"), [(-0.6654, 7.73), (-0.7801, 9.10), (-0.850, 9.94)])
def test_condition_number_of_the_jacobian(z, number):
    assert np.linalg.cond(leg_jacobian(LEG, (0.0, 0.0, z))) == pytest.approx(number, abs=5e-3)


@REFERENCES
def test_rate_of_the_jacobian_agrees_with_differences(reference):
    points, _ = random_points(reference, seed=3)
    velocity = np.random.default_rng(4).uniform(-0.2, 0.2, points.shape)
    ahead, behind = (leg_jacobian(LEG, points + t * velocity, reference) for t in (1e-4, -1e-4))
    exact = leg_jacobian_rate(LEG, points, velocity, reference)
    np.testing.assert_allclose(exact, (ahead - behind) / 2e-4, rtol=0, atol=1e-6)
    assert np.abs(exact).max() > 0.1


@REFERENCES
def test_velocities_and_accelerations_of_a_curve_agree_with_differences(reference):
    points, _ = random_points(reference, seed=5)
    rng = np.random.default_rng(6)
    at = curve(points, *rng.uniform(-0.15, 0.15, (3, *points.shape)))
    dt = 1e-3
    now, ahead, behind = (leg_motion(LEG, at(t), reference) for t in (0.0, dt, -dt))
    np.testing.assert_allclose(now.length, leg_inverse(LEG, points, reference), rtol=0, atol=1e-15)
    numeric = (ahead.length - behind.length) / (2.0 * dt)
    np.testing.assert_allclose(now.velocity, numeric, rtol=0, atol=1e-6)
    numeric = (ahead.velocity - behind.velocity) / (2.0 * dt)
    np.testing.assert_allclose(now.acceleration, numeric, rtol=0, atol=1e-6)


@REFERENCES
def test_motion_is_what_equations_27_and_28_make_of_the_jacobian(reference):
    points, _ = random_points(reference, seed=7)
    velocity, acceleration = np.random.default_rng(8).uniform(-0.2, 0.2, (2, *points.shape))
    found = leg_motion(LEG, Motion(points, velocity, acceleration), reference)
    jacobian = leg_jacobian(LEG, points, reference)
    rate = leg_jacobian_rate(LEG, points, velocity, reference)
    np.testing.assert_allclose(found.velocity, (jacobian @ velocity[..., None])[..., 0])
    expected = rate @ velocity[..., None] + jacobian @ acceleration[..., None]
    np.testing.assert_allclose(found.acceleration, expected[..., 0], rtol=1e-10, atol=1e-14)


def test_lengths_rates_out_of_reach_are_nan_and_leave_the_others_alone():
    points = np.array(((0.0, 0.0, -0.7), (0.0, 0.0, 0.7), (0.05, 0.1, -0.7)))
    found = leg_motion(LEG, Motion(points, np.ones((3, 3)), np.ones((3, 3))), ["E1", "E2", "E3"])
    for values in found:
        assert np.isnan(values).all(axis=-1).tolist() == [False, True, False]
        assert np.isfinite(values[[0, 2]]).all()
    assert np.isnan(leg_jacobian(LEG, points)).all(axis=(1, 2)).tolist() == [False, True, False]


def test_one_velocity_serves_many_points():
    points, _ = random_points("E1", count=5)
    velocity = np.array((0.0, 0.1, 0.0))
    many = leg_motion(LEG, Motion(points, velocity, np.zeros(3)))
    assert many.acceleration.shape == (5, 3)
    one = leg_motion(LEG, Motion(points[3], velocity, np.zeros(3)))
    for values, value in zip(many, one, strict=True):
        np.testing.assert_allclose(values[3], value, rtol=1e-12)
