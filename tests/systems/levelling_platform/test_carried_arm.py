"""Platform and arm as one chain: what is reached is reached, and what is not is said."""

import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.serial_arm import ArmJoint, ArmLink, SerialArm
from parapod.systems.levelling_platform.carried_arm import BarredTip, CarriedArm, UnreachableTip
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.statics import PAPER_ARM, KinematicPlatformParams
from parapod.systems.levelling_platform.tip import TipReach

GEOMETRY = PlatformGeometry(foot_radius=0.025)
TILTED = math.radians(2.0), math.radians(3.0)
BASE = 0.3, 0.2, 0.1


def six_joints():
    """A wrist on an elbow on a shoulder, of half the paper's size."""
    turn = math.tau
    places = ((0.0, 0.0, 0.3), (0.0, 0.14, 0.0), (0.0, -0.13, 0.43), (0.0, 0.0, 0.39))
    places += ((0.0, 0.13, 0.0), (0.0, 0.0, 0.1))
    z, y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)
    joints = [
        ArmJoint(f"joint_{i}", place, axis=axis, lower=-turn, upper=turn)
        for i, (place, axis) in enumerate(zip(places, (z, y, y, y, z, y), strict=True))
    ]
    sideways = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))
    return SerialArm(tuple(joints), (ArmLink(1.0),) * 6, (0.0, 0.1, 0.0), sideways)


def carried(arm=PAPER_ARM, rod=None, ground=TILTED, **settings):
    params = KinematicPlatformParams(arm=arm)
    return CarriedArm(GEOMETRY, params, rod, ground, margin=0.05, base=BASE, **settings)


CASES = {
    "rigid": carried(),
    "flexible": carried(rod=FlexibleRod()),
    "uneven": carried(foot_offsets=(0.004, 0.0, 0.002, -0.003)),
    "six joints": carried(six_joints()),
}


def places(platform, random, count):
    """Points at which the tip is in some posture, out of the base and above the ground."""
    joints = random.uniform(-1.2, 1.2, (8 * count, platform.arm.count))
    posture = platform.postures[0] + random.uniform(-1.0, 1.0, (8 * count, 3)) * [0.01, 0.01, 2e-3]
    points = platform.tip_position(posture, joints)
    is_fit = points[:, 2] > 0.8
    return points[is_fit][:count], posture[is_fit][:count], joints[is_fit][:count]


@pytest.mark.parametrize("platform", CASES.values(), ids=CASES.keys())
def test_the_tip_is_where_it_is_wanted(platform):
    points, *_ = places(platform, np.random.default_rng(1), 6)
    for point in points:
        reach = platform.reach(point)
        solution = reach.solution
        there = platform.tip_position(solution.posture, solution.joints)
        np.testing.assert_allclose(there, point, atol=1e-9)
        legs = inverse_kinematics(
            GEOMETRY, solution.posture, platform.ground, platform.foot_offsets
        )
        np.testing.assert_allclose(legs, solution.extension, atol=1e-12)
        assert solution.stroke_left >= 0.0
        assert reach.margin >= platform.margin


def test_a_tip_looks_where_it_should():
    platform = CASES["six joints"]
    random = np.random.default_rng(2)
    points, postures, joints = places(platform, random, 5)
    for point, view in zip(points, platform.view(postures, joints), strict=True):
        solution = platform.reach(point, view=view).solution
        np.testing.assert_allclose(
            platform.view(solution.posture, solution.joints), view, atol=1e-6
        )
        assert solution.error < 1e-9


@pytest.mark.parametrize("which", [0, 1], ids=["level", "legs in mid-stroke"])
@pytest.mark.parametrize("rod", [None, FlexibleRod()], ids=["rigid", "flexible"])
def test_the_chain_of_a_rod_on_a_turntable_is_its_closed_form(which, rod):
    roll, pitch, height = carried().postures[which].tolist()
    closed = TipReach(GEOMETRY, PAPER_ARM, rod, TILTED, (roll, pitch))
    joints = np.random.default_rng(3).uniform(-1.0, 1.0, (50, 2))
    ours = carried(rod=rod).tip_position((roll, pitch, height), joints)
    np.testing.assert_allclose(ours, closed.tip_position(height, joints), atol=1e-9)


def test_the_legs_do_only_what_the_arm_cannot():
    """The platform under six joints stays level in the middle of its heights."""
    platform = CASES["six joints"]
    points, *_ = places(platform, np.random.default_rng(4), 4)
    for point in points:
        posture = platform.reach(point).solution.posture
        np.testing.assert_allclose(posture, platform.postures[0], atol=1e-4)


def test_derivatives_are_those_of_the_tip():
    platform = CASES["flexible"]
    posture, joints = platform.postures[0], np.array([0.4, 0.8])
    jacobian = platform.posture_jacobian(posture, joints)
    step = 1e-5 * np.eye(3)
    forth, back = (platform.tip_position(posture + s * step, joints) for s in (1.0, -1.0))
    np.testing.assert_allclose(jacobian, (forth - back).T / 2e-5, atol=1e-5)


def test_a_batch_is_its_rows():
    platform = CASES["flexible"]
    random = np.random.default_rng(5)
    joints = random.uniform([0.0, 0.3], [0.6, 0.9], (5, 2))
    points = platform.tip_position(platform.postures[0], joints)
    batch = platform.solve(points, [0.3, 0.6])
    assert (batch.error < 1e-9).all()
    for i, point in enumerate(points):
        row = platform.solve(point, [0.3, 0.6])
        np.testing.assert_allclose(batch.joints[i], row.joints, atol=1e-9)
        np.testing.assert_allclose(batch.posture[i], row.posture, atol=1e-9)


def test_a_far_point_is_refused_with_the_nearest_one():
    platform = CASES["rigid"]
    point = np.array([1.8, 0.2, 1.2])
    with pytest.raises(UnreachableTip, match=r"does not reach .* nearest") as caught:
        platform.reach(point)
    nearest = caught.value.nearest
    assert platform.reach(nearest, [0.1, 1.2]).solution.error < 1e-6
    # Nothing that the tip reaches is nearer.
    random = np.random.default_rng(6)
    joints = random.uniform([-0.3, 0.9], [0.5, 1.55], (2000, 2))
    posture = np.array([0.0, 0.0, 0.478]) + random.uniform(-1.0, 1.0, (2000, 3)) * [
        *(0.06, 0.06),
        0.08,
    ]
    legs = inverse_kinematics(GEOMETRY, posture, TILTED, on_unreachable="nan")
    fits = np.isfinite(legs).all(axis=1)
    assert fits.sum() > 100
    away = np.linalg.norm(platform.tip_position(posture[fits], joints[fits]) - point, axis=1)
    assert away.min() >= np.linalg.norm(nearest - point) - 1e-6


def test_a_view_that_the_arm_does_not_have_is_refused():
    """A rod looks along itself, wherever its point is."""
    with pytest.raises(BarredTip, match="cannot look along its view"):
        CASES["rigid"].reach((1.36, 0.81, 1.89), view=(0.0, 0.0, -1.0))


def test_a_point_inside_the_machine_is_refused():
    platform = CASES["six joints"]
    with pytest.raises(BarredTip, match="in the platform's base"):
        platform.reach((0.05, 0.0, 0.43))


def test_a_platform_that_would_nearly_tip_is_refused():
    platform = replace(CASES["rigid"], margin=0.6)
    with pytest.raises(BarredTip, match="mm would be left to the edge between the feet"):
        platform.reach((1.36, 0.81, 1.89))


@pytest.mark.parametrize("ground", [(1e6, 1e6), (1e308, -1e308), (2.5, 0.0)])
def test_ground_on_which_no_platform_stands_is_refused(ground):
    carried = CarriedArm(GEOMETRY, KinematicPlatformParams(), ground=ground)
    with np.errstate(all="ignore"), pytest.raises(BarredTip, match="does not stand on ground"):
        carried.reach([1.0, 0.0, 2.0])


def test_the_extent_holds_every_place():
    platform = CASES["rigid"]
    low, high = platform.extent
    assert (low < (-1.9, -1.9, 0.5)).all()
    assert (high > (1.9, 1.9, 2.6)).all()
