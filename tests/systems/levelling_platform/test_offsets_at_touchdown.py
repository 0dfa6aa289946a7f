"""The offsets that the ground estimator tells are heights of the ground, upwards."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.ground_estimator import GroundEstimator
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.statics import resting_posture


def estimated(extension, attitude, geometry=MODEL_GEOMETRY):
    """Ground and offsets after the trigger has risen."""
    system = GroundEstimator(geometry)
    context = system.CreateDefaultContext()
    for name, value in (("extension", extension), ("attitude", attitude), ("trigger", [1.0])):
        system.GetInputPort(name).FixValue(context, value)
    state = system.EvalUniquePeriodicDiscreteUpdate(context)
    return state.value(0), state.value(2)


def reach(leg, extension):
    """How far a foot is below the platform's centre [m]."""
    return foot_to_centre(leg, extension)[2]


@pytest.mark.parametrize("lifted", range(4))
def test_a_foot_that_stands_higher_has_an_offset_above_zero(lifted):
    geometry = PlatformGeometry(foot_radius=0.025)
    leg, extension, bump = geometry.legs[lifted], [0.405] * 4, 4e-3
    slope = (reach(leg, 0.406) - reach(leg, 0.404)) / 2e-3
    for _ in range(5):
        short = reach(leg, 0.405) - reach(leg, extension[lifted])
        extension[lifted] -= (bump - short) / slope
    assert reach(leg, extension[lifted]) == pytest.approx(reach(leg, 0.405) - bump, abs=1e-9)
    _, offsets = estimated(extension, (0.0, 0.0), geometry)
    # Of four corners of a rectangle the plane of least squares leaves a quarter, by diagonals;
    # the foot moves sideways too, by what the tolerance says.
    signs = np.where((np.arange(4) - lifted) % 2 == 0, 1.0, -1.0)
    np.testing.assert_allclose(offsets, 0.25 * bump * signs, atol=0.03 * bump)


@pytest.mark.parametrize("ground", [(0.0, 0.0), (0.03, -0.05)])
def test_offsets_are_what_a_plane_leaves_of_the_heights_on_which_the_platform_stands(ground):
    """Legs that reach the heights (6, -2, -3, 1) mm, and a plane through these by `lstsq`."""
    heights = np.array((6e-3, -2e-3, -3e-3, 1e-3))
    upright = RollPitchYaw(*ground, 0.0).ToRotationMatrix().matrix()
    extension = np.full(4, 0.405)
    for _ in range(8):
        feet = np.array(
            [
                foot_to_centre(leg, d)
                for leg, d in zip(MODEL_GEOMETRY.legs, extension.tolist(), strict=True)
            ]
        )
        missing = (feet[:, 2] - MODEL_GEOMETRY.foot_radius) - (0.45 - heights)
        slope = [
            (reach(leg, d + 1e-6) - reach(leg, d - 1e-6)) / 2e-6
            for leg, d in zip(MODEL_GEOMETRY.legs, extension.tolist(), strict=True)
        ]
        extension -= missing / slope
    assert np.abs(missing).max() < 1e-9
    columns = np.column_stack((feet[:, :2], np.ones(4)))
    plane, *_ = np.linalg.lstsq(columns, heights, rcond=None)
    tilted, offsets = estimated(extension, ground)
    left = heights - columns @ plane
    assert np.abs(left).min() > 8e-4
    np.testing.assert_allclose(offsets, left, atol=2e-5)
    # Feet are at minus their vectors: where the ground rises along x, its normal leans back.
    normal = upright.T @ RollPitchYaw(*tilted, 0.0).ToRotationMatrix().matrix()[:, 2]
    expected = np.array((plane[0], plane[1], 1.0))
    np.testing.assert_allclose(normal, expected / np.linalg.norm(expected), atol=1e-4)


def test_on_that_ground_with_those_offsets_the_legs_stand_as_they_did():
    extension, attitude = [0.405, 0.411, 0.402, 0.4095], (0.02, -0.01)
    ground, offsets = estimated(extension, attitude)
    posture = resting_posture(MODEL_GEOMETRY, extension, ground, offsets)
    assert np.abs(offsets).min() > 5e-4
    np.testing.assert_allclose(posture[:2], attitude, atol=1e-6)
