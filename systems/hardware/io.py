"""Devices seen from a loop: a thread for each of them, readers and writers with ports.

Nothing in the loop waits for a bus: a thread talks to each device (`DeviceThread`), and the
systems `PartReader` and `PartWriter` exchange whole samples and commands with the threads of the
devices of one part of a machine.
"""

import logging
import math
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from pydrake.systems.framework import Context, InputPort, State

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read
from parapod.systems.hardware.clock import (
    Hold,
    answer_time,
    hold,
    monotonic,
    standing_still,
    wait,
    wait_until,
)
from parapod.systems.hardware.device import Device, DeviceError, DeviceFault, Signals

_LOG = logging.getLogger(__name__)

# Commands that are older than this are not the controller's will any more [s].
COMMAND_TIMEOUT = 0.1
# Readings start so early that this share of them ends a margin [s] before the loop samples, at
# most the largest lead, a share of the period, ahead.
_IN_TIME = 0.995
_MARGIN = 5e-4
_LARGEST_LEAD = 0.7
# Step by which the estimate of a reading's duration, once it is due, follows each one [s].
_LEARNING = 2e-4
# Reading times that differ by less are equal [s].
_ROUNDING = 1e-6
# What a device sends is read no sooner than this after the last reading; it is missing after this
# [periods].
_SOON, _MISSING = 0.2, 2.0
# Number of the newest ages that are kept: some minutes.
_KEPT = 30_000
# An emulated time waits for readings and commands that are not done after so much of a period [-]:
# what is read while time goes on is newer than its stamp by as much.
_HELD = 0.2
# Longest time until a thread ends once it is asked to; a device's calls are shorter [s].
_JOIN_TIMEOUT = 2.0


class Sample(NamedTuple):
    """Newest values of a device, and its state.

    Attributes:
        values: values of its signals; empty before the first.
        stamp: time of devices (`clock.monotonic`) when the reading of them began [s].
        fault: fault since then.
        words: message of the device about it, without its name; "" if nothing is wrong.
    """

    values: Mapping[str, tuple[float, ...]]
    stamp: float
    fault: DeviceFault
    words: str


class _Command(NamedTuple):
    signals: Signals
    posted: float
    measured: float


class DeviceThread:
    """Reads a device once a period and writes commands as soon as they come.

    A loop that says when it takes samples (`taken`) gets fresh ones: the next reading is begun so
    late that it ends just before they are taken again. Without a loop the readings are periodic.
    What a device sends without being asked is read when it comes, but not more often than five
    times a period, and once none has come for two periods.

    Samples and commands are tuples that are swapped whole. When no command has come for
    `command_timeout`, the outputs are made neutral: a controller that hangs moves nothing, unless
    it hangs in compiled code that keeps Python's lock, and this thread waits for it. What
    the device raises becomes the sample's fault; the thread goes on and tries again, and a device
    that answers again has no fault any more.

    The device must be configured; `start` activates it, `stop` deactivates it.
    """

    def __init__(
        self,
        device: Device,
        period: float = 0.01,
        command_timeout: float = COMMAND_TIMEOUT,
        clock: Callable[[], float] = monotonic,
    ):
        """Prepares the thread.

        Args:
            device: device that is read and written.
            period: period of the loop and of the readings [s].
            command_timeout: see the class [s].
            clock: monotonic [s].
        """
        self.device, self.period = device, period
        self._timeout, self._clock = command_timeout, clock
        self._every = period if device.is_asked else _MISSING * period
        self._read_at = -math.inf
        if not device.is_asked:
            device.on_measured = self._read_now
        self._sample = self._no_sample()
        self._command: _Command | None = None
        self._written: _Command | None = None
        self._obeys_since = -math.inf
        self._is_neutral = True
        self._write_words: tuple[DeviceFault, str] | None = None
        self._write_ages: deque[float] = deque(maxlen=_KEPT)
        self._due, self._reading_time, self._taken_at = clock(), 0.0, -math.inf
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._has_sample = threading.Event()
        # How long the next reading may take until an emulated time waits for it, and its end [s].
        self._allowed, self._reading_at, self._hold = _HELD * period, math.inf, Hold()
        self._is_reading = False
        self._thread: threading.Thread | None = None

    @property
    def sample(self) -> Sample:
        """The newest sample, with the device's present fault."""
        wrong, sample = self._write_words, self._sample
        if wrong is None or sample.fault:
            return sample
        return sample._replace(fault=wrong[0], words=wrong[1])

    @property
    def error(self) -> DeviceError | None:
        """Error of the device by now, to be raised; None if there is none."""
        sample = self.sample
        if not sample.fault:
            return None
        return DeviceError(self.device.name, sample.words, sample.fault)

    @property
    def write_ages(self) -> list[float]:
        """Ages of measurements when the commands made of them had been written [s].

        One for each write, of the newest ones.
        """
        return list(self._write_ages)

    @property
    def obeys_since(self) -> float:
        """Time since which the device has what it is commanded now [s].

        Infinite while that has not been written; minus infinity before the first command.
        """
        is_silent = self._is_neutral and self._command is not None
        if is_silent or not _are_same(self._command, self._written):
            return math.inf
        return self._obeys_since

    def taken(self) -> None:
        """A loop takes the sample now, and will again in a period."""
        now = self._clock()
        # A loop that is late by less than half a period keeps to its schedule.
        scheduled = self._taken_at + self.period
        self._taken_at = scheduled if 0.0 <= now - scheduled < 0.5 * self.period else now
        if self._due > now:  # a reading that is late already must not be put off for ever
            if self.device.is_asked:
                self._read_before_taken()
            if not self._is_reading:
                self._wait_for_reading()
        self._wake.set()

    def post(self, commands: Signals, measured: float) -> None:
        """Has commands written.

        Args:
            commands: the device's signals.
            measured: time of devices of the measurements that they were made of [s].
        """
        now = self._clock()
        if not self.sample.fault:
            # Before the thread can see the command: it goes on to the next reading afterwards.
            self._hold.until(min(now + _HELD * self.period, self._reading_at))
        self._command = _Command(commands, now, measured)
        self._wake.set()

    def start(self, timeout: float = 1.0) -> None:
        """Activates the device and waits for its first sample.

        Raises:
            DeviceError: it refuses, or there is no sample in time.
        """
        self._stopping.clear()
        self._has_sample.clear()
        self._sample = self._no_sample()
        self._command = self._written = self._write_words = None
        self._obeys_since = -math.inf
        self._is_neutral = True
        with standing_still():
            self.device.activate()
        name = f"io {self.device.name}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()
        if not wait(self._has_sample, timeout) and (error := self.error) is not None:
            self.stop()
            raise error

    def stop(self) -> Exception | None:
        """Ends the thread and deactivates the device; returns why that is not certain."""
        self._stopping.set()
        self._wake.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(answer_time(_JOIN_TIMEOUT))
        try:
            with standing_still():
                self.device.deactivate()
        except Exception as error:  # other devices are still to come
            return error
        return None

    def _no_sample(self) -> Sample:
        return Sample({}, self._clock(), DeviceFault.SILENT, "no sample yet")

    @property
    def _lead(self) -> float:
        """Time before the loop takes samples again, at which a reading is due [s]."""
        return min(self._reading_time + _MARGIN, _LARGEST_LEAD * self.period)

    @property
    def _before_taken(self) -> float:
        """Instant at which a reading is due that ends just before samples are taken again [s]."""
        return self._taken_at + self.period - self._lead

    def _read_now(self) -> None:
        due = max(self._clock(), self._read_at + _SOON * self.period)
        if due < self._due:
            self._due = due
            self._wake.set()

    def _read_before_taken(self) -> None:
        self._due = self._before_taken
        self._allowed = min(self._lead - _MARGIN, _HELD * self.period)

    def _wait_for_reading(self) -> None:
        """Has an emulated time wait for the next reading, unless the device is at fault."""
        if self._has_sample.is_set() and not self._sample.fault and self.device.measures:
            self._reading_at = self._due + self._allowed
            self._hold.until(self._reading_at)

    def _run(self) -> None:
        self._due, self._hold = self._clock(), hold()
        self._reading_at = self._due + self._allowed if self.device.measures else math.inf
        self._hold.until(self._reading_at)
        try:
            self._serve()
        finally:
            self._hold.until(math.inf)

    def _serve(self) -> None:
        while not self._stopping.is_set():
            command = self._command
            if command is not None and command is not self._written:
                self._write(command)
                self._hold.until(self._reading_at)
            now = self._clock()
            newest = self._command  # by now: a slow device's write may have taken longer than that
            if newest is not None and now - newest.posted > self._timeout:
                self._fall_silent()
            if now >= self._due:
                due, self._due = self._due, max(self._due + self._every, now)
                self._allowed = _HELD * self.period
                self._read(due)
            wait_until(self._wake, min(self._due, self._clock() + self._timeout))
            self._wake.clear()

    def _read(self, due: float) -> None:
        self._read_at = began = self._clock()
        self._is_reading = True
        try:
            values = {name: tuple(v) for name, v in self.device.read().items()}
        except Exception as error:
            fault, words = _described(self.device, error)
            self._sample = self._sample._replace(fault=fault, words=words)
            self._is_reading, self._reading_at = False, math.inf
            self._hold.until(math.inf)
            return
        stamp = self.device.stamp
        self._sample = Sample(values, began if stamp is None else stamp, DeviceFault.NONE, "")
        self._learn(self._clock() - due)
        self._has_sample.set()
        # Samples of readings that begin at the loop's tick would be a period old at each tick.
        if self.device.is_asked and self._clock() < self._before_taken < self._due:
            self._read_before_taken()
        self._is_reading = False  # before the next one is waited for, by the loop or here
        self._wait_for_reading()

    def _learn(self, took: float) -> None:
        """Follows that quantile of the times, which a rare long one does not move."""
        if not self._has_sample.is_set():
            # From nothing it would take ten readings, all of them too late.
            self._reading_time = min(took, _LARGEST_LEAD * self.period)
            return
        # Emulated time waits for a reading at that time, and shows no longer one.
        longer = took > self._reading_time - _ROUNDING
        self._reading_time += _LEARNING * (_IN_TIME if longer else _IN_TIME - 1.0)

    def _write(self, command: _Command) -> None:
        if self._is_neutral or not _are_same(command, self._written):
            self._obeys_since = math.inf
        # Before the write: one that fails half way may have moved something already.
        self._written, self._is_neutral = command, False
        try:
            self.device.write(command.signals)
        except Exception as error:
            self._write_words = _described(self.device, error)
            self._obeys_since = math.inf
            return
        self._write_words = None
        self._obeys_since = min(self._obeys_since, self._clock())
        self._write_ages.append(self._clock() - command.measured)

    def _fall_silent(self) -> None:
        if self._is_neutral:
            return
        words = f"no command for {self._timeout:g} s"
        try:
            self.device.neutral()
            self._is_neutral = True
            words = f"{words}; outputs are neutral"
        except Exception as error:
            words = f"{words}, and {_described(self.device, error)[1]}"
        self._write_words = DeviceFault.NO_COMMAND, words


def _are_same(one: _Command | None, other: _Command | None) -> bool:
    """Whether two commands ask a device for the same."""
    if one is None or other is None or one is other:
        return one is other
    signals, had = one.signals, other.signals
    return signals.keys() == had.keys() and all(
        tuple(signals[n]) == tuple(had[n]) for n in signals
    )


def _described(device: Device, error: Exception) -> tuple[DeviceFault, str]:
    """Code and words of what a device has raised; another device than itself is named."""
    if isinstance(error, DeviceError):
        return error.fault, error.words if error.device == device.name else str(error)
    if not isinstance(error, ParapodError):
        _LOG.error("%s", device.name, exc_info=error)
    text = " ".join(f"{type(error).__name__} {error}".split())
    return DeviceFault.FAILED, text


# Measurements that are older than this are shown as NaN, which no controller follows [s].
STALE_AFTER = 0.1


class PartReader(LeafSystem):
    """Takes the newest samples of the devices of one part, all at one instant of the loop.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `age` | 1 | s | time since the oldest sample of the part was begun |
    | out `fault` | 1 | code | the first device's `DeviceFault`; 0: none |
    | out `stamp` | 1 | s | time of devices when the oldest sample was begun |

    Besides, one output for each signal that a device measures, with its name, size and SI unit.

    State: discrete, every port's value, taken in a periodic unrestricted update at offset 0: the
    controllers' discrete updates of the same instant see it. Nothing here waits for a device: its
    thread does.

    Bad input: signals that are older than `stale_after` are NaN until there are newer ones; age
    and fault show why.
    """

    def __init__(
        self,
        part: str = "part",
        threads: Sequence[DeviceThread] = (),
        period: float = 0.01,
        stale_after: float = STALE_AFTER,
        clock: Callable[[], float] = monotonic,
    ):
        """Creates the system; its ports follow from what the devices measure.

        Args:
            part: name of the part.
            threads: threads of its devices; none for a part without.
            period: period of the loop [s].
            stale_after: see the class [s].
            clock: clock of the threads [s].
        """
        super().__init__()
        self.set_name(f"{part}_reader")
        self._threads, self._clock, self._stale_after = tuple(threads), clock, stale_after
        self._signals: list[tuple[DeviceThread, str, int]] = []
        for thread in self._threads:
            for signal, size in thread.device.measures.items():
                self._declare(signal, size)
                self._signals.append((thread, signal, size))
        for name in ("age", "fault", "stamp"):
            self._declare(name, 1)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update_samples)

    def _declare(self, name: str, size: int) -> None:
        self.DeclareStateOutputPort(name, self.DeclareDiscreteState(size))

    def reset(self, context: Context) -> None:
        """Puts the newest samples into a context, so that a loop begins with measurements.

        Raises:
            DeviceError: a device has a fault.
        """
        for thread in self._threads:
            if (error := thread.error) is not None:
                raise error
        for index, values in enumerate(self._taken()):
            context.SetDiscreteState(index, values)

    def _update_samples(self, context: Context, state: State) -> None:
        discrete = state.get_mutable_discrete_state()
        for index, values in enumerate(self._taken()):
            discrete.set_value(index, values)

    def _taken(self) -> list[np.ndarray]:
        """The values of all ports."""
        samples = {id(thread): thread.sample for thread in self._threads}
        for thread in self._threads:
            thread.taken()
        now = self._clock()
        values = []
        for thread, signal, size in self._signals:
            sample = samples[id(thread)]
            fresh = now - sample.stamp <= self._stale_after
            shown_value = sample.values.get(signal) if fresh else None
            values.append(
                np.full(size, math.nan) if shown_value is None else np.array(shown_value)
            )
        measuring = [samples[id(thread)] for thread in self._threads if thread.device.measures]
        stamp = min((sample.stamp for sample in measuring), default=now)
        fault = next((s.fault for s in samples.values() if s.fault), DeviceFault.NONE)
        return [*values, np.array([now - stamp]), np.array([float(fault)]), np.array([stamp])]


# After the controllers' updates of the same instant, so that commands are not a period old [s].
WRITE_OFFSET = 1e-6


class PartWriter(LeafSystem):
    """Hands commands to the threads of a part's devices.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `stamp` | 1 | s | time of devices of the measurements behind them; unconnected: now |

    Besides, one input for each signal that a device is commanded, with its name, size and SI unit.

    No state. Commands are handed over in a periodic publish event, a microsecond after the loop's
    instant: they are those that the controllers have made of that instant's measurements, provided
    that they are held by then. An output that follows from measurements and from a state has
    another value once the state is updated; it has to come through a `ZeroOrderHold`. Nothing here
    waits for a device.

    Bad input: what is not finite is neutral for the device.
    """

    def __init__(
        self,
        part: str = "part",
        threads: Sequence[DeviceThread] = (),
        period: float = 0.01,
    ):
        """Creates the system; its ports follow from what the devices are commanded.

        Args:
            part: name of the part.
            threads: threads of its devices.
            period: period of the loop [s].
        """
        super().__init__()
        self.set_name(f"{part}_writer")
        self._threads = [thread for thread in threads if thread.device.commands]
        self._inputs: dict[str, InputPort] = {}
        for thread in self._threads:
            for signal, size in thread.device.commands.items():
                if signal not in self._inputs:
                    self._inputs[signal] = self.DeclareVectorInputPort(signal, size)
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        self.DeclarePeriodicPublishEvent(period, WRITE_OFFSET, self._publish_commands)

    def _publish_commands(self, context: Context) -> None:
        connected = self._stamp.HasValue(context)
        stamp = read(self._stamp, context)[0] if connected else monotonic()
        values = {name: tuple(read(port, context)) for name, port in self._inputs.items()}
        for thread in self._threads:
            thread.post({name: values[name] for name in thread.device.commands}, stamp)
