from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.walking_chair.chair import foot_corners
from parapod.systems.walking_chair.gait import (
    DIRECTIONS,
    ORDERS,
    TrotGait,
    gait_branches,
    gait_motion,
    gait_references,
)
from parapod.systems.walking_chair.geometry import ChairGeometry

CHAIR, GAIT = ChairGeometry(), TrotGait()
TIMES = np.linspace(0.0, 25.0, 5001)
GAITS = [
    TrotGait(order=order, direction=direction, cycles=cycles)
    for order in ORDERS
    for direction in DIRECTIONS
    for cycles in (1, 2)
]


def corners_of(motion, lengths):
    return foot_corners(CHAIR, motion.body.position, motion.body.rotation, lengths)


# Bodies and feet


def test_body_follows_equation_45():
    times = np.array((0.0, 2.0, 5.0, 9.0, 10.0, 12.0, 15.0, 17.0, 20.0, 21.0, 25.0))
    y = np.clip(20.54 * (times - 10.0), 0.0, 102.7)
    z = np.minimum(np.clip(22.94 * times, 0.0, 114.7), 114.7 - 22.94 * np.maximum(times - 20, 0.0))
    position = 1e3 * gait_motion(CHAIR, GAIT, times).body.position
    np.testing.assert_allclose(position[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(position[:, 1], y, rtol=0, atol=1e-10)
    np.testing.assert_allclose(position[:, 2] - 665.4, z, rtol=0, atol=1e-10)


def test_feet_support_but_while_their_pair_swings():
    support = gait_motion(CHAIR, GAIT, (2.0, 7.0, 12.0, 17.0, 22.0)).support
    all_four = [True] * 4
    first, second = [False, True, False, True], [True, False, True, False]
    assert support.tolist() == [all_four, first, all_four, second, all_four]


def test_which_feet_support_between_phases_depends_on_the_side():
    at = [gait_motion(CHAIR, GAIT, 10.0, side).support[0] for side in ("left", "right")]
    assert at == [False, True]


@pytest.mark.parametrize("gait", GAITS)
def test_supporting_feet_do_not_move_and_are_on_the_ground(gait):
    times = np.linspace(0.0, gait.duration, 2001)
    motion = gait_motion(CHAIR, gait, times)
    on_ground = motion.support
    np.testing.assert_array_equal(motion.feet.position[on_ground][:, 2], 0.0)
    np.testing.assert_array_equal(motion.feet.velocity[on_ground], 0.0)
    np.testing.assert_array_equal(motion.feet.acceleration[on_ground], 0.0)
    assert (motion.feet.position[~on_ground][:, 2] >= 0.0).all()


@pytest.mark.parametrize("gait", GAITS)
def test_nothing_jumps_but_velocities(gait):
    ends = gait.phase_duration * np.arange(len(gait.phases) + 1)
    before, after = (gait_motion(CHAIR, gait, ends, side) for side in ("left", "right"))
    for name in ("body", "feet"):
        one, other = getattr(before, name).position, getattr(after, name).position
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-15)


@pytest.mark.parametrize("side", ["left", "right"])
def test_chair_rests_before_and_after_the_gait(side):
    motion = gait_motion(CHAIR, GAIT, (-1.0, 26.0), side)
    np.testing.assert_allclose(
        motion.body.position, ((0, 0, 0.6654), (0, 0.1027, 0.6654)), rtol=0, atol=1e-15
    )
    for values in (motion.body.velocity, motion.feet.velocity, motion.feet.acceleration):
        assert not np.any(values)
    assert motion.support.all()


def test_all_feet_and_the_body_go_one_step_in_a_cycle():
    for gait in GAITS:
        start, end = (gait_motion(CHAIR, gait, t) for t in (0.0, gait.duration))
        way = (0.0, gait.cycles * gait.signed_step, 0.0)
        np.testing.assert_allclose(end.body.position - start.body.position, way, atol=1e-15)
        for foot in end.feet.position - start.feet.position:
            np.testing.assert_allclose(foot, way, rtol=0, atol=1e-15)


def test_start_is_where_the_body_stands():
    moved = gait_motion(CHAIR, replace(GAIT, start=(1.0, -2.0)), TIMES)
    here = gait_motion(CHAIR, GAIT, TIMES)
    for one, other in ((moved.body, here.body), (moved.feet, here.feet)):
        shift = one.position - other.position
        np.testing.assert_allclose(
            shift, np.broadcast_to((1.0, -2.0, 0.0), shift.shape), rtol=0, atol=1e-14
        )


@pytest.mark.parametrize("order", ORDERS)
def test_forward_and_then_back_returns_to_the_start(order):
    forward = TrotGait(order=order, cycles=2)
    there = gait_motion(CHAIR, forward, forward.duration)
    start = tuple(there.body.position[:2].tolist())
    back = replace(forward, direction="back", start=start)
    returned = gait_motion(CHAIR, back, back.duration).body.position
    np.testing.assert_allclose(
        returned, gait_motion(CHAIR, forward, 0.0).body.position, rtol=0, atol=1e-15
    )
    arrived = corners_of(there, gait_branches(CHAIR, forward, forward.duration).length)
    departs = corners_of(gait_motion(CHAIR, back, 0.0), gait_branches(CHAIR, back, 0.0).length)
    np.testing.assert_allclose(departs, arrived, rtol=0, atol=1e-12)


# Reference corners


def test_reference_corners_follow_from_the_side_the_feet_lean_to():
    assert gait_references(CHAIR, GAIT).tolist() == [1, 2, 2, 1]
    assert gait_references(CHAIR, replace(GAIT, order="24-13")).tolist() == [2, 1, 1, 2]
    assert gait_references(CHAIR, replace(GAIT, direction="back")).tolist() == [2, 1, 1, 2]


@pytest.mark.parametrize("gait", GAITS)
def test_no_corner_goes_into_the_ground_in_any_gait(gait):
    times = np.linspace(0.0, gait.duration, 2001)
    corners = corners_of(gait_motion(CHAIR, gait, times), gait_branches(CHAIR, gait, times).length)
    assert corners[..., 2].min() > -1e-9


@pytest.mark.parametrize(
    ("reference", "legs", "depth"), [("E1", (1, 2), 14.55), ("E2", (0, 3), 14.41)]
)
def test_corners_go_into_the_ground_with_one_corner_as_every_foots_reference(
    planned_for, reference, legs, depth
):
    motion, branches = planned_for(reference, GAIT, TIMES)
    lowest = 1e3 * corners_of(motion, branches.length)[..., 2].min(axis=(0, 2))
    for leg in range(4):
        assert lowest[leg] == pytest.approx(-depth if leg in legs else 0.0, abs=5e-3)


def test_supporting_feet_are_flat_while_others_swing():
    times = np.array((6.0, 9.0, 16.0, 19.0))
    motion = gait_motion(CHAIR, GAIT, times)
    corners = corners_of(motion, gait_branches(CHAIR, GAIT, times).length)
    np.testing.assert_allclose(corners[motion.support][..., 2], 0.0, atol=1e-12)
    assert motion.support.sum() == 8
