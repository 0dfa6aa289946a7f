"""Faults of a sampled signal in the words of PX4's failure injection, and their injector."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import (
    AbstractParameterIndex,
    BasicVector,
    Context,
    DiscreteStateIndex,
    DiscreteValues,
)

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array

# Two instants closer than this are the same one: sample times are sums and products of periods.
_SAME_INSTANT = 1e-9


class FaultKind(StrEnum):
    """Kind of a fault, named as by PX4's `failure` command.

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
    """Reaction that a finding demands of a machine; a higher one includes the lower ones."""

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


# Sign of a pressed emergency stop; its contact is closed while it is not pressed.
EMERGENCY_STOP_SIGN = "the emergency stop is pressed, or its wire is broken"


@dataclass(frozen=True)
class Fault:
    """A fault of a signal: what happens, to which element, from when to when.

    Attributes:
        kind: kind of the fault.
        index: element, counted from 0; None for all of them.
        begin: time of its beginning [s].
        duration: [s]; infinite: it does not end.
        seed: seed of garbage.
        scale: factor of a wrong value [-]; None: 1 with an offset and -1, a reversed sign,
            without.
        offset: offset of a wrong value, in the signal's unit.
        sample_period: sample period of a slow device [s].
        delay: delay of a delayed one [s].
        missing_time: time for which an intermittent one is off [s].
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
        period: period of the samples [s].
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
        """Number of cycles since the fault began."""
        elapsed = sample * self.period - self.fault.begin
        return math.floor((elapsed + _SAME_INSTANT) / cycle)


def first_sample(time: float, period: float) -> int:
    """Number of the first sample at or after a time."""
    return math.ceil((time - _SAME_INSTANT) / period)


def last_sample(time: float, period: float) -> int:
    """Number of the last sample at or before a time."""
    return math.floor((time + _SAME_INSTANT) / period)


# Longest delay for which an injector keeps samples by default [s].
LONGEST_DELAY = 1.0


class FaultInjector(LeafSystem):
    """Passes a signal, or what a failed device would show in its place.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `signal` | n | any | what the device would publish |
    | out `faulted` | n | that of the signal | what it publishes |
    | out `extra_age` | 1 | s | by how much faults make the data older, in whole periods |
    | out `changed` | 1 | - | 1 once a sample of `faulted` has differed from `signal` |

    What each kind of fault does to the samples is said by `FaultKind`. Without an active fault
    `faulted` is the signal itself, bit for bit and without delay (direct feedthrough), between
    samples too. Faults begin and end with the first sample at or after their time; one that is
    over before the next sample has no effect. Where several act on an element, the one listed last
    counts; the age is that of the oldest element. Elements that are stuck, or slow and not due,
    are not sampled, so one such fault that follows another at once keeps the other's value.

    A sample is the signal as every discrete system sees it at that instant, before the instant's
    updates. An injector should have the period of the systems that read it.

    State: discrete, the sample that is held of each element (n) and its number (n), the samples
    of the longest delay, the newest one's number and how many there are (2), `changed` (1),
    updated every period. Garbage needs none: it follows from the seed and the sample's number.

    Parameters (Context): the faults, abstract, see `set_faults`. The context's defaults have the
    constructor's.

    Bad input: a value that is not finite passes, or is held or delayed, like any other; only
    `off` and `garbage` hide it. At a time that is not finite there are no faults.

    Args:
        size: number of elements n.
        faults: faults to inject.
        period: period of the samples [s].
        off_value: value shown of a device that does not publish, n values or one for all.
        span: smallest and largest plausible value, n of each or one for all, of garbage.
        is_binary: the signal's values are 0 and 1.
        longest_delay: longest delay of the delayed faults that can be set [s].
    """

    def __init__(
        self,
        size: int = 1,
        faults: Sequence[Fault] = (),
        period: float = 0.01,
        off_value: ArrayLike = 0.0,
        span: tuple[ArrayLike, ArrayLike] = (0.0, 1.0),
        is_binary: bool = False,
        longest_delay: float = LONGEST_DELAY,
    ) -> None:
        super().__init__()
        if not 0.0 < period < math.inf:
            raise ValueError(f"period must be above 0, not {period}")
        self.set_name("fault_injector")
        self.size, self.period, self.longest_delay = size, period, longest_delay
        self.is_binary = is_binary
        self._off_value = np.broadcast_to(off_value, size).astype(float).tolist()
        self._low, self._high = (np.broadcast_to(end, size).astype(float) for end in span)
        if not (np.isfinite([self._low, self._high]).all() and (self._low <= self._high).all()):
            raise ValueError(f"span must be finite and in order, not {span}")
        # One more than the lag: the newest sample is that of the present instant, once taken.
        self._capacity = first_sample(longest_delay, period) + 1

        self._signal: Any = self.DeclareVectorInputPort("signal", size)
        self._faults = self.DeclareAbstractParameter(Value[object](self._checked(faults)))
        self._held = int(self.DeclareDiscreteState(size))
        self._held_number = int(self.DeclareDiscreteState(np.full(size, -1.0)))
        self._history = int(self.DeclareDiscreteState(self._capacity * size))
        self._progress = int(self.DeclareDiscreteState(np.array([-1.0, 0.0])))
        changed = self.DeclareDiscreteState(1)
        self._changed = int(changed)
        follows = {
            self.time_ticket(),
            self.abstract_parameter_ticket(AbstractParameterIndex(self._faults)),
            *(
                self.discrete_state_ticket(DiscreteStateIndex(index))
                for index in (self._held, self._held_number, self._history, self._progress)
            ),
        }
        self.DeclareVectorOutputPort(
            "faulted",
            size,
            self._calc_faulted,
            prerequisites_of_calc=follows | {self._signal.ticket()},
        )
        self.DeclareVectorOutputPort(
            "extra_age", 1, self._calc_extra_age, prerequisites_of_calc=follows
        )
        self.DeclareStateOutputPort("changed", changed)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_samples)

    def set_faults(self, context: Context, faults: Sequence[Fault]) -> None:
        """Replaces the faults in a context and takes `changed` back; samples taken stay.

        Resetting the context to its defaults brings back the constructor's faults.

        Raises:
            ValueError: a fault that does not fit the signal or the period; the context stays as
                it is.
        """
        checked = self._checked(faults)
        context.get_mutable_abstract_parameter(self._faults).set_value(checked)
        context.get_mutable_discrete_state(self._changed).SetFromVector(np.zeros(1))

    def _checked(self, faults: Sequence[Fault]) -> tuple[SampledFault, ...]:
        for fault in faults:
            if fault.index is not None and fault.index >= self.size:
                raise ValueError(f"index must be in 0..{self.size - 1} or None, not {fault.index}")
            if fault.kind is FaultKind.DELAYED and fault.delay > self.longest_delay:
                raise ValueError(
                    f"delay must be up to longest_delay, {self.longest_delay}, not {fault.delay}"
                )
            shortest = min(fault.missing_time, fault.good_time)
            # Between two samples a turn would have none.
            if fault.kind is FaultKind.INTERMITTENT and shortest < self.period:
                raise ValueError(
                    f"missing_time and good_time must be a period, {self.period}, or more, "
                    f"not {shortest}"
                )
        return tuple(SampledFault(fault, self.period) for fault in faults)

    def _calc_faulted(self, context: Context, output: BasicVector) -> None:
        values = read_array(self._signal, context)
        ruling, now = self._ruling(context)
        if ruling:
            samples = self._samples(context)
            for i, fault in ruling.items():
                values[i] = self._shown(samples, fault, i, now, float(values[i]))
        output.SetFromVector(values)

    def _calc_extra_age(self, context: Context, output: BasicVector) -> None:
        ruling, now = self._ruling(context)
        behind = 0
        if ruling:
            samples = self._samples(context)
            behind = max(now - samples.published(*item, now) for item in ruling.items())
        output.SetFromVector(np.array([behind * self.period]))

    def _update_samples(self, context: Context, discrete_state: DiscreteValues) -> None:
        signal = read_array(self._signal, context)
        ruling, now = self._ruling(context)
        sample = np.array(context.get_discrete_state(self._held).value())
        numbers = np.array(context.get_discrete_state(self._held_number).value())
        is_taken = np.full(self.size, True)
        for i, fault in ruling.items():
            keeps = fault.fault.kind is FaultKind.STUCK or (
                fault.fault.kind is FaultKind.SLOW and not fault.is_due(now)
            )
            is_taken[i] = not keeps or numbers[i] < 0.0
        sample = np.where(is_taken, signal, sample)
        discrete_state.set_value(self._held, sample)
        discrete_state.set_value(self._held_number, np.where(is_taken, float(now), numbers))
        history = context.get_discrete_state(self._history).value()
        history = np.concatenate((signal, history[: -self.size]))
        discrete_state.set_value(self._history, history)
        count = min(context.get_discrete_state(self._progress)[1] + 1, self._capacity)
        discrete_state.set_value(self._progress, np.array([now, count]))

        if ruling:
            faulted: Any = read_array(self.GetOutputPort("faulted"), context)
            if not np.array_equal(faulted, signal, equal_nan=True):
                discrete_state.set_value(self._changed, np.ones(1))

    def _ruling(self, context: Context) -> tuple[dict[int, SampledFault], int]:
        """The fault that counts for each element that has one, and the present sample's number."""
        parameter: Any = context.get_abstract_parameter(self._faults)
        time = context.get_time()
        if not math.isfinite(time):
            return {}, 0
        now = last_sample(time, self.period)
        return {
            i: fault
            for fault in parameter.get_value()
            if fault.is_active(now)
            for i in (range(self.size) if fault.fault.index is None else (fault.fault.index,))
        }, now

    def _samples(self, context: Context) -> "_Samples":
        newest, count = context.get_discrete_state(self._progress).value().tolist()
        return _Samples(
            context.get_discrete_state(self._held).value(),
            context.get_discrete_state(self._held_number).value(),
            context.get_discrete_state(self._history).value().reshape(-1, self.size),
            int(newest),
            int(count),
        )

    def _shown(
        self, samples: "_Samples", sampled: SampledFault, i: int, now: int, value: float
    ) -> float:
        """Value that element i shows in place of another."""
        fault = sampled.fault
        match fault.kind:
            case FaultKind.OFF | FaultKind.INTERMITTENT:
                return value if sampled.gap(now) is None else self._off_value[i]
            case FaultKind.STUCK:
                return value if samples.held_number[i] < 0.0 else samples.held[i]
            case FaultKind.SLOW:
                is_held = samples.held_number[i] == samples.published(i, sampled, now)
                return samples.held[i] if is_held else value
            case FaultKind.DELAYED:
                if not samples.count:
                    return value
                return samples.history[samples.newest - samples.published(i, sampled, now), i]
            case FaultKind.GARBAGE:
                return self._garbage(fault, i, now)
            case FaultKind.WRONG if self.is_binary:
                return value if math.isnan(value) else float(not value > 0.5)
            case _:
                return fault.factor * value + fault.offset

    def _garbage(self, fault: Fault, i: int, now: int) -> float:
        random = np.random.default_rng((fault.seed, now, i))
        if random.random() < fault.nan_share:
            return math.nan
        if self.is_binary:
            return float(random.integers(2))
        return random.uniform(self._low[i], self._high[i])


@dataclass(frozen=True)
class _Samples:
    """Memory of an injector about its signal.

    Attributes:
        held: the sample that each element holds (n).
        held_number: its number (n), -1 for none.
        history: the last samples (capacity, n), newest first.
        newest: number of the newest one.
        count: number of samples.
    """

    held: NDArray[np.float64]
    held_number: NDArray[np.float64]
    history: NDArray[np.float64]
    newest: int
    count: int

    def published(self, i: int, sampled: SampledFault, now: int) -> int:
        """Number of the sample that the device published last of element i."""
        gap = sampled.gap(now)
        if gap is not None:
            return gap - 1
        if sampled.fault.kind is FaultKind.SLOW:
            is_new = self.held_number[i] < 0.0 or sampled.is_due(now)
            return now if is_new else int(self.held_number[i])
        if sampled.fault.kind is FaultKind.DELAYED and self.count:
            oldest = self.newest - self.count + 1
            return min(max(now - sampled.lag, oldest), self.newest)
        return now
