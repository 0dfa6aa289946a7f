"""Force with which a leg carries its share of the body, and the bounce that follows from it.

A robot of the quadruped kind trots on two pairs of legs by turns, half a stride apart. Each leg
pushes with half a sine throughout its stance, whose mean over a stride is the weight that it
carries; so the body goes up and down a little. Laws of this kind are common for such robots; the
paper shows measured forces (Figure 2) without numbers.

A machine that walks slowly does not bounce: there one pair hands the load over to the other one
while both stand, and their forces together are always the weight.
"""

import math
from dataclasses import dataclass

import numpy as np

from parapod.systems.core.motion_laws import quintic
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.gait import Gait


@dataclass(frozen=True)
class Support:
    """Force of one leg over its strides, and motion of the body that two such legs carry.

    Attributes:
        gait: the gait.
        mass: mass of the body that one leg carries, a quarter of a quadruped's [kg].
        is_even: true if both pairs together always carry the weight, and the body does not bounce;
            otherwise each leg pushes with half a sine.
    """

    gait: Gait
    mass: float
    is_even: bool = False

    def __post_init__(self) -> None:
        if self.is_even and not self.gait.duty > 0.5:
            raise ValueError(
                f"an even load needs a duty above 0.5, not {self.gait.duty:g}: one pair of legs "
                "hands it over to the other one while both stand"
            )
        if not (math.isfinite(self.mass) and self.mass > 0.0):
            raise ValueError(f"mass must be positive, not {self.mass!r}")

    @property
    def weight(self) -> float:
        """Weight that one leg carries on the average [N]."""
        return self.mass * GRAVITY

    @property
    def peak(self) -> float:
        """Force of the leg in the middle of its stance [N]."""
        if self.is_even:
            return 2.0 * self.weight
        return 0.5 * math.pi * self.weight / self.gait.duty

    def force(self, share: Array) -> Array:
        """Force (...) of the leg, upwards [N], at shares (...) of a stride from touchdown on."""
        if self.is_even:
            since, both = np.mod(share, 1.0), self.gait.duty - 0.5
            shares = np.clip((since / both, (self.gait.duty - since) / both), 0.0, 1.0)
            return self.peak * quintic(shares)[0].prod(axis=0)
        within = np.mod(share, 1.0) / self.gait.duty
        return np.where(within < 1.0, self.peak * np.sin(math.pi * np.minimum(within, 1.0)), 0.0)

    def bounce(self, share: Array) -> Array:
        """Height (3, ...) of the body above its mean, its rate and the rate of this [m, s].

        Args:
            share: (...) of the stride of the leg; the other one's is half a stride ahead.
        """
        if self.is_even:
            return np.zeros((3, *np.shape(share)))
        one, other = self._lifted(share), self._lifted(np.asarray(share) + 0.5)
        return 0.5 * (one + other)

    def _lifted(self, share: Array) -> Array:
        """Motion (3, ...) of the mass under the force of one leg and its weight alone."""
        s, d = np.mod(share, 1.0), self.gait.duty
        angle = math.pi * np.minimum(s / d, 1.0)
        after = np.maximum(s - d, 0.0)
        # The force by the weight, and its integrals over the share.
        once = 0.5 * (1.0 - np.cos(angle))
        twice = 0.5 * (np.minimum(s, d) - d / math.pi * np.sin(angle)) + after
        # Rate and height at touchdown with which the motion repeats itself, about its mean.
        rate = 0.5 * d - 0.5
        mean = 0.25 * d**2 - (d / math.pi) ** 2 + 0.5 * (1.0 - d)
        height = 1.0 / 6.0 - 0.5 * rate - mean
        duration = 1.0 / self.gait.frequency
        return GRAVITY * np.stack(
            (
                duration**2 * (twice - 0.5 * s**2 + rate * s + height),
                duration * (once - s + rate),
                self.force(s) / self.weight - 1.0,
            )
        )
