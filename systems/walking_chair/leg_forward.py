"""Where the foot is, given the lengths of a leg's branches.

With h = l_11 + x_2 - x_3, K_i = (a^2 + b^2 + h^2 - l_1i^2) / 2, S and D their half sum and half
difference, rho (cos delta, sin delta) = (b cos 30, h) and psi = beta + delta, the lengths of the
UPS branches are two equations for the angles:

    a b sin^2 30 cos(alpha) + a cos 30 rho cos(psi) = S
    a sin 30 rho sin(alpha) sin(psi) = D

They are equivalent to a polynomial of degree 4 in cos(alpha), with a double root for a leg
without side swing (alpha = 0), where its solutions are poor. Newton's method from the straight leg
finds the assembly that the leg takes: out of 100 000 triples of lengths within the strokes
it found one wherever that polynomial has it, in 12 iterations at most.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.batching import of_width
from parapod.systems.elementwise import nan_without_warning
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import branch_lengths, leg_corners
from parapod.systems.walking_chair.up_branch import is_within_joints
from parapod.systems.walking_chair.vectors import Array

_ITERATIONS = 40
_LARGEST_STEP = 1.0  # [rad]
_SMALLEST_STEP = 1e-15  # [rad]
# How far the lengths of what was found may be from the given ones [m].
_TOLERANCE = 1e-10


class LegPosture(NamedTuple):
    """Where a foot is in its leg's frame {A1}.

    Attributes:
        point: (..., 3) corner E_1 [m].
        alpha: (...) angle of the UP branch and the foot about y [rad].
        beta: (...) their angle about the foot's x axis [rad].
    """

    point: NDArray[np.float64]
    alpha: NDArray[np.float64]
    beta: NDArray[np.float64]


def leg_forward(geometry: LegGeometry, lengths: ArrayLike) -> LegPosture:
    """Where the foot is, given the lengths of the branches.

    Args:
        geometry: the leg.
        lengths: (..., 3) l_11, l_12, l_13 of the branches UP, UPS, UPS [m].

    Returns:
        Corner E_1 and the foot's angles; NaN where the leg cannot be assembled, which is so for
        three out of ten triples of lengths within the strokes.

    Raises:
        ValueError: wrong shapes.
    """
    up = up_of_lengths(geometry, lengths)
    return LegPosture(leg_corners(geometry, up)[..., 0, :], up[..., 1], up[..., 2])


@nan_without_warning
def up_of_lengths(geometry: LegGeometry, lengths: ArrayLike) -> NDArray[np.float64]:
    """Coordinates of the UP branch, given the lengths of all three.

    Args:
        geometry: the leg.
        lengths: (..., 3) l_11, l_12, l_13 [m].

    Returns:
        (..., 3) l_11 [m], alpha, beta [rad]; NaN where the leg cannot be assembled.

    Raises:
        ValueError: wrong shapes.
    """
    given = of_width(lengths, 3, "lengths").astype(np.float64)
    alpha, beta = _newton(geometry, given)
    up = np.stack([given[..., 0], alpha, beta], axis=-1)
    error = np.abs(branch_lengths(geometry, up) - given).max(axis=-1)
    good = (error <= _TOLERANCE) & is_within_joints(up)
    return np.where(good[..., np.newaxis], up, np.nan)


def _newton(geometry: LegGeometry, lengths: Array) -> tuple[Array, Array]:
    """The angles alpha and beta, where the iteration converges."""
    s_30, c_30 = 0.5, 0.5 * np.sqrt(3.0)
    a, b = geometry.a, geometry.b
    l_11, l_12, l_13 = np.moveaxis(lengths, -1, 0)
    h = l_11 + geometry.x2 - geometry.x3
    half_sum = 0.5 * (a * a + b * b + h * h - 0.5 * (l_12 * l_12 + l_13 * l_13))
    half_difference = 0.25 * (l_13 - l_12) * (l_13 + l_12)
    rho, delta = np.hypot(b * c_30, h), np.arctan2(h, b * c_30)
    p, q, r = a * b * s_30 * s_30, a * c_30 * rho, a * s_30 * rho
    alpha, beta = np.zeros_like(l_11), np.zeros_like(l_11)
    for _ in range(_ITERATIONS):
        s_a, c_a = np.sin(alpha), np.cos(alpha)
        s_p, c_p = np.sin(beta + delta), np.cos(beta + delta)
        f = p * c_a + q * c_p - half_sum
        g = r * s_a * s_p - half_difference
        f_a, f_b, g_a, g_b = -p * s_a, -q * s_p, r * c_a * s_p, r * s_a * c_p
        determinant = f_a * g_b - f_b * g_a
        step_a = (f_b * g - g_b * f) / determinant
        step_b = (g_a * f - f_a * g) / determinant
        size = np.maximum(np.abs(step_a), np.abs(step_b))
        scale = np.minimum(1.0, _LARGEST_STEP / np.maximum(size, _LARGEST_STEP))
        alpha, beta = alpha + scale * step_a, beta + scale * step_b
        if not (size > _SMALLEST_STEP).any():
            break
    return alpha, beta
