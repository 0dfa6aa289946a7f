"""Guards of real machines: they watch every job on the hardware and end what is not plausible."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from parapod.systems.core.errors import ParapodError


@dataclass(frozen=True)
class Trip:
    """Reason for which a job is ended.

    Attributes:
        name: its name, as documents list it.
        sign: observation that shows it.
        distrusted: parts whose measurements may be wrong: what they show is remembered by no file.
        ends: whether the job is ended; not if its own supervisor has seen to it.
    """

    name: str
    sign: str
    distrusted: tuple[str, ...] = ()
    ends: bool = True


class Guard(Protocol):
    """Judge of what a machine measures and is commanded.

    Attributes:
        signals: names of the signals that it looks at; a loop need not have all of them.
    """

    @property
    def signals(self) -> frozenset[str]:
        """See the class."""

    def check(self, now: float, values: Mapping[str, NDArray[Any]]) -> Trip | None:
        """Looks at the signals of one tick.

        Args:
            now: monotonic clock [s].
            values: newest values, of those of the signals that the loop has.

        Returns:
            What is wrong; None while everything is plausible.
        """


class Tripped(ParapodError):
    """A job that its guard has ended; the text names the reason and its sign."""

    def __init__(self, trip: Trip):
        self.trip = trip
        super().__init__(f"{trip.name}: {trip.sign}; the job has been ended")


# A tick that comes so much earlier or later than a period after the last one is irregular [-].
_IRREGULAR = 0.5


class Ticks:
    """Tells regular ticks, whose measurements can be compared with those before, from others."""

    def __init__(self, period: float):
        """Begins; the first tick is irregular.

        Args:
            period: period of the loop [s].
        """
        self._period, self._last = period, -math.inf

    def is_regular(self, now: float) -> bool:
        """Whether a tick at this time comes a period after the one before.

        Args:
            now: monotonic clock [s].
        """
        late, self._last = now - self._last - self._period, now
        return abs(late) <= _IRREGULAR * self._period
