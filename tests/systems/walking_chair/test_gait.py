"""The trotting gait: its phases and its motion, and walks that are made of gaits."""

import math
from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.gait import (
    DIRECTIONS,
    ORDERS,
    TrotGait,
    Walk,
    gait_branches,
    gait_motion,
    gait_references,
    there_and_back,
)
from parapod.systems.walking_chair.geometry import ChairGeometry

GAIT = TrotGait()


def test_one_cycle_takes_25_seconds_of_five_phases():
    assert GAIT.phases == ("lift", "first swing", "shift", "second swing", "lower")
    assert GAIT.duration == 25.0


def test_further_cycles_repeat_the_three_steps_between_one_lift_and_one_lowering():
    gait = TrotGait(cycles=3)
    assert gait.phases == (
        "lift", *("first swing", "shift", "second swing") * 3, "lower"
    )  # fmt: skip
    assert gait.duration == 55.0


@pytest.mark.parametrize(
    ("order", "pairs"), [("13-24", ((0, 2), (1, 3))), ("24-13", ((1, 3), (0, 2)))]
)
def test_order_names_the_pairs(order, pairs):
    assert TrotGait(order=order).pairs == pairs


def test_direction_is_the_sign_of_the_step():
    assert GAIT.signed_step == 0.1027
    assert TrotGait(direction="back").signed_step == -0.1027


def test_times_belong_to_the_phase_that_they_are_in():
    index, share = GAIT.locate([-1.0, 2.5, 6.0, 24.0, 30.0])
    assert index.tolist() == [-1, 0, 1, 4, 5]
    np.testing.assert_allclose(share[1:4], (0.5, 0.2, 0.8), rtol=1e-14)


def test_a_time_between_two_phases_belongs_to_the_one_on_the_side_asked_for():
    ends = 5.0 * np.arange(6)
    right, share = GAIT.locate(ends)
    assert right.tolist() == [0, 1, 2, 3, 4, 5]
    np.testing.assert_array_equal(share, 0.0)
    left, share = GAIT.locate(ends, "left")
    assert left.tolist() == [-1, 0, 1, 2, 3, 4]
    np.testing.assert_array_equal(share[1:], 1.0)


@pytest.mark.parametrize("time", [math.nan, math.inf, [0.0, math.nan]])
def test_a_time_that_is_not_finite_is_refused(time):
    with pytest.raises(ValueError, match="times must be finite"):
        GAIT.locate(time)


def test_an_unknown_side_is_refused_with_those_that_are():
    with pytest.raises(ValueError, match="one of right, left, not 'middle'"):
        GAIT.locate(0.0, "middle")


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("order", "12-34", "13-24, 24-13"),
        ("direction", "sideways", "forward, back"),
        ("body_law", "cubic", "linear, ramped, cycloid, quintic"),
    ],
)
def test_unknown_names_are_refused_with_the_admissible_ones(name, value, allowed):
    with pytest.raises(ValueError, match=f"{name} must be one of {allowed}, not '{value}'"):
        replace(GAIT, **{name: value})


@pytest.mark.parametrize("cycles", [0, -1, 1.5, "2"])
def test_cycles_are_counted(cycles):
    with pytest.raises(ValueError, match="cycles must be a whole number"):
        TrotGait(cycles=cycles)


@pytest.mark.parametrize("name", ["lift", "step", "swing_height", "phase_duration"])
@pytest.mark.parametrize("value", [0.0, -0.1, math.nan, math.inf])
def test_sizes_that_are_not_positive_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"{name} must be positive"):
        replace(GAIT, **{name: value})


@pytest.mark.parametrize("start", [(0.0,), (0.0, math.nan), (0.0, 0.0, 0.0)])
def test_a_start_that_is_no_place_is_refused(start):
    with pytest.raises(ValueError, match="start must be two finite numbers"):
        replace(GAIT, start=start)


def test_feet_that_stand_are_those_that_do_not_swing():
    gait = TrotGait(order="24-13", cycles=2)
    assert len(gait.standing) == len(gait.phases) == 8
    swinging = [tuple(leg + 1 for leg in range(4) if not row[leg]) for row in gait.standing]
    assert swinging == [(), (2, 4), (), (1, 3), (2, 4), (), (1, 3), ()]


@pytest.mark.parametrize(
    ("time", "side", "phase"),
    [(-1.0, "right", 0), (0.0, "left", 0), (5.0, "right", 1), (5.0, "left", 0), (7.0, "left", 1),
     (24.9, "right", 4), (25.0, "right", 4), (99.0, "right", 4)],
)  # fmt: skip
def test_a_time_has_a_phase_even_before_and_after_the_gait(time, side, phase):
    assert TrotGait().phase_at(time, side) == phase


def test_the_reversed_gait_leads_back_to_the_start():
    gait = TrotGait(cycles=3, start=(0.1, -0.2))
    back = gait.reversed()
    assert back.direction == "back"
    assert back.start == gait.end == pytest.approx((0.1, -0.2 + 3 * gait.step))
    assert back.end == pytest.approx(gait.start)
    assert back.reversed().direction == "forward"


CHAIR = ChairGeometry()
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


TWICE = TrotGait(cycles=2)
BOTH = there_and_back(TWICE)


def lengths_of(walk, time, side="right"):
    motion = walk.motion(CHAIR, time, side)
    body = motion.body.position
    return chair_inverse(CHAIR, body, np.eye(3), motion.feet.position, motion.references)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_lengths_are_continuous_where_one_gait_follows_another(order, direction):
    walk = there_and_back(TrotGait(order=order, direction=direction, body_law="cycloid"))
    junction = walk.gaits[0].duration
    before, after = (lengths_of(walk, junction, side) for side in ("left", "right"))
    np.testing.assert_allclose(before, after, rtol=0.0, atol=1e-12)
    for step in (1e-6, -1e-6):
        assert np.abs(lengths_of(walk, junction + step) - after).max() < 1e-9


def test_there_and_back_ends_where_it_began():
    start, end = (BOTH.motion(CHAIR, time) for time in (0.0, BOTH.duration))
    np.testing.assert_allclose(end.body.position, start.body.position, atol=1e-12)
    np.testing.assert_allclose(
        lengths_of(BOTH, BOTH.duration), lengths_of(BOTH, 0.0), rtol=0.0, atol=1e-12
    )
    # The feet too; each gait has a corner of its own as their reference.
    middle = BOTH.motion(CHAIR, TWICE.duration)
    back = BOTH.motion(CHAIR, BOTH.duration)
    moved = (back.feet.position - middle.feet.position)[:, 1]
    np.testing.assert_allclose(moved, -2 * 0.1027, atol=1e-12)


def test_the_way_there_is_the_gait_and_the_way_back_is_its_reverse():
    for time in (0.0, 3.3, 17.0, TWICE.duration - 1e-9):
        expected = gait_motion(CHAIR, TWICE, time)
        np.testing.assert_array_equal(
            BOTH.motion(CHAIR, time).feet.position, expected.feet.position
        )
        later = gait_branches(CHAIR, TWICE.reversed(), time).length
        found = lengths_of(BOTH, TWICE.duration + time)
        np.testing.assert_allclose(found, later, rtol=0.0, atol=1e-12)


def test_phases_ends_and_standing_belong_together():
    count = 2 * len(TWICE.phases)
    assert len(BOTH.phases) == len(BOTH.ends) == len(BOTH.standing) == count == 16
    assert BOTH.phases == TWICE.phases * 2
    assert BOTH.standing == TWICE.standing + TWICE.reversed().standing
    assert np.diff((0.0, *BOTH.ends)) == pytest.approx(5.0)
    assert BOTH.ends[-1] == pytest.approx(BOTH.duration)
    for index, (begin, end) in enumerate(zip((0.0, *BOTH.ends), BOTH.ends, strict=False)):
        middle = 0.5 * (begin + end)
        assert BOTH.phase_at(middle) == index
        support = BOTH.motion(CHAIR, middle).support
        assert tuple(support.tolist()) == BOTH.standing[index]


def test_a_time_between_two_phases_belongs_to_either_side():
    for index, end in enumerate(BOTH.ends[:-1]):
        assert BOTH.phase_at(end, "left") == index
        assert BOTH.phase_at(end, "right") == index + 1


def test_what_jumps_between_two_phases_is_seen_from_either_side():
    # By Eq. (45) the lift ends, and the lowering of the first gait begins, with a step.
    for end, left, right in ((5.0, 0.02294, 0.0), (35.0, 0.0, -0.02294), (80.0, -0.02294, 0.0)):
        velocities = [BOTH.motion(CHAIR, end, side).body.velocity[2] for side in ("left", "right")]
        assert velocities == pytest.approx((left, right))
        assert (
            tuple(BOTH.motion(CHAIR, end, "left").support)
            == BOTH.standing[BOTH.phase_at(end, "left")]
        )


def test_before_and_after_the_walk_it_rests():
    assert BOTH.phase_at(-3.0) == 0
    assert BOTH.phase_at(BOTH.duration + 3.0) == len(BOTH.phases) - 1
    for outside, at in ((-1.0, 0.0), (BOTH.duration + 1.0, BOTH.duration)):
        motion = BOTH.motion(CHAIR, outside)
        assert not np.any(motion.body.velocity)
        assert not np.any(motion.feet.velocity)
        np.testing.assert_allclose(lengths_of(BOTH, outside), lengths_of(BOTH, at), atol=1e-12)


def test_motions_at_many_times_are_those_at_each():
    times = np.array([0.0, 2.5, 7.5, 39.9, 40.0, 41.0, 63.0, 80.0, 99.0])
    together = BOTH.motions(CHAIR, times)
    for k, time in enumerate(times.tolist()):
        one = BOTH.motion(CHAIR, time)
        np.testing.assert_array_equal(together.body.position[k], one.body.position)
        np.testing.assert_array_equal(together.body.velocity[k], one.body.velocity)
        np.testing.assert_array_equal(together.feet.position[k], one.feet.position)
        np.testing.assert_array_equal(together.feet.acceleration[k], one.feet.acceleration)
        np.testing.assert_array_equal(together.references[k], one.references)
        np.testing.assert_array_equal(together.support[k], one.support)


def test_gaits_that_do_not_join_are_refused():
    with pytest.raises(ValueError, match=r"starts at \(0.0, 0.0\) cannot follow .* at \(0.0, 0.2"):
        Walk((TWICE, TWICE))


def test_a_walk_without_a_gait_is_refused():
    with pytest.raises(ValueError, match="needs a gait"):
        Walk(())
