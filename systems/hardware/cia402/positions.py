"""Position-controlled axes."""

import math
from collections.abc import Sequence

from parapod.systems.core.elementwise import clamp
from parapod.systems.hardware.canopen import wrapped
from parapod.systems.hardware.cia402.device import LONGEST, Cia402Device, unwrapped
from parapod.systems.hardware.cia402.settings import AxesSettings
from parapod.systems.hardware.cia402.states import Controlword

# A measurement that is older tells nothing about where an axis is [s].
_FRESH = 0.1


class Cia402Positions(Cia402Device):
    """Axes whose positions are commanded; see also `Cia402Device`.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | command `position_command` | n | rad or m | where the axes are to be by the next command |

    The mode has no profile, be it an EPOS2's position mode (-1) or the cyclic synchronous one of
    others (8): an axis goes to its set value at once, and the driver moves that. From one command
    to the next a set value goes by `max_velocity` times the time between them at most, and no
    pause counts for more than 20 ms; so no command makes an axis faster. A
    command that is not finite leaves its axis where it is. Commands beyond the ends of the strokes
    are those of the ends; an axis that is beyond one can only come back.

    **No jumps.** When the drives are enabled the set values are the positions that are measured,
    and so they are after each stop, by brake, emergency stop or failure: axes are let go only when
    a reading has shown, since the stop, that all of them stand. Whatever has been commanded before
    counts no more.

    **Silence.** `neutral` leaves each axis at its last set value, which it reaches within its lag.
    So does a command while positions have not been measured for 0.1 s. A drive that is further
    from its set value than the settings' `following_error` gives up, with a fault.
    """

    def _adopt(self, settings: AxesSettings) -> None:
        super()._adopt(settings)
        self._strokes = None if self._is_homing else settings.strokes
        self._has_limits = self._strokes is not None
        # Set values [counts], and when they were sent.
        self._set, self._moved = [0] * len(settings.node_ids), -math.inf

    def _begin(self, settings: Sequence[int]) -> None:
        pairs = zip(settings, self._counts, strict=True)
        self._set = [unwrapped(setting, count) for setting, count in pairs]
        self._moved = self._clock()

    @property
    def _is_fresh(self) -> bool:
        return self._clock() - self._measured <= _FRESH

    def _may_run(self) -> bool:
        if self._word is Controlword.ENABLE_OPERATION:
            return True
        return self._stands_by_now and self._is_fresh

    def _run(self) -> None:
        now = self._clock()
        offsets: Sequence[int] = ()
        if self._word is not Controlword.ENABLE_OPERATION:
            self._set = [count or 0 for count in self._counts]
        elif self._wanted is not None and self._is_fresh:
            before, elapsed = self._set, min(now - self._moved, LONGEST)
            self._set = self._moved_on(self._wanted, elapsed)
            offsets = self._fed(before, elapsed)
        self._moved = now
        self._send(Controlword.ENABLE_OPERATION, [wrapped(v) for v in self._set], offsets)

    def _fed(self, before: Sequence[int], elapsed: float) -> Sequence[int]:
        """Velocities of the set values that the drives are told beside them, in their unit."""
        share = self._settings.feedforward
        if share == 0.0 or elapsed <= 0.0:
            return ()
        rpm = 60.0 * share / (self._settings.counts_per_turn * elapsed)
        moves = zip(self._controllers, self._set, before, strict=True)
        return [drive.speed((value - previous) * rpm) for drive, value, previous in moves]

    def _moved_on(self, command: Sequence[float], elapsed: float) -> list[int]:
        """Set values after a time, on their ways to positions that are wanted [counts]."""
        step = math.floor(self._settings.counts(self._settings.max_velocity * elapsed))
        axes = zip(command, self._set, self._directions, self._offset, strict=True)
        lower, upper = self._strokes or (None, None)
        positions = []
        for i, (position, value, sign, offset) in enumerate(axes):
            if not math.isfinite(position):
                positions.append(value)
                continue
            if lower is not None and upper is not None:
                here = offset + sign * self._settings.position(value)
                position = float(clamp(position, min(lower[i], here), max(upper[i], here)))
            way = sign * self._settings.counts(position - offset) - value
            positions.append(value + round(float(clamp(way, -step, step))))
        return positions
