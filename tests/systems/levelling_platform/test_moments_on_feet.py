"""Forces and moments on a platform that stands on its feet alone balance where rollers touch."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.statics import (
    KinematicPlatformParams,
    centre_of_mass,
    stand,
)

PARAMS = KinematicPlatformParams()
WEIGHT = (PARAMS.mass + PARAMS.arm_mass) * PARAMS.gravity
RADIUS = MODEL_GEOMETRY.foot_radius


def unbalanced(extension, ground, arm=(0.0, 0.0), offsets=(0.0,) * 4):
    """Force along the ground's normal [N], and moments about two axes in its plane [N m]."""
    stance = stand(
        MODEL_GEOMETRY, PARAMS, list(extension), [0.0] * 4, list(ground), list(arm), offsets
    )
    R = RollPitchYaw(*stance.posture[:2], 0.0).ToRotationMatrix().matrix()
    n = R.T @ RollPitchYaw(*ground, 0.0).ToRotationMatrix().matrix()[:, 2]
    touches = [
        -np.array(foot_to_centre(leg, d)) - (RADIUS + offset) * n
        for leg, d, offset in zip(MODEL_GEOMETRY.legs, extension, offsets, strict=True)
    ]
    force = np.array(stance.contact_force)
    weight = R.T @ (0.0, 0.0, -WEIGHT)
    below = -stance.posture[2] * n
    moment = np.cross(np.array(touches) - below, np.outer(force, n)).sum(axis=0)
    moment += np.cross(np.array(centre_of_mass(PARAMS, list(arm))) - below, weight)
    # Friction acts in the plane, and has no moment about axes in it.
    in_plane = moment - (moment @ n) * n
    return force.sum() + weight @ n, np.linalg.norm(in_plane)


@pytest.mark.parametrize("ground", [(0.0, 0.0), (0.08, 0.0), (0.0, -0.08), (-0.06, 0.05)])
@pytest.mark.parametrize(
    ("extension", "offsets"),
    [((0.405,) * 4, (0.0,) * 4), ((0.4, 0.406, 0.404, 0.41), (2e-3, 0.0, -1e-3, 1e-3))],
)
def test_feet_carry_the_weight_where_its_line_meets_the_ground(ground, extension, offsets):
    force, moment = unbalanced(extension, ground, offsets=offsets)
    assert abs(force) < 1e-12 * WEIGHT
    # A fifth of a millimetre beside that line; the radius of the rollers moves it by two.
    assert moment < 2e-4 * WEIGHT
