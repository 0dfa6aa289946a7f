import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import height_range, inverse_kinematics
from parapod.systems.levelling_platform.plane import normal_of
from parapod.systems.levelling_platform.ranges import (
    foot_stiffness_matrix,
    ground_of,
    highest_step,
    level_range,
    tilt_range,
)

PAPER = PlatformGeometry(foot_radius=0.025)
_REAR, _FRONT = PAPER.legs[:2], (replace(leg, l_7=0.212, l_x=-0.43) for leg in PAPER.legs[2:])
UNEQUAL = replace(PAPER, own_legs=(*_REAR, *_FRONT))
GEOMETRIES = pytest.mark.parametrize("geometry", [PAPER, UNEQUAL], ids=["paper", "unequal"])
LEVEL = (0.0, 0.0)
AZIMUTHS = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)


def test_ground_leans_by_its_angle_in_its_direction():
    roll, pitch = ground_of(0.1, AZIMUTHS).T
    x, y, z = normal_of(roll, pitch)
    np.testing.assert_allclose(np.arccos(z), 0.1, rtol=1e-9)
    turn = np.arctan2(y, x) - AZIMUTHS
    np.testing.assert_allclose(np.cos(turn), 1.0, rtol=0.0, atol=1e-12)


@GEOMETRIES
def test_the_heights_shrink_to_one_where_the_ground_is_too_steep(geometry):
    ground = ground_of(level_range(geometry, AZIMUTHS), AZIMUTHS)
    low, high = height_range(geometry, LEVEL, ground).T
    np.testing.assert_allclose(low, high, rtol=0.0, atol=1e-9)
    posture = np.column_stack([np.zeros((16, 2)), 0.5 * (low + high)])
    for factor, is_reached in ((0.999, True), (1.001, False)):
        extension = inverse_kinematics(geometry, posture, factor * ground, on_unreachable="nan")
        assert (np.isfinite(extension).all(axis=1) == is_reached).all()


@GEOMETRIES
def test_the_platform_tilts_as_far_as_a_leg_has_stroke(geometry):
    free = tilt_range(geometry, AZIMUTHS)
    height = float(np.mean(height_range(geometry, LEVEL, LEVEL)))
    fixed = tilt_range(geometry, AZIMUTHS, height)
    assert (fixed <= free + 1e-12).all()
    low, high = height_range(geometry, ground_of(fixed, AZIMUTHS), LEVEL).T
    np.testing.assert_allclose(np.minimum(height - low, high - height), 0.0, rtol=0.0, atol=1e-9)


@GEOMETRIES
def test_any_foot_can_stand_on_the_highest_step(geometry):
    step = highest_step(geometry)
    reached = []
    for leg in range(4):
        for factor in (0.999, 1.001):
            offsets = np.zeros(4)
            offsets[leg] = factor * step
            low, high = height_range(geometry, LEVEL, LEVEL, offsets)
            reached.append((factor < 1.0, low <= high))
    assert all(is_reached for is_lower, is_reached in reached if is_lower)
    assert not all(is_reached for is_lower, is_reached in reached if not is_lower)


def test_a_platform_that_stands_level_nowhere_has_no_range():
    geometry = replace(UNEQUAL, own_legs=(*_REAR, *(replace(leg, l_7=0.9) for leg in _REAR)))
    assert (level_range(geometry, AZIMUTHS) == 0.0).all()


def test_the_feet_resist_roll_pitch_and_height_by_hand():
    feet = np.array([(-2.0, 1.0), (-2.0, -1.0), (2.0, -1.0), (2.0, 1.0)])
    stiffness = foot_stiffness_matrix(feet, 10.0)
    np.testing.assert_allclose(stiffness, np.diag([40.0, 160.0, 40.0]))
