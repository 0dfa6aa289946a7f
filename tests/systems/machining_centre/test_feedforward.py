import numpy as np
import pytest

from parapod.systems.machining_centre.feedforward import CentreFeedforward
from parapod.systems.machining_centre.job import swung_to
from parapod.systems.machining_centre.platform_mode import leg_lengths, moved
from parapod.systems.machining_centre.posture import Posture, lockable_joints
from parapod.systems.machining_centre.swing import LOCKABLE, LockSet, close_locks

TILTED = np.array((0.01, -0.01, 0.49, 0.05, 0.1, 0.08))
PLATFORM, FOOT = 1.0, 2.0
NOWHERE = np.full(6, np.nan)


def lock_set_of(geometry):
    return LockSet(1, ((2, 3), (3, 6))) if geometry.limbs == 3 else LockSet(1)


@pytest.fixture
def lead(stand, geometry):
    """lead(more): the system at a posture, legs longer than by the kinematics."""

    def make(more=0.0, **inputs):
        values = lockable_joints(geometry, Posture(TILTED, geometry.footholds))
        closed = np.zeros((geometry.limbs, 4))
        for limb, joint in lock_set_of(geometry).joints:
            closed[limb - 1, LOCKABLE.index(joint)] = 1.0
        usual = {
            "mode": 0.0,
            "target": np.zeros(6),
            "toward": NOWHERE,
            "loose_limb": 0.0,
            "feet": geometry.footholds.ravel(),
            "locked_at": values.ravel(),
            "locks_closed": closed.ravel(),
            "pose": TILTED,
            "position_measured": leg_lengths(geometry, TILTED) + more,
        }
        return stand(CentreFeedforward(geometry), **(usual | inputs))

    return make


def ways(count=8):
    return [np.array((0.002, -0.001, 0.002, 3e-4, 5e-4, 4e-4)) * k for k in range(1, count)]


def test_at_rest_the_first_measured_lengths_are_held(geometry, lead):
    machine = lead(more=1e-3)
    held = leg_lengths(geometry, TILTED) + 1e-3
    assert np.array_equal(machine["position_command"], held)
    machine.tick(3, position_measured=held + 2e-4)
    # The first update has seen other lengths already.
    assert np.allclose(machine["position_command"], held + 2e-4)
    machine.tick(3, position_measured=held - 5e-4)
    assert np.allclose(machine["position_command"], held + 2e-4)
    assert np.allclose(machine["length_error"], -7e-4)


def test_at_rest_what_is_desired_is_what_is_known(geometry, lead):
    machine = lead().tick(2)
    assert np.array_equal(machine["pose_desired"], TILTED)
    assert not machine["foot_desired"].any()
    machine.set(pose=TILTED + 0.01, loose_limb=2.0)
    assert np.array_equal(machine["pose_desired"], TILTED + 0.01)
    assert np.array_equal(machine["foot_desired"], geometry.footholds[1])


def test_a_platform_is_led_by_its_lengths_and_what_the_held_ones_were_more(geometry, lead):
    more = np.random.default_rng(0).uniform(-1e-4, 1e-4, geometry.legs)
    machine = lead(more).tick(2)
    for way in ways():
        target = moved(TILTED, way)
        machine.set(mode=PLATFORM, target=target)
        expected = leg_lengths(geometry, target) + more
        assert np.allclose(machine["position_command"], expected, atol=1e-15)
        assert machine["is_stuck"][0] == 0.0
        machine.tick(position_measured=expected)
        assert np.array_equal(machine["pose_desired"], target)
        assert np.allclose(machine["length_error"], 0.0, atol=1e-15)
    # Having arrived, lengths stay; and so does what they are more, in the next motion.
    machine.tick(2, mode=0.0, pose=target)
    assert np.allclose(machine["position_command"], expected, atol=1e-15)
    machine.set(mode=PLATFORM, target=TILTED)
    back = leg_lengths(geometry, TILTED) + more
    assert np.allclose(machine["position_command"], back, atol=1e-12)


def test_a_motion_begins_without_a_jump_wherever_the_platform_is_known_to_be(geometry, lead):
    machine = lead().tick(2)
    known = moved(TILTED, np.full(6, 2e-4))
    machine.tick(pose=known)
    held = machine["position_command"]
    machine.set(mode=PLATFORM, target=known)
    assert np.allclose(machine["position_command"], held, atol=1e-12)


def test_a_loose_foot_is_led_through_its_locks(geometry, lead):
    more = np.random.default_rng(0).uniform(-1e-4, 1e-4, geometry.legs)
    machine = lead(more, loose_limb=1.0).tick(2)
    locks = close_locks(geometry, TILTED, lock_set_of(geometry), along="left")
    pose = TILTED
    for way in ways():
        target = moved(geometry.footholds[0], way)
        machine.set(mode=FOOT, target=target)
        expected = swung_to(geometry, locks, target, pose)
        assert np.allclose(machine["position_command"], expected.lengths + more, atol=1e-15)
        machine.tick()
        assert np.allclose(machine["pose_desired"], expected.pose, atol=1e-15)
        assert np.allclose(machine["foot_desired"], expected.foot_pose, atol=1e-15)
        pose = expected.pose


def test_where_the_platform_is_wanted_counts_as_far_as_it_is_open(geometry, lead):
    machine = lead(loose_limb=1.0).tick(2)
    target, toward = moved(geometry.footholds[0], ways()[0]), moved(TILTED, ways()[2])
    machine.set(mode=FOOT, target=target)
    free = machine["position_command"]
    machine.set(toward=toward)
    led = machine["position_command"]
    locks = close_locks(geometry, TILTED, lock_set_of(geometry), along="left")
    expected = swung_to(geometry, locks, target, TILTED, toward=toward)
    assert np.allclose(led, expected.lengths, atol=1e-12)
    # A tripod's platform has one direction that is open, as its foot may turn: none but that.
    assert np.abs(led - free).max() > (1e-4 if geometry.limbs == 4 else 1e-6)


@pytest.mark.parametrize("mode", [PLATFORM, FOOT])
def test_what_cannot_be_reached_is_not_followed_and_says_so(geometry, lead, mode):
    machine = lead(loose_limb=1.0).tick(2)
    before, pose = machine["position_command"], machine["pose_desired"]
    far = (TILTED if mode == PLATFORM else geometry.footholds[0]) + (0.0, 0.0, 0.4, 0, 0, 0)
    for target in (far, NOWHERE):
        machine.tick(2, mode=mode, target=target)
        assert machine["is_stuck"][0] == 1.0
        assert np.array_equal(machine["position_command"], before)
        assert np.array_equal(machine["pose_desired"], pose)
    near = TILTED if mode == PLATFORM else geometry.footholds[0]
    machine.tick(2, target=near)
    assert machine["is_stuck"][0] == 0.0


def test_a_foot_that_none_or_too_few_locks_lead_is_stuck(geometry, lead):
    target = geometry.footholds[0]
    for limb in (0.0, geometry.limbs + 1.0, np.nan):
        assert lead(loose_limb=limb, mode=FOOT, target=target).tick(2)["is_stuck"][0] == 1.0
    free = lead(
        loose_limb=1.0, mode=FOOT, target=target, locks_closed=np.zeros(4 * geometry.limbs)
    )
    assert free.tick(2)["is_stuck"][0] == float(geometry.limbs == 3)


def test_the_error_is_what_legs_have_more_than_they_are_to_have_now(geometry, lead):
    machine = lead().tick(2)
    target = moved(TILTED, ways()[1])
    machine.set(mode=PLATFORM, target=target)
    # What is commanded now is to be there a period from now.
    assert np.allclose(machine["length_error"], 0.0, atol=1e-15)
    machine.tick()
    late = leg_lengths(geometry, TILTED) - leg_lengths(geometry, target)
    assert np.allclose(machine["length_error"], late, atol=1e-15)
    assert np.abs(late).max() > 1e-4
