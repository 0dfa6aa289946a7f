"""Guard of the real centre: legs that follow, encoders that are right, data that is young."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.guard import AGE, POSITION, STOP, Sign, SignGuard
from parapod.diagrams.machining_centre.design import LegScenario
from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.systems.machining_centre.geometry import leg_name

_ERROR, _CURRENT = "length_error", "legs.current"
_LEGS = ("legs",)


@dataclass(frozen=True)
class CentreLimits:
    """Limits of what is normal: design choices.

    Attributes:
        following: largest distance of a leg from where it was led [m].
        fastest: speed of a leg [m/s]; twice that of the drives as they are set, as encoders are
            read at instants that are not quite regular.
        share: share of the largest force of a leg that its current may mean [-].
        oldest: largest age of the measurements [s].
        persists: time for which a sign must last, but for a jump [s].
    """

    following: float = 4e-3
    fastest: float = 0.3
    share: float = 1.0
    oldest: float = 0.06
    persists: float = 0.1

    @classmethod
    def for_drives(cls, drives: LegScenario) -> "CentreLimits":
        """Limits of a centre with other drives: of speed the same share."""
        by_speed = drives.max_velocity_mm_s / LegScenario().max_velocity_mm_s
        return cls(fastest=cls.fastest * by_speed)


class CentreGuard(SignGuard):
    """Ends a job in which a leg does not follow, pushes too hard, or is measured wrongly.

    The drives then stop and hold, and all locks and clamps close. What locks and clamps tell is
    watched by the sequencer, which ends a job itself.
    """

    signals = frozenset((POSITION, _ERROR, _CURRENT, AGE, STOP))

    def __init__(self, scenario: CentreScenario, limits: CentreLimits | None = None):
        """Begins to watch.

        Args:
            scenario: its `control.period` and `machine.legs` are taken.
            limits: limits of normal behaviour; None: those of its drives.
        """
        legs = scenario.machine.legs
        self._limits = CentreLimits.for_drives(legs) if limits is None else limits
        super().__init__(scenario.control.period, self._limits.oldest)
        self._most = self._limits.share * legs.max_force_N / legs.force_per_current_N_A

    def _signs(
        self, is_regular: bool, elapsed: float, values: Mapping[str, NDArray[Any]]
    ) -> Iterator[tuple[str, Sign]]:
        """See `SignGuard`."""
        limits = self._limits
        yield from self._usual(is_regular, elapsed, values, limits, _named)
        if _ERROR in values:
            off = ~(np.abs(values[_ERROR]) <= limits.following)
            if off.any():
                words = _named(off, f"is more than {1e3 * limits.following:g} mm off its way")
                yield "following_error", Sign(words, limits.persists, _LEGS)
        if _CURRENT in values:
            hard = np.abs(values[_CURRENT]) > self._most
            if hard.any():
                yield "overload", Sign(_named(hard, "carries more than it may"), limits.persists)
        yield from self._stale(values, limits)


def _named(which: NDArray[np.bool_], what: str) -> str:
    return f"the {leg_name(int(np.argmax(which)))} {what}"
