import numpy as np
import pytest

from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.gait import (
    DIRECTIONS,
    ORDERS,
    TrotGait,
    Walk,
    gait_branches,
    gait_motion,
    there_and_back,
)
from parapod.systems.walking_chair.geometry import ChairGeometry

CHAIR, GAIT = ChairGeometry(), TrotGait(cycles=2)
BOTH = there_and_back(GAIT)


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


def test_every_phase_begins_where_the_one_before_ends():
    for time in (0.0, *BOTH.ends):
        left, right = (lengths_of(BOTH, time, side) for side in ("left", "right"))
        np.testing.assert_allclose(left, right, rtol=0.0, atol=1e-12)


def test_there_and_back_ends_where_it_began():
    start, end = (BOTH.motion(CHAIR, time) for time in (0.0, BOTH.duration))
    np.testing.assert_allclose(end.body.position, start.body.position, atol=1e-12)
    np.testing.assert_allclose(
        lengths_of(BOTH, BOTH.duration), lengths_of(BOTH, 0.0), rtol=0.0, atol=1e-12
    )
    # The feet too; each gait has a corner of its own as their reference.
    middle = BOTH.motion(CHAIR, GAIT.duration)
    back = BOTH.motion(CHAIR, BOTH.duration)
    moved = (back.feet.position - middle.feet.position)[:, 1]
    np.testing.assert_allclose(moved, -2 * 0.1027, atol=1e-12)


def test_the_way_there_is_the_gait_and_the_way_back_is_its_reverse():
    for time in (0.0, 3.3, 17.0, GAIT.duration - 1e-9):
        expected = gait_motion(CHAIR, GAIT, time)
        np.testing.assert_array_equal(
            BOTH.motion(CHAIR, time).feet.position, expected.feet.position
        )
        later = gait_branches(CHAIR, GAIT.reversed(), time).length
        found = lengths_of(BOTH, GAIT.duration + time)
        np.testing.assert_allclose(found, later, rtol=0.0, atol=1e-12)


def test_phases_ends_and_standing_belong_together():
    count = 2 * len(GAIT.phases)
    assert len(BOTH.phases) == len(BOTH.ends) == len(BOTH.standing) == count == 16
    assert BOTH.phases == GAIT.phases * 2
    assert BOTH.standing == GAIT.standing + GAIT.reversed().standing
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
        Walk((GAIT, GAIT))


def test_a_walk_without_a_gait_is_refused():
    with pytest.raises(ValueError, match="needs a gait"):
        Walk(())
