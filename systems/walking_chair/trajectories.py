"""Trajectories of body and feet: the circle of a foot, the swing of a foot.

The circle is the one of the paper's experiment with leg 1; the swing goes forwards in a cycloid,
up and down in three sections of sines.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.motion_laws import blended, cycloid
from parapod.systems.core.vectors import Array


class Motion(NamedTuple):
    """Motion of a point, or of several.

    Attributes:
        position: (..., 3) [m].
        velocity: (..., 3) [m/s].
        acceleration: (..., 3) [m/s2].
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]


class BodyMotion(NamedTuple):
    """Motion of the body's frame {S} in the world; by default it is level and at rest.

    Attributes:
        position: (..., 3) of S [m].
        rotation: (..., 3, 3) of {S}.
        velocity: (..., 3) of S [m/s].
        angular_velocity: (..., 3) in the world's axes [rad/s].
        acceleration: (..., 3) of S [m/s2].
        angular_acceleration: (..., 3) in the world's axes [rad/s2].
    """

    position: ArrayLike
    rotation: ArrayLike = np.eye(3)
    velocity: ArrayLike = (0.0, 0.0, 0.0)
    angular_velocity: ArrayLike = (0.0, 0.0, 0.0)
    acceleration: ArrayLike = (0.0, 0.0, 0.0)
    angular_acceleration: ArrayLike = (0.0, 0.0, 0.0)


class BranchMotion(NamedTuple):
    """Motion of a leg's three branches UP, UPS, UPS, or of all legs' (..., 4, 3).

    Attributes:
        length: (..., 3) between the joints' centres [m].
        velocity: (..., 3) of the lengths [m/s].
        acceleration: (..., 3) of the lengths [m/s2].
    """

    length: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]


@dataclass(frozen=True)
class FootCircle:
    """Horizontal circle of the corner E_1 in the leg's frame {A1}, Eq. (49).

    It begins at its nearest point to the x axis and turns counter-clockwise seen from above.

    Attributes:
        radius: radius of the circle [m].
        centre_y: y of its centre [m].
        z: z of its plane [m].
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
        """Duration of the whole motion [s]."""
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
        progress, slope, bend = blended(share, self.ramp / self.duration)
        moving = (t >= 0.0) & (t < self.duration)
        angle = way * progress - 0.5 * math.pi
        rate = np.where(moving, way * slope / self.duration, 0.0)
        rate_rate = np.where(moving, way * bend / self.duration**2, 0.0)
        zeros = np.zeros_like(angle)
        outwards = self.radius * np.stack((np.cos(angle), np.sin(angle), zeros), axis=-1)
        along = self.radius * np.stack((-np.sin(angle), np.cos(angle), zeros), axis=-1)
        rate, rate_rate = rate[..., np.newaxis], rate_rate[..., np.newaxis]
        centre = np.array((0.0, self.centre_y, self.z))
        return Motion(centre + outwards, rate * along, rate_rate * along - rate**2 * outwards)


@dataclass(frozen=True)
class FootTrajectory:
    """Trajectory of a swinging foot, Eqs. (40)-(44), from rest to rest.

    Attributes:
        length: length of the step S_0 along y [m]; negative for a step back.
        height: the highest point H, halfway [m].
        duration: duration of the swing, T_m [s].
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
