"""Rotations as axes, and products of batches."""

import math

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from scipy.spatial.transform import Rotation

from parapod.systems.core.vectors import (
    Axes,
    cross,
    inverse,
    times,
    turn_between,
    turned_angles,
)

RNG = np.random.default_rng(0)


def test_cross_products_broadcast_as_numpys():
    a, b = RNG.normal(size=(5, 1, 3)), RNG.normal(size=(4, 3))
    np.testing.assert_allclose(cross(a, b), np.cross(a, b), rtol=1e-14)


def test_inverses_are_inverses():
    matrices = RNG.normal(size=(20, 3, 3))
    products = inverse(matrices) @ matrices
    np.testing.assert_allclose(products, np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-12)


def test_a_singular_matrix_in_a_batch_leaves_the_others_alone():
    matrices = RNG.normal(size=(3, 3, 3))
    matrices[1] = 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        found = inverse(matrices)
    assert np.isfinite(found).all(axis=(1, 2)).tolist() == [True, False, True]


def test_matrices_times_vectors_broadcast():
    matrix, vectors = RNG.normal(size=(3, 3)), RNG.normal(size=(2, 5, 3))
    np.testing.assert_allclose(times(matrix, vectors), vectors @ matrix.T, rtol=1e-14)


ANGLES = [(0.0, 0.0, 0.0), (0.3, -0.4, 1.2), (-3.0, 1.5, 2.0), (0.1, 0.5 * math.pi, 0.0)]


@pytest.mark.parametrize("angles", ANGLES)
def test_axes_are_the_columns_of_the_rotation_matrix(angles):
    R = RollPitchYaw(angles).ToRotationMatrix()
    expected = R.matrix().T
    np.testing.assert_allclose(Axes.from_roll_pitch_yaw(*angles), expected, atol=1e-15)
    for scale in (1.0, -1.0, 3.0):
        quaternion = scale * R.ToQuaternion().wxyz()
        np.testing.assert_allclose(Axes.from_quaternion(quaternion), expected, atol=1e-14)


@pytest.mark.parametrize("angles", ANGLES[:3])
def test_angles_come_back(angles):
    axes = Axes.from_roll_pitch_yaw(*angles)
    np.testing.assert_allclose(axes.roll_pitch_yaw(), angles, atol=1e-12)


def test_rounding_beyond_the_vertical_gives_a_right_angle():
    axes = Axes((0.0, 0.0, -1.0 - 1e-15), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    assert axes.roll_pitch_yaw()[1] == pytest.approx(0.5 * math.pi)


def test_components_keep_the_length_and_are_undone_by_the_rotation():
    angles, vector = (0.3, -0.4, 1.2), np.array((1.0, 2.0, -3.0))
    seen = Axes.from_roll_pitch_yaw(*angles).components(vector)
    R = RollPitchYaw(angles).ToRotationMatrix()
    np.testing.assert_allclose(R.multiply(np.array(seen)), vector, atol=1e-14)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_angles_that_are_not_finite_give_nan(bad):
    assert np.isnan(Axes.from_roll_pitch_yaw(0.1, bad, 0.2).components((1.0, 2.0, 3.0))).all()


@pytest.mark.parametrize("size", [0.0, 1e-12, 9e-5, 1.1e-4, 1e-2, 0.7, 2.5])
def test_a_single_turn_is_that_of_scipy_s_rotations(size):
    random = np.random.default_rng(1)
    for _ in range(20):
        angles = random.uniform(-1.0, 1.0, 3) * (3.0, 1.2, 3.0)
        turn = random.normal(size=3)
        turn *= size / np.linalg.norm(turn)
        before = Rotation.from_euler("xyz", angles)
        after = turned_angles(angles.tolist(), turn.tolist())
        wanted = (Rotation.from_rotvec(turn) * before).as_matrix()
        np.testing.assert_allclose(
            Rotation.from_euler("xyz", after).as_matrix(), wanted, rtol=0, atol=1e-14
        )
        np.testing.assert_allclose(turn_between(angles.tolist(), after), turn, rtol=0, atol=1e-13)
