"""Statics of the walking chair at rest: corners of the feet, branches and body.

Legs are taken as massless for the forces. The force of the ground on corner j of a foot is f_j; a
branch then holds with

    tau = -sum_j G_j^T f_j,    G_j = dE_j / dl,

positive where it pushes its ends apart. All vectors are along the body's axes.

At rest on flat, rigid ground a branch gives way under load like a spring of stiffness k. With
vertical forces N >= 0 of the ground on the twelve corners of the feet, the corners give way
upwards by C N, C = M^T M / k, where M are the branches' forces by N. The corners' heights

    h + roll y - pitch x + z + C N >= 0

are zero where N is not, and N balances the weight. The part below the actuators, the foot, weighs
on them the other way: N counts there less the foot's own weight w on its corners. That is the
minimum of (N - w)^T C (N - w) / 2 + N^T z over all N >= 0 in balance, a non-negative least squares
problem; height and tilt are its multipliers. Tilts are fractions of a degree: all is linear in
them to a micrometre.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls  # type: ignore[import-untyped]

from parapod.systems.core.batching import of_width, row_by_row
from parapod.systems.core.vectors import inverse, product
from parapod.systems.walking_chair.geometry import ChairGeometry, LegGeometry
from parapod.systems.walking_chair.leg import leg_corners, up_of_lengths
from parapod.systems.walking_chair.rates import leg_jacobian

_CORNERS = np.array((1, 2, 3))


def corner_jacobians(geometry: LegGeometry, up: ArrayLike) -> NDArray[np.float64]:
    """Derivatives G_j of the foot's corners by the branches' lengths.

    Args:
        geometry: the leg.
        up: (..., 3) coordinates of the UP branch [m, rad, rad].

    Returns:
        (..., 3, 3, 3): corner, axis of {A1}, branch.
    """
    corners = leg_corners(geometry, up)
    return inverse(leg_jacobian(geometry, corners, _CORNERS))


def force_map(geometry: ChairGeometry, lengths: ArrayLike) -> NDArray[np.float64]:
    """Map from forces of the ground on the corners to forces of the branches.

    Args:
        geometry: the chair.
        lengths: (..., 4, 3) of the branches [m].

    Returns:
        (..., 12, 12, 3): branch force tau [N] by corner and axis of {S} of a force of the ground
        [N]; NaN for legs that cannot be assembled.
    """
    return force_map_at(geometry, up_of_lengths(geometry.leg, of_width(lengths, 3, "lengths")))


def force_map_at(geometry: ChairGeometry, up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map of `force_map` at coordinates (..., 4, 3) of the UP branches [m, rad, rad]."""
    by_leg = np.einsum("lai,...lcib->...lbca", geometry.R_SA, corner_jacobians(geometry.leg, up))
    batch = up.shape[:-2]
    whole = np.zeros((*batch, 4, 3, 4, 3, 3))
    for leg in range(4):
        whole[..., leg, :, leg, :, :] = -by_leg[..., leg, :, :, :]
    return whole.reshape(*batch, 12, 12, 3)


# Stiffness of a branch [N/m], as in the model of rigid bodies (assumption).
STIFFNESS = 1e6
# Weight of the balance against the springs' energy.
_BALANCE = 1e3
# Share of the weight below which a corner carries nothing.
_UNLOADED = 1e-7


class Rest(NamedTuple):
    """The chair at rest; rows of several chairs are a dimension ahead of all.

    Attributes:
        roll: roll of the body [rad].
        pitch: pitch of the body [rad].
        height: height of S above the ground [m].
        loads: (12) forces of the ground on the corners [N].
        gaps: (12) of the corners above the ground [m].
        branch_forces: (12) [N].
    """

    roll: NDArray[np.float64]
    pitch: NDArray[np.float64]
    height: NDArray[np.float64]
    loads: NDArray[np.float64]
    gaps: NDArray[np.float64]
    branch_forces: NDArray[np.float64]


def rest(
    corners: NDArray[np.float64],
    by_vertical: NDArray[np.float64],
    weight: ArrayLike,
    centre: NDArray[np.float64],
    foot_weight: float = 0.0,
    stiffness: float = STIFFNESS,
) -> Rest:
    """Find how the chair rests, or each of several whose rows are a dimension ahead of all.

    Args:
        corners: (12, 3) of the unloaded feet, from S in {S} [m].
        by_vertical: (12, 12) branch forces by vertical forces on the corners [-].
        weight: weight of the whole [N].
        centre: (2) or (3) centre of mass from S in {S} [m].
        foot_weight: weight of each foot, part of the whole [N].
        stiffness: axial stiffness of a branch [N/m].
    """
    x, y, z = np.moveaxis(corners, -1, 0)
    weights = np.asarray(weight)[..., np.newaxis]
    # Heights are relative to the lowest one; S is found from it.
    lowest = z.min(axis=-1)
    level = z - lowest[..., np.newaxis]
    root = by_vertical / np.sqrt(stiffness)
    root_T = np.swapaxes(root, -1, -2)
    own = np.full(x.shape[-1], foot_weight / 3.0)
    ones, none = np.ones_like(x), np.zeros_like(weights)
    balance = np.stack((ones, x - centre[..., :1], y - centre[..., 1:2]), axis=-2)
    springs = root @ own - np.linalg.solve(root_T, level[..., np.newaxis])[..., 0]
    loads = row_by_row(
        _least_squares,
        2,
        np.concatenate((root, _BALANCE * balance), axis=-2),
        np.concatenate((springs, _BALANCE * weights, none, none), axis=-1),
    )
    carry = loads > _UNLOADED * weights
    given_way = product(root_T, product(root, loads - own)) + level
    plane = np.stack((ones, -x, y), axis=-1)
    above = row_by_row(_supported, 2, plane, -given_way, carry)
    height, pitch, roll = np.moveaxis(above, -1, 0)
    return Rest(
        roll,
        pitch,
        height - lowest,
        np.where(carry, loads, 0.0),
        np.where(carry, 0.0, given_way + product(plane, above)),
        product(by_vertical, loads - own),
    )


def _least_squares(rows: NDArray[np.float64], aims: NDArray[np.float64]) -> NDArray[np.float64]:
    """Factors, none of them negative, with which rows come nearest to what they aim at."""
    factors: NDArray[np.float64] = nnls(rows, aims)[0]
    return factors


def _supported(
    plane: NDArray[np.float64], heights: NDArray[np.float64], carry: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """(3) coefficients of the plane through the corners that carry."""
    return np.linalg.lstsq(plane[carry], heights[carry], rcond=None)[0]
