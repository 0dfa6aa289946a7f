"""Guard of the real chair: branches that follow, encoders that do not jump, feet that support."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.guard import Ticks, Trip
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.systems.safety.faults import EMERGENCY_STOP_SIGN
from parapod.systems.walking_chair.geometry import BRANCHES

_POSITION, _NODE, _MARGIN = "legs.position", "position_node", "support_margin"
_AGE, _STOP = "status.age", "legs.emergency_stop"


@dataclass(frozen=True)
class ChairLimits:
    """Limits of what is normal: design choices. Behind them what a walk has with drives as bought.

    Attributes:
        following: largest distance of a branch from where it is to be next [m]; .9 mm.
        fastest: speed of a branch [m/s]; .078.
        margin: least distance of the centre of mass from the support's edge [m]; .051.
        oldest: largest age of the measurements [s]; .01.
        persists: time for which a sign must last, but for a jump [s].
    """

    following: float = 5e-3
    fastest: float = 0.15
    margin: float = 0.0
    oldest: float = 0.06
    persists: float = 0.1


class ChairGuard:
    """Ends a walk in which a branch does not follow, an encoder jumps or no foot supports.

    The drives then stop and hold. A branch that is stuck, driven the wrong way or shown wrongly
    is off its way sooner or later; currents are watched by the drives themselves.
    """

    signals = frozenset((_POSITION, _NODE, _MARGIN, _AGE, _STOP))

    def __init__(self, scenario: ChairScenario, limits: ChairLimits = ChairLimits()):
        """Begins to watch.

        Args:
            scenario: its `control.period` is that of the loop.
            limits: what is normal.
        """
        self._period, self._limits = scenario.control.period, limits
        self._position: NDArray[Any] | None = None
        self._ticks = Ticks(scenario.control.period)
        self._since: dict[str, float] = {}

    def check(self, now: float, values: Mapping[str, NDArray[Any]]) -> Trip | None:
        """See `Guard`."""
        signs = dict(self._signs(self._ticks.is_regular(now), values))
        self._position = values[_POSITION].copy()
        self._since = {name: self._since.get(name, now) for name in signs}
        for name, (sign, persists, distrusted) in signs.items():
            if now - self._since[name] >= persists:
                return Trip(name, sign, distrusted)
        return None

    def _signs(
        self, is_regular: bool, values: Mapping[str, NDArray[Any]]
    ) -> Iterator[tuple[str, tuple[str, float, tuple[str, ...]]]]:
        """Name of each sign, its words, for how long it must last, and whom it makes suspect."""
        limits, position = self._limits, values[_POSITION]
        legs = ("legs",)
        if _STOP in values and values[_STOP][0] > 0.5:
            yield "emergency_stop", (EMERGENCY_STOP_SIGN, 0.0, ())
        if self._position is not None and is_regular:
            jumps = np.abs(position - self._position) > limits.fastest * self._period
            if jumps.any():
                yield "encoder_jump", (_named(jumps, "changes faster than it can"), 0.0, legs)
        if _NODE in values:
            off = ~(np.abs(position - values[_NODE]) <= limits.following)
            if off.any():
                words = _named(off, f"is more than {1e3 * limits.following:g} mm off its way")
                yield "following_error", (words, limits.persists, legs)
        if _MARGIN in values and values[_MARGIN][0] < limits.margin:
            words = "the centre of mass is not above the feet that stand"
            yield "no_support", (words, limits.persists, ())
        if _AGE in values and not values[_AGE][0] <= limits.oldest:
            yield "legs_stale", ("measurements that are old", limits.persists, ())


def _named(which: NDArray[Any], what: str) -> str:
    """Sentence about the first branch of some."""
    return f"{BRANCHES[int(np.flatnonzero(which)[0])]} {what}"
