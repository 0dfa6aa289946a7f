"""Laws of motion from rest to rest, by their names.

A law gives, for the share x of the duration that has passed, the share s of the way that is done,
and its derivatives ds/dx and d2s/dx2. At both ends the derivatives are those inside.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from parapod.systems.core.vectors import Array

type MotionLaw = Callable[[Array], tuple[Array, Array, Array]]


def blended(x: Array, blend: float) -> tuple[Array, Array, Array]:
    """Constant speed 1 / (1 - blend), which sines lead up to and down from.

    Args:
        x: (...) share of the duration, in [0, 1].
        blend: share of the duration of each sine, in [0, 0.5]; 0 for steps of the speed.
    """
    top = 1.0 / (1.0 - blend)
    near = np.minimum(x, 1.0 - x)
    mirrored = np.where(x > 0.5, -1.0, 1.0)
    if blend == 0.0:
        return 1.0 * x, np.ones_like(x), np.zeros_like(x)
    angle = np.where(near < blend, math.pi * near / blend, math.pi)
    lag = np.where(near < blend, 0.5 * near + 0.5 * blend / math.pi * np.sin(angle), 0.5 * blend)
    distance = top * (near - lag)
    way = np.where(x > 0.5, 1.0 - distance, distance)
    speed = 0.5 * top * (1.0 - np.cos(angle))
    return way, speed, mirrored * 0.5 * top * math.pi / blend * np.sin(angle)


def cycloid(x: Array) -> tuple[Array, Array, Array]:
    """One period of a sine as acceleration."""
    angle = 2.0 * math.pi * x
    return x - np.sin(angle) / (2.0 * math.pi), 1.0 - np.cos(angle), 2.0 * math.pi * np.sin(angle)


def quintic(x: Array) -> tuple[Array, Array, Array]:
    """Polynomial of least jerk from rest to rest."""
    y = 1.0 - x
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2), 30.0 * (x * y) ** 2, 60.0 * x * y * (y - x)


def s_curve(x: Array, ramp: float) -> tuple[Array, Array, Array]:
    """Constant speed 1 / (1 - ramp), which cubics lead up to and down from.

    Its largest acceleration, 1.5 / (ramp (1 - ramp)), is less than that of `blended`.

    Args:
        x: (...) share of the duration, in [0, 1].
        ramp: share of the duration of each cubic, in (0, 0.5].
    """
    top = 1.0 / (1.0 - ramp)
    near = np.minimum(x, 1.0 - x)
    y = np.minimum(near / ramp, 1.0)
    lag = 0.5 * ramp * (1.0 - (1.0 - y) ** 3 * (1.0 + y))
    distance = top * (near - lag)
    acceleration = np.where(x > 0.5, -6.0, 6.0) * top / ramp * y * (1.0 - y)
    return np.where(x > 0.5, 1.0 - distance, distance), top * y**2 * (3.0 - 2.0 * y), acceleration


def joined(x: Array, duration: float, begin: Array, end: Array) -> Array:
    """Polynomial of degree five from one state of motion to another.

    Args:
        x: (...) share of the duration, in [0, 1].
        duration: [s].
        begin: (n, 3) values, rates and accelerations at the beginning.
        end: (n, 3) the same at the end.

    Returns:
        (n, 3, ...) values, rates and accelerations.
    """
    unit = duration ** np.arange(3)
    (p, v, a), (q, w, b) = (begin * unit).T, (end * unit).T
    a, b = 0.5 * a, 0.5 * b
    away, faster, change = q - p - v - a, w - v - 2.0 * a, b - a
    powers = np.stack(
        (
            p,
            v,
            a,
            10.0 * away - 4.0 * faster + change,
            -15.0 * away + 7.0 * faster - 2.0 * change,
            6.0 * away - 3.0 * faster + change,
        )
    )
    pieces = []
    for order in range(3):
        each = [np.multiply.outer(c, x**i) for i, c in enumerate(powers)]
        pieces.append(sum(each) / duration**order)
        powers = powers[1:] * np.arange(1, len(powers))[:, np.newaxis]
    return np.stack(pieces, axis=1)


# The speed of "linear" jumps at both ends; that of the others does not.
MOTION_LAWS: dict[str, MotionLaw] = {
    "linear": partial(blended, blend=0.0),
    "ramped": partial(blended, blend=0.2),
    "cycloid": cycloid,
    "quintic": quintic,
}
