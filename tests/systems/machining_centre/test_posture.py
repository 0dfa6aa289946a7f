import numpy as np
import pytest

from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import swung_to
from parapod.systems.machining_centre.platform_mode import displacement, leg_lengths, moved
from parapod.systems.machining_centre.posture import (
    CentrePosture,
    Posture,
    closed_locks,
    lockable_joints,
    posture_of,
)
from parapod.systems.machining_centre.swing import LOCKABLE, LockSet, close_locks

HOME = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
TILTED = np.array((0.01, -0.01, 0.49, 0.05, 0.1, 0.08))
PERIOD = 0.01


def lock_set_of(geometry, limb=1):
    if geometry.limbs == 4:
        return LockSet(limb)
    others = [other for other in (1, 2, 3) if other != limb]
    return LockSet(limb, ((others[0], 3), (others[1], 6)))


def switches(geometry, lock_set=None):
    closed = np.zeros((geometry.limbs, 4))
    for limb, joint in lock_set.joints if lock_set else ():
        closed[limb - 1, LOCKABLE.index(joint)] = 1.0
    return closed.ravel()


@pytest.fixture
def stand(stand, geometry):
    """stand(**options): the system on its feet, everything clamped, at a tilted pose."""

    def make(**options):
        system = CentrePosture(geometry, PERIOD, TILTED, **options)
        return stand(
            system,
            position=leg_lengths(geometry, TILTED),
            locks_closed=switches(geometry),
            clamps_closed=np.ones(geometry.limbs),
        )

    return make


def walk_foot(geometry, machine, lock_set, way, count=25):
    """Leads the loose foot on by a way, in steps; platform and foot at the end."""
    limb, pose = lock_set.limb, machine["pose"]
    feet = machine["feet"].reshape(-1, 6)
    locks = close_locks(geometry, pose, lock_set, feet, along="left")
    begun = feet[limb - 1].copy()
    for k in range(1, count + 1):
        share = k / count
        found = swung_to(geometry, locks, begun + share * way, pose)
        pose, feet[limb - 1] = found.pose, found.foot_pose
        machine.tick(position=found.lengths)
        assert np.allclose(machine["pose"], pose, atol=2e-5)
        assert np.allclose(machine["feet"].reshape(-1, 6), feet, atol=2e-5)
        assert machine["is_determined"][0] == 1.0
    return pose, feet


def test_a_platform_stays_where_it_is_while_the_loose_foot_rests(geometry):
    limb = lock_set_of(geometry).limb
    locks = close_locks(geometry, TILTED, lock_set_of(geometry), geometry.footholds, along="left")
    found = swung_to(geometry, locks, geometry.footholds[limb - 1], TILTED)
    np.testing.assert_allclose(found.pose, TILTED, atol=1e-12)


def test_a_clamped_platform_is_followed_by_its_lengths(geometry, stand):
    machine = stand()
    for k in range(1, 40):
        twist = 0.01 * k * np.array((0.1, -0.2, 0.15, 0.05, 0.03, 0.04))
        pose = moved(TILTED, twist)
        machine.tick(position=leg_lengths(geometry, pose))
        assert np.abs(displacement(pose, machine["pose"])).max() < 1e-9
        assert np.array_equal(machine["feet"], geometry.footholds.ravel())
        expected = lockable_joints(geometry, Posture(pose, geometry.footholds))
        assert np.allclose(machine["joints"], expected.ravel(), atol=1e-8)


def test_a_foot_is_followed_over_locks_clamps_and_a_swing_without_a_jump(geometry, stand):
    machine, lock_set = stand(), lock_set_of(geometry)
    loose = np.ones(geometry.limbs)
    loose[0] = 0.0
    begun = machine["pose"], machine["feet"]

    def check_rest(pose, feet):
        machine.tick(2)
        assert np.abs(displacement(pose, machine["pose"])).max() < 1e-9
        assert np.abs(machine["feet"] - feet.ravel()).max() < 1e-9

    machine.set(locks_closed=switches(geometry, lock_set))
    check_rest(*begun)
    values = lockable_joints(geometry, Posture(TILTED, geometry.footholds)).ravel()
    closed = switches(geometry, lock_set) > 0.5
    assert np.allclose(machine["locked_at"][closed], values[closed], atol=1e-12)
    assert not machine["locked_at"][~closed].any()
    machine.set(clamps_closed=loose)
    check_rest(*begun)
    way = np.array((0.015, 0.01, 0.012, 0.0, 0.0, 0.0))
    walk_foot(geometry, machine, lock_set, way)
    machine.tick(3)  # what a step leaves is made up for at rest
    landed = machine["pose"], machine["feet"]
    assert np.allclose(landed[1][:3], geometry.footholds[0, :3] + way[:3], atol=2e-5)
    assert np.allclose(machine["joints"][closed], values[closed], atol=2e-5)
    assert np.array_equal(machine["locked_at"][closed], values[closed])
    machine.set(clamps_closed=np.ones(geometry.limbs))
    check_rest(*landed)
    machine.set(locks_closed=switches(geometry))
    check_rest(*landed)
    # From now on its lengths are those of the new foothold.
    pose = moved(landed[0], np.array((0.0, 0.0, 0.01, 0.001, 0.002, 0.001)))
    machine.tick(position=leg_lengths(geometry, pose, landed[1].reshape(-1, 6)))
    machine.tick()
    assert np.abs(displacement(pose, machine["pose"])).max() < 1e-5
    assert np.array_equal(machine["feet"], landed[1])


def test_joints_that_are_locked_again_are_locked_where_they_are_then(geometry, stand):
    machine, lock_set = stand(), lock_set_of(geometry)
    closed = switches(geometry, lock_set)
    machine.tick(2, locks_closed=closed)
    first = machine["locked_at"]
    machine.tick(2, locks_closed=switches(geometry))
    pose = moved(TILTED, np.array((0.01, 0.02, 0.01, 0.0, 0.0, 0.005)))
    machine.tick(2, position=leg_lengths(geometry, pose))
    assert np.array_equal(machine["locked_at"], first)
    machine.tick(2, locks_closed=closed)
    values = lockable_joints(geometry, Posture(pose, geometry.footholds)).ravel()
    assert np.allclose(machine["locked_at"][closed > 0.5], values[closed > 0.5], atol=1e-6)


def test_what_determines_no_posture_leaves_the_last_one_and_says_so(geometry, stand):
    lengths = leg_lengths(geometry, moved(TILTED, np.full(6, 0.002)))
    two, one = np.ones(geometry.limbs), np.ones(geometry.limbs)
    two[:2], one[0] = 0.0, 0.0
    for changes in (
        {"clamps_closed": two, "locks_closed": np.ones(4 * geometry.limbs)},
        {"clamps_closed": one},  # with no lock of its limb closed
        {"position": np.where(np.arange(geometry.legs) == 2, np.nan, lengths)},
        {"position": np.full(geometry.legs, np.inf)},
        {"position": np.full(geometry.legs, 0.01)},
    ):
        machine = stand()
        before = machine["pose"], machine["feet"]
        machine.tick(3, **({"position": lengths} | changes))
        assert machine["is_determined"][0] == 0.0, changes
        assert np.array_equal(machine["pose"], before[0])
        assert np.array_equal(machine["feet"], before[1])
        machine.set(position=lengths, clamps_closed=np.ones(geometry.limbs))
        machine.tick(2, locks_closed=switches(geometry))
        assert machine["is_determined"][0] == 1.0
        assert np.allclose(machine["pose"], moved(TILTED, np.full(6, 0.002)), atol=1e-6)


def test_a_sampled_posture_is_that_of_the_last_update(geometry, stand):
    now, sampled = stand(), stand(is_sampled=True)
    pose = moved(TILTED, np.array((0.0, 0.0, 0.0, 0.003, 0.0, 0.002)))
    lengths = leg_lengths(geometry, pose)
    for machine in (now, sampled):
        machine.tick(2).set(position=lengths)
    assert np.allclose(now["pose"], pose, atol=1e-6)
    assert np.allclose(sampled["pose"], TILTED, atol=1e-12)
    sampled.tick()
    assert np.allclose(sampled["pose"], pose, atol=1e-6)
    for machine in (now, sampled):
        machine.set(position=np.full(geometry.legs, np.nan))
    assert (now["is_determined"][0], sampled["is_determined"][0]) == (0.0, 1.0)
    assert sampled.tick()["is_determined"][0] == 0.0


def test_a_centre_is_put_on_other_footholds(geometry, stand, uneven):
    machine, feet = stand(), uneven(1)[0]
    machine.system.stand(machine.context, HOME, feet)
    machine.tick(2, position=leg_lengths(geometry, TILTED, feet))
    assert np.abs(displacement(TILTED, machine["pose"])).max() < 1e-6
    assert np.array_equal(machine["feet"], feet.ravel())


def test_closed_locks_are_those_that_are_closed_with_the_loose_limb_s_first(geometry):
    values = np.arange(4.0 * geometry.limbs).reshape(-1, 4)
    closed = np.zeros((geometry.limbs, 4), dtype=bool)
    closed[1], closed[0, 2], closed[2, 3] = True, True, True
    locks = closed_locks(geometry, 2, values, geometry.footholds, closed)
    assert locks.lock_set == LockSet(2, ((1, 3), (3, 6)))
    assert locks.values.tolist() == [4.0, 5.0, 6.0, 7.0, 2.0, 11.0]
    assert locks.along == "left"


def test_a_tripod_whose_standing_limbs_are_not_locked_has_no_posture():
    geometry = CentreGeometry(3)
    before = Posture(TILTED, geometry.footholds)
    locked, clamped = np.zeros((3, 4), dtype=bool), np.array((False, True, True))
    locked[0] = True
    values, lengths = lockable_joints(geometry, before), leg_lengths(geometry, TILTED)
    assert posture_of(geometry, lengths, before, values, locked, clamped) is None
    locked[1, 2] = locked[2, 3] = True
    found = posture_of(geometry, lengths, before, values, locked, clamped)
    assert np.allclose(found.pose, TILTED, atol=1e-12)
    assert np.allclose(found.feet, geometry.footholds, atol=1e-9)
