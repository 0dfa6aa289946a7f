"""A card of National Instruments' X Series as NI-DAQmx shows it: tasks, channels, refusals."""

import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from parapod.systems.hardware.emulators.ni_errors import NiRefusal
from parapod.systems.hardware.emulators.ni_wiring import NiWiring
from parapod.systems.hardware.extras import need

# Of a 6363 (its specifications): analog inputs and outputs, counters, lines of each port.
_CHANNELS = {"ai": 32, "ao": 4, "ctr": 4}
_LINES = (32, 8, 8)

# Range of its analog outputs [V].
_RANGE = 10.0

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


class NiCard:
    """The card and its driver.

    The methods with names of the driver's functions take a request of the NI gRPC Device Server
    and give the fields of its response. Tasks and outputs stay when a client goes.
    """

    def __init__(self, wiring: NiWiring, device: str = "PXI1Slot2", product: str = "PXIe-6363"):
        """Creates a card without tasks.

        Args:
            wiring: what it is connected to.
            device: its name.
            product: its type.
        """
        self._wiring, self._device, self._product = wiring, device, product
        self._tasks: dict[str, _Task] = {}
        self._made = 0
        self._lock = threading.Lock()

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
        with self._lock:
            return getattr(self, function)(request)

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
        del self._tasks[self._task(request).name]
        return {}

    def StartTask(self, request: Any) -> Mapping[str, Any]:
        """Reserves the channels of a task, and counts from the initial position on."""
        task = self._task(request)
        for other in self._tasks.values():
            taken = set(other.channels) & set(task.channels)
            if other is not task and other.is_running and taken:
                code = -200587 if "line" in min(taken) else -50103
                raise NiRefusal(code, Device=self._device, Task_Name=task.name)
        task.is_running = True
        if task.kind == "ctr":
            self._wiring.start_counter(int(task.channels[0][3:]))
        return {}

    def StopTask(self, request: Any) -> Mapping[str, Any]:
        """Gives the channels of a task back."""
        self._task(request).is_running = False
        return {}

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
        values = map(bool, request.write_array)
        self._wiring.set_lines(dict(zip(task.channels, values, strict=True)))
        return {"samps_per_chan_written": 1}

    def ReadDigitalLines(self, request: Any) -> Mapping[str, Any]:
        """Digital inputs, a byte each, in the order of the task."""
        task = self._task(request)
        _, limits = self._wiring.measure()
        inputs = {f"port0/line{index}": value for index, value in enumerate(limits)}
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
        """How many of a kind of channel there are."""
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
