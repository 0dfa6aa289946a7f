"""Feet that do not stand in one plane: kinematics, and the systems that know of it."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.core.triples import dot, minus
from parapod.systems.levelling_platform.geometry import LegDeviation, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    height_range,
    inverse_kinematics,
    unevenness,
)
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import (
    normal_of,
    normal_over,
    normal_through,
    raised,
    to_platform,
)
from parapod.systems.levelling_platform.statics import resting_posture

ROLLER = PlatformGeometry(foot_radius=0.025, extension_min=0.37, extension_max=0.45)
BUILT = replace(
    ROLLER,
    deviations=(
        LegDeviation(l_x=1e-3, l_7=-2e-3),
        LegDeviation(beta=0.01, l_4=1e-3),
        LegDeviation(l_6=-1e-3, alpha=0.005),
        LegDeviation(l_y=2e-3, l_3=5e-4),
    ),
)
GEOMETRIES = pytest.mark.parametrize("geometry", [ROLLER, BUILT], ids=["drawn", "built"])
GROUND = np.array((0.02, -0.03))
POSTURE = np.array((0.01, -0.02, 0.475))
RATE = np.array((0.02, 0.01, 0.005))
OFFSETS = np.array((0.004, -0.003, 0.002, -0.005))


def stances(count=200, seed=0, size=0.01):
    """Random postures, grounds and offsets."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-0.06, 0.06, (count, 2))
    attitude = ground + rng.uniform(-0.03, 0.03, (count, 2))
    posture = np.column_stack([attitude, rng.uniform(0.45, 0.49, count)])
    return posture, ground, rng.uniform(-size, size, (count, 4))


def feet_of(geometry, extension):
    """Vectors (4, 3) from the feet to the platform's centre."""
    legs = zip(geometry.legs, np.asarray(extension).tolist(), strict=True)
    return np.array([foot_to_centre(leg, d) for leg, d in legs])


def upwards(posture, ground):
    """The ground's normal in the platform's frame."""
    return np.array(to_platform(normal_of(*ground.tolist()), *posture[:2].tolist()))


def heights(geometry, extension, posture, ground):
    """Heights (4) of the feet above the ground's plane."""
    feet = feet_of(geometry, extension)
    return posture[2] - geometry.foot_radius - feet @ upwards(posture, ground)


# Planes


def test_normal_over_points_makes_their_heights_differ_by_the_offsets():
    rng = np.random.default_rng(1)
    for _ in range(50):
        points = [(0.7, -0.5, 0.4), (0.8, 0.6, 0.42), (-0.7, 0.5, 0.38)]
        points = [tuple((np.array(p) + rng.uniform(-0.1, 0.1, 3)).tolist()) for p in points]
        offsets = rng.uniform(-0.05, 0.05, 3).tolist()
        for order in itertools.permutations(range(3)):
            g = normal_over([points[i] for i in order], [offsets[i] for i in order])
            assert dot(g, g) == pytest.approx(1.0, abs=1e-14)
            assert g[2] > 0.9
            above = [dot(g, points[i]) + offsets[i] for i in range(3)]
            np.testing.assert_allclose(above, above[0], rtol=0, atol=1e-14)
        normal, length = normal_through(*points)
        for offset in (0.0, 0.03):
            found = normal_over(points, [offset] * 3)
            np.testing.assert_allclose(found, np.array(normal) / length, rtol=0, atol=1e-14)


@pytest.mark.parametrize("legs", [(0, 1, 2), (3, 1, 0), (2, 0, 3), (1, 3, 2)])
def test_raised_feet_are_as_far_down_as_they_stood_up(legs):
    points = [(0.7, -0.5, 0.4), (0.8, 0.6, 0.42), (-0.7, 0.5, 0.38), (-0.8, -0.6, 0.41)]
    offsets = [0.01, -0.02, 0.03, 0.005]
    g = normal_over([points[i] for i in legs], [offsets[i] for i in legs])
    found = raised(points, offsets, legs)
    for before, after, offset in zip(points, found, offsets, strict=True):
        assert dot(g, minus(after, before)) == pytest.approx(offset, abs=1e-15)
    on_plane = [dot(g, found[i]) for i in legs]
    np.testing.assert_allclose(on_plane, on_plane[0], rtol=0, atol=1e-14)


# Kinematics


@GEOMETRIES
@pytest.mark.parametrize("legs", [None, (0, 1, 2), (3, 1, 0), (2, 0, 3), (1, 3, 2)])
def test_forward_kinematics_undoes_inverse_kinematics_on_offsets(geometry, legs):
    posture, ground, offsets = stances()
    extension = inverse_kinematics(geometry, posture, ground, offsets)
    returned = forward_kinematics(geometry, extension, ground, legs, offsets)
    np.testing.assert_allclose(returned, posture, rtol=0, atol=1e-12)


@pytest.mark.parametrize("legs", [None, (0, 1, 2), (3, 1, 0)])
def test_offsets_of_zero_change_nothing_even_where_the_feet_are_not_in_one_plane(legs):
    extension = 0.405 + np.random.default_rng(2).uniform(-0.002, 0.002, (50, 4))
    flat = forward_kinematics(ROLLER, extension, GROUND, legs)
    zero = forward_kinematics(ROLLER, extension, GROUND, legs, np.zeros(4))
    np.testing.assert_allclose(zero, flat, rtol=0, atol=1e-13)


def test_one_offset_under_all_feet_lifts_the_platform_by_as_much():
    extension = inverse_kinematics(ROLLER, POSTURE, GROUND)
    lifted = forward_kinematics(ROLLER, extension, GROUND, foot_offsets=[0.013] * 4)
    np.testing.assert_allclose(lifted, POSTURE + np.array((0.0, 0.0, 0.013)), rtol=0, atol=1e-13)


@GEOMETRIES
def test_unevenness_is_what_the_plane_of_least_squares_leaves_of_the_offsets(geometry):
    for posture, ground, offsets in zip(*stances(50, seed=3), strict=True):
        extension = inverse_kinematics(geometry, posture, ground, offsets)
        found = unevenness(geometry, extension)
        feet = feet_of(geometry, extension)
        affine = np.column_stack([np.ones(4), feet[:, :2]])
        left = offsets - affine @ np.linalg.lstsq(affine, offsets, rcond=None)[0]
        # Offsets are taken along the normal of their plane, and the planes differ by a tilt.
        fitted = upwards(forward_kinematics(geometry, extension, ground), ground)
        left *= fitted[2] / upwards(posture, ground)[2]
        np.testing.assert_allclose(found, left, rtol=0, atol=1e-12)


@GEOMETRIES
def test_the_fitted_posture_stands_on_the_unevenness(geometry):
    extension = 0.41 + np.random.default_rng(6).uniform(-0.005, 0.005, (50, 4))
    posture = forward_kinematics(geometry, extension, GROUND)
    offsets = unevenness(geometry, extension)
    returned = inverse_kinematics(geometry, posture, GROUND, offsets)
    np.testing.assert_allclose(returned, extension, rtol=0, atol=1e-12)


def test_unevenness_is_nan_where_an_extension_cannot_be_built():
    extension = np.full((3, 4), 0.405)
    extension[1, 2] = math.nan
    found = unevenness(ROLLER, extension)
    assert np.isnan(found[1]).all()
    assert np.isfinite(found[[0, 2]]).all()


@GEOMETRIES
def test_ends_of_the_height_range_on_offsets_are_reachable_and_just_outside_is_not(geometry):
    posture, ground, offsets = stances(50, seed=7)
    low, high = height_range(geometry, posture[:, :2], ground, offsets).T
    assert (low < high).all()
    for end, outwards in ((low, -1.0), (high, 1.0)):
        at_end = np.column_stack([posture[:, :2], end])
        extension = inverse_kinematics(geometry, at_end, ground, offsets)
        margin = np.minimum(extension - 0.37, 0.45 - extension).min(axis=1)
        np.testing.assert_allclose(margin, 0.0, atol=1e-12)
        at_end[:, 2] += outwards * 1e-7
        beyond = inverse_kinematics(geometry, at_end, ground, offsets, on_unreachable="nan")
        assert np.isnan(beyond).all()


# At rest


@GEOMETRIES
def test_at_rest_on_four_feet_the_posture_is_that_of_any_legs(geometry):
    for posture, ground, offsets in zip(*stances(30, seed=8), strict=True):
        for under in (np.zeros(4), offsets):
            extension = inverse_kinematics(geometry, posture, ground, under)
            found = resting_posture(geometry, extension, ground, under)
            np.testing.assert_allclose(found, posture, rtol=0, atol=1e-9)


@GEOMETRIES
def test_at_rest_no_foot_is_below_the_ground_and_three_are_on_it(geometry):
    rng = np.random.default_rng(9)
    lifted = set()
    for _ in range(100):
        extension = 0.41 + rng.uniform(-0.002, 0.002, 4)
        ground, offsets = rng.uniform(-0.05, 0.05, 2), rng.uniform(-0.005, 0.005, 4)
        posture = resting_posture(geometry, extension, ground, offsets)
        gap = heights(geometry, extension, posture, ground) - offsets
        order = np.argsort(gap)
        np.testing.assert_allclose(gap[order[:3]], 0.0, rtol=0, atol=1e-12)
        assert gap[order[3]] > 0.0
        lifted.add(int(order[3]))
    assert lifted == {0, 1, 2, 3}


def test_at_rest_the_weight_falls_between_the_three_feet_that_carry_it():
    rng = np.random.default_rng(10)
    for _ in range(100):
        extension, ground = 0.41 + rng.uniform(-0.002, 0.002, 4), rng.uniform(-0.05, 0.05, 2)
        posture = resting_posture(ROLLER, extension, ground)
        carrying = np.argsort(heights(ROLLER, extension, posture, ground))[:3]
        feet = -feet_of(ROLLER, extension)[carrying]
        down = -np.array(to_platform((0.0, 0.0, 1.0), *posture[:2].tolist()))
        # Shares of the feet at whose mean the line of gravity through F meets their plane.
        system = np.vstack([np.column_stack([feet.T, -down]), [1.0, 1.0, 1.0, 0.0]])
        shares = np.linalg.solve(system, (0.0, 0.0, 0.0, 1.0))[:3]
        assert (shares >= 0.0).all()


@pytest.mark.parametrize("leg", range(4))
def test_at_rest_a_leg_that_cannot_be_built_gives_nan(leg):
    for bad in (math.nan, 0.3):
        extension = np.full(4, 0.405)
        extension[leg] = bad
        assert np.isnan(resting_posture(ROLLER, extension, GROUND)).all()
