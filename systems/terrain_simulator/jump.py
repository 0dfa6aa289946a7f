"""Squat jump of a leg on the bench: the plate stands, and the slide's drive is idle."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from parapod.systems.core.motion_laws import joined
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.walk import WalkMotion


@dataclass(frozen=True)
class SquatJump:
    """A jump: the hip sinks, is thrown up, flies, lands with bent knee and comes up again.

    The plate's vertical speed in Table 1 is that of a jump of 0.3 m.

    Attributes:
        place: x, z of the plate's middle, below the hip [m].
        mass: mass that the leg carries with its hip, itself included [kg].
        standing: height of the hip above the plate, as it stands [m].
        squatting: the same before the jump, and after landing [m].
        stretched: the same where the foot leaves the plate [m].
        landing: the same where it touches it again: so much bent that it can be drawn up at the
            speed at which the hip falls [m].
        height: rise of the hip in flight above that [m].
        foot_radius: radius of the round foot [m].
        begin: time for which the leg stands first [s].
        sinking: duration of the squat [s].
        braking: duration of the landing [s].
    """

    place: tuple[float, float]
    mass: float
    standing: float = 0.58
    squatting: float = 0.48
    stretched: float = 0.66
    landing: float = 0.62
    height: float = 0.3
    foot_radius: float = 0.02
    begin: float = 0.4
    sinking: float = 0.5
    braking: float = 0.13

    def __post_init__(self) -> None:
        if not self.foot_radius < self.squatting < min(self.standing, self.landing):
            raise ValueError(
                f"squatting = {self.squatting!r} m must be below standing = {self.standing!r} m "
                f"and landing = {self.landing!r} m"
            )
        if not self.landing < self.stretched:
            raise ValueError(
                f"landing = {self.landing!r} m must be below stretched = {self.stretched!r} m"
            )
        for name in ("mass", "height", "sinking", "braking"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ValueError(f"{name} must be positive, not {getattr(self, name)!r}")

    @property
    def hip(self) -> tuple[float, float]:
        """x, z of the hip as it stands [m]."""
        return self.place[0], self.place[1] + self.standing

    @property
    def takeoff_speed(self) -> float:
        """Speed at which the hip leaves [m/s]: sqrt(2 g h)."""
        return math.sqrt(2.0 * GRAVITY * self.height)

    @property
    def pushing(self) -> float:
        """Duration of the push [s]: twice that at the speed of take-off."""
        return 2.0 * (self.stretched - self.squatting) / self.takeoff_speed

    @property
    def flight(self) -> float:
        """Duration of the flight [s]."""
        return (self.takeoff_speed + self.landing_speed) / GRAVITY

    @property
    def landing_speed(self) -> float:
        """Speed at which the hip falls where it lands [m/s]."""
        return math.sqrt(2.0 * GRAVITY * (self.height + self.stretched - self.landing))

    @property
    def drawing_up(self) -> float:
        """Duration in which the foot is drawn up before it lands [s]."""
        return 2.0 * (self.stretched - self.landing) / self.landing_speed

    @cached_property
    def instants(self) -> tuple[float, ...]:
        """Ends of standing, squat, push, flight, landing and rising [s]."""
        parts = (
            self.begin, self.sinking, self.pushing, self.flight, self.braking, self.sinking
        )  # fmt: skip
        return tuple(float(t) for t in np.cumsum(parts))

    @property
    def duration(self) -> float:
        """Time at which it stands again [s]."""
        return self.instants[-1]

    def at(self, time: ArrayLike) -> WalkMotion:
        """Motion at times (...) [s]; see `WalkMotion`, where the hip's height is in `bounce`."""
        t = np.asarray(time, dtype=np.float64)
        above = self._hip(t)
        flies = (t > self.instants[2]) & (t < self.instants[3])
        length = np.where(flies, self._flown(t), above)
        level = np.zeros_like(above)
        pose = np.zeros((3, *t.shape, 3))
        pose[0, ..., :2] = self.place
        foot = np.stack((level, -length), axis=-1)
        foot[0, ..., 1] += self.foot_radius
        bounce = above.copy()
        bounce[0] -= self.standing
        zero = np.zeros(t.shape)
        return WalkMotion(
            pose=pose,
            belt=zero,
            foot=foot,
            force=np.where(flies, 0.0, self.mass * (GRAVITY + above[2])),
            hip_force=zero,
            stance=~flies,
            distance=level,
            rise=level,
            bounce=bounce,
        )

    def _hip(self, t: Array) -> Array:
        """Height (3, ...) of the hip above the plate, and its derivatives [m, s]."""
        stand, squat = (np.array([[h, 0.0, 0.0]]) for h in (self.standing, self.squatting))
        v = self.takeoff_speed
        leaves = np.array([[self.stretched, v, -GRAVITY]])
        lands = np.array([[self.landing, -self.landing_speed, -GRAVITY]])
        legs = ((stand, squat), (squat, leaves), None, (lands, squat), (squat, stand))
        positions = np.zeros((3, *t.shape))
        positions[0] = self.standing
        for begin, end, ends in zip(self.instants[:-1], self.instants[1:], legs, strict=True):
            inside = (t > begin) & (t <= end)
            if ends is not None:
                positions[:, inside] = joined(
                    (t[inside] - begin) / (end - begin), end - begin, *ends
                )[0]
            else:
                since = t[inside] - begin
                positions[0, inside] = self.stretched + since * (v - 0.5 * GRAVITY * since)
                positions[1, inside], positions[2, inside] = v - GRAVITY * since, -GRAVITY
        return positions

    def _flown(self, t: Array) -> Array:
        """Length (3, ...) of the leg in flight: stretched, and drawn up before it lands."""
        last = np.clip((t - self.instants[3]) / self.drawing_up + 1.0, 0.0, 1.0)
        stretched = np.array([[self.stretched, 0.0, 0.0]])
        lands = np.array([[self.landing, -self.landing_speed, -GRAVITY]])
        flown = joined(last, self.drawing_up, stretched, lands)[0]
        return np.where(last > 0.0, flown, stretched.T.reshape(3, *[1] * t.ndim))
