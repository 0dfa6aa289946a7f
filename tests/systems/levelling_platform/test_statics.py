import math
from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RollPitchYaw

from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.statics import (
    KinematicPlatformParams,
    Stance,
    rod_arm,
    stand,
    stand_on_feet_and_wheels,
)
from parapod.systems.levelling_platform.wheels import WheelGeometry

WHEELS = WheelGeometry()
PARAMS = KinematicPlatformParams()
WEIGHT = 51.0 * PARAMS.gravity
GROUND = (0.03, -0.05)
UPRIGHT = (0.0, 0.0)
LEVEL = (0.0, 0.0)
STILL = (0.0, 0.0, 0.0, 0.0)
FLAT = (0.0, 0.0, 0.0, 0.0)


def standing(extension, ground=LEVEL, arm=UPRIGHT, offsets=FLAT, velocity=STILL, params=PARAMS):
    return stand_on_feet_and_wheels(
        DRAWN,
        WHEELS,
        params,
        list(extension),
        list(velocity),
        list(ground),
        list(arm),
        tuple(offsets),
    )


def on_feet(extension, ground=LEVEL, arm=UPRIGHT, offsets=FLAT, velocity=STILL):
    return stand(
        DRAWN,
        PARAMS,
        list(extension),
        list(velocity),
        list(ground),
        list(arm),
        tuple(offsets),
    )


def rotation(attitude):
    return RollPitchYaw(attitude[0], attitude[1], 0.0).ToRotationMatrix().matrix()


def centre_of_mass(arm, params=PARAMS):
    """From F, in the platform's frame."""
    turn, swing = arm
    along = np.array(
        (math.sin(swing) * math.cos(turn), math.sin(swing) * math.sin(turn), math.cos(swing))
    )
    rod, base = params.arm.links[1], params.arm.joints[0].place
    moment = rod.mass * (np.array(base) + rod.centre[2] * along)
    return (params.mass * np.array(params.centre_of_mass) + moment) / (params.mass + rod.mass)


class InTheWorld:
    """A stance seen in the world, where the ground's plane goes through the origin."""

    def __init__(self, stance, extension, ground, arm, offsets, params=PARAMS):
        R = rotation(stance.posture[:2])
        self.n = rotation(ground)[:, 2]
        centre = stance.posture[2] * self.n
        feet = [
            -np.array(foot_to_centre(leg, d)) for leg, d in zip(DRAWN.legs, extension, strict=True)
        ]
        self.com = centre + R @ centre_of_mass(arm, params)
        self.centres = centre + np.array([*feet, *WHEELS.axles]) @ R.T
        reach = np.append(DRAWN.foot_radius + np.array(offsets), [WHEELS.radius] * 4)
        self.depth = reach - self.centres @ self.n
        stiffness = np.repeat((params.foot_stiffness, params.wheel_stiffness), 4)
        self.force = stiffness * np.maximum(self.depth, 0.0)

    @property
    def unbalanced(self):
        """Force along the ground's normal, moments about two axes in its plane [N, N m]."""
        touch = self.centres - np.outer(self.centres @ self.n, self.n)
        # Friction acts in the plane, and has no moment about axes in it.
        moment = np.cross(touch, np.outer(self.force, self.n)).sum(axis=0)
        moment += np.cross(self.com, (0.0, 0.0, -WEIGHT))
        in_plane = moment - (moment @ self.n) * self.n
        return self.force.sum() - WEIGHT * self.n[2], *in_plane


def cases(count, seed=0):
    """Extensions, grounds, arms and heights of the feet around touchdown."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        yield (
            rng.uniform(0.412, 0.428, 4).tolist(),
            rng.uniform(-0.08, 0.08, 2).tolist(),
            [rng.uniform(-3.0, 3.0), rng.uniform(-1.0, 1.0)],
            rng.uniform(0.0, 0.02, 4).tolist(),
        )


def mixed_cases(count, seed=0):
    """Those that stand on feet and wheels, with their stance."""
    for case in cases(count, seed):
        stance = standing(*case)
        if max(stance.contact_force) > 0.0 and stance != on_feet(*case):
            yield case, stance


def is_nowhere(stance):
    return all(np.isnan(value).all() for value in stance)


# On wheels


def test_with_legs_up_it_stands_parallel_to_the_ground_on_its_wheels():
    # The centre of mass a little off the middle inclines it by some hundredths of a millimetre.
    stance = standing([0.45] * 4, GROUND)
    np.testing.assert_allclose(stance.posture[:2], GROUND, atol=1e-4)
    assert stance.contact_force == [0.0] * 4
    np.testing.assert_array_equal(stance.load_force, 0.0)
    assert min(stance.foot_height) > 0.15
    np.testing.assert_array_equal(stance.angular_velocity, 0.0)


def test_wheels_give_way_under_a_quarter_of_the_weight_each():
    centred = replace(PARAMS, arm=rod_arm((0.0, 0.0, 0.145)))
    stance = standing([0.45] * 4, params=centred)
    sunk = 51.0 * 9.81 / 4.0 / centred.wheel_stiffness
    np.testing.assert_allclose(stance.posture, (0.0, 0.0, 0.390 - sunk), rtol=0, atol=1e-12)


def test_specific_force_at_rest_is_minus_gravity_in_the_platforms_frame():
    stance = standing([0.45] * 4, GROUND)
    expected = rotation(stance.attitude).T @ (0.0, 0.0, PARAMS.gravity)
    np.testing.assert_allclose(stance.specific_force, expected, rtol=1e-12)


def test_raised_legs_that_move_move_nothing_else():
    still, moving = (standing([0.45] * 4, GROUND, velocity=[v] * 4) for v in (0.0, 0.006))
    assert still == moving


# On feet


def test_on_its_feet_alone_it_is_what_stands_on_feet():
    count = 0
    for extension, ground, arm, offsets in cases(100, seed=1):
        lifted = (np.array(extension) - 0.02).tolist()
        velocity = (0.001, -0.002, 0.003, 0.0)
        same = on_feet(lifted, ground, arm, offsets, velocity)
        if min(same.contact_force) >= 0.0:
            assert standing(lifted, ground, arm, offsets, velocity) == same
            count += 1
    assert count > 80


@pytest.mark.parametrize("ground", [LEVEL, (0.08, 0.0), (0.0, -0.08), (-0.06, 0.05)])
@pytest.mark.parametrize(
    ("extension", "offsets"),
    [((0.405,) * 4, FLAT), ((0.4, 0.406, 0.404, 0.41), (2e-3, 0.0, -1e-3, 1e-3))],
)
def test_feet_carry_the_weight_where_its_line_meets_the_ground(ground, extension, offsets):
    stance = on_feet(extension, ground, offsets=offsets)
    world = InTheWorld(stance, extension, ground, UPRIGHT, offsets)
    world.force = np.append(stance.contact_force, np.zeros(4))
    force, *moment = world.unbalanced
    assert abs(force) < 1e-12 * WEIGHT
    # A fifth of a millimetre beside that line; the radius of the rollers moves it by two.
    assert np.linalg.norm(moment) < 2e-4 * WEIGHT


# On both


def test_forces_and_moments_balance_and_no_support_pulls():
    mixed = 0
    for case in cases(600):
        stance = standing(*case)
        world = InTheWorld(stance, *case)
        assert min(stance.contact_force) >= 0.0
        total = sum(stance.contact_force) + world.force[4:].sum()
        assert total == pytest.approx(WEIGHT * world.n[2], rel=1e-5)
        if max(stance.contact_force) > 0.0 and stance != on_feet(*case):
            np.testing.assert_allclose(stance.contact_force, world.force[:4], rtol=0, atol=1e-7)
            np.testing.assert_allclose(world.unbalanced, 0.0, atol=1e-6)
            # Feet that do not carry are above the ground by their height.
            height = np.maximum(-world.depth[:4], 0.0)
            np.testing.assert_allclose(stance.foot_height, height, atol=1e-12)
            mixed += 1
    assert mixed > 120


def test_actuators_hold_what_their_feet_carry():
    step = 1e-6
    for (extension, ground, *_), stance in mixed_cases(100):
        g = rotation(stance.attitude).T @ rotation(ground)[:, 2]
        for leg, d, force, load in zip(
            DRAWN.legs, extension, stance.contact_force, stance.load_force, strict=True
        ):
            ahead, behind = (np.array(foot_to_centre(leg, x)) for x in (d + step, d - step))
            lift = g @ (ahead - behind) / (2.0 * step)
            assert load == pytest.approx(force * lift, rel=1e-5)


@pytest.mark.parametrize("stiffness", [1e4, 1e9])
def test_it_balances_with_other_stiffnesses(stiffness):
    params = replace(PARAMS, foot_stiffness=stiffness, wheel_stiffness=3.0 * stiffness)
    for case in cases(100):
        stance = standing(*case, params=params)
        world = InTheWorld(stance, *case, params=params)
        if world.force[4:].any():
            np.testing.assert_allclose(
                world.unbalanced, 0.0, atol=1e-6 + 1e-14 * stiffness, err_msg=str(case)
            )


def test_while_legs_go_down_nothing_jumps():
    """Each foot meets the ground by itself; in steps of a quarter, changes are a quarter."""
    offsets = (2e-4, 0.0, 1.2e-4, 0.5e-4)

    def largest_change(step):
        extension = np.arange(0.42020, 0.41990, -step)
        stances = [standing([d] * 4, GROUND, (0.3, 0.2), offsets) for d in extension]
        carried = np.array([s.contact_force for s in stances])
        assert carried[0].tolist() == [0.0] * 4
        assert carried[-1].min() >= 0.0
        assert carried[-1].sum() == pytest.approx(WEIGHT * rotation(GROUND)[2, 2], rel=1e-5)
        signals = np.array([[*s.posture, *s.contact_force] for s in stances])
        return np.abs(np.diff(signals, axis=0)).max(axis=0)

    coarse, fine = largest_change(5e-7), largest_change(1.25e-7)
    assert (coarse[:3] > 0.0).all()
    # The closed form of feet alone leaves out how the load inclines the feet: some .03 N.
    np.testing.assert_array_less(fine, 0.26 * coarse + np.repeat((1e-8, 0.05), (3, 4)))
    np.testing.assert_array_less(coarse[3:], 10.0)


def test_angular_velocity_agrees_with_differences_of_the_attitude():
    rng = np.random.default_rng(2)
    step, compared = 1e-5, 0
    for (extension, ground, arm, offsets), stance in mixed_cases(200, seed=3):
        velocity = rng.uniform(-0.01, 0.01, 4)
        behind, ahead = (
            standing(np.array(extension) + sign * step * velocity, ground, arm, offsets)
            for sign in (-1.0, 1.0)
        )
        carrying = [
            tuple(InTheWorld(s, extension, ground, arm, offsets).force > 1.0)
            for s in (behind, stance, ahead)
        ]
        if len(set(carrying)) > 1:
            continue
        roll_rate, pitch_rate, _ = (np.array(ahead.attitude) - behind.attitude) / (2.0 * step)
        roll = stance.attitude[0]
        expected = (roll_rate, pitch_rate * math.cos(roll), -pitch_rate * math.sin(roll))
        moving = standing(extension, ground, arm, offsets, velocity)
        # What the points of contact shift by is left out.
        error = np.linalg.norm(np.subtract(moving.angular_velocity, expected))
        assert error <= 2e-3 * np.linalg.norm(expected)
        compared += 1
    assert compared > 20


# Tipping over and bad input


def test_on_steep_ground_it_leans_on_raised_feet_before_it_tips_over():
    extension = [0.45] * 4
    upright, leaning, over = (standing(extension, (roll, 0.0)) for roll in (0.5, 0.65, 1.2))
    assert upright.contact_force == [0.0] * 4
    assert sum(force > 0.0 for force in leaning.contact_force) == 2
    for roll, stance in ((0.5, upright), (0.65, leaning)):
        world = InTheWorld(stance, extension, (roll, 0.0), UPRIGHT, FLAT)
        np.testing.assert_allclose(world.unbalanced, 0.0, atol=1e-6)
    assert is_nowhere(over)


def test_on_its_feet_it_tips_over_where_one_of_them_would_have_to_pull():
    steep = (1.2, 0.0)
    assert min(on_feet([0.405] * 4, steep).contact_force) < 0.0
    assert is_nowhere(standing([0.405] * 4, steep))


def test_where_a_leg_cannot_be_built_or_an_input_is_nan_it_stands_nowhere():
    for leg in range(4):
        for bad in (math.nan, 0.6, 0.3):
            extension = [bad if i == leg else 0.45 for i in range(4)]
            assert math.isnan(standing(extension).posture[2])
    for name, size in (("ground", 2), ("arm", 2), ("offsets", 4)):
        assert np.isnan(standing([0.45] * 4, **{name: [math.nan] * size}).posture).any()


# The plant


@pytest.mark.parametrize("extension", [(0.45,) * 4, (0.4195, 0.43, 0.4203, 0.45), (0.41,) * 4])
def test_the_plant_with_wheels_shows_this_stance(stand, extension):
    velocity, arm, offsets = (0.001, 0.0, -0.002, 0.003), (0.3, 0.4), (0.0, 0.004, 0.002, 0.0)
    system = KinematicPlatform(DRAWN, PARAMS, WHEELS)
    platform = stand(system, extension=extension, velocity=velocity, arm_position=arm)
    system.set_ground(platform.context, GROUND, offsets)
    stance = standing(extension, GROUND, arm, offsets, velocity)
    shown = set(Stance._fields) - {"normal"}  # which is for `standing` only
    for name in shown:
        np.testing.assert_array_equal(platform[name], getattr(stance, name))


def test_without_wheels_the_plant_stands_on_its_feet_however_low(stand):
    system = KinematicPlatform(DRAWN, PARAMS)
    platform = stand(system, extension=[0.43] * 4, velocity=STILL)
    assert platform["posture"][2] < 0.35
    assert platform["contact_force"].sum() == pytest.approx(WEIGHT, rel=1e-5)


def test_lists_that_a_caller_changes_are_solved_anew():
    extension, arm = [0.41, 0.405, 0.41, 0.405], [0.1, 0.2]
    others = list(STILL), list(LEVEL)
    first = stand(DRAWN, PARAMS, extension, *others, arm)
    extension[:] = [0.405, 0.41, 0.405, 0.41]
    moved = stand(DRAWN, PARAMS, extension, *others, arm)
    assert moved.posture != first.posture
    arm[1] = 0.9
    leaning = stand(DRAWN, PARAMS, extension, *others, arm)
    assert leaning.contact_force != moved.contact_force
    heavier = stand(DRAWN, replace(PARAMS, arm=rod_arm(mass=2.0)), extension, *others, arm)
    assert heavier.contact_force != leaning.contact_force
