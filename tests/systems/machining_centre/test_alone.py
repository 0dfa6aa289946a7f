"""Rows of several centres have, to the last bit, what each of them has alone."""

from dataclasses import replace

import numpy as np
import pytest

from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.machining_centre.branch import branch_joints
from parapod.systems.machining_centre.platform_mode import (
    displacement,
    displacement_alone,
    forward_kinematics,
    leg_lengths,
    moved,
    moved_alone,
    poses_alone,
)
from parapod.systems.machining_centre.swing import (
    Locks,
    LockSet,
    SingularSwing,
    legs_alone,
    swing_forward,
    swing_inverse,
    swung_alone,
)
from parapod.systems.machining_centre.wrench import index_alone, wrench_indices

ROWS = 40
LAST_STEP = 2e-3


@pytest.fixture
def centres(geometry):
    """Poses, feet and locks of several centres."""
    random = np.random.default_rng(0)
    poses = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0)) + random.uniform(-0.03, 0.03, (ROWS, 6))
    feet = geometry.footholds + random.uniform(-0.01, 0.01, (ROWS, geometry.limbs, 6))
    lock_set = LockSet.printed(geometry, 1)
    limbs, joints = np.array(lock_set.joints).T - 1
    values = branch_joints(geometry, poses, feet, along="left")[:, limbs, joints]
    return random, poses, feet, Locks(lock_set, values, feet, "left")


def test_displacements_of_rows(centres):
    _, poses, feet, _ = centres
    twists = displacement_alone(poses, feet[:, 0])
    assert np.array_equal(
        twists, [displacement(*row) for row in zip(poses, feet[:, 0], strict=True)]
    )
    twists[::2] *= 1e-6
    assert np.array_equal(
        moved_alone(poses, twists), [moved(*row) for row in zip(poses, twists, strict=True)]
    )


def test_poses_and_indices_of_rows(geometry, centres):
    random, poses, feet, _ = centres
    lengths = leg_lengths(geometry, poses, feet)
    lengths += random.uniform(-1e-3, 1e-3, lengths.shape)
    lengths[3, 2] = np.nan
    expected = [
        forward_kinematics(geometry, *row, last_step=LAST_STEP).pose
        for row in zip(lengths, poses, feet, strict=True)
    ]
    found = poses_alone(geometry, lengths, poses, feet, LAST_STEP)
    assert np.array_equal(found, expected, equal_nan=True)
    assert np.isnan(found).any(axis=1).sum() == 1
    indices = [wrench_indices(geometry, *row).w_minmax for row in zip(poses, feet, strict=True)]
    assert np.array_equal(
        index_alone(geometry, poses, feet, range(1, geometry.limbs + 1)), indices
    )


def test_swinging_feet_of_rows(geometry, centres):
    random, poses, feet, locks = centres
    lengths = leg_lengths(geometry, poses, feet)
    lengths += random.uniform(-1e-3, 1e-3, lengths.shape)
    lengths[3, 5] = np.nan
    for row, (pose, foot) in enumerate(
        zip(*swung_alone(geometry, lengths, locks, poses, LAST_STEP), strict=True)
    ):
        arguments = geometry, lengths[row], locks.of_rows(row), poses[row]
        if row == 3:
            with pytest.raises(SingularSwing):
                swing_forward(*arguments, last_step=LAST_STEP)
            assert np.isnan(pose).all()
            continue
        expected = swing_forward(*arguments, last_step=LAST_STEP)
        assert np.array_equal(pose, expected.pose)
        assert np.array_equal(foot, expected.foot_pose)


@pytest.mark.parametrize("is_led", [True, False])
def test_legs_of_rows(geometry, centres, is_led):
    random, poses, feet, locks = centres
    turns = geometry.limbs == 3
    targets = feet[:, 0] + random.uniform(-2e-3, 2e-3, (ROWS, 6))
    targets[3, 2] += 1.0  # out of reach
    toward = poses + random.uniform(-2e-3, 2e-3, (ROWS, 6)) if is_led else None
    options = {"turns": turns, "tolerance": 0.05, "last_step": LAST_STEP}
    found = legs_alone(geometry, targets, locks, poses, toward=toward, **options)
    for row, parts in enumerate(zip(*found, strict=True)):
        own = replace(locks.of_rows(row), footholds=feet[row])
        goal = None if toward is None else toward[row]
        try:
            legs = swing_inverse(geometry, targets[row], own, poses[row], toward=goal, **options)
        except (SingularSwing, UnreachablePosture):
            assert np.isnan(parts[0]).all()
            continue
        assert row != 3
        for part, expected in zip(parts, (legs.lengths, legs.pose, legs.foot_pose), strict=True):
            assert np.array_equal(part, expected)
    assert np.isfinite(found[0]).all(axis=1).sum() > ROWS // 2
