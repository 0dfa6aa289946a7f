import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.machining_centre.branch import branch_joints, branch_joints_and_rates
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import displacement, leg_lengths, moved
from parapod.systems.machining_centre.swing import (
    LockSet,
    SingularSwing,
    close_locks,
    lock_conditions,
    lock_sets,
    swing_forward,
    swing_inverse,
)
from parapod.systems.machining_centre.wrench import wrench_indices

HOME = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
PITCHED = np.array((0.0, 0.0, 0.48, 0.0, 0.2, 0.0))
TRIPOD, QUADRUPED = CentreGeometry(3), CentreGeometry(4)


def swung(geometry, by, start=HOME, lock_set=None, **options):
    """A swing of limb 1 by a displacement of its foot."""
    locks = close_locks(geometry, start, lock_set or LockSet.printed(geometry, 1))
    return swing_inverse(geometry, geometry.footholds[0] + by, locks, start, **options), locks


def test_a_swing_from_a_tilted_pose_is_that_computed_by_another_program():
    found, locks = swung(TRIPOD, (0.02, 0.01, 0.015, 0.0, 0.02, 0.0), PITCHED)
    values = (0.0, 0.2332513871, 0.0, -0.4332513871, -0.0305427528, 0.0305427528)
    assert np.allclose(locks.values, values, atol=1e-10)
    pose = (0.0191793289, 0.0101904086, 0.5467897201, -0.006423643, 0.2199913512, -0.0027592878)
    assert np.allclose(found.pose, pose, atol=1e-9)
    lengths = (533.48709416, 532.58802298, 559.20130096, 580.35030646, 585.32668154, 562.44702764)
    assert np.allclose(1e3 * found.lengths, lengths, atol=1e-6)
    assert found.residual < 1e-12
    assert len(found.open_directions) == 0


def test_locked_joints_keep_their_values_and_legs_fit(geometry):
    by = np.array((0.03, 0.02, 0.02, 0.0, 0.0, 0.0))
    found, locks = swung(geometry, by)
    feet = geometry.footholds.copy()
    feet[0] += by
    joints = branch_joints(geometry, found.pose, feet)
    held = [joints[limb - 1, joint - 1] for limb, joint in locks.lock_set.joints]
    assert np.abs(held - locks.values).max() < 1e-12
    assert np.allclose(leg_lengths(geometry, found.pose, feet), found.lengths, atol=1e-15)


@pytest.mark.parametrize("steps", [1, 20])
def test_the_platform_of_a_flat_tripod_goes_across_the_loose_limb(steps):
    # p = p_0 + (I - l l^T) d, l along the loose limb, in steps or at once.
    by = np.array((0.1, 0.02, 0.03, 0.0, 0.0, 0.0))
    line = HOME[:3] + TRIPOD.middles[0] - TRIPOD.footholds[0, :3]
    line /= np.linalg.norm(line)
    locks, pose = close_locks(TRIPOD, HOME, LockSet.printed(TRIPOD, 1)), HOME
    for k in range(1, steps + 1):
        found = swing_inverse(TRIPOD, TRIPOD.footholds[0] + by * k / steps, locks, pose)
        pose = found.pose
    expected = HOME[:3] + by[:3] - line * (line @ by[:3])
    assert np.allclose(pose[:3], expected, atol=1e-9)
    assert np.allclose(pose[3:], 0.0, atol=1e-9)
    (open_direction,) = found.open_directions
    assert np.allclose(open_direction[:3], 0.0, atol=1e-9)
    assert np.allclose(np.abs(open_direction[3:] @ line), 1.0, atol=1e-9)


def test_a_foot_of_a_flat_tripod_cannot_be_tilted():
    with pytest.raises(SingularSwing, match=r"limb 1 cannot swing so: .*smallest singular value"):
        swung(TRIPOD, (0.0, 0.0, 0.0, 0.35, 0.0, 0.0))


def test_a_quadruped_tilts_its_foot_and_makes_100_mm_at_once():
    found, _ = swung(QUADRUPED, (0.0, 0.0, 0.0, 0.0, 0.35, 0.0))
    assert found.residual < 1e-12
    found, _ = swung(QUADRUPED, (0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert found.residual < 1e-12
    assert found.open_directions.shape == (2, 6)


def test_what_is_open_is_used_for_stroke_and_index(geometry):
    locks, by = close_locks(geometry, HOME, LockSet.printed(geometry, 1)), np.zeros(6)
    by[0] = 0.06
    poses = {}
    for freedom in (0.0, 2e-3):
        pose = HOME
        for k in range(1, 41):
            foot = geometry.footholds[0] + by * min(1.0, k / 20)
            pose = swing_inverse(geometry, foot, locks, pose, freedom=freedom).pose
        poses[freedom] = pose
    feet = geometry.footholds.copy()
    feet[0] += by
    still, used = (leg_lengths(geometry, pose, feet) for pose in poses.values())
    middle = 0.5 * (geometry.stroke_min + geometry.stroke_max)
    moved = np.linalg.norm(poses[2e-3] - poses[0.0])
    assert moved > 1e-3
    if geometry.limbs == 3:
        assert np.mean((used - middle) ** 4) < np.mean((still - middle) ** 4)
    else:
        indices = [
            wrench_indices(geometry, pose, feet, standing=(2, 3, 4)).w_minmax
            for pose in poses.values()
        ]
        assert indices[1] > indices[0]


def test_the_freedom_is_no_faster_than_asked():
    locks = close_locks(QUADRUPED, HOME, LockSet.printed(QUADRUPED, 1))
    found = swing_inverse(QUADRUPED, QUADRUPED.footholds[0], locks, HOME, freedom=1e-4)
    assert 1e-6 < np.linalg.norm((found.pose - HOME) * (1, 1, 1, 0.1, 0.1, 0.1)) < 1.1e-4


def test_the_paper_s_locks_hold_the_flat_tripod_but_do_not_determine_it():
    conditions = lock_conditions(TRIPOD, HOME, LockSet.printed(TRIPOD, 1))
    assert conditions.inverse == pytest.approx(0.0, abs=1e-12)
    assert conditions.holding == pytest.approx(0.0545902443, abs=1e-9)
    tilted = lock_conditions(TRIPOD, PITCHED, LockSet.printed(TRIPOD, 1))
    assert tilted.inverse > 0.01


@pytest.mark.parametrize(
    ("pair", "inverse", "holding"),
    [
        ("22 31", 0.046, 0.094),
        ("22 33", 0.046, 0.165),
        ("23 33", 0.033, 0.133),
        ("26 32", 0.046, 0.088),
        ("22 32", 0.0, 0.142),
        ("26 36", 0.076, 0.0),
    ],
)
def test_other_pairs_of_locks_have_the_values_computed_by_another_program(pair, inverse, holding):
    standing = tuple((int(word[0]), int(word[1])) for word in pair.split())
    conditions = lock_conditions(TRIPOD, HOME, LockSet(1, standing))
    assert conditions.inverse == pytest.approx(inverse, abs=5e-4)
    assert conditions.holding == pytest.approx(holding, abs=5e-4)


def test_three_limbs_hold_the_quadruped_without_locks():
    conditions = lock_conditions(QUADRUPED, np.stack((HOME, PITCHED)), LockSet(1))
    assert conditions.inverse.shape == (2,)
    assert (conditions.inverse > 0.1).all()
    assert (conditions.holding > 0.1).all()


def test_a_leg_that_would_leave_its_stroke_is_named():
    with pytest.raises(UnreachablePosture, match="of limb 1"):
        swung(QUADRUPED, (0.0, 0.0, -0.25, 0.0, 0.0, 0.0), longest=1.0)


def test_a_foot_that_is_no_number_is_refused_and_has_no_conditions():
    with pytest.raises(SingularSwing, match="limb 1 cannot swing so: a limb has no joint values"):
        swung(QUADRUPED, (np.nan, 0.0, 0.0, 0.0, 0.0, 0.0))
    conditions = lock_conditions(QUADRUPED, np.stack((HOME, HOME * np.nan)), LockSet(1))
    assert np.isnan(conditions.inverse).tolist() == [False, True]
    assert np.isnan(conditions.holding).tolist() == [False, True]


def test_a_jump_of_the_platform_is_refused():
    with pytest.raises(SingularSwing, match="may go 10 mm") as refused:
        swung(QUADRUPED, (0.1, 0.0, 0.0, 0.0, 0.0, 0.0), longest=0.01)
    assert refused.value.limb == 1
    assert refused.value.smallest_singular_value > 0.1


def test_feet_that_are_turned_by_half_a_turn_change_no_length():
    # Their q_1 is then near +-pi, and one turn away from where it was.
    by, turned = np.array((0.03, 0.02, 0.02, 0.0, 0.0, 0.0)), QUADRUPED.footholds.copy()
    turned[:, 5] += np.pi
    locks = close_locks(QUADRUPED, PITCHED, LockSet(1), turned)
    assert np.abs(np.abs(locks.values[0]) - np.pi) < 0.2
    for way in (by, by * (1.0, -1.0, 1.0, 1.0, 1.0, 1.0)):
        expected, _ = swung(QUADRUPED, way, PITCHED)
        found = swing_inverse(QUADRUPED, turned[0] + way, locks, PITCHED)
        assert np.allclose(found.lengths, expected.lengths, atol=1e-9)


def test_locks_that_are_not_kept_are_refused_beyond_the_tolerance():
    # Where a direction that the locks do determine is taken for open, they are off by a little.
    by = (0.002, 0.001, 0.0, 0.0, 0.002, 0.0)
    with pytest.raises(SingularSwing, match=r"off by \d+(\.\d+)? mrad") as refused:
        swung(TRIPOD, by, PITCHED, open_below=0.05)
    assert refused.value.limb == 1
    found, _ = swung(TRIPOD, by, PITCHED, open_below=0.05, tolerance=0.02)
    assert 1e-6 < found.residual < 0.02


@pytest.mark.parametrize(
    ("geometry", "lock_set", "says"),
    [
        (TRIPOD, LockSet(4), "must be one of 1..3"),
        (TRIPOD, LockSet(1), "2 joints of standing limbs must be locked, not 0"),
        (TRIPOD, LockSet(1, ((2, 1), (2, 1))), "2 joints of standing limbs"),
        (TRIPOD, LockSet(1, ((1, 1), (2, 1))), "joint 1 of limb 1 cannot be locked"),
        (TRIPOD, LockSet(1, ((2, 5), (3, 1))), "joint 5 of limb 2 cannot be locked"),
        (QUADRUPED, LockSet(1, ((5, 1),)), "limbs are 2, 3, 4"),
    ],
)
def test_lock_sets_that_do_not_fit_are_refused(geometry, lock_set, says):
    with pytest.raises(ValueError, match=says):
        close_locks(geometry, HOME, lock_set)


# Sets with which a tripod swings from this pose, far from its singularities.
ROLLED = np.array((0.01, -0.02, 0.49, 0.05, 0.12, 0.1))
SWINGS = [
    (TRIPOD, PITCHED, LockSet.printed(TRIPOD, 1)),
    (TRIPOD, ROLLED, LockSet(1, ((2, 3), (3, 6)))),
    (TRIPOD, ROLLED, LockSet(2, ((3, 3), (3, 6)))),
    (TRIPOD, ROLLED, LockSet(3, ((1, 2), (2, 1)))),
    (QUADRUPED, ROLLED, LockSet(1)),
    (QUADRUPED, PITCHED, LockSet(4)),
]
KINDS = pytest.mark.parametrize(("geometry", "start", "lock_set"), SWINGS)
ALONG = pytest.mark.parametrize("along", ["middle", "left"])


def small_ways(lock_set, count=6):
    rng = np.random.default_rng(lock_set.limb)
    ways = rng.uniform(-1.0, 1.0, (count, 6)) * (*(0.012,) * 3, *(0.01,) * 3)
    return ways


def feet_with(geometry, limb, foot):
    feet = geometry.footholds.copy()
    feet[limb - 1] = foot
    return feet


def values_of(geometry, pose, feet, locks):
    return close_locks(geometry, pose, locks.lock_set, feet, along=locks.along).values


@ALONG
@KINDS
def test_lengths_of_a_swing_lead_back_to_platform_and_foot(geometry, start, lock_set, along):
    locks = close_locks(geometry, start, lock_set, along=along)
    for way in small_ways(lock_set):
        foot = geometry.footholds[lock_set.limb - 1] + way
        found = swing_inverse(geometry, foot, locks, start)
        back = swing_forward(geometry, found.lengths, locks, start)
        assert np.allclose(back.pose, found.pose, atol=1e-10)
        assert np.abs(displacement(foot, back.foot_pose)).max() < 1e-10
        assert np.array_equal(found.foot_pose, foot)
        assert back.residual < 1e-11
        conditions = lock_conditions(
            *(geometry, found.pose, lock_set),
            feet_with(geometry, lock_set.limb, foot),
            along=along,
        )
        assert back.smallest_singular_value == pytest.approx(conditions.holding, rel=1e-6)
        assert found.smallest_singular_value == pytest.approx(
            conditions.inverse, rel=1e-6, abs=1e-12
        )


@ALONG
@pytest.mark.parametrize("limb", [1, 2, 3])
def test_every_set_that_holds_a_tripod_leads_back(limb, along):
    tried = 0
    for lock_set in lock_sets(TRIPOD, limb):
        at = lock_conditions(TRIPOD, ROLLED, lock_set, along=along)
        if min(at.inverse, at.holding) < 0.03:
            continue
        locks, tried = close_locks(TRIPOD, ROLLED, lock_set, along=along), tried + 1
        foot = TRIPOD.footholds[limb - 1] + (0.002, -0.003, 0.004, 0.002, -0.001, 0.003)
        found = swing_inverse(TRIPOD, foot, locks, ROLLED)
        back = swing_forward(TRIPOD, found.lengths, locks, ROLLED)
        assert np.allclose(back.pose, found.pose, atol=1e-10)
        assert np.abs(displacement(foot, back.foot_pose)).max() < 1e-10
    assert tried >= 3


@ALONG
@pytest.mark.parametrize(("geometry", "start", "lock_set"), SWINGS[1:])
def test_a_foot_that_may_turn_keeps_all_locks_where_it_is_told_to_be(
    geometry, start, lock_set, along
):
    locks, limb = close_locks(geometry, start, lock_set, along=along), lock_set.limb
    turned = []
    for way in small_ways(lock_set):
        asked = geometry.footholds[limb - 1] + way
        found = swing_inverse(geometry, asked, locks, start, turns=True)
        off = displacement(asked, found.foot_pose)
        third = rotation_of(asked)[:, 2]
        # Only about its own axis.
        assert np.allclose(off[:3], (off[:3] @ third) * third, atol=1e-12)
        assert np.allclose(off[3:], 0.0, atol=1e-15)
        turned.append(abs(off[:3] @ third))
        feet = feet_with(geometry, limb, found.foot_pose)
        assert np.allclose(values_of(geometry, found.pose, feet, locks), locks.values, atol=1e-10)
        back = swing_forward(geometry, found.lengths, locks, start)
        assert np.allclose(back.pose, found.pose, atol=1e-9)
        assert np.abs(displacement(found.foot_pose, back.foot_pose)).max() < 1e-9
    if geometry.limbs == 3:
        assert max(turned) > 1e-3


def rotation_of(pose):
    return Rotation.from_euler("xyz", pose[3:]).as_matrix()


@pytest.mark.parametrize("geometry", [TRIPOD, QUADRUPED], ids=["tripod", "quadruped"])
def test_turning_leaves_out_the_loose_foot_s_first_joint_and_no_other(geometry):
    lock_set = LockSet(1, ((2, 3), (3, 6))) if geometry.limbs == 3 else LockSet(1)
    rates = branch_joints_and_rates(geometry, ROLLED)[1] * (1, 1, 1, 0.1, 0.1, 0.1)
    for turns, joints in ((False, lock_set.joints), (True, lock_set.joints[1:])):
        rows = np.array([rates[limb - 1, joint - 1] for limb, joint in joints])
        expected = np.linalg.svd(rows, compute_uv=False)[-1]
        at = lock_conditions(geometry, ROLLED, lock_set, turns=turns)
        assert at.inverse == pytest.approx(expected, rel=1e-9)
        held = lock_conditions(geometry, ROLLED, lock_set)
        assert at.holding == held.holding
    assert lock_set.joints[0] == (1, 1)


def test_one_direction_more_is_open_where_the_foot_may_turn():
    for geometry, count in ((TRIPOD, 0), (QUADRUPED, 2)):
        lock_set = LockSet(1, ((2, 3), (3, 6))) if geometry.limbs == 3 else LockSet(1)
        locks = close_locks(geometry, ROLLED, lock_set)
        for turns in (False, True):
            found = swing_inverse(geometry, geometry.footholds[0], locks, ROLLED, turns=turns)
            assert len(found.open_directions) == count + turns


@pytest.mark.parametrize("turns", [False, True])
def test_where_a_platform_is_wanted_decides_what_is_open_and_nothing_else(turns):
    geometry, lock_set = QUADRUPED, LockSet(2)
    locks = close_locks(geometry, ROLLED, lock_set, along="left")
    foot = geometry.footholds[1] + (0.004, 0.003, 0.006, 0.002, 0.0, 0.001)
    nearest = swing_inverse(geometry, foot, locks, ROLLED, turns=turns)
    directions, unit = nearest.open_directions, np.array((1, 1, 1, 0.1, 0.1, 0.1))
    assert len(directions) == 2 + turns
    wanted = moved(ROLLED, np.array((0.01, 0.01, -0.01, 0.003, -0.004, 0.002)))
    found = swing_inverse(geometry, foot, locks, ROLLED, toward=wanted, turns=turns)
    feet = feet_with(geometry, 2, found.foot_pose)
    assert np.allclose(values_of(geometry, found.pose, feet, locks), locks.values, atol=1e-9)
    left = displacement(found.pose, wanted) / unit
    # Nothing is left of it in open directions, but for what these turn on the way.
    before = displacement(ROLLED, wanted) / unit
    assert np.linalg.norm(found.open_directions @ left) < 0.02 * np.linalg.norm(before)
    gone = displacement(nearest.pose, found.pose) / unit
    assert np.linalg.norm(gone) > 0.3 * np.linalg.norm(directions @ before)
    # Where it is wanted with every lock kept it comes exactly, from anywhere near.
    again = swing_inverse(geometry, foot, locks, ROLLED, toward=found.pose, turns=turns)
    assert np.allclose(again.pose, found.pose, atol=1e-6)


def test_a_platform_that_is_determined_goes_nowhere_else_for_being_wanted_there():
    lock_set = LockSet(1, ((2, 3), (3, 6)))
    locks = close_locks(TRIPOD, ROLLED, lock_set)
    foot = TRIPOD.footholds[0] + (0.004, 0.003, 0.006, 0.002, 0.0, 0.001)
    free = swing_inverse(TRIPOD, foot, locks, ROLLED)
    led = swing_inverse(TRIPOD, foot, locks, ROLLED, toward=HOME)
    assert np.allclose(led.pose, free.pose, atol=1e-12)


@pytest.mark.parametrize("turns", [False, True])
@KINDS
def test_a_last_step_leaves_about_its_square(geometry, start, lock_set, turns):
    locks, limb = close_locks(geometry, start, lock_set, along="left"), lock_set.limb
    way = np.array((0.5, -0.3, 0.4, 0.3, -0.2, 0.4)) * (*(1.0,) * 3, *(5.0,) * 3)
    left = []
    for size in (2e-3, 1e-3):
        foot = geometry.footholds[limb - 1] + size * way
        one = swing_inverse(
            *(geometry, foot, locks, start), last_step=1.0, tolerance=1.0, turns=turns
        )
        feet = feet_with(geometry, limb, one.foot_pose)
        off = values_of(geometry, one.pose, feet, locks) - locks.values
        exact = swing_inverse(geometry, foot, locks, start, turns=turns)
        step = np.linalg.norm(displacement(start, exact.pose) / (1, 1, 1, 0.1, 0.1, 0.1))
        assert np.abs(off).max() < 3.0 * step**2
        left.append(np.abs(off).max())
    assert left[0] / left[1] == pytest.approx(4.0, rel=0.15)


def test_a_swing_of_one_step_back_leaves_its_square_too():
    locks = close_locks(TRIPOD, ROLLED, LockSet(1, ((2, 3), (3, 6))), along="left")
    way, left = np.array((0.5, -0.3, 0.4, 0.6, -0.5, 0.4)), []
    for size in (2e-3, 1e-3):
        foot = TRIPOD.footholds[0] + size * way
        found = swing_inverse(TRIPOD, foot, locks, ROLLED)
        one = swing_forward(TRIPOD, found.lengths, locks, ROLLED, last_step=1.0)
        left.append(np.abs(displacement(one.pose, found.pose)).max())
    assert 0.0 < left[0] < 1e-4
    assert left[0] / left[1] == pytest.approx(4.0, rel=0.15)


def test_legs_that_nothing_holds_have_no_posture():
    # A quarter of a turn: the known singularity of such platforms.
    pose = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
    locks = close_locks(TRIPOD, pose, LockSet(1, ((2, 6), (3, 6))))
    assert lock_conditions(TRIPOD, pose, locks.lock_set).holding < 1e-9
    with pytest.raises(SingularSwing, match="does not hold the platform"):
        swing_forward(TRIPOD, leg_lengths(TRIPOD, pose), locks, pose)
    with pytest.raises(SingularSwing):
        swing_forward(
            QUADRUPED, np.full(8, np.nan), close_locks(QUADRUPED, HOME, LockSet(1)), HOME
        )
