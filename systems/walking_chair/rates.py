"""Rates of a leg's branches: exact Jacobian, its rate, velocities and accelerations.

Both the lengths and the reference corner are functions of the UP branch's coordinates, so
J = (d lengths / d up) (d corner / d up)^-1. The paper's Eq. (24) leaves out the foot's spin about
the UP branch, which makes its Jacobian wrong by up to some per cent wherever both angles are not
zero; this one is exact.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import of_width
from parapod.systems.core.elementwise import nan_without_warning
from parapod.systems.core.vectors import Array, inverse, times
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import (
    Reference,
    branch_lengths,
    carried,
    carried_jacobian,
    carried_jacobian_rate,
    reference_corner,
    up_branch,
    ups_vectors,
)
from parapod.systems.walking_chair.trajectories import BranchMotion, Motion


class _Posture(NamedTuple):
    """A leg's posture and what changes with the UP branch's coordinates."""

    up: Array  # (..., 3)
    corner: Array  # (..., 3) reference corner from U_11
    up_by_corner: Array  # (..., 3, 3) the corner's derivatives by `up`, inverted
    ends: Array  # (..., 2, 3) lower ends of the UPS branches from U_11
    ends_by_up: Array  # (..., 2, 3, 3)
    lengths: Array  # (..., 2) of the UPS branches
    directions: Array  # (..., 2, 3) of the UPS branches
    jacobian: Array  # (..., 3, 3) of the lengths by the corner


@nan_without_warning
def leg_jacobian(
    geometry: LegGeometry, point: ArrayLike, reference: Reference = "E1"
) -> NDArray[np.float64]:
    """Derivative of the branches' lengths by the reference corner's place, Eq. (27) made exact.

    Args:
        geometry: the leg.
        point: (..., 3) place of the reference corner in {A1} [m].
        reference: corner, "E1", "E2" or "E3" (or 1, 2, 3); one, or an array (...).

    Returns:
        (..., 3, 3) matrix d(lengths) / d(point) [-]; NaN where the leg cannot reach.

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    return _posture(geometry, point, reference).jacobian


@nan_without_warning
def leg_jacobian_rate(
    geometry: LegGeometry, point: ArrayLike, velocity: ArrayLike, reference: Reference = "E1"
) -> NDArray[np.float64]:
    """Rate of `leg_jacobian` while the reference corner moves, the dotted J of Eq. (28).

    Args:
        geometry: the leg.
        point: (..., 3) place of the reference corner in {A1} [m].
        velocity: (..., 3) its velocity [m/s].
        reference: corner, "E1", "E2" or "E3" (or 1, 2, 3); one, or an array (...).

    Returns:
        (..., 3, 3) [1/s]; NaN where the leg cannot reach.

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    return _jacobian_rate(_posture(geometry, point, reference), of_width(velocity, 3, "velocity"))


@nan_without_warning
def leg_motion(geometry: LegGeometry, motion: Motion, reference: Reference = "E1") -> BranchMotion:
    """Lengths, velocities and accelerations of the branches, Eqs. (12), (27) and (28).

    Args:
        geometry: the leg.
        motion: motion of the reference corner in {A1}, arrays (..., 3).
        reference: corner, "E1", "E2" or "E3" (or 1, 2, 3); one, or an array (...).

    Returns:
        Arrays (..., 3); NaN where the leg cannot reach.

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    velocity = of_width(motion.velocity, 3, "velocity")
    acceleration = of_width(motion.acceleration, 3, "acceleration")
    posture = _posture(geometry, motion.position, reference)
    jacobian_rate = _jacobian_rate(posture, velocity)
    return BranchMotion(
        branch_lengths(geometry, posture.up),
        times(posture.jacobian, velocity),
        times(jacobian_rate, velocity) + times(posture.jacobian, acceleration),
    )


def _posture(geometry: LegGeometry, point: ArrayLike, reference: Reference) -> _Posture:
    up = up_branch(geometry, point, reference)
    corner = carried(geometry, up, reference_corner(geometry, reference))
    up_by_corner = inverse(carried_jacobian(up, corner))
    ends, ends_by_up, lengths, directions, lengths_by_up = _branches(geometry, up)
    jacobian = lengths_by_up @ up_by_corner
    return _Posture(up, corner, up_by_corner, ends, ends_by_up, lengths, directions, jacobian)


def _branches(geometry: LegGeometry, up: Array) -> tuple[Array, ...]:
    """Ends of the UPS branches by `up`; lengths, directions; derivatives of all lengths."""
    both = up[..., np.newaxis, :]
    ends = carried(geometry, both, geometry.lower_joints[1:])
    ends_by_up = carried_jacobian(both, ends)
    vectors = ups_vectors(geometry, up)
    lengths = np.linalg.norm(vectors, axis=-1)
    directions = vectors / lengths[..., np.newaxis]
    ups_rows = np.einsum("...ki,...kij->...kj", directions, ends_by_up)
    return ends, ends_by_up, lengths, directions, _with_up_row(ups_rows, 1.0)


@nan_without_warning
def corner_jacobians(geometry: LegGeometry, up: ArrayLike) -> NDArray[np.float64]:
    """Derivatives G_j of the foot's corners by the branches' lengths.

    Args:
        geometry: the leg.
        up: (..., 3) coordinates of the UP branch [m, rad, rad].

    Returns:
        (..., 3, 3, 3): corner, axis of {A1}, branch.
    """
    up = of_width(up, 3, "up")
    *_, lengths_by_up = _branches(geometry, up)
    both = up[..., np.newaxis, :]
    corners_by_up = carried_jacobian(both, carried(geometry, both, geometry.corners))
    jacobians: Array = corners_by_up @ inverse(lengths_by_up)[..., np.newaxis, :, :]
    return jacobians


def _jacobian_rate(posture: _Posture, velocity: Array) -> Array:
    """J' = (L' - J C') C^-1 with J = L C^-1, L and C being derivatives by `up`."""
    up_rate = times(posture.up_by_corner, velocity)
    corner_rows = carried_jacobian_rate(posture.up, up_rate, posture.corner)
    both, both_rate = posture.up[..., np.newaxis, :], up_rate[..., np.newaxis, :]
    ends_by_up_rate = carried_jacobian_rate(both, both_rate, posture.ends)
    end_velocities = times(posture.ends_by_up, both_rate)
    along = np.einsum("...ki,...ki->...k", posture.directions, end_velocities)
    across = end_velocities - along[..., np.newaxis] * posture.directions
    directions_rate = across / posture.lengths[..., np.newaxis]
    ups_rows = np.einsum("...ki,...kij->...kj", directions_rate, posture.ends_by_up)
    ups_rows = ups_rows + np.einsum("...ki,...kij->...kj", posture.directions, ends_by_up_rate)
    return (_with_up_row(ups_rows, 0.0) - posture.jacobian @ corner_rows) @ posture.up_by_corner


def _with_up_row(ups_rows: Array, value: float) -> Array:
    """Rows of all three branches, given those of the UPS branches; the UP branch is l_11."""
    rows = np.zeros((*ups_rows.shape[:-2], 3, 3))
    rows[..., 0, 0] = value
    rows[..., 1:, :] = ups_rows
    return rows
