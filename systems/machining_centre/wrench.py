"""Wrenches that the legs of a clamped centre can resist: Eqs. (20)-(30), exactly.

The forces of the legs, each at most f_max, make a zonotope of wrenches. Its facets follow from all
sets of five legs; no direction is sampled, because the worst one is between those of any sample.
Moments are about P_O and divided by r_c. Eq. (25) writes the same set of wrenches: its H divides
by the forces by which its f is multiplied.
"""

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from parapod.systems.core.batching import of_width, row_by_row
from parapod.systems.core.elementwise import nan_without_warning
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import (
    feet_of,
    jacobian,
    legs_at,
    length_scale,
    rows_of,
)

# Poses that are calculated beside each other: their numbers stay in a core's cache.
_CHUNK = 1024
# Below this share of the largest one a diagonal element is rounding: the platform is not held.
_SINGULAR = 1e-12
# Five columns that are dependent make no facet; their normal is rounding below this.
_DEGENERATE = 1e-9


class WrenchIndices(NamedTuple):
    """Resistance of a centre to wrenches, in units of the sum of its legs' largest forces.

    Attributes:
        w_minmax: (...) magnitude that is resisted in every direction, Eq. (28); 0 where the legs
            do not hold the platform.
        w_max: (...) largest magnitude that is resisted in any direction, Eq. (29).
        ratio: (...) eta = w_max / w_minmax, Eq. (30).
    """

    w_minmax: Array
    w_max: Array
    ratio: Array


def wrench_indices(
    geometry: CentreGeometry,
    pose: ArrayLike,
    footholds: ArrayLike | None = None,
    *,
    standing: Sequence[int] | None = None,
) -> WrenchIndices:
    """Wrench indices at platform poses, whatever the legs' stroke.

    Args:
        geometry: the centre.
        pose: (..., 6) x, y, z, roll, pitch, yaw of {P} in the world [m, rad].
        footholds: (..., n, 6) poses of the feet's frames; None for the paper's pattern.
        standing: limbs that are clamped, counted from 1, at least three; None for all. The
            largest force stays 1 / 2n.

    Raises:
        ValueError: wrong shapes, or too few limbs.
    """
    limbs = range(1, geometry.limbs + 1) if standing is None else standing
    if len(set(limbs)) < 3 or not set(limbs) <= set(range(1, geometry.limbs + 1)):
        raise ValueError(
            f"standing limbs must be at least three of 1..{geometry.limbs}, not {tuple(limbs)}"
        )
    legs = _legs_of(limbs)
    poses, feet = of_width(pose, 6, "pose"), feet_of(geometry, footholds)
    shape = np.broadcast_shapes(poses.shape[:-1], feet.shape[:-2])
    flat = np.broadcast_to(poses, (*shape, 6)).reshape(-1, 6)
    own = feet.ndim > 2
    each = np.broadcast_to(feet, (*shape, *feet.shape[-2:])).reshape(-1, *feet.shape[-2:])
    result = np.empty((2, len(flat)))
    scale = length_scale(geometry)[:, np.newaxis]
    for begin in range(0, len(flat), _CHUNK):
        part = slice(begin, begin + _CHUNK)
        rows = rows_of(legs_at(geometry, flat[part], each[part] if own else feet))[legs] / scale
        result[0, part] = _smallest_resistance(rows)
        result[1, part] = _largest_resistance(rows)
    w_minmax, w_max = (result / geometry.legs).reshape(2, *shape)
    with np.errstate(divide="ignore"):
        return WrenchIndices(w_minmax, w_max, w_max / w_minmax)


def index_alone(
    geometry: CentreGeometry, pose: Array, footholds: Array, standing: Sequence[int]
) -> Array:
    """Index w_minmax of `wrench_indices`, of each pose to the last bit as if it were alone.

    Args:
        geometry: the centre.
        pose: (6) or (rows, 6) of the platform [m, rad].
        footholds: (n, 6) or (rows, n, 6) poses of the feet's frames.
        standing: limbs that are clamped, counted from 1, at least three.
    """
    rows = jacobian(geometry, pose, footholds)[..., _legs_of(standing), :] / length_scale(geometry)
    index: Array = _smallest_resistance(rows[..., np.newaxis])[..., 0] / geometry.legs
    return index


def _legs_of(limbs: Iterable[int]) -> list[int]:
    return [leg for limb in sorted(set(limbs)) for leg in (2 * limb - 2, 2 * limb - 1)]


def _largest_resistance(rows: Array) -> Array:
    """Distance (k) of the zonotope's farthest corner, of rows (m, 6, k), unit forces."""
    count = len(rows)
    pairs = list(combinations(range(count), 2))
    products = np.stack([np.sum(rows[i] * rows[j], axis=0) for i, j in pairs])
    # Corners come in pairs that are opposite: the first sign may be +.
    signs = np.array(list(np.ndindex((1,) + (2,) * (count - 1)))) * -2.0 + 1.0
    of_pairs = np.stack([signs[:, i] * signs[:, j] for i, j in pairs], axis=-1)
    own = np.sum(rows**2, axis=(0, 1))
    return np.sqrt(own + 2.0 * (of_pairs @ products).max(axis=0))


@nan_without_warning
def _smallest_resistance(rows: Array) -> Array:
    """Distance (..., k) of the zonotope's nearest facet, of rows (..., m, 6, k), unit forces.

    The normal u of a facet is perpendicular to five columns h_j of the wrench matrix H; the
    facet's distance is the sum of |u . h_j| over the others, |u| = 1. With y = H^T u, which is in
    the row space of H: six legs have one other column, y = e_i; eight have three, and their part
    of y is perpendicular to the two null vectors of H. The normal is u = pinv(H)^T y. Of more
    legs, of which few poses are looked at, normals follow from all sets of five columns.
    """
    Q, R = _orthogonal(rows)
    inverse = _times_inverse(Q[..., :6, :], R)
    gram = np.einsum("...aik,...bik->...abk", inverse, inverse)  # |u|^2 = y^T gram y
    gram = np.moveaxis(gram, (-3, -2), (0, 1))
    diagonal = np.abs(np.stack([R[..., i, i, :] for i in range(6)]))
    nearest = np.full(diagonal.shape[1:], np.inf)
    if rows.shape[-3] > 8:
        nearest = row_by_row(_nearest_facet, 3, rows)
    elif rows.shape[-3] == 6:
        nearest = 1.0 / np.sqrt(np.stack([gram[i, i] for i in range(6)]).max(axis=0))
    else:
        null = np.moveaxis(Q[..., 6:, :], (-3, -2), (0, 1))
        minors = {
            (i, j): null[i, 0] * null[j, 1] - null[i, 1] * null[j, 0]
            for i, j in combinations(range(8), 2)
        }
        for a, b, c in combinations(range(8), 3):
            y_a, y_b, y_c = minors[b, c], -minors[a, c], minors[a, b]
            square = (
                gram[a, a] * y_a**2
                + gram[b, b] * y_b**2
                + gram[c, c] * y_c**2
                + 2.0 * (gram[a, b] * y_a * y_b + gram[a, c] * y_a * y_c + gram[b, c] * y_b * y_c)
            )
            total = np.abs(y_a) + np.abs(y_b) + np.abs(y_c)
            distance = total / np.sqrt(square)
            nearest = np.where(total > _DEGENERATE, np.fmin(nearest, distance), nearest)
    is_held = diagonal.min(axis=0) > _SINGULAR * diagonal.max(axis=0)
    return np.where(is_held, nearest, 0.0)


def _nearest_facet(rows: Array) -> Array:
    """Distance (k) of the zonotope's nearest facet, of any number of rows (m, 6, k)."""
    fives = np.array(list(combinations(range(len(rows)), 5)))
    without = np.array([[j for j in range(6) if j != i] for i in range(6)])
    nearest = np.empty(rows.shape[-1])
    for k, matrix in enumerate(np.moveaxis(rows, -1, 0)):
        # The vector perpendicular to five others: its elements are minors, with changing signs.
        minors = np.linalg.det(np.moveaxis(matrix[fives][:, :, without], 1, -2))
        normals = minors * (1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
        size = np.linalg.norm(normals, axis=-1)
        is_facet = size > _DEGENERATE
        distance = np.abs(normals[is_facet] @ matrix.T).sum(axis=-1) / size[is_facet]
        nearest[k] = distance.min(initial=np.inf)
    return nearest


def _orthogonal(matrix: Array) -> tuple[Array, Array]:
    """Householder's Q (..., m, m, k) and R (..., 6, 6, k) of matrices (..., m, 6, k)."""
    A, (*batch, count, _, k) = matrix.copy(), matrix.shape
    Q = np.zeros((*batch, count, count, k))
    Q[..., range(count), range(count), :] = 1.0
    for i in range(min(6, count - 1)):
        v = A[..., i:, i, :].copy()
        v[..., 0, :] += np.copysign(np.sqrt(np.sum(v**2, axis=-2)), v[..., 0, :])
        twice = (2.0 / np.sum(v**2, axis=-2))[..., np.newaxis, :]
        below = A[..., i:, i:, :]
        along = twice * np.einsum("...ak,...abk->...bk", v, below)
        below -= v[..., np.newaxis, :] * along[..., np.newaxis, :, :]
        right = Q[..., i:, :]
        along = twice * np.einsum("...abk,...bk->...ak", right, v)
        right -= along[..., np.newaxis, :] * v[..., np.newaxis, :, :]
    return Q, A[..., :6, :, :]


def _times_inverse(Q: Array, R: Array) -> Array:
    """Q R^-T (..., m, 6, k) of upper triangular R (..., 6, 6, k)."""
    X = np.empty(Q.shape)
    for i in reversed(range(6)):
        row = R[..., i, :, :]
        product = np.einsum("...ajk,...jk->...ak", X[..., i + 1 :, :], row[..., i + 1 :, :])
        X[..., i, :] = (Q[..., i, :] - product) / row[..., np.newaxis, i, :]
    return X
