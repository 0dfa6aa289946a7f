"""The UP branch, which alone decides where the foot is and how it is inclined.

Its coordinates are up = (..., 3): length l_11 from U_11 to U_14 [m] and the angles alpha about
the upper platform's y axis and beta about the foot's x axis [rad], R = R_y(alpha) R_x(beta),
Eq. (9). The branch runs along the foot's -z axis (Eq. (6) prints it parallel to z; it is
opposite), so what is fixed to the foot at the place m of {E1} is at

    P = R (m - (l_11 + x_2) e_z)    from U_11, in {A1}.

Each universal joint turns within +-90 degrees (Table 1), which leaves one solution.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.vectors import Array, cross, times

_Y_AXIS = np.array((0.0, 1.0, 0.0))


class UpPose(NamedTuple):
    """The UP branch with sines and cosines in the place of its angles, each (...).

    Attributes:
        length: l_11 [m].
        s_a: sine of alpha.
        c_a: cosine of alpha.
        s_b: sine of beta.
        c_b: cosine of beta.
    """

    length: Array
    s_a: Array
    c_a: Array
    s_b: Array
    c_b: Array


def pose_of_corner(geometry: LegGeometry, from_joint: Array, corner: Array) -> UpPose:
    """How the UP branch must be to put a corner of the foot at a place.

    Eqs. (10), (14), (16) and (18) for all three corners at once, with the roots that the legs
    take. With r^2 = t_m^2 + e_y^2, the corner (e_x, e_y) is `depth` = sqrt(r^2 - y^2) below the
    axis of alpha, seen along it, and x^2 + z^2 = depth^2 + e_x^2; so no angle is needed.

    Args:
        geometry: the leg.
        from_joint: (..., 3) the place from U_11, in {A1} [m].
        corner: (..., 3) the corner in {E1} [m].

    Returns:
        The pose; NaN where a joint would have to turn by 90 degrees or more, or the branch have
        no length.
    """
    x, y, z = from_joint[..., 0], from_joint[..., 1], from_joint[..., 2]
    e_x, e_y = corner[..., 0], corner[..., 1]
    across = e_x * e_x
    square = x * x + y * y + z * z - across
    t_m = np.sqrt(square - e_y * e_y)
    depth = np.sqrt(square - y * y)
    around = depth * depth + across
    c_b = (y * e_y + t_m * depth) / square
    c_a = (e_x * x - depth * z) / around
    length = t_m - geometry.x2
    ok = np.where((length > 0.0) & (c_a > 0.0) & (c_b > 0.0), 1.0, np.nan)
    s_a, s_b = -(depth * x + e_x * z) / around, (y * t_m - e_y * depth) / square
    return UpPose(length * ok, s_a, c_a, s_b, c_b)


def up_of_corner(geometry: LegGeometry, from_joint: Array, corner: Array) -> Array:
    """Coordinates of the UP branch that put a corner of the foot at a place.

    Args:
        geometry: the leg.
        from_joint: (..., 3) the place from U_11, in {A1} [m].
        corner: (..., 3) the corner in {E1} [m].

    Returns:
        (..., 3) l_11 [m], alpha, beta [rad], all NaN where `pose_of_corner` has no length.
    """
    pose = pose_of_corner(geometry, from_joint, corner)
    length = np.asarray(pose.length)
    up = np.empty((*length.shape, 3))
    nowhere = 0.0 * length
    up[..., 0] = length
    up[..., 1] = np.arctan2(pose.s_a, pose.c_a) + nowhere
    up[..., 2] = np.arctan2(pose.s_b, pose.c_b) + nowhere
    return up


def is_within_joints(up: Array) -> NDArray[np.bool_]:
    """(...) whether the branch has a length and its joint turns by less than 90 degrees."""
    return (up[..., 0] > 0.0) & (np.abs(up[..., 1:]) < 0.5 * math.pi).all(axis=-1)


def foot_rotation(up: Array) -> Array:
    """(..., 3, 3) rotation of the foot's frame {E1} in {A1}, Eq. (9)."""
    sine, cosine = np.sin(up[..., 1:]), np.cos(up[..., 1:])
    s_a, s_b, c_a, c_b = sine[..., 0], sine[..., 1], cosine[..., 0], cosine[..., 1]
    rotation = np.zeros((*up.shape[:-1], 3, 3))
    rotation[..., 0, 0], rotation[..., 2, 0] = c_a, -s_a
    rotation[..., 0, 1], rotation[..., 1, 1], rotation[..., 2, 1] = s_a * s_b, c_b, c_a * s_b
    rotation[..., 0, 2], rotation[..., 1, 2], rotation[..., 2, 2] = s_a * c_b, -s_b, c_a * c_b
    return rotation


def carried(geometry: LegGeometry, up: Array, places: Array) -> Array:
    """(..., 3) where the foot carries places (..., 3) of {E1}: from U_11, in {A1} [m]."""
    below = np.zeros((*up.shape[:-1], 3))
    below[..., 2] = up[..., 0] + geometry.x2
    return times(foot_rotation(up), places - below)


def carried_jacobian(up: Array, point: Array) -> Array:
    """Derivatives of `carried` by the coordinates of the UP branch.

    Args:
        up: (..., 3) coordinates.
        point: (..., 3) what `carried` gives for them [m].

    Returns:
        (..., 3, 3) columns by l_11 [-], alpha and beta [m/rad].
    """
    rotation = foot_rotation(up)
    by_alpha = cross(_Y_AXIS, point)
    by_beta = cross(rotation[..., 0], point)
    return _columns(-rotation[..., 2], by_alpha, by_beta)


def carried_jacobian_rate(up: Array, up_rate: Array, point: Array) -> Array:
    """Rate of `carried_jacobian` while the UP branch moves.

    Args:
        up: (..., 3) coordinates.
        up_rate: (..., 3) their rates [m/s, rad/s, rad/s].
        point: (..., 3) what `carried` gives for the coordinates [m].

    Returns:
        (..., 3, 3) rates of the columns [1/s], [m/rad/s].
    """
    rotation = foot_rotation(up)
    x_axis, z_axis = rotation[..., 0], rotation[..., 2]
    alpha_rate, beta_rate = up_rate[..., 1, np.newaxis], up_rate[..., 2, np.newaxis]
    angular_velocity = alpha_rate * _Y_AXIS + beta_rate * x_axis
    velocity = times(carried_jacobian(up, point), up_rate)
    # The foot's x axis turns with alpha alone.
    x_axis_rate = alpha_rate * cross(_Y_AXIS, x_axis)
    by_length = -cross(angular_velocity, z_axis)
    by_alpha = cross(_Y_AXIS, velocity)
    by_beta = cross(x_axis_rate, point) + cross(x_axis, velocity)
    return _columns(by_length, by_alpha, by_beta)


def _columns(by_length: Array, by_alpha: Array, by_beta: Array) -> Array:
    """Columns (..., 3) as a matrix; the first may be common to several points (..., n, 3)."""
    matrix = np.empty((*by_beta.shape, 3))
    matrix[..., 0], matrix[..., 1], matrix[..., 2] = by_length, by_alpha, by_beta
    return matrix
