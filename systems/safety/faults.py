"""Faults of a sampled signal, in the words of PX4's failure injection, and how grave they are."""

import math
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import cached_property

# Two instants closer than this are the same one: sample times are sums and products of periods.
_SAME_INSTANT = 1e-9


class FaultKind(StrEnum):
    """What a device does wrong, named as by PX4's `failure` command.

    Sample k of a signal is its value at k periods of the injector. A fault acts on whole samples:
    on the first at or after `begin` and on all that follow before `begin + duration`. The age
    below is by how much the shown data are older than without the fault.
    """

    OFF = "off"
    """Publishes nothing: shows the signal's off value; the age is the time since the last sample
    before the fault, one period at the fault's first sample."""

    STUCK = "stuck"
    """Publishes the newest sample from before the fault again and again: the value stays, and so
    does an age of 0. A fault that no sample precedes keeps its own first one."""

    GARBAGE = "garbage"
    """Publishes random values: in each sample and element another one, uniform over the signal's
    span (0 or 1 for a binary signal), a share `nan_share` of them NaN; age 0. The values depend
    on seed, sample and element alone."""

    WRONG = "wrong"
    """Publishes factor * value + offset in place of each value; a binary signal is inverted, 1
    for values up to 0.5 and 0 for those above; age 0. NaN stays NaN."""

    SLOW = "slow"
    """Publishes less often: shows the first sample of every `sample_period` from `begin` on until
    the next one; the age is the time since the sample shown."""

    DELAYED = "delayed"
    """Publishes late: shows the sample that is `delay` old, rounded up to whole periods, or the
    oldest there is; the age is the time since the sample shown."""

    INTERMITTENT = "intermittent"
    """Publishes in turns: off for `missing_time`, as it is for `good_time`, and so on; in each
    turn that is off value and age are those of `OFF`."""


class Severity(IntEnum):
    """What a machine has to do about a finding; a higher one includes the lower ones."""

    NONE = 0
    """Nothing is wrong."""

    WARN = 1
    """Told and recorded; the job goes on."""

    HOLD = 2
    """No new motion: position controllers keep the machine where it is, and the job goes on by
    itself when the cause is gone."""

    BRAKE = 3
    """Controllers are not trusted: actuators at rest without command, brakes and self-locking
    screws carry the load. The job goes on by command when the cause is gone."""

    LATCHED_OFF = 4
    """Drives without power, until a person has looked and starts the machine anew; that the cause
    is gone does not end it."""


@dataclass(frozen=True)
class Fault:
    """A fault of a signal: what happens, to which element, from when to when.

    Attributes:
        kind: what happens.
        index: element, counted from 0; None for all of them.
        begin: time of its beginning [s].
        duration: [s]; infinite: it does not end.
        seed: of garbage.
        scale: factor of a wrong value [-]; None: 1 with an offset and -1, a reversed sign,
            without.
        offset: of a wrong value, in the signal's unit.
        sample_period: of a slow device [s].
        delay: of a delayed one [s].
        missing_time: how long an intermittent one is off [s].
        good_time: and how long it is not, after that [s].
        nan_share: share of garbage that is NaN, 0 to 1 [-].
    """

    kind: FaultKind
    index: int | None = None
    begin: float = 0.0
    duration: float = math.inf
    seed: int = 0
    scale: float | None = None
    offset: float = 0.0
    sample_period: float = 0.1
    delay: float = 0.1
    missing_time: float = 0.1
    good_time: float = 0.1
    nan_share: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", FaultKind(self.kind))
        if not 0.0 <= self.begin < math.inf:
            raise ValueError(f"begin must be finite and 0 or more, not {self.begin}")
        for name in ("duration", "sample_period", "delay", "missing_time", "good_time"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be above 0, not {getattr(self, name)}")
        for name in ("delay", "missing_time", "good_time", "sample_period", "offset", "factor"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, not {getattr(self, name)}")
        if not 0.0 <= self.nan_share <= 1.0:
            raise ValueError(f"nan_share must be in 0..1, not {self.nan_share}")
        if self.seed < 0 or (self.index is not None and self.index < 0):
            raise ValueError(f"seed and index must be 0 or more, not {self.seed} and {self.index}")

    @property
    def factor(self) -> float:
        """Factor of a wrong value."""
        if self.scale is not None:
            return self.scale
        return 1.0 if self.offset else -1.0


@dataclass(frozen=True)
class SampledFault:
    """A fault on the grid of samples, in whole numbers of them.

    Attributes:
        fault: the fault.
        period: of the samples [s].
    """

    fault: Fault
    period: float

    def is_active(self, sample: int) -> bool:
        """Whether the fault acts on a sample."""
        return self._first <= sample < self._end

    def gap(self, sample: int) -> int | None:
        """First sample of those, up to this one, that are not published; None if this one is."""
        fault = self.fault
        if fault.kind is FaultKind.OFF:
            return self._first
        if fault.kind is not FaultKind.INTERMITTENT:
            return None
        cycle = fault.missing_time + fault.good_time
        turn = fault.begin + self._turn(sample, cycle) * cycle
        is_good = sample * self.period >= turn + fault.missing_time - _SAME_INSTANT
        return None if is_good else first_sample(turn, self.period)

    def is_due(self, sample: int) -> bool:
        """Whether a slow device publishes this sample."""
        every = self.fault.sample_period
        return self._turn(sample, every) != self._turn(sample - 1, every)

    @cached_property
    def lag(self) -> int:
        """By how many samples a delayed device is late."""
        return first_sample(self.fault.delay, self.period)

    @cached_property
    def _first(self) -> int:
        return first_sample(self.fault.begin, self.period)

    @cached_property
    def _end(self) -> float:
        end = self.fault.begin + self.fault.duration
        return first_sample(end, self.period) if math.isfinite(end) else math.inf

    def _turn(self, sample: int, cycle: float) -> int:
        """How many cycles have passed since the fault began."""
        elapsed = sample * self.period - self.fault.begin
        return math.floor((elapsed + _SAME_INSTANT) / cycle)


def first_sample(time: float, period: float) -> int:
    """Number of the first sample at or after a time."""
    return math.ceil((time - _SAME_INSTANT) / period)


def last_sample(time: float, period: float) -> int:
    """Number of the last sample at or before a time."""
    return math.floor((time + _SAME_INSTANT) / period)
