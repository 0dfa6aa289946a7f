"""NI-DAQmx with one emulated X Series card: its refusals, and its tasks and channels."""

import math
import random
import re
import threading
from collections.abc import Mapping
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
        text: its description.
    """

    def __init__(self, code: int, **details: object):
        self.code = code
        lines = "".join(f"\n{name.replace('_', ' ')}: {value}" for name, value in details.items())
        self.text = f"{_TEXTS[code]}{lines}\n\nStatus Code: {code}"
        super().__init__(self.text)


# Channels of a 6363 (its specifications): analog inputs and outputs, counters, lines of each port.
_CHANNELS = {"ai": 32, "ao": OUTPUTS, "ctr": COUNTERS}
_LINES = (32, 8, 8)

# Range of its analog outputs [V]; ranges and resolution of its inputs, of which the driver takes
# the smallest range that holds what is asked for [V, bit].
_RANGE = 10.0
_INPUT_RANGES, _INPUT_BITS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0), 16
# Random noise of an input, in steps of its converter (assumption): 0.3 mV in the range of 10 V.
_NOISE = 1.0
_BY_CHANNEL = 0  # nidaqmx.constants.FillMode

# Cards with a watchdog: X Series (X Series User Manual, "Watchdog Timer"); M Series have none.
_WITH_WATCHDOG = re.compile(r"-63\d\d")
# Longest timeout of it [s] (ditto), and the one that never ends.
_LONGEST_WATCHDOG, _NEVER = (2**32 - 1) * 8e-9, -1.0
_RESET_TIMER, _CLEAR_EXPIRATION = 0, 1  # nidaqmx.constants.WDTTaskAction
_RESERVE, _UNRESERVE = 4, 5  # nidaqmx.constants.TaskMode

# The driver that is emulated: NI-DAQmx 2025 Q1.
_VERSION = {0x1272: 25, 0x1923: 0, 0x2F22: 0}

_COUNTS = 2**32
_COUNTED_EDGES = {"X_1": 1, "X_2": 2, "X_4": 4}


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

    The methods with names of the driver's functions take a request of the NI gRPC Device Server
    and give the fields of its response. Tasks and outputs stay when a client goes.

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

    def call(self, function: str, request: Any) -> Mapping[str, Any]:
        """Calls a function of the driver.

        Args:
            function: its name, one of `FUNCTIONS`.
            request: its arguments.

        Returns:
            The fields of its response.

        Raises:
            NiRefusal: the driver refuses.
        """
        self.advance()
        with self._lock:
            return getattr(self, function)(request)

    def advance(self) -> None:
        """Does what is due without a call: the watchdog expires, the button is pressed."""
        with self._lock:
            if monotonic() >= self._expires_at:
                self._expires_at, self._locked = math.inf, frozenset(self._guarded)
                self._wiring.set_lines(self._guarded)
            self._wiring.follow()

    def CreateTask(self, request: Any) -> Mapping[str, Any]:
        """A task without channels, or the one of that name."""
        self._made += 1
        name = request.session_name or f"_unnamedTask<{self._made}>"
        new, attach = name not in self._tasks, request.initialization_behavior
        if attach == 1 and not new:
            raise NiRefusal(-200089, Task_Name=name)
        if attach == 2 and new:
            raise NiRefusal(-200088, Task_Name=name)
        if new:
            self._tasks[name] = _Task(name)
        return {"task": {"name": name}, "new_session_initialized": new}

    def ClearTask(self, request: Any) -> Mapping[str, Any]:
        """Removes a task; the outputs hold."""
        task = self._task(request)
        self._stop(task)
        del self._tasks[task.name]
        return {}

    def StartTask(self, request: Any) -> Mapping[str, Any]:
        """Reserves the channels of a task, and counts from the initial position on."""
        task = self._task(request)
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
            self._restart(task)
        if task.kind == "ctr":
            self._wiring.start_counter(int(task.channels[0][3:]))
        return {}

    def StopTask(self, request: Any) -> Mapping[str, Any]:
        """Gives the channels of a task back."""
        self._stop(self._task(request))
        return {}

    def TaskControl(self, request: Any) -> Mapping[str, Any]:
        """Reserves a task that does not run, or no longer."""
        if request.action_raw not in (_RESERVE, _UNRESERVE):
            raise NiRefusal(-200077, Property="TaskControl", Requested_Value=request.action_raw)
        self._task(request).is_reserved = request.action_raw == _RESERVE
        return {}

    def CreateWatchdogTimerTaskEx(self, request: Any) -> Mapping[str, Any]:
        """A watchdog task without lines, or the one of that name."""
        self._check_device(request.device_name)
        if not _WITH_WATCHDOG.search(self._product):
            raise NiRefusal(-200662, Device=self._device)
        is_time = 0.0 < request.timeout <= _LONGEST_WATCHDOG
        if not is_time and request.timeout != _NEVER:
            raise NiRefusal(-200668, Requested_Value=request.timeout)
        watchdog_task = self.CreateTask(request)
        if watchdog_task["new_session_initialized"]:
            task = self._tasks[watchdog_task["task"]["name"]]
            task.kind, task.timeout = "watchdog", request.timeout
        return watchdog_task

    def CfgWatchdogDOExpirStates(self, request: Any) -> Mapping[str, Any]:
        """Sets what lines become when the watchdog expires."""
        task = self._watchdog(request)
        levels = need("nidaqmx.constants").Level
        states = {levels.HIGH.value: True, levels.LOW.value: False}
        channels = self._channels(request.channel_names, "line")
        if len(channels) != len(request.expir_state_array):
            raise NiRefusal(-200524, Task_Name=task.name)
        if not set(request.expir_state_array) <= set(states):
            raise NiRefusal(-200077, Property="Watchdog.DO.ExpirState")
        for channel, state in zip(channels, request.expir_state_array, strict=True):
            task.states[channel] = states[state]
        return {}

    def ControlWatchdogTask(self, request: Any) -> Mapping[str, Any]:
        """Starts the timer of a watchdog anew, or unlocks its lines."""
        task = self._watchdog(request)
        if request.action_raw == _CLEAR_EXPIRATION:
            self._locked = frozenset()
        elif self._locked:
            raise NiRefusal(-200644, Task_Name=task.name)
        elif task.is_running:
            self._restart(task)
        return {}

    def GetWatchdogAttributeBool(self, request: Any) -> Mapping[str, Any]:
        """Whether it has expired."""
        task = self._watchdog(request)
        if not task.is_running and not task.is_reserved:
            raise NiRefusal(-200983, Task_Name=task.name)
        return _attribute(request, {0x21A8: bool(self._locked)})

    def GetTaskAttributeString(self, request: Any) -> Mapping[str, Any]:
        """Its name and its channels."""
        task = self._task(request)
        names = ", ".join(f"{self._device}/{channel}" for channel in task.channels)
        return _attribute(request, {0x1276: task.name, 0x1273: names})

    def GetTaskAttributeUInt32(self, request: Any) -> Mapping[str, Any]:
        """The number of its channels."""
        task = self._task(request)
        # Lines are one channel together.
        count = min(len(task.channels), 1) if task.kind in ("di", "do") else len(task.channels)
        return _attribute(request, {0x2181: count})

    def GetSystemInfoAttributeUInt32(self, request: Any) -> Mapping[str, Any]:
        """The driver's version."""
        return _attribute(request, _VERSION)

    def GetDeviceAttributeString(self, request: Any) -> Mapping[str, Any]:
        """The card's type."""
        self._check_device(request.device_name)
        return _attribute(request, {0x631: self._product})

    def CreateAOVoltageChan(self, request: Any) -> Mapping[str, Any]:
        """Adds analog outputs to a task."""
        low, high = request.min_val, request.max_val
        channels = self._channels(request.physical_channel, "ao")
        if not low < high:
            raise NiRefusal(-200082, Minimum=low, Maximum=high)
        if low < -_RANGE or high > _RANGE:
            raise NiRefusal(-200077, Property="AO.Max", Requested_Value=high)
        task = self._add(request, "ao", channels)
        task.low, task.high = low, high
        return {}

    def CreateAIVoltageChan(self, request: Any) -> Mapping[str, Any]:
        """Adds analog inputs to a task."""
        low, high = request.min_val, request.max_val
        channels = self._channels(request.physical_channel, "ai")
        if not low < high:
            raise NiRefusal(-200082, Minimum=low, Maximum=high)
        if max(-low, high) > _INPUT_RANGES[-1]:
            raise NiRefusal(-200077, Property="AI.Max", Requested_Value=high)
        task = self._add(request, "ai", channels)
        task.high = min(each for each in _INPUT_RANGES if each >= max(-low, high))
        return {}

    def CreateCILinEncoderChan(self, request: Any) -> Mapping[str, Any]:
        """Adds a linear encoder to a task."""
        constants = need("nidaqmx.constants")
        channels = self._channels(request.counter, "ctr")
        if len(channels) > 1 or self._task(request).channels:
            raise NiRefusal(-200147, Task_Name=request.task.name)
        decodings = {constants.EncoderType[name].value: n for name, n in _COUNTED_EDGES.items()}
        if request.decoding_type_raw not in decodings:
            raise NiRefusal(-200077, Property="CI.Encoder.DecodingType")
        if request.units_raw != constants.LengthUnits.METERS.value:
            raise NiRefusal(-200077, Property="CI.LinEncoder.Units")
        task = self._add(request, "ctr", channels)
        task.edges = decodings[request.decoding_type_raw]
        task.distance, task.initial = request.dist_per_pulse, request.initial_pos
        return {}

    def CreateDIChan(self, request: Any) -> Mapping[str, Any]:
        """Adds digital inputs to a task."""
        self._add(request, "di", self._channels(request.lines, "line"))
        return {}

    def CreateDOChan(self, request: Any) -> Mapping[str, Any]:
        """Adds digital outputs to a task."""
        self._add(request, "do", self._channels(request.lines, "line"))
        return {}

    def WriteAnalogF64(self, request: Any) -> Mapping[str, Any]:
        """Sets the analog outputs of a task."""
        task = self._written(request, "ao", len(request.write_array))
        for channel, volts in zip(task.channels, request.write_array, strict=True):
            if not task.low <= volts <= task.high:
                raise NiRefusal(
                    -200561,
                    Channel_Name=f"{self._device}/{channel}",
                    Data=volts,
                    Minimum=task.low,
                    Maximum=task.high,
                )
        self._wiring.set_outputs(dict(zip(task.channels, request.write_array, strict=True)))
        return {"samps_per_chan_written": 1}

    def WriteDigitalLines(self, request: Any) -> Mapping[str, Any]:
        """Sets the digital outputs of a task."""
        task = self._written(request, "do", len(request.write_array))
        if self._locked & set(task.channels):
            raise NiRefusal(-200678, Task_Name=task.name)
        values = map(bool, request.write_array)
        self._wiring.set_lines(dict(zip(task.channels, values, strict=True)))
        return {"samps_per_chan_written": 1}

    def ReadAnalogF64(self, request: Any) -> Mapping[str, Any]:
        """Voltages of a task, sampled on demand: for each channel as many as are asked for."""
        task, count = self._task(request), request.num_samps_per_chan
        if task.kind != "ai":
            raise NiRefusal(-200430, Task_Name=task.name)
        if request.fill_mode_raw != _BY_CHANNEL:
            raise NiRefusal(-200077, Property="FillMode", Requested_Value=request.fill_mode_raw)
        scans = [self._converted(task) for _ in range(count)]
        read = [scan[k] for k in range(len(task.channels)) for scan in scans]
        return {"read_array": read, "samps_per_chan_read": count}

    def ReadDigitalLines(self, request: Any) -> Mapping[str, Any]:
        """Digital inputs, a byte each, in the order of the task."""
        task = self._task(request)
        _, inputs = self._wiring.measure()
        read = bytes(inputs.get(channel, False) for channel in task.channels)
        return {"read_array": read, "samps_per_chan_read": 1, "num_bytes_per_samp": len(read)}

    def ReadCounterScalarF64(self, request: Any) -> Mapping[str, Any]:
        """Position of an encoder; a counter that does not run is where it begins."""
        task = self._task(request)
        if not task.is_running:
            return {"value": task.initial}
        counts, _ = self._wiring.measure()
        edges = counts[int(task.channels[0][3:])]
        pulses = (edges * task.edges // 4 + _COUNTS // 2) % _COUNTS - _COUNTS // 2
        return {"value": task.initial + pulses * task.distance / task.edges}

    def _task(self, request: Any) -> _Task:
        task = self._tasks.get(request.task.name)
        if task is None:
            raise NiRefusal(-200088, Task_Name=request.task.name)
        return task

    def _converted(self, task: _Task) -> list[float]:
        """Voltages of a task's analog inputs as the converter shows them; 0 V without a wire."""
        volts, step = self._wiring.inputs(), 2.0 * task.high / 2**_INPUT_BITS
        steps = (volts.get(name, 0.0) / step for name in task.channels)
        noisy = (each + self._noise.gauss(0.0, _NOISE) for each in steps)
        largest = 2 ** (_INPUT_BITS - 1)
        return [step * min(max(round(each), -largest), largest - 1) for each in noisy]

    def _watchdog(self, request: Any) -> _Task:
        task = self._task(request)
        if task.kind != "watchdog":
            raise NiRefusal(-200635, Task_Name=task.name)
        return task

    def _restart(self, task: _Task) -> None:
        """Starts the timer of a watchdog."""
        never = task.timeout == _NEVER
        self._expires_at = math.inf if never else monotonic() + task.timeout

    def _stop(self, task: _Task) -> None:
        """Stops a task; a watchdog that has expired stays so."""
        if task.kind == "watchdog" and task.is_running:
            self._expires_at = math.inf
        task.is_running = False

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
        return [self._channel(name, kind) for name in names]

    def _channel(self, name: str, kind: str) -> str:
        device, _, channel = name.lower().partition("/")
        self._check_device(name.partition("/")[0] if device else name)
        match = re.fullmatch(r"(ai|ao|ctr)(\d+)|port(\d+)/(line)(\d+)", channel)
        if match is None or int(match[2] or match[5]) >= self._size(match):
            raise NiRefusal(-200170, Device=self._device, Physical_Channel_Name=channel)
        if (match[1] or match[4]) != kind:
            raise NiRefusal(-200430, Device=self._device, Physical_Channel_Name=channel)
        return channel

    @staticmethod
    def _size(match: re.Match[str]) -> int:
        """Number of channels of a kind."""
        if match[1]:
            return _CHANNELS[match[1]]
        port = int(match[3])
        return _LINES[port] if port < len(_LINES) else 0

    def _add(self, request: Any, kind: str, channels: list[str]) -> _Task:
        task = self._task(request)
        if task.kind not in ("", kind):
            raise NiRefusal(-200430, Task_Name=task.name)
        if set(task.channels) & set(channels) or len(set(channels)) < len(channels):
            raise NiRefusal(-200489, Task_Name=task.name)
        task.kind = kind
        task.channels += channels
        return task

    def _written(self, request: Any, kind: str, size: int) -> _Task:
        """A task that may be written to."""
        task = self._task(request)
        if task.kind != kind:
            raise NiRefusal(-200430, Task_Name=task.name)
        if size != len(task.channels):
            raise NiRefusal(-200524, Task_Name=task.name)
        if not task.is_running:
            if not request.auto_start:
                raise NiRefusal(-200846, Task_Name=task.name)
            self.StartTask(request)
        return task


def _attribute(request: Any, values: Mapping[int, Any]) -> Mapping[str, Any]:
    """The value of an attribute."""
    if request.attribute_raw not in values:
        raise NiRefusal(-200197, Property=hex(request.attribute_raw))
    return {"value": values[request.attribute_raw]}


FUNCTIONS = tuple(name for name in vars(NiCard) if re.match("[A-Z]", name))
"""The functions of the driver that are emulated."""
