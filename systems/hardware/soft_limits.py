"""Ends between which axes are kept, whatever they are commanded."""

import math
from collections.abc import Sequence
from dataclasses import dataclass


def check_order(lower: Sequence[float], upper: Sequence[float]) -> None:
    """Refuses limits in the wrong order, or not finite.

    Args:
        lower: (n) smallest positions [m or rad].
        upper: (n) largest positions [m or rad].

    Raises:
        ValueError: not as many of both, or an axis has none between them.
    """
    if len(lower) != len(upper):
        raise ValueError(f"{len(lower)} lower limits and {len(upper)} upper ones")
    for i, (low, high) in enumerate(zip(lower, upper, strict=True), start=1):
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"limits of axis {i} must be finite and in order: {low}, {high}")


@dataclass(frozen=True)
class SoftLimits:
    """Limits of positions that are kept by limiting velocities towards them.

    An axis may go as fast as lets it stop at the limit if it goes on for `lead` before it begins
    to slow down: v lead + v^2 / (2 deceleration) = distance. At a limit and beyond it nothing
    moves outwards; the way back is free.

    Attributes:
        lower: (n) smallest positions [m or rad].
        upper: (n) largest positions [m or rad].
        lead: the longest time from a measurement until an axis that it should stop begins to
            slow down [s]: age of measurements, bus and the lag of the drive.
        deceleration: deceleration of stopping axes [m/s^2 or rad/s^2].
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    lead: float
    deceleration: float

    def __post_init__(self) -> None:
        check_order(self.lower, self.upper)
        for name in ("lead", "deceleration"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be above 0 and finite, not {getattr(self, name)}")

    def allowed(self, velocities: Sequence[float], positions: Sequence[float]) -> list[float]:
        """Velocities (n) with which no axis leaves its limits [m/s or rad/s].

        Args:
            velocities: (n) that are wanted; one that is not finite is 0.
            positions: (n) as measured [m or rad].
        """
        limits = zip(velocities, positions, self.lower, self.upper, strict=True)
        return [self._within(v, x - low, high - x) for v, x, low, high in limits]

    def _within(self, velocity: float, below: float, above: float) -> float:
        if not math.isfinite(velocity):
            return 0.0
        if velocity > 0.0:
            return min(velocity, self._fastest(above))
        return max(velocity, -self._fastest(below))

    def _fastest(self, distance: float) -> float:
        """Largest velocity from which the axis stops at the limit; 0 at it and beyond it."""
        if not distance > 0.0:  # NaN as well
            return 0.0
        a, lead = self.deceleration, self.lead
        # The root without a difference of nearly equal numbers.
        return 2.0 * distance / (lead + math.sqrt(lead**2 + 2.0 * distance / a))
