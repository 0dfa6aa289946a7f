"""Rotations as three axes, in plain numbers, and products of batches (..., 3) and (..., 3, 3)."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parapod.systems.core import quaternions
from parapod.systems.core.elementwise import (
    Elementwise,
    asin,
    atan2,
    is_finite,
    length_of,
    sin_cos,
    sqrt,
    where,
)

type Vector3 = tuple[float, float, float]


def rotation_columns(
    roll: Elementwise, pitch: Elementwise, yaw: Elementwise
) -> tuple[tuple[Elementwise, Elementwise, Elementwise], ...]:
    """Columns of R = R_z(yaw) R_y(pitch) R_x(roll), of floats or of arrays of one shape."""
    (s_r, c_r), (s_p, c_p), (s_y, c_y) = sin_cos(roll), sin_cos(pitch), sin_cos(yaw)
    return (
        (c_y * c_p, s_y * c_p, -s_p),
        (c_y * s_p * s_r - s_y * c_r, s_y * s_p * s_r + c_y * c_r, c_p * s_r),
        (c_y * s_p * c_r + s_y * s_r, s_y * s_p * c_r - c_y * s_r, c_p * c_r),
    )


class Axes(NamedTuple):
    """Unit vectors of a body's axes in the world: the columns of its rotation matrix."""

    x: Vector3
    y: Vector3
    z: Vector3

    @classmethod
    def from_quaternion(cls, quaternion: Sequence[float]) -> "Axes":
        """Axes of a body with this quaternion (w, x, y, z), of any length but zero."""
        w, x, y, z = quaternion
        s = 2.0 / (w * w + x * x + y * y + z * z)
        return cls(
            (1.0 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)),
            (s * (x * y - w * z), 1.0 - s * (x * x + z * z), s * (y * z + w * x)),
            (s * (x * z + w * y), s * (y * z - w * x), 1.0 - s * (x * x + y * y)),
        )

    @classmethod
    def from_roll_pitch_yaw(cls, roll: float, pitch: float, yaw: float) -> "Axes":
        """Axes of a body with R = R_z(yaw) R_y(pitch) R_x(roll); NaN for infinite angles."""
        if not is_finite(roll + pitch + yaw):
            return cls(_UNKNOWN, _UNKNOWN, _UNKNOWN)
        return cls(*rotation_columns(roll, pitch, yaw))

    def roll_pitch_yaw(self) -> Vector3:
        """Angles of R = R_z(yaw) R_y(pitch) R_x(roll) [rad]."""
        sine = -self.x[2]
        pitch = asin(where(sine < -1.0, -1.0, where(sine > 1.0, 1.0, sine)))
        return atan2(self.y[2], self.z[2]), pitch, atan2(self.x[1], self.x[0])

    def in_world(self, vector: Sequence[float]) -> Vector3:
        """A vector along the body's axes, in the world."""
        a, b, c = vector
        (x_1, x_2, x_3), (y_1, y_2, y_3), (z_1, z_2, z_3) = self
        return (
            x_1 * a + y_1 * b + z_1 * c,
            x_2 * a + y_2 * b + z_2 * c,
            x_3 * a + y_3 * b + z_3 * c,
        )

    def components(self, vector: Sequence[float]) -> Vector3:
        """A vector of the world along the body's axes."""
        a, b, c = vector
        (x_1, x_2, x_3), (y_1, y_2, y_3), (z_1, z_2, z_3) = self
        return (
            x_1 * a + x_2 * b + x_3 * c,
            y_1 * a + y_2 * b + y_3 * c,
            z_1 * a + z_2 * b + z_3 * c,
        )


_UNKNOWN = (math.nan, math.nan, math.nan)
# Squares of angles [rad] below which their series are exact.
_SMALL = 1e-8


def turned_angles(angles: Sequence[float], turn: Sequence[float]) -> Vector3:
    """Roll, pitch and yaw of a body after a turn in the world.

    SciPy's rotations take ten times as long for a single one.

    Args:
        angles: roll, pitch and yaw of R = R_z(yaw) R_y(pitch) R_x(roll) [rad].
        turn: rotation vector [rad].
    """
    a, b, c = turn
    square = a * a + b * b + c * c
    angle = sqrt(square)
    if square < _SMALL:
        sine, versine = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        half, _ = sin_cos(0.5 * angle)
        sine, versine = sin_cos(angle)[0] / angle, 2.0 * half * half / square
    rotated = []
    for x, y, z in rotation_columns(*angles):
        along = a * x + b * y + c * z
        rotated.append(
            (
                x + sine * (b * z - c * y) + versine * (a * along - square * x),
                y + sine * (c * x - a * z) + versine * (b * along - square * y),
                z + sine * (a * y - b * x) + versine * (c * along - square * z),
            )
        )
    (x_1, x_2, x_3), (_, _, y_3), (_, _, z_3) = rotated
    return atan2(y_3, z_3), atan2(-x_3, length_of(x_1, x_2)), atan2(x_2, x_1)


def turn_between(start: Sequence[float], end: Sequence[float]) -> Vector3:
    """Rotation vector [rad] by which `turned_angles` takes angles from start to end."""
    of_angles = quaternions.of_angles
    return quaternions.turn_between(of_angles(*start), of_angles(*end))


type Array = NDArray[np.float64]

_NEXT, _LAST = np.array((1, 2, 0)), np.array((2, 0, 1))


def cross(a: Array, b: Array) -> Array:
    """Cross products; numpy's own takes many times as long for a single one."""
    return a.take(_NEXT, -1) * b.take(_LAST, -1) - a.take(_LAST, -1) * b.take(_NEXT, -1)


def times(matrix: Array, vector: Array) -> Array:
    """Matrices times vectors."""
    return np.einsum("...ij,...j->...i", matrix, vector)


def product(matrix: Array, vector: Array) -> Array:
    """Matrices times vectors, each as `@` has it for one."""
    # Of what does not lie together NumPy sums in another order.
    result: Array = (matrix @ np.ascontiguousarray(vector)[..., np.newaxis])[..., 0]
    return result


def inverse(matrix: Array) -> Array:
    """Inverses of 3x3 matrices; not finite for singular ones, where numpy's would raise."""
    a, b, c = matrix[..., 0], matrix[..., 1], matrix[..., 2]
    rows = np.empty(matrix.shape)
    rows[..., 0, :], rows[..., 1, :], rows[..., 2, :] = cross(b, c), cross(c, a), cross(a, b)
    determinant = np.einsum("...i,...i->...", a, rows[..., 0, :])
    return rows / determinant[..., np.newaxis, np.newaxis]
