"""One axis of a sampled sensor: noise, whole counts and saturation, and the drift of its bias."""

import math
from typing import NamedTuple, Self


class SensorAxis(NamedTuple):
    """How one axis turns a value into a reading.

    Attributes:
        deviation: of a sample's noise.
        resolution: one count; 0 for none.
        limit: largest reading.
    """

    deviation: float
    resolution: float
    limit: float

    @classmethod
    def sampled(cls, period: float, noise_density: float, resolution: float, limit: float) -> Self:
        """An axis with one-sided white noise that is sampled with that period [s].

        The limit becomes one in whole counts, so that a rounded reading cannot exceed it.
        """
        if resolution:
            limit = math.floor(limit / resolution + 1e-6) * resolution
        return cls(math.sqrt(0.5 / period) * noise_density, resolution, limit)

    def read(self, value: float, noise: float) -> float:
        """The reading, in whole counts and within the limit; zero for NaN.

        Args:
            value: what is measured, with its biases.
            noise: unit Gaussian.
        """
        value += self.deviation * noise
        if not -self.limit < value < self.limit:
            return 0.0 if value != value else math.copysign(self.limit, value)
        return round(value / self.resolution) * self.resolution if self.resolution else value


class Drift(NamedTuple):
    """First-order Gauss-Markov process, from one sample to the next.

    Attributes:
        decay: factor of the state.
        kick: factor of unit Gaussian noise.
    """

    decay: float
    kick: float

    @classmethod
    def sampled(cls, period: float, deviation: float, correlation_time: float) -> Self:
        """A process with this stationary deviation, times in [s]."""
        decay = math.exp(-period / correlation_time)
        return cls(decay, deviation * math.sqrt(1.0 - decay * decay))
