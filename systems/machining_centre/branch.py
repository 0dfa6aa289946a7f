"""A limb seen as one serial chain from its foot to the platform: Eqs. (1)-(10), mended.

The chain of Figure 4 (b), from the foot's frame {A}: q_1 about its third axis, q_2 against the
axis y' = z_a x x' that q_1 has turned, q_3 against v_3, the normal of the limb's plane, q_4 along
the limb, q_5 about v_3, q_6 against u, the line from the left pivot to the right one.

Mended, because the printed equations do not return to the pose they came from: projections in
Eqs. (3), (6) and (9) subtract a scalar times a vector; v_c is the direction from P_O to P_C; the
normal in Eq. (4) has unit length; the normal in Eq. (8) is z_a x v_3, not u.
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from parapod.systems.core.batching import of_width
from parapod.systems.core.elementwise import nan_without_warning, sqrt
from parapod.systems.core.rows import numbers_of, values_of
from parapod.systems.core.vectors import (
    Array,
    cross,
    product,
    rotation_columns,
    times,
    turned_angles,
)
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import feet_of, moved_alone

# The line that the chain follows: from the foot to the middle of the pivots, as the paper has it,
# or along the left leg, as a machine has it whose ankle is joined to that leg.
type Along = Literal["middle", "left"]
# A chain's determinant [m^2] below which it is taken for singular; at home it is some 0.05.
_FLAT = 1e-12


@nan_without_warning
def branch_joints(
    geometry: CentreGeometry,
    pose: ArrayLike,
    footholds: ArrayLike | None = None,
    *,
    along: Along = "middle",
) -> Array:
    """Joint values of all limbs' chains at platform poses: Eqs. (1)-(10).

    Args:
        geometry: the centre.
        pose: (..., 6) x, y, z, roll, pitch, yaw of {P} in the world [m, rad].
        footholds: (..., n, 6) poses of the feet's frames; None for the paper's pattern.
        along: line of the chain; "left" makes q_3, q_4 and q_5 those of the left leg.

    Returns:
        (..., n, 6) of q_1 .. q_6 [rad, and q_4 in m].

    Raises:
        ValueError: wrong shapes.
    """
    return _joints(_chains(geometry, pose, footholds, along))


def branch_forward(
    geometry: CentreGeometry,
    joints: ArrayLike,
    footholds: ArrayLike | None = None,
    *,
    along: Along = "middle",
) -> Array:
    """Poses of the platform at the ends of the limbs' chains; equal ones if the joints fit.

    Args:
        geometry: the centre.
        joints: (..., n, 6) of q_1 .. q_6 [rad, and q_4 in m].
        footholds: (..., n, 6) poses of the feet's frames; None for the paper's pattern.
        along: line of the chains.

    Returns:
        (..., n, 6) x, y, z, roll, pitch, yaw of {P} in the world, of each limb [m, rad].

    Raises:
        ValueError: wrong shapes.
    """
    q = of_width(joints, 6, "joints").astype(np.float64)
    if q.ndim < 2 or q.shape[-2] != geometry.limbs:
        raise ValueError(f"joints must have shape (..., {geometry.limbs}, 6), not {q.shape}")
    R_WA, foot = _frames(feet_of(geometry, footholds))
    R_WL = R_WA @ _rotation("ZYX", q[..., 0], -q[..., 1], -q[..., 2])
    R_WP = R_WL @ _rotation(
        "XYZ", q[..., 4], -q[..., 5], np.broadcast_to(-geometry.angles, q.shape[:-1])
    )
    end = foot + q[..., 3:4] * R_WL[..., :, 2]
    origin = end - times(R_WP, _ends(geometry, along))
    return np.concatenate((origin, _angles(R_WP)), axis=-1)


@nan_without_warning
def branch_joints_and_rates(
    geometry: CentreGeometry,
    pose: ArrayLike,
    footholds: ArrayLike | None = None,
    *,
    along: Along = "middle",
) -> tuple[Array, Array]:
    """Joint values, and their rates by the platform's twist at P_O while the feet are at rest.

    Arguments and errors are those of `branch_joints`.

    Returns:
        The joint values, and (..., n, 6, 6) rows of q_1 .. q_6, columns of [angular; linear] in
        the world; rates are NaN where a chain is stretched over its foot's axis or lies in the
        line of its pivots.
    """
    chains = _chains(geometry, pose, footholds, along)
    return _joints(chains), _rates(chains)


def foot_of_limb(
    geometry: CentreGeometry,
    pose: ArrayLike,
    limb: int,
    lengths: ArrayLike,
    locked: ArrayLike,
    *,
    along: Along = "middle",
) -> Array:
    """Pose (6) of a loose foot whose limb's joints 1, 2, 3 and 6 are locked [m, rad].

    Args:
        geometry: the centre.
        pose: (6) of the platform, or rows (rows, 6) [m, rad].
        limb: counted from 1.
        lengths: (2) of its left and right leg, or those of each row [m].
        locked: (4) values of q_1, q_2, q_3 and q_6, or those of each row [rad].
        along: line of the limb's chain.

    Raises:
        ValueError: wrong shapes, or legs that do not meet.
    """
    left, right = numbers_of(of_width(lengths, 2, "lengths"))
    q_1, q_2, q_3, q_6 = np.moveaxis(of_width(locked, 4, "locked"), -1, 0)
    apart = float(np.linalg.norm(geometry.pivots[1] - geometry.pivots[0]))
    if along == "middle":
        length = sqrt(0.5 * (left**2 + right**2) - 0.25 * apart**2)
        sine = (right**2 - left**2) / (2.0 * length * apart)
    else:
        length = left
        sine = (right**2 - left**2 - apart**2) / (2.0 * left * apart)
    sines = np.array(values_of(sine))
    if not (np.abs(sines) <= 1.0).all():
        raise ValueError(f"legs of {left:g} and {right:g} m do not meet: {apart:g} m are between")
    q_5, turn = np.arcsin(sines), np.full(sines.shape, -geometry.angles[limb - 1])
    R_WP, origin = _frames(of_width(pose, 6, "pose"))
    R_WL = R_WP @ np.swapaxes(_rotation("XYZ", q_5, -q_6, turn), -1, -2)
    R_WA = R_WL @ np.swapaxes(_rotation("ZYX", q_1, -q_2, -q_3), -1, -2)
    end = product(R_WP, _ends(geometry, along)[limb - 1])
    foot = origin + end - np.array(values_of(length))[..., np.newaxis] * R_WL[..., 2]
    return np.concatenate((foot, _angles(R_WA)), axis=-1)


def turned_foot(foot_pose: Array, angle: float) -> Array:
    """A foot's pose (6) after a turn [rad] about its third axis."""
    R_WA, place = _frames(foot_pose)
    turn = angle * R_WA[:, 2]
    return np.concatenate((place, turned_angles(foot_pose[3:].tolist(), turn.tolist())))


def turned_feet(feet: Array, angles: Array) -> Array:
    """Poses (rows, 6) of feet after turns (rows) [rad], each as `turned_foot` has it for one."""
    turns = angles[:, np.newaxis] * _frames(feet)[0][..., :, 2]
    return moved_alone(feet, np.hstack((turns, np.zeros_like(turns))))


class _Chains(NamedTuple):
    """Axes and arms of the limbs' chains in the world, (..., n, 3) each, and their lengths."""

    x_a: Array
    z_a: Array
    y: Array
    v_3: Array
    v_c: Array
    u: Array
    line: Array
    length: Array
    from_foot: Array
    from_end: Array


def _chains(
    geometry: CentreGeometry, pose: ArrayLike, footholds: ArrayLike | None, along: Along
) -> _Chains:
    """The chains at poses; `from_foot` and `from_end` lead to P_O."""
    R_WP, origin = _frames(of_width(pose, 6, "pose"))
    R_WA, foot = _frames(feet_of(geometry, footholds))
    R_WP, origin = R_WP[..., np.newaxis, :, :], origin[..., np.newaxis, :]
    u = times(R_WP, _unit(geometry.pivots[1::2] - geometry.pivots[0::2]))
    end = times(R_WP, _ends(geometry, along))
    from_foot = origin - foot
    span = end + from_foot
    length = np.linalg.norm(span, axis=-1)
    line = span / length[..., np.newaxis]
    x_a, z_a = R_WA[..., :, 0], R_WA[..., :, 2]
    v_3 = _unit(cross(u, line))
    y = _unit(cross(np.broadcast_to(z_a, v_3.shape), v_3))
    v_c = times(R_WP, _unit(geometry.middles))
    return _Chains(x_a, z_a, y, v_3, v_c, u, line, length, from_foot, -end)


def _joints(chains: _Chains) -> Array:
    x_a, z_a, y, v_3, v_c, u, line, length, *_ = chains
    z_2, across = _perpendicular(z_a, v_3), _perpendicular(v_3, z_a)
    # From, to, about: Eqs. (10), (8), (7), (4), (2).
    rows = (
        (x_a, across, z_a),
        (z_2, z_a, y),
        (line, z_2, v_3),
        (u, line, v_3),
        (_perpendicular(line, u), v_c, u),
    )
    first, second, normal = (_beside(line.shape, *vectors) for vectors in zip(*rows, strict=True))
    angles = _angle(first, second, normal)
    joints = np.empty((*length.shape, 6))
    joints[..., :3], joints[..., 3] = angles[..., :3], length
    joints[..., 4:] = 0.5 * np.pi - angles[..., 3:]
    return joints


def _rates(chains: _Chains) -> Array:
    shape, v_3 = chains.line.shape, chains.v_3
    axes = _beside(shape, chains.z_a, -chains.y, -v_3, chains.line, v_3, -chains.u)
    arms = _beside(shape, *(chains.from_foot,) * 4, *(chains.from_end,) * 2)
    # Twist [angular; linear] at P_O by which each joint moves the platform.
    twists = np.concatenate((axes, cross(axes, arms)), axis=-1)
    twists[..., 3, :3], twists[..., 3, 3:] = 0.0, chains.line
    twists = np.swapaxes(twists, -1, -2)
    is_regular = np.isfinite(twists).all(axis=(-2, -1))
    rates = np.full(twists.shape, np.nan)
    is_regular[is_regular] = np.abs(np.linalg.det(twists[is_regular])) > _FLAT
    rates[is_regular] = np.linalg.inv(twists[is_regular])
    return rates


def _beside(shape: tuple[int, ...], *vectors: Array) -> Array:
    """Vectors (..., 3) of a shape, one a row (..., k, 3); copied, as that is quickest."""
    rows = np.empty((*shape[:-1], len(vectors), 3))
    for i, vector in enumerate(vectors):
        rows[..., i, :] = vector
    return rows


def _ends(geometry: CentreGeometry, along: Along) -> Array:
    """(n, 3) ends of the chains in {P}."""
    if along not in ("middle", "left"):
        raise ValueError(f'along must be "middle" or "left", not {along!r}')
    return geometry.middles if along == "middle" else geometry.pivots[0::2]


def _frames(poses: Array) -> tuple[Array, Array]:
    """Rotations (..., 3, 3) and origins (..., 3) of poses (..., 6)."""
    rotation = np.empty((*poses.shape[:-1], 3, 3))
    for j, column in enumerate(rotation_columns(poses[..., 3], poses[..., 4], poses[..., 5])):
        for i, part in enumerate(column):
            rotation[..., i, j] = part
    return rotation, poses[..., :3]


def _rotation(axes: str, *angles: ArrayLike) -> Array:
    stacked = np.stack(angles, axis=-1).astype(np.float64)
    matrices: Array = Rotation.from_euler(axes, stacked.reshape(-1, 3)).as_matrix()
    return matrices.reshape(*stacked.shape[:-1], 3, 3)


def _angles(rotation: Array) -> Array:
    """Roll, pitch and yaw (..., 3)."""
    angles: Array = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_euler("xyz")
    return angles.reshape(rotation.shape[:-1])


def _unit(vector: Array) -> Array:
    return vector / np.sqrt(np.add.reduce(vector**2, axis=-1, keepdims=True))


def _perpendicular(vector: Array, normal: Array) -> Array:
    """Direction of a vector's part that is perpendicular to a unit vector."""
    along = np.add.reduce(vector * normal, axis=-1, keepdims=True)
    return _unit(vector - along * normal)


def _angle(first: Array, second: Array, normal: Array) -> Array:
    """Angle Theta from one unit vector to another about a unit normal, Eq. (1)."""
    sine = np.add.reduce(normal * cross(first, second), axis=-1)
    return np.arctan2(sine, np.add.reduce(first * second, axis=-1))
