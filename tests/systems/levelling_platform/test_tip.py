"""Inverse kinematics of the arm's tip: round trips, the plant's own tip, points out of reach."""

import math

import numpy as np
import pytest

from parapod.systems.arm.flexible_arm import FlexibleArm
from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.serial_arm import ArmJoint, ArmLink, SerialArm
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.statics import PAPER_ARM, KinematicPlatformParams
from parapod.systems.levelling_platform.tip import REACHED, TipReach

GEOMETRY = PlatformGeometry(foot_radius=0.025)
RODS = [None, FlexibleRod(), FlexibleRod(bending_stiffness=(300.0, 200.0), modes=3)]
STANCES = [
    ((0.0, 0.0), (0.0, 0.0)),
    ((0.03, 0.05), (0.0, 0.0)),
    ((-0.02, 0.04), (0.01, 0.02)),
]


def reach_of(rod=None, ground=(0.0, 0.0), attitude=(0.0, 0.0)):
    return TipReach(GEOMETRY, PAPER_ARM, rod, ground, attitude)


def somewhere(reach, count=500, seed=1, most=1.3):
    """Heights (n) and joints (n, 2) within stroke."""
    random = np.random.default_rng(seed)
    height = random.uniform(*reach.heights, count)
    return height, np.stack(
        [random.uniform(-3.0, 3.0, count), random.uniform(0.02, most, count)], axis=-1
    )


@pytest.mark.parametrize("rod", RODS)
@pytest.mark.parametrize(("ground", "attitude"), STANCES)
def test_point_of_the_tip_is_reached_by_the_way_it_came_from(rod, ground, attitude):
    reach = reach_of(rod, ground, attitude)
    height, joints = somewhere(reach)
    solution = reach.solve(reach.tip_position(height, joints))
    assert solution.is_reached.all()
    assert solution.error.max() < (1e-9 if rod is None else REACHED)
    np.testing.assert_allclose(solution.posture[:, 2], height, atol=2e-5)
    np.testing.assert_allclose(solution.joints, joints, atol=1e-5)
    np.testing.assert_allclose(solution.posture[:, :2], np.tile(attitude, (500, 1)))


@pytest.mark.parametrize("rod", RODS)
@pytest.mark.parametrize(("ground", "attitude"), STANCES)
def test_forward_kinematics_are_those_of_the_plant_and_its_rod(rod, ground, attitude):
    reach = reach_of(rod, ground, attitude)
    heights, joints = somewhere(reach, 5)
    stiff = KinematicPlatformParams(foot_stiffness=1e12)
    platform = KinematicPlatform(GEOMETRY, stiff, ground=ground)
    straight = FlexibleRod(bending_stiffness=(1e9, 1e9), modes=1)
    arm = FlexibleArm(rod or straight, 1e-6 if rod is None else 1e-3, PAPER_ARM)
    for height, position in zip(heights.tolist(), joints, strict=True):
        extension = inverse_kinematics(GEOMETRY, [*attitude, height], ground)
        context = platform.CreateDefaultContext()
        platform.GetInputPort("extension").FixValue(context, extension)
        platform.GetInputPort("velocity").FixValue(context, np.zeros(4))
        platform.GetInputPort("arm_position").FixValue(context, position)
        pose = platform.GetOutputPort("base_pose").Eval(context)
        rods = arm.CreateDefaultContext()
        arm.set_rest(rods, pose, position.tolist())
        arm.GetInputPort("base_pose").FixValue(rods, pose)
        arm.GetInputPort("joint_state").FixValue(rods, [*position, 0.0, 0.0])
        tip = arm.GetOutputPort("tip_pose").Eval(rods)[4:]
        np.testing.assert_allclose(reach.tip_position(height, position), tip, atol=1e-7)


def test_level_rigid_rod_reaches_a_point_in_closed_form():
    reach = reach_of()
    point = reach.tip_position(0.48, [0.3, 0.8])
    solution = reach.solve(point)
    roll, pitch, height = solution.posture
    assert (roll, pitch) == (0.0, 0.0)
    turn, swing = solution.joints
    base = reach.tip_position(height, [0.0, 0.0]) - [0.0, 0.0, 2.02]
    along = [math.sin(swing) * math.cos(turn), math.sin(swing) * math.sin(turn), math.cos(swing)]
    np.testing.assert_allclose(base + 2.02 * np.array(along), point, atol=1e-12)
    np.testing.assert_allclose(
        solution.extension, inverse_kinematics(GEOMETRY, solution.posture, (0.0, 0.0)), atol=1e-12
    )


def test_sag_is_compensated_and_not_to_do_so_misses_by_it():
    rod = FlexibleRod()
    point = reach_of().tip_position(0.47, [0.2, 1.1])
    bent, straight = reach_of(rod).solve(point), reach_of().solve(point)
    assert bent.joints[1] < straight.joints[1]
    missed = reach_of(rod).tip_position(straight.posture[2], straight.joints) - point
    sag = rod.sag(-9.81 * math.sin(straight.joints[1]), 9.81 * math.cos(straight.joints[1]))
    assert np.linalg.norm(missed) == pytest.approx(abs(sag.across), rel=1e-3)


def test_two_free_angles_buy_stroke_on_a_slope():
    level = reach_of(None, ground=(0.0, 0.05))
    point = level.tip_position(level.heights[0] + 2e-3, [0.1, 0.6])
    leaning = level.with_attitude(0.0, 0.02)
    assert leaning.solve(point).stroke_left > level.solve(point).stroke_left + 1e-3
    assert leaning.solve(point).is_reached
    assert leaning.solve(point).error < 1e-9


def test_batch_is_its_rows():
    reach = reach_of(FlexibleRod(), *STANCES[1])
    height, joints = somewhere(reach, 6)
    points = reach.tip_position(height, joints).reshape(2, 3, 3)
    points[1, 2] = (0.0, 0.0, 9.0)
    batch = reach.solve(points)
    assert not batch.is_reached[1, 2]
    for index in np.ndindex(2, 3):
        row = reach.solve(points[index])
        for whole, own in zip(batch, row, strict=True):
            np.testing.assert_allclose(whole[index], own, rtol=1e-9, atol=1e-12)


def test_other_arms_are_refused():
    arm = SerialArm((ArmJoint("slide", kind="prismatic"),), (ArmLink(),))
    with pytest.raises(ValueError, match="must be a rod on a turntable"):
        TipReach(GEOMETRY, arm)
