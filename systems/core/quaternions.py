"""Rotations as quaternions (w, x, y, z), in plain numbers."""

from collections.abc import Sequence
from functools import reduce

from parapod.systems.core.elementwise import (
    atan2,
    copysign,
    greatest,
    length_of,
    quotient,
    sin_cos,
    sqrt,
    where,
)

type Quaternion = tuple[float, float, float, float]
type Vector3 = tuple[float, float, float]


def product(p: Sequence[float], q: Sequence[float]) -> Quaternion:
    """Quaternion of the rotation q, followed by p in the axes that do not turn."""
    (a, b, c, d), (w, x, y, z) = p, q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def of_turn(turn: Sequence[float]) -> Quaternion:
    """Quaternion of a rotation vector [rad]."""
    angle = length_of(*turn)
    sine, cosine = sin_cos(0.5 * angle)
    share = where(angle > 0.0, quotient(sine, angle), 0.5)
    x, y, z = (share * part for part in turn)
    return cosine, x, y, z


def of_angles(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Quaternion of R = R_z(yaw) R_y(pitch) R_x(roll) [rad]; NaN for infinite angles."""
    (a, d), (b, e), (c, f) = sin_cos(0.5 * roll), sin_cos(0.5 * pitch), sin_cos(0.5 * yaw)
    return (
        d * e * f + a * b * c,
        a * e * f - d * b * c,
        d * b * f + a * e * c,
        d * e * c - a * b * f,
    )


def of_axes(axes: Sequence[Sequence[float]]) -> Quaternion:
    """Quaternion of a body with these unit vectors as its axes x, y and z.

    By the largest of its elements, after Shepperd, "Quaternion from rotation matrix", 1978.
    """
    (a, d, g), (b, e, h), (c, f, i) = axes
    squares = (a + e + i, a - e - i, e - a - i, i - a - e)
    largest = reduce(greatest, squares)
    twice = sqrt(1.0 + largest)
    by, half = 0.5 / twice, 0.5 * twice
    if largest == squares[0]:
        return half, (h - f) * by, (c - g) * by, (d - b) * by
    if largest == squares[1]:
        return (h - f) * by, half, (b + d) * by, (c + g) * by
    if largest == squares[2]:
        return (c - g) * by, (b + d) * by, half, (f + h) * by
    return (d - b) * by, (c + g) * by, (f + h) * by, half


def turn_between(start: Sequence[float], end: Sequence[float]) -> Vector3:
    """Rotation vector [rad], in the axes that do not turn, from one rotation to another."""
    w, x, y, z = start
    cosine, *sines = product(end, (w, -x, -y, -z))
    sine = length_of(*sines)
    # Quaternions of opposite signs are the same rotation.
    factor = where(sine == 0.0, 2.0, quotient(2.0 * atan2(sine, abs(cosine)), sine))
    factor = copysign(factor, cosine)
    return sines[0] * factor, sines[1] * factor, sines[2] * factor
