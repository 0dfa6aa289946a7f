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

from parapod.systems.core.batching import of_width
from parapod.systems.core.vectors import inverse
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
        (..., 12, 12, 3): branch force tau [N] by corner and axis of {S} of a force of the ground [N];
        NaN for legs that cannot be assembled.
    """
    up = up_of_lengths(geometry.leg, of_width(lengths, 3, "lengths"))
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
    """The chair at rest.

    Attributes:
        roll: roll of the body [rad].
        pitch: pitch of the body [rad].
        height: height of S above the ground [m].
        loads: (12) forces of the ground on the corners [N].
        gaps: (12) of the corners above the ground [m].
        branch_forces: (12) [N].
    """

    roll: float
    pitch: float
    height: float
    loads: NDArray[np.float64]
    gaps: NDArray[np.float64]
    branch_forces: NDArray[np.float64]


def rest(
    corners: NDArray[np.float64],
    by_vertical: NDArray[np.float64],
    weight: float,
    centre: NDArray[np.float64],
    foot_weight: float = 0.0,
    stiffness: float = STIFFNESS,
) -> Rest:
    """Find how the chair rests.

    Args:
        corners: (12, 3) of the unloaded feet, from S in {S} [m].
        by_vertical: (12, 12) branch forces by vertical forces on the corners [-].
        weight: weight of the whole [N].
        centre: (2) or (3) centre of mass from S in {S} [m].
        foot_weight: weight of each foot, part of the whole [N].
        stiffness: axial stiffness of a branch [N/m].
    """
    x, y, z = corners.T
    # Heights are relative to the lowest one; S is found from it.
    level = z - z.min()
    root = by_vertical / np.sqrt(stiffness)
    own = np.full(len(x), foot_weight / 3.0)
    balance = np.stack((np.ones(len(x)), x - centre[0], y - centre[1]))
    springs = root @ own - np.linalg.solve(root.T, level)
    loads, _ = nnls(
        np.vstack((root, _BALANCE * balance)),
        np.concatenate((springs, (_BALANCE * weight, 0.0, 0.0))),
    )
    carry = loads > _UNLOADED * weight
    given_way = root.T @ (root @ (loads - own)) + level
    plane = np.column_stack((np.ones(len(x)), -x, y))
    above, *_ = np.linalg.lstsq(plane[carry], -given_way[carry], rcond=None)
    height, pitch, roll = above.tolist()
    return Rest(
        roll,
        pitch,
        height - z.min(),
        np.where(carry, loads, 0.0),
        np.where(carry, 0.0, given_way + plane @ above),
        by_vertical @ (loads - own),
    )
