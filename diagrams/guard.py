"""Guards of real machines: they watch every job on the hardware and end what is not plausible."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from types import MappingProxyType
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
        axis: part and number, from 0, of the axis that shows the sign; None for the whole machine.
    """

    name: str
    sign: str
    distrusted: tuple[str, ...] = ()
    ends: bool = True
    axis: tuple[str, int] | None = None


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
    """A job that its guard has ended; the text names the reason and its sign.

    Args:
        trip: the reason.
        axes: names of the machine's axes by part, as its declaration has them.
    """

    def __init__(self, trip: Trip, axes: Mapping[str, Sequence[str]] = MappingProxyType({})):
        self.trip, who = trip, ""
        if trip.axis is not None:
            part, number = trip.axis
            who = f"{axes[part][number]} "
        super().__init__(f"{trip.name}: {who}{trip.sign}; the job has been ended")


class Sign(NamedTuple):
    """Observation that something is wrong.

    Attributes:
        words: words for it.
        persists: time for which it must last to end a job [s].
        distrusted: see `Trip`.
        axis: number of the axis that shows it, from 0; None for the whole machine.
    """

    words: str
    persists: float
    distrusted: tuple[str, ...] = ()
    axis: int | None = None


@dataclass(frozen=True)
class DriveLimits:
    """Limits of what is normal of drives: design choices.

    Attributes:
        following: largest distance of an axis from where it was led [m].
        fastest: speed of an axis [m/s].
        current: largest current of a motor [A].
        oldest: largest age of the measurements [s].
        persists: time for which a sign must last, but for a jump [s].
    """

    following: float
    fastest: float
    current: float = math.inf
    oldest: float = 0.06
    persists: float = 0.1


class SignGuard[L: DriveLimits](ABC):
    """Guard of drives by signs that must last.

    All drives have these: the emergency stop, an encoder that jumps, an axis that does not follow
    or pushes too hard, data that is old. A machine's guard adds its own.

    Attributes:
        part: part of the machine that the drives are of.
    """

    part: ClassVar[str] = "legs"

    def __init__(self, period: float, limits: L):
        """Begins to watch.

        Args:
            period: period of the loop [s].
            limits: limits of normal behaviour.
        """
        self._period, self._ticks, self._limits = period, Ticks(period), limits
        self._oldest = limits.oldest
        self._position: NDArray[Any] | None = None
        self._stamp = 0.0  # when that was measured [s]
        self._since: dict[str, float] = {}

    def allow_age(self, seconds: float) -> float:
        """Lets measurements be older than usual, if that is more; returns the usual limit [s]."""
        self._oldest = max(seconds, self._limits.oldest)
        return self._limits.oldest

    def check(self, now: float, values: Mapping[str, NDArray[Any]]) -> Trip | None:
        """See `Guard`."""
        stamp = now - (float(values[AGE][0]) if AGE in values else 0.0)
        elapsed = max(stamp - self._stamp, self._period)
        is_regular = self._ticks.is_regular(now)
        # What says more comes first.
        of_drives = self._usual(is_regular, elapsed, values)
        signs = dict(chain(of_drives, self._signs(values), self._stale(values)))
        self._position, self._stamp = values[f"{self.part}.position"].copy(), stamp
        self._since = {name: self._since.get(name, now) for name in signs}
        for name, sign in signs.items():
            if now - self._since[name] >= sign.persists:
                axis = None if sign.axis is None else (self.part, sign.axis)
                return Trip(name, sign.words, sign.distrusted, axis=axis)
        return None

    @abstractmethod
    def _distances(self, values: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
        """Distances of the axes from where they were led [m]; None where nothing leads them.

        Args:
            values: see `Guard.check`.
        """

    def _signs(self, values: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, Sign]]:
        """Names of the machine's own signs of a tick, and the signs.

        Args:
            values: see `Guard.check`.
        """
        yield from ()

    def _usual(
        self, is_regular: bool, elapsed: float, values: Mapping[str, NDArray[Any]]
    ) -> Iterator[tuple[str, Sign]]:
        """Signs that all drives have.

        Args:
            is_regular: true if the tick comes a period after the one before.
            elapsed: time between the measurements and those before [s].
            values: see `Guard.check`.
        """
        limits, part = self._limits, self.part
        stop, position = f"{part}.emergency_stop", values[f"{part}.position"]
        if stop in values and values[stop][0] > 0.5:
            yield "emergency_stop", Sign(EMERGENCY_STOP_SIGN, 0.0)
        if self._position is not None and is_regular:
            jumps = np.abs(position - self._position) > limits.fastest * elapsed
            yield from first_of("encoder_jump", jumps, "changes faster than it can", 0.0, (part,))
        if (off := self._distances(values)) is not None:
            words = f"is more than {1e3 * limits.following:g} mm off its way"
            far = ~(np.abs(off) <= limits.following)
            yield from first_of("following_error", far, words, limits.persists, (part,))
        if (current := values.get(f"{part}.current")) is not None:
            hard = np.abs(current) > limits.current
            yield from first_of("overload", hard, "pushes harder than it may", limits.persists)

    def _stale(self, values: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, Sign]]:
        """Sign of data that is old."""
        if AGE in values and not values[AGE][0] <= self._oldest:
            yield f"{self.part}_stale", Sign("measurements that are old", self._limits.persists)


def first_of(
    name: str,
    which: NDArray[np.bool_],
    words: str,
    persists: float,
    distrusted: tuple[str, ...] = (),
) -> Iterator[tuple[str, Sign]]:
    """Sign of the first axis of some; nothing if there is none.

    Args:
        name: name of the sign.
        which: axes that show it (n), as truth values.
        words: words for what it does.
        persists: see `Sign`.
        distrusted: see there.
    """
    if which.any():
        yield name, Sign(words, persists, distrusted, int(np.argmax(which)))


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
