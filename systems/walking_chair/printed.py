"""Equations of the walking chair's paper as printed, for comparison with the corrected ones."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import foot_rotation, ups_vectors

type Vector = NDArray[np.float64]


def skew(v: Vector) -> Vector:
    """S(v), with S(v) u = v x u."""
    x, y, z = v
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))


def _half_tangents(
    geometry: LegGeometry, point: Vector, sign_v: float, sign_u: float
) -> tuple[float, float]:
    """U and v of Eqs. (18) and (16) for E_2, with signs of the roots."""
    b_s, b_c = 0.5 * geometry.b, 0.5 * math.sqrt(3.0) * geometry.b
    x, y, z = point
    t_m = math.sqrt(x * x + y * y + (z + geometry.x1) ** 2 - geometry.b**2)
    v = (-t_m + sign_v * math.sqrt(t_m**2 + b_c**2 - y * y)) / (b_c - y)
    beta = 2.0 * math.atan(v)
    k = b_c * math.sin(beta) + t_m * math.cos(beta)
    u = (k + sign_u * math.sqrt(k * k + b_s**2 - x * x)) / (b_s - x)
    return u, v


def roots(
    geometry: LegGeometry, point: Vector, sign_v: float, sign_u: float
) -> tuple[float, float]:
    """Angles alpha and beta for E_2 at a point, by Eqs. (16) and (18) [rad].

    Args:
        geometry: the leg.
        point: (3) E_2 in {A1} [m].
        sign_v: sign of the root in Eq. (16).
        sign_u: sign of the root in Eq. (18).
    """
    u, v = _half_tangents(geometry, point, sign_v, sign_u)
    return 2.0 * math.atan(u), 2.0 * math.atan(v)


def printed_angles(geometry: LegGeometry, point: Vector) -> tuple[float, float]:
    """Angles alpha and beta for E_2 at a point, with Eq. (19) as printed [rad]."""
    u, v = _half_tangents(geometry, point, 1.0, -1.0)
    return math.atan(2.0 * u), math.atan(2.0 * v)


def printed_jacobian(geometry: LegGeometry, up: Vector) -> Vector:
    """J_12 of Eqs. (25) to (27) for E_2, with w_11 of Eq. (24) as printed.

    Args:
        geometry: the leg.
        up: (3) l_11 [m], alpha, beta [rad].
    """
    rotation = foot_rotation(up)
    n_11 = -rotation[:, 2]
    turning = skew(n_11) / up[0]
    ends = (geometry.lower_joints - geometry.lower_joints[0]) @ rotation.T
    rows = [n_11]
    for vector, end in zip(ups_vectors(geometry, up), ends[1:], strict=True):
        n = vector / np.linalg.norm(vector)
        rows.append(n + np.cross(end, n) @ turning)
    to_corner = rotation @ (geometry.corners[1] - geometry.lower_joints[0])
    by_joint = np.eye(3) - skew(to_corner) @ turning
    return np.array(rows) @ np.linalg.inv(by_joint)


def _turned(time: float) -> Vector:
    """A body's rotation that changes about all axes."""
    a, b, c = 0.3 + 0.2 * time, -0.2 + 0.3 * time, 0.5 - 0.4 * time
    turn_z = np.array(((math.cos(a), -math.sin(a), 0), (math.sin(a), math.cos(a), 0), (0, 0, 1)))
    turn_y = np.array(((math.cos(b), 0, math.sin(b)), (0, 1, 0), (-math.sin(b), 0, math.cos(b))))
    turn_x = np.array(((1, 0, 0), (0, math.cos(c), -math.sin(c)), (0, math.sin(c), math.cos(c))))
    return turn_z @ turn_y @ turn_x


def _place(time: float) -> Vector:
    return np.array((0.1 * math.sin(time), 0.2 * time, 0.7 + 0.05 * math.cos(2.0 * time)))


def _foot(time: float) -> Vector:
    return np.array((0.2 + 0.1 * time, 0.3 * math.cos(time), 0.02 * math.sin(3.0 * time)))


def _seen(time: float) -> Vector:
    """The foot from the body, along the body's axes."""
    return _turned(time).T @ (_foot(time) - _place(time))


def _rate(function: Callable[[float], Vector], time: float, step: float = 1e-5) -> Vector:
    rate: Vector = (function(time + step) - function(time - step)) / (2.0 * step)
    return rate


def _bend(function: Callable[[float], Vector], time: float, step: float = 1e-4) -> Vector:
    bend: Vector = (function(time + step) + function(time - step) - 2 * function(time)) / step**2
    return bend


def _angular_velocity(time: float) -> Vector:
    turning = _rate(_turned, time) @ _turned(time).T
    return np.array((turning[2, 1], turning[0, 2], turning[1, 0]))


def printed_point_velocity(time: float = 0.4) -> tuple[Vector, Vector, Vector]:
    """Velocity of a foot seen from a body that turns: Eq. (33) printed, corrected, differences."""
    rotation, w, joint_angles = _turned(time), _angular_velocity(time), _seen(time)
    plain = rotation.T @ (_rate(_foot, time) - _rate(_place, time))
    printed = plain - rotation.T @ rotation @ skew(joint_angles) @ w
    corrected = plain + rotation.T @ rotation @ skew(joint_angles) @ rotation.T @ w
    return printed, corrected, _rate(_seen, time)


def printed_point_acceleration(time: float = 0.4) -> tuple[Vector, Vector]:
    """Acceleration of a foot seen from a body that turns: Eq. (35) corrected, differences."""
    rotation, w = _turned(time), _angular_velocity(time)
    turning = _rate(_angular_velocity, time, 1e-4)
    apart = rotation @ _seen(time)
    relative = rotation @ _rate(_seen, time)
    corrected = rotation.T @ (
        _bend(_foot, time)
        - _bend(_place, time)
        - np.cross(turning, apart)
        - np.cross(w, np.cross(w, apart))
        - 2.0 * np.cross(w, relative)
    )
    return corrected, _bend(_seen, time)
