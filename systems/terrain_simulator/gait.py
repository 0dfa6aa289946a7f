"""Gait of one leg over the terrain simulator: stance, return, and the height of the body.

Shares are those of a stride, from touchdown on. Functions of a share (...) give arrays (3, ...):
a value and its first and second derivatives by time.
"""

import math
from dataclasses import dataclass

import numpy as np

from parapod.systems.core.motion_laws import quintic, s_curve
from parapod.systems.core.vectors import Array


@dataclass(frozen=True)
class Gait:
    """Gait of one leg.

    Attributes:
        speed: speed of the body v [m/s]; 0 for a leg that treads on the spot.
        frequency: strides a second f [Hz], the paper's "step frequency".
        duty: share of the stride in which the foot stands, d [-].
        ramp: share of the return in which its speed ramps up, and in which it ramps down (the law
            `s_curve`) [-]; None for a quintic.
    """

    speed: float
    frequency: float = 2.0
    duty: float = 0.5
    ramp: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.speed) and self.speed >= 0.0):
            raise ValueError(f"speed must not be negative, but is {self.speed!r}")
        if not (math.isfinite(self.frequency) and self.frequency > 0.0):
            raise ValueError(f"frequency must be positive, not {self.frequency!r}")
        if not 0.0 < self.duty < 1.0:
            raise ValueError(f"duty must be between 0 and 1, not {self.duty!r}")
        if self.ramp is not None and not 0.0 < self.ramp <= 0.5:
            raise ValueError(f"ramp must be in (0, 0.5], not {self.ramp!r}")

    @property
    def stride(self) -> float:
        """Way of the body in a stride [m]."""
        return self.speed / self.frequency

    @property
    def stance(self) -> float:
        """Way of the body while the foot stands, L [m]."""
        return self.duty * self.stride

    @property
    def return_speed(self) -> float:
        """Largest speed at which a pedal returns [m/s]."""
        top = 1.875 if self.ramp is None else 1.0 / (1.0 - self.ramp)
        return self.speed * (top / (1.0 - self.duty) - 1.0)

    def returned(self, share: Array) -> Array:
        """Share (3, ...) of the way to the next foothold that is done: 0 throughout stance."""
        u = self._swung(share)
        progress = quintic(u) if self.ramp is None else s_curve(u, self.ramp)
        return _by_time(progress, self.frequency / (1.0 - self.duty))

    def dipped(self, share: Array) -> Array:
        """Share (3, ...) of the dip: a sixth power, 1 in the middle of the swing."""
        u = self._swung(share)
        q, dq = u * (1.0 - u), 1.0 - 2.0 * u
        dip = 64.0 * q**3, 192.0 * q**2 * dq, 384.0 * q * (dq**2 - q)
        return _by_time(dip, self.frequency / (1.0 - self.duty))

    def body(self, heights: Array, share: Array) -> Array:
        """Height (3, ...) of the body [m]: a uniform cubic B-spline, with knots in mid-stance.

        Args:
            heights: (..., 5) of the footholds, from two before this one to two after it [m].
            share: (...) of the stride that has passed.
        """
        since = share - 0.5 * self.duty
        ahead = (since >= 0.0)[..., np.newaxis]
        a, b, c, d = np.moveaxis(np.where(ahead, heights[..., 1:], heights[..., :-1]), -1, 0)
        y = since - np.floor(since)
        # A polynomial of b and of differences, which is exact on level ground.
        linear, square, cubic = (
            0.5 * (c - a),
            0.5 * (a - 2.0 * b + c),
            (d - a + 3.0 * (b - c)) / 6.0,
        )
        place = b + square / 3.0 + y * (linear + y * (square + y * cubic))
        rate = linear + y * (2.0 * square + 3.0 * y * cubic)
        return _by_time((place, rate, 2.0 * square + 6.0 * y * cubic), self.frequency)

    def _swung(self, share: Array) -> Array:
        return np.clip((share - self.duty) / (1.0 - self.duty), 0.0, 1.0)


def _by_time(value: tuple[Array, Array, Array], rate: float) -> Array:
    """Derivatives by time of a function of a share that grows at this rate [1/s]."""
    return np.stack((value[0], rate * value[1], rate**2 * value[2]))
