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
minimum of (N - w)^T C (N - w) / 2 + N^T z over all N >= 0 in balance; height and tilt are its
multipliers. Which corners carry is found by turns: the equations of those that are thought to are
solved; those that would pull are let go, and then the one that would be lowest below the ground
carries. Tilts are fractions of a degree: all is linear in them to a micrometre.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls  # type: ignore[import-untyped]

from parapod.systems.core.batching import of_width
from parapod.systems.core.vectors import product
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.leg import up_of_lengths
from parapod.systems.walking_chair.rates import corner_jacobians


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
    in_body = geometry.R_SA[:, np.newaxis] @ corner_jacobians(geometry.leg, up)
    by_leg = np.moveaxis(in_body, -1, -3)
    batch = up.shape[:-2]
    whole = np.zeros((*batch, 4, 3, 4, 3, 3))
    for leg in range(4):
        whole[..., leg, :, leg, :, :] = -by_leg[..., leg, :, :, :]
    return whole.reshape(*batch, 12, 12, 3)


# Stiffness of a branch [N/m], as in the model of rigid bodies (assumption).
STIFFNESS = 1e6
# Share of the weight below which a corner carries nothing; that with which one may pull, and the
# depth at which it may be below the ground [m], as numbers are rounded.
_UNLOADED, _PULLING, _BELOW = 1e-7, 1e-9, 1e-13
# Turns after which what carries is taken from the loads that come nearest to a balance.
_MOST_TURNS = 6
# Yielding of the balance, so that its equations have a solution where less than three corners are
# thought to carry; in terms of springs of 1 N/m.
_YIELDING = 1e-15
_IDENTITY = np.eye(15)
# Weight of the balance of a chair that tips over against the energy of its springs.
_BALANCE = 1e3


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
    carrying: NDArray[np.bool_] | None = None,
) -> Rest:
    """Find how the chair rests, or each of several whose rows are a dimension ahead of all.

    One whose centre of mass is beside its feet has the loads that come nearest to a balance.

    Args:
        corners: (12, 3) of the unloaded feet, from S in {S} [m].
        by_vertical: (12, 12) branch forces by vertical forces on the corners [-].
        weight: weight of the whole [N].
        centre: (2) or (3) centre of mass from S in {S} [m].
        foot_weight: weight of each foot, part of the whole [N].
        stiffness: axial stiffness of a branch [N/m].
        carrying: (12) corners that are thought to carry, such as those that did a moment before,
            which saves time; None, or none of them, for all.
    """
    several = corners.shape[:-2]
    x, y, z = np.moveaxis(corners.reshape(-1, *corners.shape[-2:]), -1, 0)
    by_vertical = by_vertical.reshape(-1, *by_vertical.shape[-2:])
    weights = np.broadcast_to(np.reshape(weight, (-1, 1)), (len(x), 1))
    centre = np.broadcast_to(centre.reshape(-1, centre.shape[-1]), (len(x), centre.shape[-1]))
    # Heights are relative to the lowest one; S is found from it.
    lowest = z.min(axis=-1)
    level = z - lowest[:, np.newaxis]
    own = np.full(x.shape, foot_weight / 3.0)
    plane = np.stack((np.ones_like(x), -x, y), axis=-1)
    springs = np.swapaxes(by_vertical, -1, -2) @ by_vertical
    moments = np.concatenate((weights, -weights * centre[:, :1], weights * centre[:, 1:2]), axis=1)
    aims = product(springs, own) - stiffness * level
    equations = _Equations.of(springs, plane, aims, moments, _BELOW * stiffness)

    def nearest(row: int) -> NDArray[np.float64]:
        root = by_vertical[row] / np.sqrt(stiffness)
        return _nearest(root, plane[row], level[row], own[row], moments[row])

    thought = np.zeros(x.shape, dtype=np.bool_) if carrying is None else carrying.reshape(x.shape)
    thought = thought | ~thought.any(axis=1, keepdims=True)
    solution, tipping = _by_turns(equations, thought, nearest)
    loads, above = solution[:, :12], solution[:, 12:] / stiffness
    for row in tipping.tolist():
        loads[row] = nearest(row)
        carry = loads[row] > _UNLOADED * weights[row]
        heights = -(product(springs[row], loads[row] - own[row]) / stiffness + level[row])[carry]
        above[row] = np.linalg.lstsq(plane[row, carry], heights, rcond=None)[0]
    carry = loads > _UNLOADED * weights
    given_way = product(springs, loads - own) / stiffness + level
    height, pitch, roll = above.T
    whole = Rest(
        roll,
        pitch,
        height - lowest,
        np.where(carry, loads, 0.0),
        np.where(carry, 0.0, given_way + product(plane, above)),
        product(by_vertical, loads - own),
    )
    return Rest(*(part.reshape((*several, *part.shape[1:]))[()] for part in whole))


class _Equations(NamedTuple):
    """Balance of rows (n) in terms of springs of 1 N/m, for which all numbers are of one size.

    With loads N and the plane's coefficients q by that stiffness, C N + P q = c at corners that
    carry, and P^T N = m.

    Attributes:
        matrix: (n, 15, 15) of C, P and P^T.
        right: (n, 15) c and m.
        pulling: (n, 1) load below which a corner pulls [N].
        below: depth below the ground at which a corner carries, by that stiffness [N].
    """

    matrix: NDArray[np.float64]
    right: NDArray[np.float64]
    pulling: NDArray[np.float64]
    below: float

    @classmethod
    def of(
        cls,
        springs: NDArray[np.float64],
        plane: NDArray[np.float64],
        aims: NDArray[np.float64],
        moments: NDArray[np.float64],
        below: float,
    ) -> "_Equations":
        """The balance of C (n, 12, 12), P (n, 12, 3), c (n, 12) and m (n, 3)."""
        matrix = np.zeros((len(springs), 15, 15))
        matrix[:, :12, :12], matrix[:, :12, 12:] = springs, plane
        matrix[:, 12:, :12] = np.swapaxes(plane, -1, -2)
        matrix[:, 12:, 12:] = -_YIELDING * np.eye(3)
        right = np.concatenate((aims, moments), axis=1)
        return cls(matrix, right, -_PULLING * moments[:, :1], -below)

    def rows(self, rows: NDArray[np.intp]) -> "_Equations":
        """Those of some rows."""
        return self._replace(
            matrix=self.matrix[rows], right=self.right[rows], pulling=self.pulling[rows]
        )

    def solve(self, carrying: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """The solution (n, 15), and the corners (n, 12) that are not what they are thought to be.

        Args:
            carrying: (n, 12) corners that are thought to carry.
        """
        left_out = np.concatenate((~carrying, np.zeros((len(carrying), 3), np.bool_)), axis=1)
        matrix = np.where(left_out[:, :, np.newaxis], _IDENTITY, self.matrix)
        right = np.where(left_out, 0.0, self.right)
        solution = np.linalg.solve(matrix, right[:, :, np.newaxis])[:, :, 0]
        gaps = (product(self.matrix, solution) - self.right)[:, :12]
        pulling = carrying & (solution[:, :12] < self.pulling)
        gaps = np.where(carrying, np.inf, gaps)
        below = (gaps < self.below) & (gaps == gaps.min(axis=1, keepdims=True))
        return solution, np.where(pulling.any(axis=1, keepdims=True), pulling, below)


def _by_turns(
    equations: _Equations,
    thought: NDArray[np.bool_],
    nearest: Callable[[int], NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Solutions (n, 15), and the rows that no corners which carry make balance.

    Args:
        equations: the balance.
        thought: (n, 12) corners that are thought to carry.
        nearest: gives the loads (12) of a row that come nearest to a balance.
    """
    solution, change = equations.solve(thought)
    waiting = np.flatnonzero(change.any(axis=1))
    carrying, turn = thought.copy(), 1
    while waiting.size and turn <= _MOST_TURNS:
        if turn < _MOST_TURNS:
            carrying[waiting] ^= change[waiting]
        else:  # turns may go round in circles
            carrying[waiting] = [nearest(row) > 0.0 for row in waiting.tolist()]
        solution[waiting], change[waiting] = equations.rows(waiting).solve(carrying[waiting])
        waiting = waiting[change[waiting].any(axis=1)]
        turn += 1
    return solution, waiting


def _nearest(
    root: NDArray[np.float64],
    plane: NDArray[np.float64],
    level: NDArray[np.float64],
    own: NDArray[np.float64],
    moments: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Loads (12), none of them negative, that come nearest to a balance."""
    springs = root @ own - np.linalg.solve(root.T, level)
    rows, aims = np.concatenate((root, _BALANCE * plane.T)), (springs, _BALANCE * moments)
    loads: NDArray[np.float64] = nnls(rows, np.concatenate(aims))[0]
    return loads
