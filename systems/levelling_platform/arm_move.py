"""Moves of turntable and arm from rest to rest."""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from parapod.systems.elementwise import Elementwise

type Profile = Literal["cubic", "quintic"]

# Peak rate and peak acceleration of a move from 0 to 1 in unit time.
_PEAKS: dict[str, tuple[float, float]] = {
    "cubic": (1.5, 6.0),
    "quintic": (1.875, 10.0 / math.sqrt(3.0)),
}
# Instants of a move that are looked at: that many intervals, and one more for each of these
# angles [rad] that it is long. Between two of them the margin is smaller by .05 mm at most.
_INTERVALS = 40
_ANGLE_STEP = 0.04


class ArmMotion(NamedTuple):
    """What turntable and arm do at an instant; at rest unless told otherwise.

    Attributes:
        angle: (..., 2) turntable and arm [rad].
        rate: (..., 2) [rad/s].
        acceleration: (..., 2) [rad/s^2].
    """

    angle: ArrayLike
    rate: ArrayLike = (0.0, 0.0)
    acceleration: ArrayLike = (0.0, 0.0)


@dataclass(frozen=True)
class ArmMove:
    """A move of turntable and arm from rest to rest, both along the same polynomial of time.

    Attributes:
        start: (2) angles at which it begins [rad].
        goal: (2) angles at which it ends [rad].
        duration: [s]; above zero unless it goes nowhere.
        profile: "cubic" has a continuous rate, "quintic" a continuous acceleration too.
    """

    start: tuple[float, float]
    goal: tuple[float, float]
    duration: float
    profile: Profile = "cubic"

    @classmethod
    def within(
        cls,
        start: tuple[float, float],
        goal: tuple[float, float],
        rate: tuple[float, float],
        acceleration: tuple[float, float],
        profile: Profile = "cubic",
    ) -> Self:
        """The shortest move whose largest rates [rad/s] and accelerations [rad/s^2] are these."""
        peak_rate, peak_acceleration = _PEAKS[profile]
        duration = 0.0
        for a, b, v, w in zip(start, goal, rate, acceleration, strict=True):
            way = abs(b - a)
            duration = max(duration, peak_rate * way / v, math.sqrt(peak_acceleration * way / w))
        return cls(start, goal, duration, profile)

    def at(self, elapsed: float) -> ArmMotion:
        """The motion this long after the beginning [s]; at rest before it and from its end on."""
        if elapsed >= self.duration:
            return ArmMotion(self.goal)
        if elapsed < 0.0:
            return ArmMotion(self.start)
        (a, b), (c, d) = self.start, self.goal
        way = (c - a, d - b)
        s, s_1, s_2 = _profile(self.profile, elapsed / self.duration)
        v, w = s_1 / self.duration, s_2 / (self.duration * self.duration)
        return ArmMotion(
            (a + s * way[0], b + s * way[1]),
            (v * way[0], v * way[1]),
            (w * way[0], w * way[1]),
        )

    def sampled(self) -> ArmMotion:
        """The motion at instants (n) from the beginning to the end, both included, moving."""
        start, way = np.array(self.start), np.subtract(self.goal, self.start)
        intervals = _INTERVALS + int(np.abs(way).max() / _ANGLE_STEP)
        progress = np.linspace(0.0, 1.0, intervals + 1)[:, np.newaxis]
        s, s_1, s_2 = _profile(self.profile, progress)
        time = self.duration or math.inf  # a move that goes nowhere is at rest
        return ArmMotion(start + s * way, s_1 * way / time, s_2 * way / (time * time))


def _profile(profile: Profile, t: Elementwise) -> tuple[Elementwise, Elementwise, Elementwise]:
    """Share of the way in unit time, and its two derivatives."""
    left = 1.0 - t
    if profile == "cubic":
        return t * t * (3.0 - 2.0 * t), 6.0 * t * left, 6.0 - 12.0 * t
    return (
        t * t * t * (10.0 + t * (6.0 * t - 15.0)),
        30.0 * t * t * left * left,
        60.0 * t * left * (left - t),
    )
