"""A machining centre of rigid bodies: loops, clamps, locks, and a foot that swings."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from parapod.diagrams.machining_centre.held_centre import make_held_centre
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.model import pose_of
from parapod.systems.machining_centre.platform_mode import leg_lengths
from parapod.systems.machining_centre.swing import LockSet, close_locks, swing_inverse

# Neither's dimensions are the paper's.
OTHERS = (
    CentreGeometry(3, 0.15, 0.6, 0.3, 0.5, 0.9),
    CentreGeometry(4, 0.2, 0.4, 0.35, 0.3, 0.7),
)
HOME = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
TILTED = np.array((0.01, 0.02, 0.48, 0.05, -0.03, 0.04))


@pytest.fixture(scope="module", params=[3, 4], ids=["tripod", "quadruped"])
def bench(request):
    return make_held_centre(CentreGeometry(request.param), 1e-3)


@pytest.mark.parametrize("geometry", OTHERS, ids=["tripod", "quadruped"])
def test_bodies_of_other_dimensions_are_those_of_the_closed_form(geometry):
    bench = make_held_centre(geometry, 1e-3)
    root = bench.diagram.CreateDefaultContext()
    pose = TILTED.copy()
    pose[2] = 0.5 * (geometry.stroke_min + geometry.stroke_max) - 0.02
    bench.stand(root, pose)
    context, plant = bench.context(root), bench.model.plant
    joints = [actuator.joint() for actuator in bench.model.actuators]
    lengths = [joint.get_translation(context) for joint in joints]
    assert np.allclose(lengths, leg_lengths(geometry, pose), atol=1e-14)
    assert np.abs(feet_of(bench, root)[:, :3] - geometry.footholds[:, :3]).max() < 1e-14
    for limb in bench.model.limbs:
        tips = [
            plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(f"{side}_rod", limb))
            for side in ("left", "right")
        ]
        assert np.abs(tips[0].translation() - tips[1].translation()).max() < 1e-14
    for joint in joints:
        assert joint.position_lower_limits() == [geometry.stroke_min]
        assert joint.position_upper_limits() == [geometry.stroke_max]


def feet_of(bench, root):
    count = bench.model.geometry.limbs
    feet = [pose_of(bench.model.foot_pose(bench.context(root), i + 1)) for i in range(count)]
    return np.array(feet)


def angles_apart(first, second):
    return np.abs(np.remainder(first - second + np.pi, 2.0 * np.pi) - np.pi)


def test_positions_close_the_loops_and_put_the_feet_where_they_stand(bench):
    geometry, root = bench.model.geometry, bench.diagram.CreateDefaultContext()
    feet = geometry.footholds + np.random.default_rng(0).uniform(-0.02, 0.02, (geometry.limbs, 6))
    bench.stand(root, TILTED, feet)
    found = feet_of(bench, root)
    assert np.abs(found[:, :3] - feet[:, :3]).max() < 1e-14
    assert angles_apart(found[:, 3:], feet[:, 3:]).max() < 1e-12
    context, plant = bench.context(root), bench.model.plant
    for limb in bench.model.limbs:
        tips = [
            plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(f"{side}_rod", limb))
            for side in ("left", "right")
        ]
        assert np.abs(tips[0].translation() - tips[1].translation()).max() < 1e-14
    assert np.allclose(bench.pose(root), TILTED, atol=1e-14)


def test_lengths_of_the_joints_are_those_of_the_kinematics(bench):
    root = bench.diagram.CreateDefaultContext()
    bench.stand(root, TILTED)
    context = bench.context(root)
    lengths = [actuator.joint().get_translation(context) for actuator in bench.model.actuators]
    assert np.allclose(lengths, leg_lengths(bench.model.geometry, TILTED), atol=1e-14)


def test_legs_and_clamps_hold_the_platform(bench):
    simulator = Simulator(bench.diagram)
    root = simulator.get_mutable_context()
    bench.stand(root, TILTED)
    simulator.Initialize()
    simulator.AdvanceTo(0.3)
    moved = bench.pose(root) - TILTED
    assert np.abs(moved[:3]).max() < 1e-4
    assert np.abs(moved[3:]).max() < 1e-4
    assert angles_apart(feet_of(bench, root), bench.model.geometry.footholds).max() < 1e-4


def test_a_foot_swings_on_locked_joints_and_is_clamped_elsewhere_without_a_jump(bench):
    simulator = Simulator(bench.diagram)
    root, model = simulator.get_mutable_context(), bench.model
    geometry, lock_set = model.geometry, LockSet.printed(model.geometry, 1)
    bench.stand(root, HOME)
    context = bench.context(root)
    locks = close_locks(geometry, HOME, lock_set, along="left")
    model.lock(context, lock_set.joints)
    model.unclamp(context, 1)
    locked = [model.lock_joint(*joint).get_angle(context) for joint in lock_set.joints]
    simulator.Initialize()
    near, steps = HOME, 60
    for k in range(1, steps + 1):
        share = k / steps
        eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        lift = 0.03 * np.sin(np.pi * eased) ** 2
        foot = geometry.footholds[0] + (0.06 * eased, 0.0, lift, 0.0, 0.0, 0.0)
        found = swing_inverse(geometry, foot, locks, near)
        near = found.pose
        bench.hold(root, found.lengths)
        simulator.AdvanceTo(0.01 * k)
    simulator.AdvanceTo(0.01 * steps + 0.2)
    landed = feet_of(bench, root)[0]
    assert np.abs(landed - foot)[:3].max() < 1e-3
    assert np.abs(landed - foot)[3:].max() < 2e-3
    after = [model.lock_joint(*joint).get_angle(context) for joint in lock_set.joints]
    assert np.abs(np.subtract(after, locked)).max() == 0.0
    model.clamp(context, 1)
    model.lock(context, ())
    simulator.AdvanceTo(0.01 * steps + 0.4)
    assert np.abs(feet_of(bench, root)[0] - landed).max() < 1e-4
    assert np.abs(model.plant.GetVelocities(context)).max() < 1e-4
    assert np.abs(bench.pose(root) - near)[:3].max() < 1e-3


def test_sinking_of_the_held_feet_quarters_with_half_the_step():
    """A clamp is a constraint that yields by what a step of gravity and motion leaves: dt^2."""
    gaps = []
    for step in (4e-3, 2e-3, 1e-3):
        bench = make_held_centre(CentreGeometry(3), step)
        simulator = Simulator(bench.diagram)
        root = simulator.get_mutable_context()
        bench.stand(root, HOME)
        simulator.Initialize()
        simulator.AdvanceTo(0.4)
        feet = feet_of(bench, root)[:, :3]
        gaps.append(np.abs(feet - bench.model.geometry.footholds[:, :3]).max())
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.15)
    assert gaps[1] / gaps[2] == pytest.approx(4.0, rel=0.15)
