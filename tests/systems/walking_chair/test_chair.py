import math

import numpy as np
import pytest

from parapod.systems.walking_chair.chair import (
    chair_inverse,
    chair_motion,
    feet_in_legs,
    foot_corners,
    standing_feet,
)
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.leg import leg_inverse
from parapod.systems.walking_chair.trajectories import BodyMotion, Motion

CHAIR = ChairGeometry()
LEVEL = np.eye(3)
POSITION = np.array((0.0, 0.0, 0.7801))
REFERENCES = ("E1", "E2", "E3", "E1")
FEET = standing_feet(CHAIR, POSITION, REFERENCES)
FLAT = leg_inverse(CHAIR.leg, (0.0, 0.0, -0.7801))


def skew(v):
    return np.array(((0.0, -v[2], v[1]), (v[2], 0.0, -v[0]), (-v[1], v[0], 0.0)))


def rotation(vector):
    """Rotation by a vector's length about it."""
    angle = np.linalg.norm(vector)
    if angle == 0.0:
        return np.eye(3)
    k = skew(vector / angle)
    return np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * k @ k


class Tumbling:
    """A body and feet that move in every way: the body turns about a fixed axis ever faster."""

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        self.axis = rng.normal(size=3)
        self.axis /= np.linalg.norm(self.axis)
        self.tilt = rotation(rng.uniform(-0.1, 0.1, 3))
        self.body = [POSITION, *rng.uniform(-0.1, 0.1, (2, 3))]
        self.feet = [FEET, *rng.uniform(-0.1, 0.1, (2, 4, 3))]
        self.rate, self.rate_rate = 0.3, 0.4

    def at(self, t):
        angle = self.rate * t + 0.5 * self.rate_rate * t**2
        body = BodyMotion(
            self.body[0] + t * self.body[1] + 0.5 * t**2 * self.body[2],
            rotation(angle * self.axis) @ self.tilt,
            self.body[1] + t * self.body[2],
            (self.rate + t * self.rate_rate) * self.axis,
            self.body[2],
            self.rate_rate * self.axis,
        )
        feet = Motion(
            self.feet[0] + t * self.feet[1] + 0.5 * t**2 * self.feet[2],
            self.feet[1] + t * self.feet[2],
            self.feet[2],
        )
        return body, feet


def pose():
    body, feet = Tumbling(3).at(0.1)
    return body.position, body.rotation, feet.position


# Poses


def test_feet_that_stand_below_their_hinges_have_branches_of_a_straight_leg():
    lengths = chair_inverse(CHAIR, POSITION, LEVEL, FEET, REFERENCES)
    np.testing.assert_allclose(lengths, np.broadcast_to(FLAT, (4, 3)), rtol=0, atol=1e-15)


def test_standing_feet_are_flat_on_the_plane_of_the_corners():
    lengths = chair_inverse(CHAIR, POSITION, LEVEL, FEET, REFERENCES)
    corners = foot_corners(CHAIR, POSITION, LEVEL, lengths)
    np.testing.assert_allclose(corners[..., 2], 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        corners[:, 0, :2], CHAIR.p_SA[:, :2] + POSITION[:2], rtol=0, atol=1e-12
    )


def test_corners_come_back_to_the_feet_in_any_pose():
    position, attitude, feet = pose()
    lengths = chair_inverse(CHAIR, position, attitude, feet, REFERENCES)
    corners = foot_corners(CHAIR, position, attitude, lengths)
    for leg, corner in enumerate((0, 1, 2, 0)):
        np.testing.assert_allclose(corners[leg, corner], feet[leg], rtol=0, atol=1e-12)


def test_place_in_a_leg_is_that_of_equation_31():
    position, attitude, feet = pose()
    points = feet_in_legs(CHAIR, position, attitude, feet)
    for leg, placement in enumerate(CHAIR.placements):
        sRn, nRn1 = CHAIR.R_SA[leg], np.eye(3)
        s_pn, n_pn1 = np.array((placement.x, placement.y, 0.0)), (0.0, 0.2 / math.sqrt(3.0), 0.0)
        in_body = np.linalg.inv(attitude) @ (feet[leg] - position)
        expected = np.linalg.inv(nRn1) @ (np.linalg.inv(sRn) @ (in_body - s_pn) - n_pn1)
        np.testing.assert_allclose(points[leg], expected, rtol=0, atol=1e-15)


def test_moving_body_and_feet_together_changes_no_length():
    position, attitude, feet = pose()
    turn, shift = rotation(np.array((0.4, -1.0, 2.0))), np.array((1.0, 2.0, 3.0))
    moved = chair_inverse(
        CHAIR, turn @ position + shift, turn @ attitude, feet @ turn.T + shift, REFERENCES
    )
    expected = chair_inverse(CHAIR, position, attitude, feet, REFERENCES)
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-14)


def test_lengths_do_not_depend_on_where_the_legs_are_placed():
    feet = FEET + np.random.default_rng(1).uniform(-0.05, 0.05, (4, 3))
    near = ChairGeometry(
        placements=tuple(
            type(place)(0.5 * place.x, 0.5 * place.y, place.turned) for place in CHAIR.placements
        )
    )
    lengths = chair_inverse(near, POSITION, LEVEL, feet + near.p_SA - CHAIR.p_SA, REFERENCES)
    expected = chair_inverse(CHAIR, POSITION, LEVEL, feet, REFERENCES)
    np.testing.assert_allclose(lengths, expected, rtol=0, atol=1e-14)


def test_batches_and_references_per_time_broadcast():
    positions = POSITION + np.linspace(0.0, 0.02, 5)[:, None]
    references = np.array((1, 2, 3, 1)) * np.ones((5, 1), dtype=int)
    lengths = chair_inverse(CHAIR, positions, LEVEL, FEET, references)
    assert lengths.shape == (5, 4, 3)
    one = chair_inverse(CHAIR, positions[3], LEVEL, FEET, REFERENCES)
    np.testing.assert_allclose(lengths[3], one, rtol=0, atol=1e-15)
    corners = foot_corners(CHAIR, positions, LEVEL, lengths)
    assert corners.shape == (5, 4, 3, 3)
    tilted = np.stack([rotation(np.array((0.0, 0.0, a))) for a in (0.0, 0.1)])[:, None]
    assert chair_inverse(CHAIR, positions, tilted, FEET, "E1").shape == (2, 5, 4, 3)


def test_a_leg_out_of_reach_leaves_the_others_alone():
    feet = FEET.copy()
    feet[2, 2] = 2.0
    lengths = chair_inverse(CHAIR, POSITION, LEVEL, feet, REFERENCES)
    assert np.isnan(lengths).all(axis=-1).tolist() == [False, False, True, False]
    corners = foot_corners(CHAIR, POSITION, LEVEL, lengths)
    assert np.isnan(corners).all(axis=(1, 2)).tolist() == [False, False, True, False]


# Motions


def test_velocities_and_accelerations_of_a_turning_body_agree_with_differences():
    tumbling, dt = Tumbling(), 1e-3
    now, ahead, behind = (chair_motion(CHAIR, *tumbling.at(t), REFERENCES) for t in (0.0, dt, -dt))
    numeric = (ahead.length - behind.length) / (2.0 * dt)
    np.testing.assert_allclose(now.velocity, numeric, rtol=0, atol=1e-6)
    numeric = (ahead.velocity - behind.velocity) / (2.0 * dt)
    np.testing.assert_allclose(now.acceleration, numeric, rtol=0, atol=1e-6)
    body, feet = tumbling.at(0.0)
    lengths = chair_inverse(CHAIR, body.position, body.rotation, feet.position, REFERENCES)
    np.testing.assert_allclose(now.length, lengths, rtol=0, atol=1e-15)


def test_a_turning_body_as_in_equation_33_moves_the_feet_the_wrong_way():
    body, feet = Tumbling().at(0.0)
    turning = BodyMotion(body.position, body.rotation, angular_velocity=body.angular_velocity)
    rest = Motion(feet.position, np.zeros((4, 3)), np.zeros((4, 3)))
    dt = 1e-4
    for leg in range(4):
        T_1 = CHAIR.R_SA[leg].T @ body.rotation.T
        s_p = body.rotation.T @ (feet.position[leg] - body.position)
        printed = -T_1 @ body.rotation @ skew(s_p) @ body.angular_velocity
        right = T_1 @ body.rotation @ skew(s_p) @ body.rotation.T @ body.angular_velocity
        spins = [rotation(t * body.angular_velocity) @ body.rotation for t in (dt, -dt)]
        ahead, behind = (
            feet_in_legs(CHAIR, body.position, spin, feet.position)[leg] for spin in spins
        )
        numeric = (ahead - behind) / (2.0 * dt)
        np.testing.assert_allclose(right, numeric, rtol=0, atol=1e-7)
        assert np.abs(printed - numeric).max() > 0.05
    assert np.abs(chair_motion(CHAIR, turning, rest, REFERENCES).velocity).max() > 0.01


def test_body_and_feet_that_turn_as_one_move_no_branch():
    position, attitude, feet = pose()
    w, e = np.array((0.2, -0.5, 0.7)), np.array((-0.3, 0.1, 0.4))
    arms = feet - position
    velocity = np.cross(w, arms)
    acceleration = np.cross(e, arms) + np.cross(w, velocity)
    body = BodyMotion(position, attitude, angular_velocity=w, angular_acceleration=e)
    found = chair_motion(CHAIR, body, Motion(feet, velocity, acceleration), REFERENCES)
    np.testing.assert_allclose(found.velocity, 0.0, atol=1e-15)
    np.testing.assert_allclose(found.acceleration, 0.0, atol=1e-14)


def test_body_is_level_and_at_rest_unless_told():
    rest = Motion(FEET, np.zeros((4, 3)), np.zeros((4, 3)))
    found = chair_motion(CHAIR, BodyMotion(POSITION), rest, REFERENCES)
    np.testing.assert_allclose(found.length, np.broadcast_to(FLAT, (4, 3)), rtol=0, atol=1e-15)
    assert not found.velocity.any()
    assert not found.acceleration.any()


# Bad input


def test_wrong_shapes_are_refused_by_name():
    for arguments, name in (
        ((POSITION, np.eye(2), FEET, "E1"), "body_rotation"),
        ((POSITION, LEVEL, FEET[0], "E1"), "feet"),
        ((POSITION, LEVEL, FEET, ["E1", "E2"]), "references"),
    ):
        with pytest.raises(ValueError, match=f"{name} must have shape"):
            chair_inverse(CHAIR, *arguments)


def test_an_unknown_corner_is_refused():
    with pytest.raises(ValueError, match="one of E1, E2, E3"):
        chair_inverse(CHAIR, POSITION, LEVEL, FEET, ("E1", "E1", "E1", "E0"))
