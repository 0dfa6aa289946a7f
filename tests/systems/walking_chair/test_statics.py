import numpy as np
import pytest

from parapod.systems.walking_chair.chair import foot_corners
from parapod.systems.walking_chair.gait import TrotGait, gait_branches, gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.leg import branch_lengths, leg_corners
from parapod.systems.walking_chair.statics import corner_jacobians, force_map

CHAIR, GAIT = ChairGeometry(), TrotGait()
LEG = CHAIR.leg
# Coordinates of the UP branch, none of them special.
UP = np.array([(0.65, 0.05, -0.1), (0.7, -0.2, 0.15), (0.8, 0.0, 0.0), (0.62, 0.1, 0.12)])


def lengths_of(up):
    return branch_lengths(LEG, up)


def test_corner_jacobians_are_derivatives_of_the_corners():
    found = corner_jacobians(LEG, UP)
    assert found.shape == (4, 3, 3, 3)
    random = np.random.default_rng(0)
    h = 1e-6
    for _ in range(5):
        way = random.normal(size=UP.shape) * (1.0, 1.0, 1.0)
        ahead, behind = UP + h * way, UP - h * way
        corners = (leg_corners(LEG, ahead) - leg_corners(LEG, behind)) / (2.0 * h)
        lengths = (lengths_of(ahead) - lengths_of(behind)) / (2.0 * h)
        np.testing.assert_allclose(
            np.einsum("ncib,nb->nci", found, lengths), corners, rtol=0.0, atol=1e-8
        )


@pytest.mark.parametrize("time", [2.5, 6.2, 7.5, 10.0, 12.5, 16.0])
def test_power_of_branches_is_that_of_the_ground(time):
    """Virtual work: the branches' forces on the lengths do what the ground's on the corners do."""
    lengths = gait_branches(CHAIR, GAIT, time).length
    by_force = force_map(CHAIR, lengths)
    body = gait_motion(CHAIR, GAIT, time).body.position
    random = np.random.default_rng(1)
    h = 1e-6
    for _ in range(10):
        forces, rates = random.normal(size=(12, 3)), random.normal(size=(4, 3))
        branches = np.einsum("bca,ca->b", by_force, forces)
        ahead, behind = (
            foot_corners(CHAIR, body, np.eye(3), lengths + sign * h * rates) for sign in (1, -1)
        )
        velocities = ((ahead - behind) / (2.0 * h)).reshape(12, 3)
        into_branches, into_ground = branches @ rates.ravel(), -(forces * velocities).sum()
        assert into_branches == pytest.approx(into_ground, abs=1e-7)
        assert abs(into_branches) > 1e-3


def test_a_leg_feels_nothing_of_the_other_feet():
    by_force = force_map(CHAIR, gait_branches(CHAIR, GAIT, 7.5).length).reshape(4, 3, 4, 3, 3)
    for leg in range(4):
        for other in range(4):
            assert bool(by_force[leg, :, other].any()) == (leg == other)


def test_upright_force_under_the_up_branch_is_the_up_branch_s():
    """A force at E1 of a flat foot acts along the UP branch, and pushes it together."""
    by_force = force_map(CHAIR, gait_branches(CHAIR, GAIT, 2.5).length)
    for leg in range(4):
        branches = by_force[3 * leg : 3 * leg + 3, 3 * leg, 2]
        np.testing.assert_allclose(branches, (1.0, 0.0, 0.0), atol=1e-12)


def test_upright_force_on_the_edge_is_shared_by_its_distance():
    """Moments about the edge and about E1: s mm behind E1 the UP branch keeps 1 - s / 173.2 mm."""
    by_force = force_map(CHAIR, gait_branches(CHAIR, GAIT, 2.5).length)
    for share in (0.2, 0.5, 0.9):
        forces = np.zeros((12, 3))
        forces[:3, 2] = (1.0 - share, 0.5 * share, 0.5 * share)
        s = share * 0.120 * np.cos(np.pi / 6.0)
        up = np.einsum("bca,ca->b", by_force, forces)[0]
        assert up == pytest.approx(1.0 - s / 0.1732, abs=1e-4)


def test_mirrored_and_turned_legs_have_mirrored_forces():
    """Legs 1 and 3 are each other turned by half a turn; branches 2 and 3 of each are mirrored."""
    by_force = force_map(CHAIR, gait_branches(CHAIR, GAIT, 2.5).length).reshape(4, 3, 4, 3, 3)
    first, third = by_force[0, :, 0], by_force[2, :, 2]
    np.testing.assert_allclose(first * (-1.0, -1.0, 1.0), third, atol=1e-12)
    swapped = first[np.ix_([0, 2, 1], [0, 2, 1])] * (-1.0, 1.0, 1.0)
    np.testing.assert_allclose(first, swapped, atol=1e-12)


def test_a_leg_that_cannot_be_assembled_has_no_forces():
    lengths = gait_branches(CHAIR, GAIT, 2.5).length.copy()
    lengths[1] = (0.6, 0.9, 0.9)
    by_force = force_map(CHAIR, lengths).reshape(4, 3, 4, 3, 3)
    assert np.isnan(by_force[1, :, 1]).all()
    assert np.isfinite(by_force[0, :, 0]).all()
