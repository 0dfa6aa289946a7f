"""Kinematics while one limb is loose: its foot is moved by all legs, through locked joints.

The loose limb's joints q_1, q_2, q_3 and q_6 are locked; a tripod needs two locks more in the
limbs that stand, because four legs do not hold a platform. A foot's pose is turned into lengths
through the platform's pose at which the locked joints keep their values.

The paper locks q_1 of both standing limbs. That holds the platform, but dq_1 by a translation of
the platform is zero where the line of a limb's pivots is perpendicular to its foot's axis: with
the platform parallel to the ground one translation along the loose limb is left open, and the
foot's attitude has one direction that cannot be commanded. `lock_conditions` checks both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from parapod.systems.core.batching import of_width
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.vectors import Array, product
from parapod.systems.machining_centre.branch import (
    Along,
    branch_joints,
    branch_joints_and_rates,
    foot_of_limb,
    turned_feet,
    turned_foot,
)
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import (
    check_strokes,
    decomposed,
    displacement,
    displacement_alone,
    feet_of,
    jacobian,
    leg_lengths,
    length_scale,
    moved,
    moved_alone,
    within_stroke,
)
from parapod.systems.machining_centre.wrench import wrench_indices

# Joints that carry locks. All of the loose limb's are closed: q_4 and q_5 follow from its legs.
LOCKABLE = (1, 2, 3, 6)
_MOST_STEPS = 30
_CONVERGED = 1e-12  # [m, and r_c rad]
# Below this smallest singular value what stands does not hold the platform.
_SINGULAR = 1e-6
# Difference for the slope of the objective in open directions, and its step by slope, of the
# paper's centre [m, m^2].
_PROBE, _GAIN = 1e-4, 1e-3
# Longest way of the paper's centre at once [m].
_LONGEST = 0.2
# Weight of the wrench index beside the stroke, per unit of the index.
_INDEX_WEIGHT = 10.0


class SingularSwing(ParapodError):
    """A motion of a foot that its locks do not let the legs make.

    Attributes:
        limb: the loose limb, counted from 1.
        smallest_singular_value: smallest singular value of the map from the platform's motion to
            the locked joints.
    """

    def __init__(self, limb: int, smallest_singular_value: float, message: str):
        self.limb, self.smallest_singular_value = limb, smallest_singular_value
        super().__init__(
            f"limb {limb} cannot swing so: {message} "
            f"(smallest singular value of its locks: {smallest_singular_value:.2g})"
        )


@dataclass(frozen=True)
class LockSet:
    """Joints that are locked while a limb is loose.

    Attributes:
        limb: the loose limb, counted from 1; its joints 1, 2, 3 and 6 are locked.
        standing: further locked joints (limb, joint) of the limbs that stand.
    """

    limb: int
    standing: tuple[tuple[int, int], ...] = ()

    @classmethod
    def printed(cls, geometry: CentreGeometry, limb: int) -> "LockSet":
        """The paper's choice: q_1 of both standing limbs of a tripod, none of a quadruped."""
        if geometry.limbs > 3:
            return cls(limb)
        return cls(limb, tuple((other, 1) for other in (1, 2, 3) if other != limb))

    def check(self, geometry: CentreGeometry) -> None:
        """Refuses a set that does not fit a centre.

        Raises:
            ValueError: names the limb or joint, or the number of locks that is needed.
        """
        limbs = range(1, geometry.limbs + 1)
        if self.limb not in limbs:
            raise ValueError(f"the loose limb must be one of 1..{geometry.limbs}, not {self.limb}")
        for limb, joint in self.standing:
            if limb not in limbs or limb == self.limb or joint not in LOCKABLE:
                others = ", ".join(str(other) for other in limbs if other != self.limb)
                raise ValueError(
                    f"joint {joint} of limb {limb} cannot be locked while limb {self.limb} is "
                    f"loose: limbs are {others}, joints 1, 2, 3, 6"
                )
        count = max(0, 6 - 2 * (geometry.limbs - 1))
        if len(set(self.standing)) < count:
            raise ValueError(
                f"{count} joints of standing limbs must be locked, not {len(self.standing)}: "
                f"{2 * (geometry.limbs - 1)} legs do not hold the platform"
            )

    @property
    def joints(self) -> tuple[tuple[int, int], ...]:
        """All locked joints (limb, joint), those of the loose limb first."""
        return (*((self.limb, joint) for joint in LOCKABLE), *self.standing)


@dataclass(frozen=True, eq=False)
class Locks:
    """Locks that are closed.

    Attributes:
        lock_set: joints that are locked.
        values: their values (k) [rad].
        footholds: (n, 6) poses of the feet's frames when they were closed; the loose limb's foot
            moves from there.
        along: line of the limbs' chains, see `branch_joints`.
    """

    lock_set: LockSet
    values: Array
    footholds: Array
    along: Along

    def of_rows(self, rows: Any) -> "Locks":
        """The locks of some of the rows, or of one of them."""
        return replace(self, values=self.values[rows], footholds=self.footholds[rows])


def lock_sets(geometry: CentreGeometry, limb: int) -> list[LockSet]:
    """All sets with as many locks in the standing limbs as are needed.

    Args:
        geometry: the centre.
        limb: the loose limb, counted from 1.
    """
    others = [other for other in range(1, geometry.limbs + 1) if other != limb]
    joints = [(other, joint) for other in others for joint in LOCKABLE]
    count = max(0, 6 - 2 * len(others))
    return [LockSet(limb, chosen) for chosen in combinations(joints, count)]


def best_sets(
    geometry: CentreGeometry, pose: Array, footholds: Array, limb: int, least: float, count: int
) -> list[LockSet]:
    """Sets with the largest singular values at a pose, the best first, for a foot on a surface.

    Args:
        geometry: the centre.
        pose: (6) of the platform [m, rad].
        footholds: (n, 6) poses of the feet's frames [m, rad].
        limb: the loose limb, counted from 1.
        least: singular value that each must have.
        count: largest number of sets.
    """
    rated = []
    for lock_set in lock_sets(geometry, limb):
        conditions = lock_conditions(
            geometry, pose, lock_set, footholds, along="left", turns=turns(geometry)
        )
        rated.append((min(float(conditions.inverse), float(conditions.holding)), lock_set))
    rated.sort(key=lambda each: -each[0])
    return [lock_set for sigma, lock_set in rated[:count] if sigma >= least]


def turns(geometry: CentreGeometry) -> bool:
    """True if swinging feet may turn about their axes: a tripod has no freedom left otherwise."""
    return geometry.limbs == 3


class LockConditions(NamedTuple):
    """Smallest singular values of a lock set, of rotations in rad and translations by r_c.

    Attributes:
        inverse: (...) of the locked joints by the platform's motion; near 0 a foot's pose does
            not determine the platform's.
        holding: (...) of the standing legs and locks by the platform's motion; near 0 they do not
            hold the platform. Both are NaN where a limb's chain has no rates.
    """

    inverse: Array
    holding: Array


class SwingPose(NamedTuple):
    """Platform and legs that put a loose foot somewhere.

    Attributes:
        pose: (6) of the platform [m, rad].
        lengths: (2n) of the legs [m].
        residual: largest difference of a locked joint from its value [rad].
        smallest_singular_value: see `LockConditions.inverse`.
        open_directions: (f, 6) displacements [rotation; translation / r_c] of the platform that
            neither foot nor locks determine, each of unit length.
        foot_pose: (6) of the loose foot, as asked, or turned about its third axis [m, rad].
    """

    pose: Array
    lengths: Array
    residual: float
    smallest_singular_value: float
    open_directions: Array
    foot_pose: Array


class SwungPose(NamedTuple):
    """Places of platform and loose foot, from the lengths of the legs.

    Attributes:
        pose: (6) of the platform [m, rad].
        foot_pose: (6) of the loose foot [m, rad].
        residual: largest difference of a standing leg's length [m], or lock's value by r_c [m].
        smallest_singular_value: see `LockConditions.holding`.
    """

    pose: Array
    foot_pose: Array
    residual: float
    smallest_singular_value: float


def close_locks(
    geometry: CentreGeometry,
    pose: ArrayLike,
    lock_set: LockSet,
    footholds: ArrayLike | None = None,
    *,
    along: Along = "middle",
) -> Locks:
    """Locks as they are when closed at a pose.

    Args:
        geometry: the centre.
        pose: (6) of the platform [m, rad].
        lock_set: joints to lock.
        footholds: (n, 6) poses of the feet's frames; None for the paper's pattern.
        along: line of the limbs' chains.

    Raises:
        ValueError: wrong shapes, or a set that does not fit the centre.
    """
    lock_set.check(geometry)
    feet = feet_of(geometry, footholds)
    joints = branch_joints(geometry, pose, feet, along=along)
    values = joints[_indices(lock_set.joints)]
    return Locks(lock_set, values, feet.copy(), along)


def lock_conditions(
    geometry: CentreGeometry,
    pose: ArrayLike,
    lock_set: LockSet,
    footholds: ArrayLike | None = None,
    *,
    along: Along = "middle",
    turns: bool = False,
) -> LockConditions:
    """Whether a lock set determines the platform's pose, and whether it holds the platform.

    Args:
        geometry: the centre.
        pose: (..., 6) [m, rad].
        lock_set: joints that are locked.
        footholds: (..., n, 6) poses of the feet's frames; None for the paper's pattern.
        along: line of the limbs' chains.
        turns: true if the loose foot may turn about its third axis, see `swing_inverse`.

    Raises:
        ValueError: wrong shapes, or a set that does not fit the centre.
    """
    lock_set.check(geometry)
    unit = _unit_motion(geometry)
    rates = branch_joints_and_rates(geometry, pose, footholds, along=along)[1] * unit
    locked = rates[(..., *_indices(lock_set.joints[turns:]), slice(None))]
    held_rows = jacobian(geometry, pose, footholds)[..., _standing_legs(geometry, lock_set), :]
    held_rows = held_rows * unit / geometry.platform_radius
    if lock_set.standing:
        also = rates[(..., *_indices(lock_set.standing), slice(None))]
        held_rows = np.concatenate((held_rows, also), axis=-2)
    return LockConditions(_smallest(locked), _smallest(held_rows))


def swing_inverse(
    geometry: CentreGeometry,
    foot_pose: ArrayLike,
    locks: Locks,
    near: ArrayLike,
    *,
    turns: bool = False,
    freedom: float = 0.0,
    toward: ArrayLike | None = None,
    longest: float | None = None,
    open_below: float = 1e-6,
    tolerance: float = 1e-6,
    last_step: float = 1e-12,
) -> SwingPose:
    """Legs that put the loose foot at a pose: Gauss-Newton steps to the nearest pose.

    Args:
        geometry: the centre.
        foot_pose: (6) x, y, z, roll, pitch, yaw of the loose foot's frame [m, rad].
        locks: the closed locks.
        near: (6) the platform's pose nearby, at best that of the sample before.
        turns: true if the foot may turn about its third axis: the heading of a foot on a surface
            does not matter, and a tripod parallel to the ground cannot choose it.
        freedom: longest way that the platform may make in directions which foot and locks leave
            open, to keep the legs in the middle of their stroke and, where three limbs stand,
            the wrench index high [m, and r_c rad]; 0: it makes none there.
        toward: (6) a pose to which the platform goes in these directions, in the place of that
            [m, rad].
        longest: longest way that the platform may make from `near` [m, and r_c rad]; None: 200 mm,
            by the centre's size.
        open_below: directions with singular values below this share of the largest one are open.
        tolerance: largest difference of a locked joint before the last step [rad].
        last_step: length of the step after which no other one follows [m, and r_c rad]; what is
            left is about its square by r_c.

    Raises:
        SingularSwing: the platform would have to move farther, or the locks cannot be kept.
        UnreachablePosture: a leg would leave its stroke.
        ValueError: wrong shapes.
    """
    limb = locks.lock_set.limb
    longest = _LONGEST * geometry.size if longest is None else longest
    feet = locks.footholds.copy()
    feet[limb - 1] = of_width(foot_pose, 6, "foot_pose")
    start = of_width(near, 6, "near").astype(np.float64)
    pose, unit = start, _unit_motion(geometry)
    chosen, lock_values = _indices(locks.lock_set.joints[turns:]), locks.values[turns:]
    drift, way = np.zeros(6), np.inf
    for step in range(_MOST_STEPS):
        joints, rates = branch_joints_and_rates(geometry, pose, feet, along=locks.along)
        missing = _wrapped(lock_values - joints[chosen])
        left, values, right = decomposed(rates[chosen] * unit, full_matrices=True)
        if not np.isfinite(values).all():
            raise SingularSwing(limb, 0.0, "a limb has no joint values there, or it is not finite")
        rank = int((values > open_below * values[0]).sum())
        smallest, open_directions = float(values[-1]), right[rank:]
        move = right[:rank].T @ (left.T[:rank] @ missing / values[:rank])
        if len(open_directions):
            if step == 0 and toward is not None:
                drift = displacement(start, of_width(toward, 6, "toward")) / unit
            elif step == 0 and freedom > 0.0:
                drift = _drift(geometry, pose, feet, limb, open_directions, freedom)
            # Of all poses that keep the locks the nearest one, or the one that is wanted there.
            displaced = displacement(start, pose) / unit if step else np.zeros(6)
            move = move + open_directions.T @ (open_directions @ (drift - displaced))
        way = geometry.platform_radius * float(np.linalg.norm(move))
        if way <= _CONVERGED:
            break
        pose = moved(pose, move * unit)
        if way <= last_step:
            break
        distance = float(np.linalg.norm(pose[:3] - start[:3]))
        if not distance <= longest:
            raise SingularSwing(
                limb,
                smallest,
                f"the platform would have to go {1e3 * distance:.0f} mm at once, and may go "
                f"{1e3 * longest:.0f} mm",
            )
    residual = float(np.abs(missing).max())
    if not (residual <= tolerance and way <= last_step):
        raise SingularSwing(
            limb,
            smallest,
            f"no pose of the platform is found that keeps its locks, which are off by "
            f"{1e3 * residual:.3g} mrad",
        )
    lengths = leg_lengths(geometry, pose, feet)
    check_strokes(geometry, lengths)
    foot = feet[limb - 1]
    if turns:
        # As far as the last step has turned it too.
        q_1 = joints[limb - 1, 0] + rates[limb - 1, 0] @ (move * unit)
        foot = turned_foot(foot, float(_wrapped(q_1 - locks.values[0])))
    return SwingPose(pose, lengths, residual, smallest, open_directions, foot)


def swing_forward(
    geometry: CentreGeometry,
    lengths: ArrayLike,
    locks: Locks,
    near: ArrayLike,
    *,
    last_step: float = 1e-12,
) -> SwungPose:
    """Platform and loose foot that legs of these lengths hold, by Newton's method.

    Standing legs and locks give the platform's pose, the loose limb's legs and locks its foot's.

    Args:
        geometry: the centre.
        lengths: (2n) [m].
        locks: the closed locks; feet that stand are where they were then.
        near: (6) a pose of the platform nearby.
        last_step: see `swing_inverse`.

    Raises:
        SingularSwing: what stands does not hold the platform near there.
        ValueError: wrong shapes.
    """
    goal = of_width(lengths, geometry.legs, "lengths").astype(np.float64)
    pose = of_width(near, 6, "near").astype(np.float64)
    lock_set, r_c = locks.lock_set, geometry.platform_radius
    smallest = 0.0
    for _ in range(_MOST_STEPS):
        twist, steps, smallest_values, off = _forward_step(geometry, pose, goal, locks)
        way, smallest = float(steps), float(smallest_values)
        if not smallest > _SINGULAR:
            break
        if way > _CONVERGED:
            pose = moved(pose, twist * min(1.0, 0.5 * r_c / way))
        if way <= last_step:
            foot = _foot_of(geometry, pose, goal, locks)
            return SwungPose(pose, foot, r_c * float(np.abs(off).max()), smallest)
    raise SingularSwing(
        lock_set.limb, smallest, "what stands does not hold the platform near where it was"
    )


def swung_alone(
    geometry: CentreGeometry, lengths: Array, locks: Locks, near: Array, last_step: float
) -> tuple[Array, Array]:
    """Platforms and loose feet by `swing_forward`, each to the last bit as if it were alone.

    Args:
        geometry: the centre.
        lengths: (rows, 2n) [m].
        locks: the closed locks, with values and feet of each row.
        near: (rows, 6) poses of the platforms nearby.
        last_step: see `swing_inverse`.

    Returns:
        Poses (rows, 6) of platform and loose foot; NaN where what stands does not hold the
        platform.

    Raises:
        ValueError: legs that do not meet.
    """
    poses, going_on, r_c = near.copy(), np.arange(len(near)), geometry.platform_radius
    for _ in range(_MOST_STEPS):
        twist, way, smallest, _ = _forward_step(
            geometry, poses[going_on], lengths[going_on], locks.of_rows(going_on)
        )
        poses[going_on[~(smallest > _SINGULAR) | np.isnan(way)]] = np.nan
        moves = (way > _CONVERGED) & (smallest > _SINGULAR)
        share = np.minimum(1.0, 0.5 * r_c / way[moves])[:, np.newaxis]
        poses[going_on[moves]] = moved_alone(poses[going_on[moves]], twist[moves] * share)
        going_on = going_on[(way > last_step) & (smallest > _SINGULAR)]
        if not going_on.size:
            break
    poses[going_on] = np.nan
    feet, there = np.full(poses.shape, np.nan), np.flatnonzero(np.isfinite(poses).all(axis=-1))
    if there.size:
        feet[there] = _foot_of(geometry, poses[there], lengths[there], locks.of_rows(there))
    return poses, feet


def legs_alone(
    geometry: CentreGeometry,
    foot_poses: Array,
    locks: Locks,
    near: Array,
    *,
    turns: bool,
    toward: Array | None,
    tolerance: float,
    last_step: float,
    open_below: float = 1e-6,
) -> tuple[Array, Array, Array]:
    """Legs by `swing_inverse`, each to the last bit as if it were alone.

    Args:
        geometry: the centre.
        foot_poses: (rows, 6) of the loose feet [m, rad].
        locks: the closed locks, with values and feet of each row.
        near: (rows, 6) poses of the platforms nearby.
        turns: see `swing_inverse`, as all that follow.
        toward: (rows, 6) poses [m, rad].
        tolerance: [rad].
        last_step: [m, and r_c rad].
        open_below: [-].

    Returns:
        Lengths (rows, 2n), and poses (rows, 6) of platform and foot; NaN where none exist.
    """
    limb, r_c, unit = locks.lock_set.limb - 1, geometry.platform_radius, _unit_motion(geometry)
    chosen, longest = (..., *_indices(locks.lock_set.joints[turns:])), _LONGEST * geometry.size
    feet, poses = locks.footholds.copy(), near.copy()
    feet[:, limb] = foot_poses
    turned, drift = feet[:, limb].copy(), np.zeros(near.shape)
    is_there, going_on = np.zeros(len(near), dtype=np.bool_), np.arange(len(near))
    for step in range(_MOST_STEPS):
        pose, start = poses[going_on], near[going_on]
        joints, rates = branch_joints_and_rates(geometry, pose, feet[going_on], along=locks.along)
        missing = _wrapped(locks.values[going_on, turns:] - joints[chosen])
        left, values, right = decomposed(rates[(*chosen, slice(None))] * unit, full_matrices=True)
        ranks = (values > open_below * values[:, :1]).sum(axis=-1)
        if step == 0 and toward is not None:
            is_open = ranks < right.shape[-1]
            drift[is_open] = displacement_alone(start, toward)[is_open] / unit
        displaced = displacement_alone(start, pose) / unit if step else np.zeros(pose.shape)
        to_go, move = drift[going_on] - displaced, np.empty(pose.shape)
        for rank in np.unique(ranks).tolist():
            of = ranks == rank
            back, ahead = np.swapaxes(left[of], -1, -2)[:, :rank], right[of]
            along = product(back, missing[of]) / values[of, :rank]
            move[of] = product(np.swapaxes(ahead[:, :rank], -1, -2), along)
            if (free := ahead[:, rank:]).size:
                move[of] += product(np.swapaxes(free, -1, -2), product(free, to_go[of]))
        move[~np.isfinite(values).all(axis=-1)] = np.nan
        way = r_c * _norm(move)
        moves, ends = way > _CONVERGED, way <= last_step
        poses[going_on[moves]] = moved_alone(pose[moves], move[moves] * unit)
        ends &= np.abs(missing).max(axis=-1) <= tolerance
        ending = going_on[ends]
        is_there[ending] = True
        if turns:  # as far as the last step has turned it too
            by = product(rates[ends, limb, 0][:, np.newaxis], move[ends] * unit)[:, 0]
            angles = _wrapped(joints[ends, limb, 0] + by - locks.values[ending, 0])
            turned[ending] = turned_feet(turned[ending], angles)
        distance = _norm(poses[going_on, :3] - start[:, :3])
        going_on = going_on[(way > last_step) & (distance <= longest)]
        if not going_on.size:
            break
    lengths = leg_lengths(geometry, poses, feet)
    is_there &= within_stroke(geometry, lengths).all(axis=-1)
    lengths[~is_there] = poses[~is_there] = turned[~is_there] = np.nan
    return lengths, poses, turned


def _foot_of(geometry: CentreGeometry, pose: Array, lengths: Array, locks: Locks) -> Array:
    """Poses (..., 6) of the loose foot."""
    limb = locks.lock_set.limb
    pair, own = lengths[..., 2 * limb - 2 : 2 * limb], locks.values[..., :4]
    return foot_of_limb(geometry, pose, limb, pair, own, along=locks.along)


def _forward_step(
    geometry: CentreGeometry, pose: Array, goal: Array, locks: Locks
) -> tuple[Array, Array, Array, Array]:
    """Displacement (..., 6) of the platform by a step of `swing_forward`, and its length.

    Returns:
        These, the smallest singular value, and what legs and locks are off.
    """
    lock_set, feet, unit = locks.lock_set, locks.footholds, _unit_motion(geometry)
    legs, r_c = _standing_legs(geometry, lock_set), geometry.platform_radius
    rows = jacobian(geometry, pose, feet)[..., legs, :] * unit / r_c
    off = (goal - leg_lengths(geometry, pose, feet))[..., legs] / r_c
    if lock_set.standing:
        joints, rates = branch_joints_and_rates(geometry, pose, feet, along=locks.along)
        also, values = _indices(lock_set.standing), locks.values[..., len(LOCKABLE) :]
        rows = np.concatenate((rows, rates[(..., *also, slice(None))] * unit), axis=-2)
        off = np.concatenate((off, _wrapped(values - joints[(..., *also)])), axis=-1)
    left, singular, right = decomposed(rows)
    along = product(np.swapaxes(left, -1, -2), off) / np.where(singular > 0.0, singular, np.nan)
    move = product(np.swapaxes(right, -1, -2), along)
    return move * unit, r_c * _norm(move), singular[..., -1], off


def _norm(vector: Array) -> Array:
    """Lengths of vectors, each as NumPy has it for one."""
    return np.sqrt(product(vector[..., np.newaxis, :], vector))[..., 0]


def _drift(
    geometry: CentreGeometry,
    pose: Array,
    feet: Array,
    limb: int,
    directions: Array,
    longest: float,
) -> Array:
    """Displacement (6), in unit motions, that betters stroke and index in open directions."""
    by = _PROBE * geometry.size
    probe = by / geometry.platform_radius * directions * _unit_motion(geometry)
    poses = moved(np.broadcast_to(pose, (2 * len(probe), 6)), np.concatenate((probe, -probe)))
    middle = 0.5 * (geometry.stroke_min + geometry.stroke_max)
    half = 0.5 * (geometry.stroke_max - geometry.stroke_min)
    cost = np.mean(((leg_lengths(geometry, poses, feet) - middle) / half) ** 4, axis=-1)
    standing = [other for other in range(1, geometry.limbs + 1) if other != limb]
    if len(standing) > 2:
        cost -= _INDEX_WEIGHT * wrench_indices(geometry, poses, feet, standing=standing).w_minmax
    ahead, behind = cost[: len(probe)], cost[len(probe) :]
    way = -_GAIN * geometry.size**2 * (ahead - behind) / (2.0 * by)
    way *= min(1.0, longest / max(float(np.linalg.norm(way)), 1e-300))
    return way / geometry.platform_radius @ directions


def _unit_motion(geometry: CentreGeometry) -> Array:
    """(6) rotation by 1 rad, translation by r_c [rad, m]."""
    return geometry.platform_radius / length_scale(geometry)


def _standing_legs(geometry: CentreGeometry, lock_set: LockSet) -> Array:
    """Mask (2n) of the legs of limbs that stand."""
    return np.repeat(np.arange(1, geometry.limbs + 1) != lock_set.limb, 2)


def _wrapped(angle: Array) -> Array:
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def _indices(joints: Sequence[tuple[int, int]]) -> tuple[Array, Array]:
    limbs, numbers = np.array(joints, dtype=int).reshape(-1, 2).T - 1
    return limbs, numbers


def _smallest(matrix: Array) -> Array:
    return decomposed(matrix)[1][..., -1]
