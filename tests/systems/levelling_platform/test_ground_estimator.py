"""The ground at touchdown: its inclination, and heights of the feet above it."""

import math

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.ground_estimator import GroundEstimator
from parapod.systems.levelling_platform.kinematics import (
    estimate_ground,
    forward_kinematics,
    inverse_kinematics,
    unevenness,
)
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.statics import resting_posture

GEOMETRY = PlatformGeometry(foot_radius=0.025)
GROUND = np.array((0.03, -0.05))
POSTURE = np.array((0.01, -0.02, 0.475))
EXTENSION = inverse_kinematics(GEOMETRY, POSTURE, GROUND)
UNEVEN = EXTENSION + 1e-3 * np.array((1.0, -2.0, 0.5, 1.0))


@pytest.fixture
def estimation(stand):
    """estimation(**inputs): an estimator whose trigger is up, but for these inputs."""
    given = {"extension": UNEVEN, "attitude": POSTURE[:2], "trigger": 1.0}
    return lambda geometry=GEOMETRY, **inputs: stand(GroundEstimator(geometry), **(given | inputs))


def assert_estimated(estimator, extension, attitude):
    """The estimate is that of these legs and this attitude."""
    expected = estimate_ground(GEOMETRY, extension, attitude)
    np.testing.assert_allclose(estimator["ground"], expected, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(estimator["foot_offsets"], unevenness(GEOMETRY, extension))
    assert estimator["valid"] == 1.0


def test_the_estimate_is_the_ground_on_which_the_legs_stand(estimation):
    even = estimation(extension=EXTENSION).tick()
    np.testing.assert_allclose(even["ground"], GROUND, rtol=0, atol=1e-13)
    np.testing.assert_allclose(even["foot_offsets"], 0.0, rtol=0, atol=1e-13)
    slope = estimation(extension=[0.41] * 4, attitude=(0.02, 0.07)).tick()
    np.testing.assert_allclose(slope["ground"], (0.02, 0.07), atol=1e-15)
    uneven = estimation().tick()
    assert_estimated(uneven, UNEVEN, POSTURE[:2])
    ground, offsets = uneven["ground"], uneven["foot_offsets"]
    posture = forward_kinematics(GEOMETRY, UNEVEN, ground, foot_offsets=offsets)
    np.testing.assert_allclose(posture[:2], POSTURE[:2], rtol=0, atol=1e-13)
    returned = inverse_kinematics(GEOMETRY, posture, ground, offsets)
    np.testing.assert_allclose(returned, UNEVEN, rtol=0, atol=1e-13)


def test_the_estimate_is_held_until_the_trigger_rises_again(estimation):
    estimator = estimation().tick()
    for trigger in (1.0, 0.0):
        estimator.tick(2, extension=EXTENSION, attitude=(0.05, 0.05), trigger=trigger)
        assert_estimated(estimator, UNEVEN, POSTURE[:2])
    assert_estimated(estimator.tick(trigger=1.0), EXTENSION, (0.05, 0.05))


@pytest.mark.parametrize("trigger", [0.5, 0.0, math.nan])
def test_a_trigger_that_is_not_above_a_half_takes_no_estimate(estimation, trigger):
    assert estimation(trigger=trigger).tick(3)["valid"] == 0.0


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("extension", (math.nan, 0.4, 0.4, 0.4)),
        ("extension", (0.4, 0.4, 0.35, 0.4)),
        ("attitude", (math.nan, 0.0)),
        ("attitude", (0.0, math.inf)),
        ("attitude_error", 1.1e-3),
        ("attitude_error", math.nan),
    ],
)
def test_a_bad_sample_leaves_the_last_estimate_but_not_valid_until_a_good_one(
    estimation, name, bad
):
    first = estimation(**{name: bad}).tick(3)
    assert not any(first[output].any() for output in ("ground", "foot_offsets", "valid"))
    estimator = estimation().tick().tick(trigger=0.0)
    before = estimator["ground"]
    estimator.tick(2, trigger=1.0, **{name: bad})
    np.testing.assert_array_equal(estimator["ground"], before)
    assert estimator["valid"] == 0.0
    estimator.tick(extension=EXTENSION, attitude=(0.05, 0.05), attitude_error=0.9e-3)
    assert_estimated(estimator, EXTENSION, (0.05, 0.05))


def test_an_encoder_count_moves_the_estimate_by_less_than_a_hundredth_of_a_degree(estimation):
    counted = np.round(EXTENSION / 1e-5) * 1e-5
    rounded = estimation(extension=counted).tick()["ground"]
    assert 0.0 < np.abs(rounded - GROUND).max() < math.radians(0.01)


# Offsets are heights of the ground, upwards


def reach(extension, geometry):
    """Depths (4) of the feet below the platform's centre [m]."""
    legs = zip(geometry.legs, np.asarray(extension).tolist(), strict=True)
    return np.array([foot_to_centre(leg, d) for leg, d in legs])[:, 2]


def standing_on(heights, geometry):
    """Extensions whose feet reach these heights, under a platform that is level."""
    extension = np.full(4, 0.405)
    wanted = reach(extension, geometry) - heights
    for _ in range(8):
        slope = (reach(extension + 1e-6, geometry) - reach(extension - 1e-6, geometry)) / 2e-6
        extension -= (reach(extension, geometry) - wanted) / slope
    np.testing.assert_allclose(reach(extension, geometry), wanted, rtol=0, atol=1e-9)
    return extension


@pytest.mark.parametrize("lifted", range(4))
def test_a_foot_that_stands_higher_has_an_offset_above_zero(estimation, lifted):
    bump = 4e-3
    extension = standing_on(bump * (np.arange(4) == lifted), GEOMETRY)
    offsets = estimation(extension=extension, attitude=(0.0, 0.0)).tick()["foot_offsets"]
    # Of four corners of a rectangle the plane of least squares leaves a quarter, by diagonals;
    # the foot moves sideways too, by what the tolerance says.
    signs = np.where((np.arange(4) - lifted) % 2 == 0, 1.0, -1.0)
    np.testing.assert_allclose(offsets, 0.25 * bump * signs, atol=0.03 * bump)


@pytest.mark.parametrize("attitude", [(0.0, 0.0), (0.03, -0.05)])
def test_offsets_are_left_by_a_plane_through_the_heights_on_which_the_platform_stands(
    estimation, attitude
):
    """Legs that reach the heights (6, -2, -3, 1) mm, and a plane through these by `lstsq`."""
    heights = np.array((6e-3, -2e-3, -3e-3, 1e-3))
    extension = standing_on(heights, DRAWN)
    legs = zip(DRAWN.legs, extension.tolist(), strict=True)
    feet = np.array([foot_to_centre(leg, d) for leg, d in legs])
    columns = np.column_stack((feet[:, :2], np.ones(4)))
    plane, *_ = np.linalg.lstsq(columns, heights, rcond=None)
    left = heights - columns @ plane
    assert np.abs(left).min() > 8e-4
    estimator = estimation(DRAWN, extension=extension, attitude=attitude).tick()
    np.testing.assert_allclose(estimator["foot_offsets"], left, atol=2e-5)
    # Feet are at minus their vectors: where the ground rises along x, its normal leans back.
    R_WF, R_WG = (
        RollPitchYaw(*angles, 0.0).ToRotationMatrix().matrix()
        for angles in (attitude, estimator["ground"])
    )
    expected = np.array((plane[0], plane[1], 1.0))
    normal = R_WF.T @ R_WG[:, 2]
    np.testing.assert_allclose(normal, expected / np.linalg.norm(expected), atol=1e-4)


def test_on_that_ground_with_those_offsets_the_legs_stand_as_they_did(estimation):
    extension, attitude = [0.405, 0.411, 0.402, 0.4095], (0.02, -0.01)
    estimator = estimation(DRAWN, extension=extension, attitude=attitude).tick()
    ground, offsets = estimator["ground"], estimator["foot_offsets"]
    posture = resting_posture(DRAWN, extension, ground, offsets)
    assert np.abs(offsets).min() > 5e-4
    np.testing.assert_allclose(posture[:2], attitude, atol=1e-6)
