"""Forces of branches and feet, and the chair at rest on them."""

import numpy as np
import pytest

from parapod.systems.core.physics import GRAVITY
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.gait import TrotGait, gait_branches, gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.leg import branch_lengths, leg_corners
from parapod.systems.walking_chair.rates import corner_jacobians
from parapod.systems.walking_chair.statics import STIFFNESS, force_map, rest

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


GEOMETRY = ChairGeometry()
LEVEL = np.eye(3)


def stand(time=2.5, changes=0.0):
    """Unloaded corners from S, and the map of vertical forces, at a time of the gait."""
    motion = gait_motion(GEOMETRY, TrotGait(), time)
    body = motion.body.position
    lengths = chair_inverse(GEOMETRY, body, LEVEL, motion.feet.position, motion.references)
    lengths = lengths + changes
    corners = foot_corners(GEOMETRY, np.zeros(3), LEVEL, lengths).reshape(12, 3)
    return corners, force_map(GEOMETRY, lengths)[..., 2]


@pytest.mark.parametrize("time", [2.5, 7.5, 12.5, 17.5])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.03, -0.02)])
def test_the_ground_carries_the_weight_below_the_centre_of_mass(time, centre):
    corners, vertical = stand(time)
    found = rest(corners, vertical, 1000.0, np.array(centre), foot_weight=20.0)
    assert (found.loads >= 0.0).all()
    assert found.loads.sum() == pytest.approx(1000.0, rel=1e-9)
    np.testing.assert_allclose(found.loads @ corners[:, :2] / 1000.0, centre, atol=1e-9)


@pytest.mark.parametrize("time", [2.5, 7.5, 12.5])
def test_corners_carry_where_they_touch_and_touch_where_they_carry(time):
    corners, vertical = stand(time)
    found = rest(corners, vertical, 1000.0, np.zeros(2), foot_weight=20.0)
    np.testing.assert_array_equal(found.gaps[found.loads > 0.0], 0.0)
    assert (found.gaps >= -1e-9).all()
    assert found.loads[found.gaps > 1e-9].max(initial=0.0) == 0.0


def test_a_chair_on_four_straight_legs_is_level_and_sinks_as_springs_do():
    corners, vertical = stand(0.0)
    found = rest(corners, vertical, 1000.0, np.zeros(2))
    assert found.roll == pytest.approx(0.0, abs=1e-9)
    assert found.pitch == pytest.approx(0.0, abs=1e-9)
    sunk = -corners[:, 2].min() - found.height
    # Four legs of three springs each, two of them inclined: stiffer than 11, softer than 12.
    assert 1000.0 / (12.0 * STIFFNESS) < sunk < 1000.0 / (11.0 * STIFFNESS)


def test_twice_the_weight_sinks_twice_as_far():
    corners, vertical = stand(0.0)
    sunk = [
        -corners[:, 2].min() - rest(corners, vertical, weight, np.zeros(2)).height
        for weight in (500.0, 1000.0)
    ]
    assert sunk[1] == pytest.approx(2.0 * sunk[0], rel=1e-6)


def test_work_of_the_weight_is_the_energy_of_the_springs():
    # Put down slowly, the weight's work is twice the springs' energy for linear springs.
    corners, vertical = stand(0.0)
    found = rest(corners, vertical, 1000.0, np.zeros(2))
    sunk = -corners[:, 2].min() - found.height
    energy = 0.5 * (found.branch_forces**2).sum() / STIFFNESS
    assert 0.5 * 1000.0 * sunk == pytest.approx(energy, rel=1e-6)


def test_a_foot_in_the_air_hangs_on_its_branches():
    corners, vertical = stand(7.5)
    found = rest(corners, vertical, 1000.0, np.zeros(2), foot_weight=19.62)
    swings = [0, 2]
    assert not found.loads.reshape(4, 3)[swings].any()
    hanging = found.branch_forces.reshape(4, 3)[swings]
    own = np.zeros(12)
    own.reshape(4, 3)[swings] = -19.62 / 3.0
    np.testing.assert_allclose(hanging, (vertical @ own).reshape(4, 3)[swings], atol=1e-6)


def test_longer_legs_on_one_side_tilt_the_chair_to_the_other():
    # Feet 2 and 3 a millimetre lower: the right side goes up, which is a negative pitch here.
    motion = gait_motion(GEOMETRY, TrotGait(), 0.0)
    feet = motion.feet.position.copy()
    feet[[1, 2], 2] -= 1e-3
    lengths = chair_inverse(GEOMETRY, motion.body.position, LEVEL, feet, motion.references)
    changes = lengths - chair_inverse(
        GEOMETRY, motion.body.position, LEVEL, motion.feet.position, motion.references
    )
    corners, vertical = stand(0.0, changes)
    found = rest(corners, vertical, 1.0, np.zeros(2))  # hardly any spring
    assert found.roll == pytest.approx(0.0, abs=1e-6)
    # Level feet tilt with the chair, and stand on their corners: the inner ones on the right and
    # the outer ones on the left.
    inner, outer = 0.155 - 0.06, 0.155 + 0.06
    assert found.pitch == pytest.approx(-1e-3 / (inner + outer), rel=1e-3)


def test_a_leg_that_is_too_short_does_not_carry():
    changes = np.zeros((4, 3))
    changes[0] = -5e-3
    corners, vertical = stand(0.0, changes)
    found = rest(corners, vertical, 1000.0, np.array((0.05, 0.03)))
    assert not found.loads[:3].any()
    assert found.gaps[:3].min() > 0.0


def test_symmetric_chair_has_symmetric_forces():
    corners, vertical = stand(0.0)
    forces = rest(corners, vertical, 106.2 * GRAVITY, np.zeros(2)).branch_forces.reshape(4, 3)
    np.testing.assert_allclose(forces, np.tile(forces[0], (4, 1)), rtol=1e-6)
    np.testing.assert_allclose(forces[:, 1], forces[:, 2], rtol=1e-6)
