"""The circle that a leg's foot is made to follow in the paper's experiment with leg 1."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from parapod.systems.walking_chair.motion import Motion
from parapod.systems.walking_chair.motion_laws import blended


@dataclass(frozen=True)
class FootCircle:
    """Horizontal circle of the corner E_1 in the leg's frame {A1}, Eq. (49).

    It begins at its nearest point to the x axis and turns counter-clockwise seen from above.

    Attributes:
        radius: of the circle [m].
        centre_y: y of its centre [m].
        z: of its plane [m].
        period: duration of a lap at full speed [s].
        laps: number of laps, after which the foot rests.
        ramp: duration of the sines that lead up to full speed and down from it [s]; 0 for the
            paper's steps of the speed. The whole motion lasts so much longer.
    """

    radius: float = 0.100
    centre_y: float = 0.100
    z: float = -0.6754
    period: float = 5.0
    laps: int = 1
    ramp: float = 0.0

    def __post_init__(self) -> None:
        for name in ("radius", "period", "laps"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, not {value!r}")
        if not (math.isfinite(self.centre_y) and math.isfinite(self.z)):
            raise ValueError(f"centre_y = {self.centre_y!r} and z = {self.z!r} must be finite")
        if not 0.0 <= self.ramp <= self.laps * self.period:
            raise ValueError(
                f"ramp must be in 0..{self.laps * self.period:g} s, the duration of all laps, "
                f"not {self.ramp!r}"
            )

    @property
    def duration(self) -> float:
        """Of the whole motion [s]."""
        return self.laps * self.period + self.ramp

    def motion(self, time: ArrayLike) -> Motion:
        """Motion of the corner E_1.

        Args:
            time: (...) since the motion began [s]. The foot rests before 0 and from `duration`
                on; without a ramp its velocity and acceleration jump there, and are at either
                time those that follow.

        Returns:
            Arrays (..., 3) in {A1}.
        """
        t = np.asarray(time, dtype=np.float64)
        way = 2.0 * math.pi * self.laps
        share = np.clip(t / self.duration, 0.0, 1.0)
        done, slope, bend = blended(share, self.ramp / self.duration)
        moving = (t >= 0.0) & (t < self.duration)
        angle = way * done - 0.5 * math.pi
        rate = np.where(moving, way * slope / self.duration, 0.0)
        rate_rate = np.where(moving, way * bend / self.duration**2, 0.0)
        zeros = np.zeros_like(angle)
        outwards = self.radius * np.stack((np.cos(angle), np.sin(angle), zeros), axis=-1)
        along = self.radius * np.stack((-np.sin(angle), np.cos(angle), zeros), axis=-1)
        rate, rate_rate = rate[..., np.newaxis], rate_rate[..., np.newaxis]
        centre = np.array((0.0, self.centre_y, self.z))
        return Motion(centre + outwards, rate * along, rate_rate * along - rate**2 * outwards)
