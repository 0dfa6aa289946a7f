"""Kinematics while all feet are clamped: legs' lengths, rates, and the pose from the lengths.

Inside, arrays have the batch last and the components first: numpy's loops then run along the
batch, which is some ten times faster than small matrices one after the other.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from parapod.systems.core.batching import of_width
from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.core.rows import each, matrix_of, numbers_of
from parapod.systems.core.vectors import (
    Array,
    cross,
    rotation_columns,
    times,
    turn_between,
    turned_angles,
)
from parapod.systems.machining_centre.geometry import CentreGeometry, leg_name

# Newton's steps below this are rounding [m, and r_c rad].
_CONVERGED = 1e-12
_MOST_STEPS = 30
# A step is no longer than this share of r_c: farther, another way to assemble may be nearer.
_LONGEST_STEP = 0.5


class Legs(NamedTuple):
    """The legs at poses, components first and the batch last.

    Attributes:
        arms: (2n, 3, ...) from P_O to the pivots, in the world [m].
        directions: (2n, 3, ...) unit vectors l from the feet to the pivots.
        lengths: (2n, ...) [m].
    """

    arms: Array
    directions: Array
    lengths: Array


class AssembledPose(NamedTuple):
    """A platform's pose from lengths, with what proves it.

    Attributes:
        pose: (..., 6) [m, rad]; NaN where Newton's steps do not converge.
        residual: (...) largest difference of a leg's length before the last step [m]. A
            quadruped's eight lengths may contradict each other: their squares are least then.
        step: (...) length of the last step [m, and r_c rad].
        smallest_singular_value: (...) of the Jacobian with moments divided by r_c; near 0 the
            platform is not held by its legs.
    """

    pose: Array
    residual: Array
    step: Array
    smallest_singular_value: Array


def inverse_kinematics(
    geometry: CentreGeometry, pose: ArrayLike, footholds: ArrayLike | None = None
) -> Array:
    """Lengths of all legs at platform poses.

    Args:
        geometry: the centre.
        pose: (..., 6) x, y, z, roll, pitch, yaw of {P} in the world [m, rad].
        footholds: (..., n, 6) poses of the feet's frames; None for the paper's pattern.

    Returns:
        (..., 2n) lengths from foot to pivot [m]: left and right of limb 1, of limb 2, ...

    Raises:
        UnreachablePosture: the first leg, of the first pose, that is outside its stroke.
        ValueError: wrong shapes.
    """
    lengths = leg_lengths(geometry, pose, footholds)
    check_strokes(geometry, lengths)
    return lengths


def leg_lengths(
    geometry: CentreGeometry, pose: ArrayLike, footholds: ArrayLike | None = None
) -> Array:
    """Lengths of all legs, whatever their stroke; arguments and result as `inverse_kinematics`."""
    return np.moveaxis(legs_at(geometry, pose, footholds).lengths, 0, -1)


def within_stroke(geometry: CentreGeometry, lengths: Array) -> NDArray[np.bool_]:
    """True where a length is within the stroke; false for NaN."""
    return (lengths >= geometry.stroke_min) & (lengths <= geometry.stroke_max)


def check_strokes(geometry: CentreGeometry, lengths: ArrayLike) -> None:
    """Refuses lengths outside the stroke.

    Args:
        geometry: the centre.
        lengths: (..., 2n) [m].

    Raises:
        UnreachablePosture: names the first leg of the first pose.
    """
    array = of_width(lengths, geometry.legs, "lengths")
    outside = ~within_stroke(geometry, array)
    if not outside.any():
        return
    *index, leg = map(int, np.argwhere(outside)[0])
    raise UnreachablePosture(
        leg + 1,
        float(array[(*index, leg)]),
        (geometry.stroke_min, geometry.stroke_max),
        tuple(index) or None,
        f" ({leg_name(leg)}, from foot to pivot)",
    )


def jacobian(
    geometry: CentreGeometry, pose: ArrayLike, footholds: ArrayLike | None = None
) -> Array:
    """Rates of the lengths by the platform's twist: Eqs. (13)-(19), about P_O.

    The rows of Eq. (18) belong to the velocity of the platform's point at the world's origin;
    these belong to the velocity of P_O.

    Args:
        geometry: the centre.
        pose: (..., 6) [m, rad].
        footholds: (..., n, 6) poses of the feet's frames; None for the paper's pattern.

    Returns:
        (..., 2n, 6): rows [moment, force], for a twist [angular; linear] at P_O in the world.

    Raises:
        ValueError: wrong shapes.
    """
    return np.moveaxis(rows_of(legs_at(geometry, pose, footholds)), (0, 1), (-2, -1))


def forward_kinematics(
    geometry: CentreGeometry,
    lengths: ArrayLike,
    near: ArrayLike,
    footholds: ArrayLike | None = None,
    *,
    last_step: float = 1e-12,
) -> AssembledPose:
    """The pose that legs of these lengths hold, by Newton's method; least squares of eight legs.

    Args:
        geometry: the centre.
        lengths: (..., 2n) [m].
        near: (..., 6) a pose nearby; lengths alone leave up to forty ways to assemble.
        footholds: (..., n, 6) poses of the feet's frames; None for the paper's pattern.
        last_step: length of the step after which no other one follows [m, and r_c rad]; what is
            left is about its square by r_c.

    Raises:
        ValueError: wrong shapes.
    """
    goal = of_width(lengths, geometry.legs, "lengths").astype(np.float64)
    pose = of_width(near, 6, "near").astype(np.float64)
    shape = np.broadcast_shapes(goal.shape[:-1], pose.shape[:-1])
    goal = np.broadcast_to(goal, (*shape, geometry.legs))
    pose = np.broadcast_to(pose, (*shape, 6)).copy()
    step = np.full(shape, np.inf)
    for _ in range(_MOST_STEPS):
        twist, step, missing, values = _newton_step(geometry, goal, pose, footholds)
        going = step > _CONVERGED
        if going.any():
            pose = moved(pose, np.where(going[..., None], twist, 0.0))
        if not (step > last_step).any():
            break
    has_converged = step <= last_step
    pose[~has_converged] = np.nan
    return AssembledPose(pose, np.abs(missing).max(axis=-1), step, values[..., -1])


def poses_alone(
    geometry: CentreGeometry, lengths: Array, near: Array, footholds: Array, last_step: float
) -> Array:
    """Poses (rows, 6) by `forward_kinematics`, each to the last bit as if it were alone.

    Args:
        geometry: the centre.
        lengths: (rows, 2n) [m].
        near: (rows, 6) poses nearby.
        footholds: (rows, n, 6) poses of the feet's frames.
        last_step: see `forward_kinematics`.
    """
    poses, going_on = near.copy(), np.arange(len(near))
    for _ in range(_MOST_STEPS):
        twist, step, *_ = _newton_step(
            geometry, lengths[going_on], poses[going_on], footholds[going_on]
        )
        moves = step > _CONVERGED
        poses[going_on[moves]] = moved_alone(poses[going_on[moves]], twist[moves])
        poses[going_on[np.isnan(step)]] = np.nan
        going_on = going_on[step > last_step]
        if not going_on.size:
            break
    poses[going_on] = np.nan
    return poses


def moved_alone(poses: Array, twists: Array) -> Array:
    """Poses (rows, 6) after displacements, each as `moved` has it for one."""
    angles = numbers_of(np.hstack((poses[:, 3:], twists[:, :3])))
    (turned,) = each(lambda *of: turned_angles(of[:3], of[3:]), *([column] for column in angles))
    position = poses[:, :3] + twists[:, 3:]
    return np.column_stack((position, matrix_of(turned, len(poses)).T))


def displacement_alone(start: Array, end: Array) -> Array:
    """Displacements (rows, 6), each as `displacement` has it for one."""
    angles: list[Any] = numbers_of(np.hstack((start[:, 3:], end[:, 3:])))
    vector = turn_between(angles[:3], angles[3:])
    return np.column_stack((matrix_of(vector, len(start)).T, end[:, :3] - start[:, :3]))


def _newton_step(
    geometry: CentreGeometry, goal: Array, pose: Array, footholds: ArrayLike | None
) -> tuple[Array, Array, Array, Array]:
    """Displacement towards lengths, its length, what the lengths lack, and singular values."""
    scale = length_scale(geometry)
    legs = legs_at(geometry, pose, footholds)
    missing = np.ascontiguousarray(goal - np.moveaxis(legs.lengths, 0, -1))
    scaled = np.moveaxis(rows_of(legs), (0, 1), (-2, -1)) / scale
    left, values, right = decomposed(scaled)
    along = times(np.swapaxes(left, -1, -2), missing) / values
    move = times(np.swapaxes(right, -1, -2), along)
    step = np.sqrt(np.sum(move**2, axis=-1))
    longest = _LONGEST_STEP * geometry.platform_radius
    shortened = np.minimum(1.0, longest / np.maximum(step, longest))[..., None]
    return shortened * move / scale, step, missing, values


def length_scale(geometry: CentreGeometry) -> Array:
    """(6) lengths per unit of a twist: r_c = r_p for its rotation [m], 1 for its translation."""
    return np.repeat((geometry.platform_radius, 1.0), 3)


def moved(pose: Array, twist: Array) -> Array:
    """Poses (..., 6) after displacements (..., 6) [rotation vector; translation]."""
    position = pose[..., :3] + twist[..., 3:]
    if position.ndim == 1:
        angles: ArrayLike = turned_angles(pose[3:].tolist(), twist[:3].tolist())
        return np.concatenate((position, angles))
    rotation = Rotation.from_rotvec(twist[..., :3].reshape(-1, 3)) * Rotation.from_euler(
        "xyz", pose[..., 3:].reshape(-1, 3)
    )
    return np.concatenate((position, rotation.as_euler("xyz").reshape(position.shape)), axis=-1)


def displacement(start: Array, end: Array) -> Array:
    """Displacements (..., 6) by which `moved` takes poses from start to end."""
    if start.ndim == end.ndim == 1:
        vector = turn_between(start[3:].tolist(), end[3:].tolist())
        return np.concatenate((vector, end[:3] - start[:3]))
    angles = np.broadcast_arrays(start[..., 3:], end[..., 3:])
    before, after = (Rotation.from_euler("xyz", a.reshape(-1, 3)) for a in angles)
    rotation = (after * before.inv()).as_rotvec().reshape(angles[0].shape)
    return np.concatenate((rotation, end[..., :3] - start[..., :3]), axis=-1)


def legs_at(geometry: CentreGeometry, pose: ArrayLike, footholds: ArrayLike | None = None) -> Legs:
    """The legs at poses.

    Args:
        geometry: the centre.
        pose: (..., 6) [m, rad].
        footholds: (..., n, 6) poses of the feet's frames; None for the paper's pattern.

    Raises:
        ValueError: wrong shapes.
    """
    poses = of_width(pose, 6, "pose")
    feet = feet_of(geometry, footholds)
    shape = np.broadcast_shapes(poses.shape[:-1], feet.shape[:-2])
    x, a = poses, feet[..., :3]
    if shape:
        x = np.moveaxis(np.broadcast_to(x, (*shape, 6)), -1, 0)
        a = np.moveaxis(np.broadcast_to(a, (*shape, geometry.limbs, 3)), (-2, -1), (0, 1))
        first, second, _ = rotation_columns(x[3], x[4], x[5])
    else:  # plain numbers
        first, second, _ = rotation_columns(*map(float, x[3:]))
    b = geometry.pivots.reshape(geometry.legs, 3, *(1,) * (len(shape) + 1))
    # All pivots are in the plane of the first two axes.
    arms = b[:, 0] * np.stack(first) + b[:, 1] * np.stack(second)
    spans = (arms + x[:3]).reshape(geometry.limbs, 2, 3, *shape) - a[:, np.newaxis]
    spans = spans.reshape(arms.shape)
    lengths = np.sqrt(np.add.reduce(spans**2, axis=1))
    return Legs(arms, spans / lengths[:, np.newaxis], lengths)


def rows_of(legs: Legs) -> Array:
    """(2n, 6, ...) rows [moment, force] of the Jacobian about P_O."""
    if legs.lengths.ndim == 1:
        return np.concatenate((cross(legs.arms, legs.directions), legs.directions), axis=1)
    arms, directions = np.moveaxis(legs.arms, 1, -1), np.moveaxis(legs.directions, 1, -1)
    return np.concatenate((np.moveaxis(cross(arms, directions), -1, 1), legs.directions), axis=1)


def feet_of(geometry: CentreGeometry, footholds: ArrayLike | None) -> NDArray[np.float64]:
    """The footholds as an array (..., n, 6); the paper's pattern for None.

    Raises:
        ValueError: wrong shape.
    """
    if footholds is None:
        return geometry.footholds
    feet = np.asarray(footholds, dtype=np.float64)
    if feet.ndim < 2 or feet.shape[-2:] != (geometry.limbs, 6):
        raise ValueError(f"footholds must have shape (..., {geometry.limbs}, 6), not {feet.shape}")
    return feet


def decomposed(matrix: Array, full_matrices: bool = False) -> tuple[Array, Array, Array]:
    """Singular value decomposition; values are NaN of matrices that are not finite."""
    if np.isfinite(matrix).all():
        return np.linalg.svd(matrix, full_matrices)
    is_finite = np.isfinite(matrix).all(axis=(-2, -1), keepdims=True)
    left, values, right = np.linalg.svd(np.where(is_finite, matrix, 0.0), full_matrices)
    return left, np.where(is_finite[..., 0], values, np.nan), right
