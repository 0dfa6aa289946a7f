"""NI-DAQmx with one emulated X Series card: its refusals, and its tasks and channels."""

import math
import random
import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from parapod.systems.core.extras import need
from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.ni.terminals import COUNTERS, OUTPUTS, NiWiring

# Texts of NI-DAQmx; the numbers are those of nidaqmx.error_codes.
_TEXTS = {
    -50103: "The specified resource is reserved. The operation could not be completed as "
    "specified.",
    -200077: "Requested value is not a supported value for this property. The property value may "
    "be invalid because it conflicts with another property.",
    -200082: "Minimum is greater than or equal to the maximum.",
    -200088: "Task specified is invalid or does not exist.",
    -200089: "Task name specified conflicts with an existing task name.",
    -200099: "Physical channel not specified.",
    -200147: "Multiple counters specified when creating a counter input channel in a task.",
    -200170: "Physical channel specified does not exist on this device. Refer to the "
    "documentation for channels available on this device.",
    -200197: "Property specified is not supported.",
    -200220: "Device identifier is invalid.",
    -200430: "I/O type of the physical channel is not the one required.",
    -200489: "Specified channel cannot be added to the task, because a channel with the same name "
    "is already in the task.",
    -200498: "Syntax for a range of objects in the input string is invalid.",
    -200524: "Number of channels in the data does not match the number of channels in the task.",
    -200561: "Attempted writing analog data that is too large or too small.",
    -200587: "Specified lines are reserved by another task or unavailable.",
    -200846: "Write cannot be performed when the auto start input is false and the task is not "
    "running.",
    # In words of our own.
    -200635: "Action specified is only for a watchdog timer task.",
    -200644: "Watchdog timer cannot be reset because it has expired.",
    -200662: "Watchdog timer is not supported by the device.",
    -200668: "Watchdog timeout is out of the range of the device.",
    -200678: "Write cannot be performed because the watchdog timer has expired.",
    -200983: "Property cannot be read while the task is not reserved, committed or running.",
}


class NiRefusal(Exception):
    """A refusal of NI-DAQmx.

    Attributes:
        code: number of the error.
    """

    def __init__(self, code: int, **details: object):
        self.code = code
        lines = "".join(f"\n{name.replace('_', ' ')}: {value}" for name, value in details.items())
        super().__init__(f"{_TEXTS[code]}{lines}\n\nStatus Code: {code}")


# Channels of a 6363 (its specifications), and the kind of each.
_SIZES = {"ai": 32, "ao": OUTPUTS, "ctr": COUNTERS}
_SIZES |= {"port0/line": 32, "port1/line": 8, "port2/line": 8}
_CHANNELS = {
    f"{name}{number}": name.rpartition("/")[2] for name in _SIZES for number in range(_SIZES[name])
}

# Ranges of its analog channels [V]: the outputs have the largest, and of those of the inputs the
# driver takes the smallest that holds what is asked for; resolution of the inputs [bit].
_RANGES, _INPUT_BITS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0), 16
# Random noise of an input, in steps of its converter (assumption): 0.3 mV in the range of 10 V.
_NOISE = 1.0

# Cards with a watchdog: X Series (X Series User Manual, "Watchdog Timer"); M Series have none.
_WITH_WATCHDOG = re.compile(r"-63\d\d")
# Longest timeout of it [s] (ditto), and the one that never ends.
_LONGEST_WATCHDOG, _NEVER = (2**32 - 1) * 8e-9, -1.0

# Numbers of nidaqmx.constants: WDTTaskAction, TaskMode, FillMode, LengthUnits, Level, and
# EncoderType with the edges that it counts.
_CLEAR_EXPIRATION, _RESERVE, _UNRESERVE, _BY_CHANNEL, _METERS = 1, 4, 5, 0, 10219
_LEVELS = {10192: True, 10214: False}
_DECODINGS = {10090: 1, 10091: 2, 10092: 4}
# SessionInitializationBehavior of session.proto.
_NEW, _ATTACH = 1, 2

_COUNTS = 2**32

FUNCTIONS: dict[str, tuple[int, ...]] = {}
"""The functions of the driver that are emulated: see `codecs`."""


def _function[F: Callable[..., Any]](*numbers: int) -> Callable[[F], F]:
    """Makes a method a function of the driver; numbers of its parameters in nidaqmx.proto."""

    def declare(method: F) -> F:
        FUNCTIONS[method.__name__] = numbers
        return method

    return declare


@dataclass
class _Task:
    """A task: what it is of, and whether it runs."""

    name: str
    kind: str = ""
    channels: list[str] = field(default_factory=list)
    is_running: bool = False
    low: float = 0.0
    high: float = 0.0
    edges: int = 4
    distance: float = 0.0
    initial: float = 0.0
    is_reserved: bool = False
    timeout: float = 0.0
    states: dict[str, bool] = field(default_factory=dict)


class NiCard:
    """The card and its driver.

    The methods with names of the driver's functions take the fields of requests that matter here,
    and give those of the responses; see `codecs`. Tasks and outputs stay when a client goes.

    **Watchdog.** One that expires sets its lines, which refuse writes until the expiration is
    cleared, by its task or by any other, or another is started; then they hold until they are
    written. Analog outputs hold all the while.
    """

    def __init__(self, wiring: NiWiring, device: str = "PXI1Slot2", product: str = "PXIe-6363"):
        """Creates a card without tasks.

        Args:
            wiring: machine to which it is connected.
            device: its name.
            product: its type.
        """
        self._wiring, self._device, self._product = wiring, device, product
        self._tasks: dict[str, _Task] = {}
        self._made = 0
        self._lock = threading.Lock()
        self._expires_at, self._guarded = math.inf, dict[str, bool]()
        self._locked: frozenset[str] = frozenset()
        self._noise = random.Random(0)

    @property
    def tasks(self) -> tuple[str, ...]:
        """Names of the tasks there are."""
        return tuple(self._tasks)

    def call(self, function: str, arguments: Mapping[str, Any]) -> Any:
        """Calls a function of the driver.

        Args:
            function: its name, one of `FUNCTIONS`.
            arguments: its arguments; instead of a task anything of the same `name`.

        Returns:
            What it returns.

        Raises:
            NiRefusal: the driver refuses.
        """
        self.advance()
        with self._lock:
            if "task" in arguments:
                name = arguments["task"].name
                if name not in self._tasks:
                    raise NiRefusal(-200088, Task_Name=name)
                arguments = {**arguments, "task": self._tasks[name]}
            return getattr(self, function)(**arguments)

    def advance(self) -> None:
        """Does what is due without a call: the watchdog expires, the button is pressed."""
        with self._lock:
            if monotonic() >= self._expires_at:
                self._expires_at, self._locked = math.inf, frozenset(self._guarded)
                self._wiring.set_lines(self._guarded)
            self._wiring.follow()

    @_function(1, 2)
    def CreateTask(self, session_name: str, initialization_behavior: int) -> tuple[_Task, bool]:
        """A task without channels, or the one of that name; whether it is new."""
        self._made += 1
        name = session_name or f"_unnamedTask<{self._made}>"
        is_new = name not in self._tasks
        if initialization_behavior == _NEW and not is_new:
            raise NiRefusal(-200089, Task_Name=name)
        if initialization_behavior == _ATTACH and is_new:
            raise NiRefusal(-200088, Task_Name=name)
        return self._tasks.setdefault(name, _Task(name)), is_new

    @_function(1)
    def ClearTask(self, task: _Task) -> None:
        """Removes a task; the outputs hold."""
        self.StopTask(task)
        del self._tasks[task.name]

    @_function(1)
    def StartTask(self, task: _Task) -> None:
        """Reserves the channels of a task, and counts from the initial position on."""
        for other in self._tasks.values():
            shared_channels = set(other.channels) & set(task.channels)
            if other.kind == task.kind == "ai":
                shared_channels = {"ai"}  # the card has one converter
            if other is not task and other.is_running and shared_channels:
                code = -200587 if "line" in min(shared_channels) else -50103
                raise NiRefusal(code, Device=self._device, Task_Name=task.name)
        task.is_running = True
        if task.kind == "watchdog":
            self._locked = frozenset()
            self._guarded = dict(task.states)
            self._expires_at = monotonic() + task.timeout
        if task.kind == "ctr":
            self._wiring.start_counter(int(task.channels[0][3:]))

    @_function(1)
    def StopTask(self, task: _Task) -> None:
        """Gives the channels of a task back; a watchdog that has expired stays so."""
        if task.kind == "watchdog" and task.is_running:
            self._expires_at = math.inf
        task.is_running = False

    @_function(1, 3)
    def TaskControl(self, task: _Task, action_raw: int) -> None:
        """Reserves a task that does not run, or no longer."""
        if action_raw not in (_RESERVE, _UNRESERVE):
            raise NiRefusal(-200077, Property="TaskControl", Requested_Value=action_raw)
        task.is_reserved = action_raw == _RESERVE

    @_function(1, 2, 3, 4)
    def CreateWatchdogTimerTaskEx(
        self, device_name: str, session_name: str, timeout: float, initialization_behavior: int
    ) -> tuple[_Task, bool]:
        """A watchdog task without lines, or the one of that name; whether it is new."""
        self._check_device(device_name)
        if not _WITH_WATCHDOG.search(self._product):
            raise NiRefusal(-200662, Device=self._device)
        if not 0.0 < timeout <= _LONGEST_WATCHDOG and timeout != _NEVER:
            raise NiRefusal(-200668, Requested_Value=timeout)
        task, is_new = self.CreateTask(session_name, initialization_behavior)
        if is_new:
            task.kind, task.timeout = "watchdog", math.inf if timeout == _NEVER else timeout
        return task, is_new

    @_function(1, 2, 3)
    def CfgWatchdogDOExpirStates(
        self, task: _Task, channel_names: str, expir_state_array: list[int]
    ) -> None:
        """Sets what lines become when the watchdog expires."""
        _require(task, "watchdog")
        channels = self._channels(channel_names, "line")
        if len(channels) != len(expir_state_array):
            raise NiRefusal(-200524, Task_Name=task.name)
        if not _LEVELS.keys() >= set(expir_state_array):
            raise NiRefusal(-200077, Property="Watchdog.DO.ExpirState")
        task.states.update(zip(channels, (_LEVELS[x] for x in expir_state_array), strict=True))

    @_function(1, 3)
    def ControlWatchdogTask(self, task: _Task, action_raw: int) -> None:
        """Starts the timer of a watchdog anew, or unlocks its lines."""
        _require(task, "watchdog")
        if action_raw == _CLEAR_EXPIRATION:
            self._locked = frozenset()
        elif self._locked:
            raise NiRefusal(-200644, Task_Name=task.name)
        elif task.is_running:
            self._expires_at = monotonic() + task.timeout

    @_function(1, 4)
    def GetWatchdogAttributeBool(self, task: _Task, attribute_raw: int) -> bool:
        """Whether it has expired."""
        _require(task, "watchdog")
        if not task.is_running and not task.is_reserved:
            raise NiRefusal(-200983, Task_Name=task.name)
        return _attribute(attribute_raw, {0x21A8: bool(self._locked)})

    @_function(1, 3)
    def GetTaskAttributeString(self, task: _Task, attribute_raw: int) -> str:
        """Its name and its channels."""
        names = ", ".join(f"{self._device}/{channel}" for channel in task.channels)
        return _attribute(attribute_raw, {0x1276: task.name, 0x1273: names})

    @_function(1, 3)
    def GetTaskAttributeUInt32(self, task: _Task, attribute_raw: int) -> int:
        """The number of its channels."""
        # Lines are one channel together.
        count = min(len(task.channels), 1) if task.kind in ("di", "do") else len(task.channels)
        return _attribute(attribute_raw, {0x2181: count})

    @_function(2)
    def GetSystemInfoAttributeUInt32(self, attribute_raw: int) -> int:
        """The driver's version: NI-DAQmx 2025 Q1."""
        return _attribute(attribute_raw, {0x1272: 25, 0x1923: 0, 0x2F22: 0})

    @_function(1, 3)
    def GetDeviceAttributeString(self, device_name: str, attribute_raw: int) -> str:
        """The card's type."""
        self._check_device(device_name)
        return _attribute(attribute_raw, {0x631: self._product})

    @_function(1, 2, 4, 5)
    def CreateAOVoltageChan(
        self, task: _Task, physical_channel: str, min_val: float, max_val: float
    ) -> None:
        """Adds analog outputs to a task."""
        self._add_voltages(task, "ao", physical_channel, min_val, max_val)

    @_function(1, 2, 6, 7)
    def CreateAIVoltageChan(
        self, task: _Task, physical_channel: str, min_val: float, max_val: float
    ) -> None:
        """Adds analog inputs to a task."""
        self._add_voltages(task, "ai", physical_channel, min_val, max_val)
        task.high = min(each for each in _RANGES if each >= max(-min_val, max_val))

    @_function(1, 2, 5, 11, 12, 13)
    def CreateCILinEncoderChan(
        self,
        task: _Task,
        counter: str,
        decoding_type_raw: int,
        units_raw: int,
        dist_per_pulse: float,
        initial_pos: float,
    ) -> None:
        """Adds a linear encoder to a task."""
        channels = self._channels(counter, "ctr")
        if len(channels) > 1 or task.channels:
            raise NiRefusal(-200147, Task_Name=task.name)
        if decoding_type_raw not in _DECODINGS:
            raise NiRefusal(-200077, Property="CI.Encoder.DecodingType")
        if units_raw != _METERS:
            raise NiRefusal(-200077, Property="CI.LinEncoder.Units")
        _add(task, "ctr", channels)
        task.edges = _DECODINGS[decoding_type_raw]
        task.distance, task.initial = dist_per_pulse, initial_pos

    @_function(1, 2)
    def CreateDIChan(self, task: _Task, lines: str) -> None:
        """Adds digital inputs to a task."""
        _add(task, "di", self._channels(lines, "line"))

    @_function(1, 2)
    def CreateDOChan(self, task: _Task, lines: str) -> None:
        """Adds digital outputs to a task."""
        _add(task, "do", self._channels(lines, "line"))

    @_function(1, 3, 7)
    def WriteAnalogF64(self, task: _Task, auto_start: bool, write_array: list[float]) -> int:
        """Sets the analog outputs of a task; the number of samples of each."""
        self._begin_to_write(task, "ao", len(write_array), auto_start)
        values = dict(zip(task.channels, write_array, strict=True))
        for channel, volts in values.items():
            if not task.low <= volts <= task.high:
                name = f"{self._device}/{channel}"
                raise NiRefusal(
                    -200561, Channel_Name=name, Data=volts, Minimum=task.low, Maximum=task.high
                )
        self._wiring.set_outputs(values)
        return 1

    @_function(1, 3, 7)
    def WriteDigitalLines(self, task: _Task, auto_start: bool, write_array: bytes) -> int:
        """Sets the digital outputs of a task; the number of samples of each."""
        self._begin_to_write(task, "do", len(write_array), auto_start)
        if self._locked & set(task.channels):
            raise NiRefusal(-200678, Task_Name=task.name)
        self._wiring.set_lines(dict(zip(task.channels, map(bool, write_array), strict=True)))
        return 1

    @_function(1, 2, 5)
    def ReadAnalogF64(
        self, task: _Task, num_samps_per_chan: int, fill_mode_raw: int
    ) -> tuple[list[float], int]:
        """Voltages of a task, sampled on demand, and how many of each channel."""
        _require(task, "ai")
        if fill_mode_raw != _BY_CHANNEL:
            raise NiRefusal(-200077, Property="FillMode", Requested_Value=fill_mode_raw)
        scans = [self._converted(task) for _ in range(num_samps_per_chan)]
        read = [scan[k] for k in range(len(task.channels)) for scan in scans]
        return read, num_samps_per_chan

    @_function(1)
    def ReadDigitalLines(self, task: _Task) -> tuple[bytes, int, int]:
        """Digital inputs, a byte each, in the order of the task; numbers of samples and bytes."""
        _, inputs = self._wiring.measure()
        read = bytes(inputs.get(channel, False) for channel in task.channels)
        return read, 1, len(read)

    @_function(1)
    def ReadCounterScalarF64(self, task: _Task) -> float:
        """Position of an encoder; a counter that does not run is where it begins."""
        if not task.is_running:
            return task.initial
        counts, _ = self._wiring.measure()
        edges = counts[int(task.channels[0][3:])]
        pulses = (edges * task.edges // 4 + _COUNTS // 2) % _COUNTS - _COUNTS // 2
        return task.initial + pulses * task.distance / task.edges

    def _converted(self, task: _Task) -> list[float]:
        """Voltages of a task's analog inputs as the converter shows them; 0 V without a wire."""
        volts, step = self._wiring.inputs(), 2.0 * task.high / 2**_INPUT_BITS
        steps = (volts.get(name, 0.0) / step for name in task.channels)
        noisy = (each + self._noise.gauss(0.0, _NOISE) for each in steps)
        largest = 2 ** (_INPUT_BITS - 1)
        return [step * min(max(round(each), -largest), largest - 1) for each in noisy]

    def _check_device(self, name: str) -> None:
        if name.lower() != self._device.lower():
            raise NiRefusal(-200220, Device_Specified=name, Suggested_Device=self._device)

    def _channels(self, text: str, kind: str) -> list[str]:
        """The physical channels of a string, without the card's name."""
        try:
            names = need("nidaqmx.utils").unflatten_channel_string(text)
        except need("nidaqmx.errors").DaqError as error:
            raise NiRefusal(-200498, Requested_Value=text) from error
        if not names:
            raise NiRefusal(-200099)
        for name in names:
            self._check_device(name.partition("/")[0] or name)
        channels = [name.partition("/")[2].lower() for name in names]
        for channel in channels:
            if _CHANNELS.get(channel) != kind:
                code = -200430 if channel in _CHANNELS else -200170
                raise NiRefusal(code, Device=self._device, Physical_Channel_Name=channel)
        return channels

    def _add_voltages(self, task: _Task, kind: str, text: str, low: float, high: float) -> None:
        channels = self._channels(text, kind)
        if not low < high:
            raise NiRefusal(-200082, Minimum=low, Maximum=high)
        if max(-low, high) > _RANGES[-1]:
            raise NiRefusal(-200077, Property=f"{kind.upper()}.Max", Requested_Value=high)
        _add(task, kind, channels)
        task.low, task.high = low, high

    def _begin_to_write(self, task: _Task, kind: str, size: int, auto_start: bool) -> None:
        """Makes sure that a task can be written to, and runs."""
        _require(task, kind)
        if size != len(task.channels):
            raise NiRefusal(-200524, Task_Name=task.name)
        if not task.is_running:
            if not auto_start:
                raise NiRefusal(-200846, Task_Name=task.name)
            self.StartTask(task)


def _require(task: _Task, kind: str) -> None:
    """Refuses a task that is of something else."""
    if task.kind != kind:
        raise NiRefusal(-200635 if kind == "watchdog" else -200430, Task_Name=task.name)


def _add(task: _Task, kind: str, channels: list[str]) -> None:
    """Adds channels to a task."""
    if task.kind:
        _require(task, kind)
    if set(task.channels) & set(channels) or len(set(channels)) < len(channels):
        raise NiRefusal(-200489, Task_Name=task.name)
    task.kind = kind
    task.channels += channels


def _attribute[T](number: int, values: Mapping[int, T]) -> T:
    """The value of an attribute."""
    if number not in values:
        raise NiRefusal(-200197, Property=hex(number))
    return values[number]
