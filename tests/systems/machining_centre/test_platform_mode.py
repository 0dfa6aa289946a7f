import math

import numpy as np
import pytest

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import (
    check_strokes,
    displacement,
    forward_kinematics,
    inverse_kinematics,
    jacobian,
    leg_lengths,
    moved,
)

STEP = 1e-6


def test_lengths_above_the_middle_follow_from_pythagoras(geometry):
    c = math.cos(geometry.half_angle)
    square = 0.18**2 + 0.1**2 - 2.0 * 0.18 * 0.1 * c + 0.5**2
    lengths = inverse_kinematics(geometry, (0.0, 0.0, 0.5, 0.0, 0.0, 0.0))
    assert np.allclose(lengths, math.sqrt(square), atol=1e-15)
    assert lengths[0] == pytest.approx(0.516666387, abs=5e-10)


def test_lengths_of_a_tilted_pose_are_those_computed_by_another_program():
    lengths = inverse_kinematics(CentreGeometry(), (0.03, 0.02, 0.5, 0.05, -0.05, 0.05))
    expected = (507.89030616, 522.37678082, 526.71409674, 510.07251206, 515.40315783, 525.15121846)
    assert np.allclose(1e3 * lengths, expected, atol=1e-8)


def test_rates_are_the_slopes_of_the_lengths(geometry, poses, uneven):
    batch, feet = poses(200), uneven(200)
    twist = np.random.default_rng(2).normal(size=(200, 6))
    ahead, behind = (
        leg_lengths(geometry, moved(batch, sign * STEP * twist), feet) for sign in (1, -1)
    )
    slopes = (ahead - behind) / (2.0 * STEP)
    rates = np.einsum("kij,kj->ki", jacobian(geometry, batch, feet), twist)
    assert np.abs(slopes - rates).max() < 1e-8


def test_rows_of_equation_18_belong_to_another_point(geometry, poses):
    pose = poses(1)[0]
    J = jacobian(geometry, pose)
    # Eq. (18): moments of the legs' directions about the world's origin, taken at the feet.
    printed = J.copy()
    feet = np.repeat(geometry.footholds[:, :3], 2, axis=0)
    printed[:, :3] = np.cross(feet, J[:, 3:])
    omega, v = np.array((0.3, -0.2, 0.5)), np.array((0.1, 0.2, -0.1))
    at_origin = v - np.cross(omega, pose[:3])
    assert np.allclose(printed @ (*omega, *at_origin), J @ (*omega, *v), atol=1e-14)
    assert np.abs(printed @ (*omega, *v) - J @ (*omega, *v)).max() > 0.02


def test_power_of_the_legs_is_that_of_the_wrench(geometry, poses):
    J = jacobian(geometry, poses(1)[0])
    rng = np.random.default_rng(3)
    force, twist = rng.normal(size=geometry.legs), rng.normal(size=6)
    assert (J.T @ force) @ twist == pytest.approx(force @ (J @ twist), rel=1e-13)


def test_lengths_lead_back_to_the_pose(geometry, poses, uneven):
    batch, feet = poses(300), uneven(300)
    found = forward_kinematics(geometry, leg_lengths(geometry, batch, feet), batch.mean(0), feet)
    assert np.abs(found.pose - batch).max() < 1e-10
    assert found.residual.max() < 1e-12
    assert found.step.max() < 1e-12
    assert found.smallest_singular_value.min() > 0.1


def test_eight_lengths_that_contradict_each_other_are_met_as_well_as_can_be(poses):
    geometry, pose = CentreGeometry(4), poses(1)[0]
    lengths = leg_lengths(geometry, pose)
    lengths[0] += 1e-3
    found = forward_kinematics(geometry, lengths, pose)
    left = leg_lengths(geometry, found.pose) - lengths
    assert 1e-5 < found.residual < 1e-3
    # Of a least sum of squares: what is left has no part that a motion could take away.
    assert np.abs(jacobian(geometry, found.pose).T @ left).max() < 1e-12


def test_lengths_that_no_platform_has_are_nan(geometry):
    found = forward_kinematics(
        geometry,
        [(0.4,) * geometry.legs, (0.05,) * geometry.legs],
        (0.0, 0.0, 0.48, 0.0, 0.0, 0.0),
    )
    assert np.isfinite(found.pose[0]).all()
    assert np.isnan(found.pose[1]).all()


def test_a_displacement_leads_from_one_pose_to_another(poses):
    batch = poses(50, angle=1.0)
    moves = displacement(batch[:-1], batch[1:])
    assert np.allclose(moved(batch[:-1], moves), batch[1:], atol=1e-14)


def test_a_pose_outside_the_stroke_is_refused_with_leg_and_missing_length(geometry):
    poses = [(0.0, 0.0, 0.5, 0.0, 0.0, 0.0), (0.3, 0.0, 0.5, 0.0, 0.0, 0.0)]
    with pytest.raises(UnreachablePosture) as refused:
        inverse_kinematics(geometry, poses)
    error = refused.value
    lengths = leg_lengths(geometry, poses[1])
    assert error.index == (1,)
    assert error.missing == pytest.approx(lengths[error.leg - 1] - 0.65)
    assert f"leg {error.leg}" in str(error)
    assert "of limb" in str(error)
    assert "390.0..650.0 mm" in str(error)


def test_both_ends_of_the_stroke_are_admissible(geometry):
    ends = np.tile((geometry.stroke_min, geometry.stroke_max), geometry.limbs)
    check_strokes(geometry, ends)
    for beyond in (-1e-9, 1e-9):
        with pytest.raises(UnreachablePosture):
            check_strokes(geometry, ends + beyond)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (((0.0, 0.0, 0.5),), "pose must have shape"),
        (((0.0,) * 6, np.zeros((5, 6))), "footholds must have shape"),
    ],
)
def test_wrong_shapes_are_called_by_their_names(geometry, arguments, says):
    with pytest.raises(ValueError, match=says):
        leg_lengths(geometry, *arguments)
