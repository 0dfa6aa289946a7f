"""The swing of one foot: forwards in a cycloid, up and down in three sections of sines."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from parapod.systems.walking_chair.motion import Motion
from parapod.systems.walking_chair.motion_laws import cycloid
from parapod.systems.walking_chair.vectors import Array


@dataclass(frozen=True)
class FootTrajectory:
    """Trajectory of a swinging foot, Eqs. (40)-(44), from rest to rest.

    Attributes:
        length: of the step S_0 along y [m]; negative for a step back.
        height: the highest point H, halfway [m].
        duration: of the swing, T_m [s].
    """

    length: float = 0.1027
    height: float = 0.100
    duration: float = 5.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.length):
            raise ValueError(f"length must be finite, not {self.length!r}")
        for name in ("height", "duration"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, not {value!r}")

    def motion(self, time: ArrayLike) -> Motion:
        """Motion of the foot from where it stood.

        Args:
            time: (...) since the swing began [s]; before and after it the foot rests.

        Returns:
            Arrays (..., 3), x being 0.
        """
        T = self.duration
        share = np.clip(np.asarray(time, dtype=np.float64) / T, 0.0, 1.0)
        y = [self.length * d / T**order for order, d in enumerate(cycloid(share))]
        z = [self.height * d / T**order for order, d in enumerate(_rise_and_fall(share))]
        zeros = np.zeros_like(share)
        return Motion(*(np.stack((zeros, *yz), axis=-1) for yz in zip(y, z, strict=True)))


def _rise_and_fall(x: Array) -> tuple[Array, Array, Array]:
    """Share of the height and its derivatives by the share x of the duration, Eq. (44).

    The third section is the first one run backwards.
    """
    near = np.minimum(x, 1.0 - x)
    outer = near < 0.25
    angle = 2.0 * math.pi * near
    scale = 1.0 / (4.0 + math.pi)
    height = np.where(outer, 2.0 * angle - np.sin(2.0 * angle), math.pi - 4.0 * np.cos(angle))
    slope = np.where(outer, 2.0 - 2.0 * np.cos(2.0 * angle), 4.0 * np.sin(angle))
    bend = np.where(outer, 4.0 * np.sin(2.0 * angle), 4.0 * np.cos(angle))
    mirrored = np.where(x > 0.5, -1.0, 1.0)
    rate = 2.0 * math.pi
    return scale * height, scale * rate * mirrored * slope, scale * rate**2 * bend
