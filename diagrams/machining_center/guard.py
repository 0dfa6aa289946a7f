"""Guard of the real centre: legs that follow, encoders that are right, data that is young."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.guard import Ticks, Trip
from parapod.diagrams.machining_center.scenario import CenterScenario
from parapod.systems.machining_center.geometry import leg_name
from parapod.systems.safety.faults import EMERGENCY_STOP_SIGN

_POSITION, _ERROR, _CURRENT = "legs.position", "length_error", "legs.current"
_AGE, _STOP = "status.age", "legs.emergency_stop"
_LEGS = ("legs",)


@dataclass(frozen=True)
class CenterLimits:
    """Limits of what is normal: design choices.

    Attributes:
        following: largest distance of a leg from where it was led [m].
        share: of the largest force of a leg that its current may mean [-].
        oldest: largest age of the measurements [s].
        persists: time for which a sign must last, but for a jump [s].
    """

    following: float = 4e-3
    share: float = 1.0
    oldest: float = 0.06
    persists: float = 0.1


class CenterGuard:
    """Ends a job in which a leg does not follow, pushes too hard, or is measured wrongly.

    The drives then stop and hold, and all locks and clamps close. What locks and clamps tell is
    watched by the sequencer, which ends a job itself.
    """

    signals = frozenset((_POSITION, _ERROR, _CURRENT, _AGE, _STOP))

    def __init__(self, scenario: CenterScenario, limits: CenterLimits = CenterLimits()):
        """Begins to watch.

        Args:
            scenario: its `control.period`, `legs` and their speeds are taken.
            limits: what is normal.
        """
        self._period, self._limits, legs = scenario.control.period, limits, scenario.legs
        # Twice the largest velocity: encoders are read at instants that are not quite regular.
        self._fastest = 2e-3 * legs.max_velocity_mm_s
        self._most = limits.share * legs.max_force_N / legs.force_per_current_N_A
        self._position: NDArray[Any] | None = None
        self._stamp = 0.0  # when that was measured [s]
        self._ticks = Ticks(scenario.control.period)
        self._since: dict[str, float] = {}

    def check(self, now: float, values: Mapping[str, NDArray[Any]]) -> Trip | None:
        """See `Guard`."""
        stamp = now - (float(values[_AGE][0]) if _AGE in values else 0.0)
        elapsed = max(stamp - self._stamp, self._period)
        signs = dict(self._signs(self._ticks.is_regular(now), elapsed, values))
        self._position, self._stamp = values[_POSITION].copy(), stamp
        self._since = {name: self._since.get(name, now) for name in signs}
        for name, (sign, persists, distrusted) in signs.items():
            if now - self._since[name] >= persists:
                return Trip(name, sign, distrusted)
        return None

    def _signs(
        self, is_regular: bool, elapsed: float, values: Mapping[str, NDArray[Any]]
    ) -> Iterator[tuple[str, tuple[str, float, tuple[str, ...]]]]:
        """Name of each sign, its words, for how long it must last, and whom it makes suspect."""
        limits, position = self._limits, values[_POSITION]
        if _STOP in values and values[_STOP][0] > 0.5:
            yield "emergency_stop", (EMERGENCY_STOP_SIGN, 0.0, ())
        if self._position is not None and is_regular:
            jumps = np.abs(position - self._position) > self._fastest * elapsed
            if jumps.any():
                yield "encoder_jump", (_named(jumps, "changes faster than it can"), 0.0, _LEGS)
        if _ERROR in values:
            off = ~(np.abs(values[_ERROR]) <= limits.following)
            if off.any():
                words = _named(off, f"is more than {1e3 * limits.following:g} mm off its way")
                yield "following_error", (words, limits.persists, _LEGS)
        if _CURRENT in values:
            hard = np.abs(values[_CURRENT]) > self._most
            if hard.any():
                yield "overload", (_named(hard, "carries more than it may"), limits.persists, ())
        if _AGE in values and not values[_AGE][0] <= limits.oldest:
            yield "legs_stale", ("measurements that are old", limits.persists, ())


def _named(which: NDArray[np.bool_], what: str) -> str:
    return f"the {leg_name(int(np.argmax(which)))} {what}"
