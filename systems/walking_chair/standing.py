"""How the chair rests on flat, rigid ground when its branches give way a little under load.

A branch is a spring of stiffness k. With vertical forces N >= 0 of the ground on the twelve
corners of the feet, the corners give way upwards by C N, C = M^T M / k, where M are the branches'
forces by N. The corners' heights

    h + roll y - pitch x + z + C N >= 0

are zero where N is not, and N balances the weight. What is below the actuators, the foot, weighs
on them the other way: N counts there less the foot's own weight w on its corners. That is the
minimum of (N - w)^T C (N - w) / 2 + N^T z over all N >= 0 in balance, a non-negative least squares
problem; height and tilt are its multipliers. Tilts are fractions of a degree: all is linear in
them to a micrometre.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls  # type: ignore[import-untyped]

# Stiffness of a branch [N/m], as in the model of rigid bodies (assumption).
STIFFNESS = 1e6
# How much the balance weighs against the springs' energy.
_BALANCE = 1e3
# Share of the weight below which a corner carries nothing.
_UNLOADED = 1e-7


class Rest(NamedTuple):
    """The chair at rest.

    Attributes:
        roll: of the body [rad].
        pitch: of the body [rad].
        height: of S above the ground [m].
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
) -> Rest:
    """How the chair rests.

    Args:
        corners: (12, 3) of the unloaded feet, from S in {S} [m].
        by_vertical: (12, 12) branch forces by vertical forces on the corners [-].
        weight: of the whole [N].
        centre: (2) or (3) centre of mass from S in {S} [m].
        foot_weight: of each foot, part of the whole [N].
    """
    x, y, z = corners.T
    # Heights are relative to the lowest one; S is found from it.
    level = z - z.min()
    root = by_vertical / np.sqrt(STIFFNESS)
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
