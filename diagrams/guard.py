"""Guards of real machines: they watch every job on the hardware and end what is not plausible."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from parapod.systems.core.errors import ParapodError
from parapod.systems.safety.faults import EMERGENCY_STOP_SIGN

# Signals that every guard of legs goes by.
POSITION, AGE, STOP = "legs.position", "status.age", "legs.emergency_stop"


@dataclass(frozen=True)
class Trip:
    """Reason for which a job is ended.

    Attributes:
        name: its name, as documents list it.
        sign: observation that shows it.
        distrusted: parts whose measurements may be wrong: what they show is remembered by no file.
        ends: true if the job is ended; false if its own supervisor reacts.
    """

    name: str
    sign: str
    distrusted: tuple[str, ...] = ()
    ends: bool = True


class Guard(Protocol):
    """Judge of what a machine measures and is commanded.

    One that watches the age of measurements may have `allow_age` as `SignGuard` has it: real jobs
    then raise its limit on a slow computer.

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


class Sign(NamedTuple):
    """Observation that something is wrong.

    Attributes:
        words: words for it.
        persists: time for which it must last to end a job [s].
        distrusted: see `Trip`.
    """

    words: str
    persists: float
    distrusted: tuple[str, ...] = ()


class UsualLimits(Protocol):
    """Limits of what is normal of all legs.

    Attributes:
        fastest: speed of a leg [m/s].
        persists: time for which a sign must last, but for a jump [s].
    """

    # fmt: off
    @property
    def fastest(self) -> float: ...  # noqa: D102
    @property
    def persists(self) -> float: ...  # noqa: D102
    # fmt: on


class SignGuard(ABC):
    """Guard of drives by signs that must last; a machine's own tells them from each tick.

    Attributes:
        part: part of the machine that the drives are of.
    """

    part: ClassVar[str] = "legs"

    def __init__(self, period: float, oldest: float):
        """Begins to watch.

        Args:
            period: period of the loop [s].
            oldest: usual largest age of the measurements [s].
        """
        self._period, self._ticks = period, Ticks(period)
        self._usual_age = self._oldest = oldest
        self._position: NDArray[Any] | None = None
        self._stamp = 0.0  # when that was measured [s]
        self._since: dict[str, float] = {}

    def allow_age(self, seconds: float) -> float:
        """Lets measurements be older than usual, if that is more; returns the usual limit [s]."""
        self._oldest = max(seconds, self._usual_age)
        return self._usual_age

    def check(self, now: float, values: Mapping[str, NDArray[Any]]) -> Trip | None:
        """See `Guard`."""
        stamp = now - (float(values[AGE][0]) if AGE in values else 0.0)
        elapsed = max(stamp - self._stamp, self._period)
        signs = dict(self._signs(self._ticks.is_regular(now), elapsed, values))
        self._position, self._stamp = values[f"{self.part}.position"].copy(), stamp
        self._since = {name: self._since.get(name, now) for name in signs}
        for name, sign in signs.items():
            if now - self._since[name] >= sign.persists:
                return Trip(name, sign.words, sign.distrusted)
        return None

    @abstractmethod
    def _signs(
        self, is_regular: bool, elapsed: float, values: Mapping[str, NDArray[Any]]
    ) -> Iterator[tuple[str, Sign]]:
        """Names of the signs of a tick, and the signs.

        Args:
            is_regular: true if it comes a period after the one before.
            elapsed: time between the measurements and those before [s].
            values: see `Guard.check`.
        """

    def _usual(
        self,
        is_regular: bool,
        elapsed: float,
        values: Mapping[str, NDArray[Any]],
        limits: UsualLimits,
        named: Callable[[NDArray[np.bool_], str], str],
    ) -> Iterator[tuple[str, Sign]]:
        """Signs that all drives have at once: the emergency stop, an encoder that jumps.

        Args:
            is_regular: see `_signs`.
            elapsed: see there.
            values: see there.
            limits: limits of normal behaviour.
            named: words about the first leg of some.
        """
        stop, position = f"{self.part}.emergency_stop", values[f"{self.part}.position"]
        if stop in values and values[stop][0] > 0.5:
            yield "emergency_stop", Sign(EMERGENCY_STOP_SIGN, 0.0)
        if self._position is not None and is_regular:
            jumps = np.abs(position - self._position) > limits.fastest * elapsed
            if jumps.any():
                words = named(jumps, "changes faster than it can")
                yield "encoder_jump", Sign(words, 0.0, (self.part,))

    def _stale(
        self, values: Mapping[str, NDArray[Any]], limits: UsualLimits
    ) -> Iterator[tuple[str, Sign]]:
        """Sign of data that is old; after those that say more."""
        if AGE in values and not values[AGE][0] <= self._oldest:
            yield f"{self.part}_stale", Sign("measurements that are old", limits.persists)


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
