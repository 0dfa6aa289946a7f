"""An NI gRPC Device Server with one X Series card, as NI-DAQmx shows it, on a Unix socket.

From the inside out: refusals, the wiring behind the card's terminals, tasks and channels, and the
server that brings them to other processes.
"""

import math
import re
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from parapod.systems.hardware.device import need
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.safety.faults import FaultKind

# What NI-DAQmx says; the numbers are those of nidaqmx.error_codes.
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


# A Sabertooth 2x25 in analog mode stands still at half of 5 V (its manual) [V].
_STILL = 2.5

# Analog outputs of a 6363.
_OUTPUTS = 4


class NiWiring:
    """The terminals of the card and the wires behind them.

    Outputs ao0.. go to motor drivers in analog mode, one for each element of the part's `voltage`;
    counters ctr0.. count the encoders of its `extension`; lines port0/line0.. are its `limits`;
    one line closes the relay in the drivers' supply, and one shows the emergency stop's feedback
    contact: high while `emergency_stop` is 0. With the relay open, or the stop pressed, `voltage`
    is 0 and `stop` is 1. The outputs hold what was last written; a line without a wire is low.
    """

    def __init__(
        self,
        harness: Harness,
        misbehaviour: Misbehaviour,
        supply_voltage: float = 12.0,
        metres_per_count: float = 1e-5,
        zero_extension: Sequence[float] | None = None,
        relay_line: str = "port0/line12",
        part: str = "legs",
        stop_line: str = "port0/line13",
    ):
        """Switches the card on: outputs at 0 V, relay open.

        Args:
            harness: wires to the simulated machine.
            misbehaviour: faults of the card's measurements.
            supply_voltage: supply voltage of the motor drivers [V].
            metres_per_count: one edge of an encoder's signals [m].
            zero_extension: extensions at which the counters are zero [m]; None: those at which
                they are started, as it is in truth.
            relay_line: line of the relay.
            part: part of the machine.
            stop_line: line of the emergency stop's contact; "": it has no wire.
        """
        self._part, self._stop_line = part, stop_line
        self._harness, self._misbehaviour = harness, misbehaviour
        self._supply, self._metres_per_count = supply_voltage, metres_per_count
        self._is_started_at_zero = zero_extension is None
        self._zero = self._edges(zero_extension or harness.get(f"{part}.extension"))
        self._relay_line = relay_line
        self._outputs = {f"ao{index}": 0.0 for index in range(_OUTPUTS)}
        self._lines: dict[str, bool] = {}
        self._was_pressed = self.is_pressed
        self._apply()

    @property
    def outputs(self) -> tuple[float, ...]:
        """Voltages at the analog outputs [V]."""
        return tuple(self._outputs.values())

    @property
    def is_relay_closed(self) -> bool:
        """Whether the motor drivers have their supply."""
        return self._lines.get(self._relay_line, False)

    @property
    def is_pressed(self) -> bool:
        """Whether the emergency stop is; a machine may have none."""
        name = f"{self._part}.emergency_stop"
        return name in self._harness and self._harness.get(name)[0] > 0.5

    def follow(self) -> None:
        """Takes the drives' supply when the emergency stop is pressed, or gives it back."""
        if self.is_pressed != self._was_pressed:
            self._apply()

    def set_outputs(self, volts: Mapping[str, float]) -> None:
        """Sets analog outputs, by their names [V]."""
        self._outputs.update(volts)
        self._apply()

    def set_lines(self, values: Mapping[str, bool]) -> None:
        """Sets digital outputs, by their names."""
        self._lines.update(values)
        self._apply()

    def start_counter(self, counter: int) -> None:
        """Lets a counter begin at zero, if counters do."""
        if self._is_started_at_zero:
            self._zero[counter] = self._edges(self._get("extension"))[counter]

    def measure(self) -> tuple[tuple[int, ...], dict[str, bool]]:
        """Edges that the counters have counted, and lines that are high, as they are shown.

        Encoders and switches that are wrong have swapped wires; those of the stop's contact are
        right.
        """
        edges = self._edges(self._get("extension"))
        counts = [edge - zero for edge, zero in zip(edges, self._zero, strict=True)]
        # Plus and minus one: what is wrong or garbage changes a switch, too.
        bits = [1.0 if value > 0.5 else -1.0 for value in self._get("limits")]
        contact = -1.0 if self.is_pressed else 1.0
        shown = self._misbehaviour.shown((*counts, *bits, contact), time.monotonic())
        size = len(counts)
        lines = {f"port0/line{i}": value > 0.0 for i, value in enumerate(shown[size:-1])}
        if self._stop_line:
            is_wrong = self._misbehaviour.kind == FaultKind.WRONG
            lines[self._stop_line] = (contact if is_wrong else shown[-1]) > 0.0
        return tuple(map(round, shown[:size])), lines

    def _get(self, signal: str) -> tuple[float, ...]:
        return self._harness.get(f"{self._part}.{signal}")

    def _edges(self, extension: Sequence[float]) -> list[int]:
        return [round(value / self._metres_per_count) for value in extension]

    def _apply(self) -> None:
        """Puts the outputs on the wires, as motor drivers and relay do."""
        size = len(self._get("voltage"))
        self._was_pressed = self.is_pressed
        is_on = self.is_relay_closed and not self._was_pressed
        shares = ((volts - _STILL) / _STILL for volts in self.outputs[:size])
        voltage = [self._supply * min(max(share, -1.0), 1.0) if is_on else 0.0 for share in shares]
        self._harness.set(f"{self._part}.voltage", voltage)
        self._harness.set(f"{self._part}.stop", (0.0 if is_on else 1.0,))


# Of a 6363 (its specifications): analog inputs and outputs, counters, lines of each port.
_CHANNELS = {"ai": 32, "ao": 4, "ctr": 4}
_LINES = (32, 8, 8)

# Range of its analog outputs [V].
_RANGE = 10.0

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
            if time.monotonic() >= self._expires_at:
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
            taken = set(other.channels) & set(task.channels)
            if other is not task and other.is_running and taken:
                code = -200587 if "line" in min(taken) else -50103
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
        made = self.CreateTask(request)
        if made["new_session_initialized"]:
            task = self._tasks[made["task"]["name"]]
            task.kind, task.timeout = "watchdog", request.timeout
        return made

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

    def _watchdog(self, request: Any) -> _Task:
        task = self._task(request)
        if task.kind != "watchdog":
            raise NiRefusal(-200635, Task_Name=task.name)
        return task

    def _restart(self, task: _Task) -> None:
        """Starts the timer of a watchdog."""
        never = task.timeout == _NEVER
        self._expires_at = math.inf if never else time.monotonic() + task.timeout

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


_SERVICE = "nidaqmx_grpc.NiDAQmx"

# How often it looks whether it may answer, or whether its cable is in its place [s].
_POLL = 0.002

# Calls that hang occupy a thread each until their caller gives up.
_THREADS = 32


class NiServer:
    """An NI gRPC Device Server that knows the functions of NI-DAQmx that a controller needs.

    It answers every other function UNIMPLEMENTED, and refuses as the driver does: with the
    error's number in the trailing metadata "ni-error" and its description as text. It runs in a
    thread of its own, from the beginning of a `with` block to its end.

    Misbehaviour: while the device does not answer, calls hang until it does or their deadline is
    over, and are not carried out in that case; while it is unplugged, none listens at the
    socket; everything else changes what counters and inputs show. Tasks and outputs stay, and a
    watchdog that nothing can reset expires.

    Attributes:
        calls: number of calls of each function.
        card: the card.
        wiring: machine to which the card is connected.
        target: the server's address, for a gRPC channel.
    """

    def __init__(
        self,
        path: str | Path,
        harness: Harness,
        misbehaviour: Misbehaviour | None = None,
        device: str = "PXI1Slot2",
        product: str = "PXIe-6363",
        supply_voltage: float = 12.0,
        metres_per_count: float = 1e-5,
        zero_extension: Sequence[float] | None = None,
        relay_line: str = "port0/line12",
        part: str = "legs",
        stop_line: str = "port0/line13",
    ):
        """Creates a server that does not listen yet.

        Args:
            path: path of the socket; at most some 100 characters.
            harness: wires to the simulated machine; with signals `voltage`, `stop`, `extension`
                and `limits` of the part, and `emergency_stop` if it has one.
            misbehaviour: faults of the device.
            device: the card's name.
            product: the card's type; those of the X Series have a watchdog.
            supply_voltage: supply voltage of the motor drivers [V].
            metres_per_count: one edge of an encoder's signals [m].
            zero_extension: extensions at which the counters are zero [m]; None: those at which
                their task starts.
            relay_line: line of the relay.
            part: part of the machine.
            stop_line: line of the emergency stop's contact; "": it has no wire.

        Raises:
            MissingExtra: gRPC or the driver library is not installed.
        """
        self._grpc = need("grpc")
        self._messages = need("nidaqmx._stubs.nidaqmx_pb2")
        self._misbehaviour = misbehaviour or Misbehaviour()
        self.wiring = NiWiring(
            harness,
            self._misbehaviour,
            supply_voltage,
            metres_per_count,
            zero_extension,
            relay_line,
            part,
            stop_line,
        )
        self.card = NiCard(self.wiring, device, product)
        self.calls: Counter[str] = Counter()
        self.target = f"unix:{path}"
        self._handlers = {name: self._handler(name) for name in FUNCTIONS}
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="ni-server")
        self._server: Any = None
        self._closing = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="ni-cable", daemon=True)

    def __enter__(self) -> Self:
        self._listen()
        self._watcher.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._closing.set()
        self._watcher.join()
        self._hang_up()
        self._pool.shutdown()

    def service(self, details: Any) -> Any:
        """The handler of a call, as gRPC asks for it; None: there is none."""
        service, _, function = details.method.lstrip("/").partition("/")
        self.calls[function] += 1
        return self._handlers.get(function) if service == _SERVICE else None

    def _listen(self) -> None:
        self._server = self._grpc.server(self._pool)
        self._server.add_generic_rpc_handlers((self,))
        self._server.add_insecure_port(self.target)
        self._server.start()

    def _hang_up(self) -> None:
        server, self._server = self._server, None
        if server is not None:
            server.stop(None).wait()

    def _watch(self) -> None:
        """Listens while the cable is in its place, and lets the card do what is due by itself."""
        while not self._closing.wait(_POLL):
            self.card.advance()
            if self._misbehaviour.is_unplugged and self._server is not None:
                self._hang_up()
            elif self._server is None and not self._misbehaviour.is_unplugged:
                self._listen()

    def _handler(self, function: str) -> Any:
        response = getattr(self._messages, f"{function}Response")

        def answer(request: Any, context: Any) -> Any:
            self._wait(context)
            try:
                return response(**self.card.call(function, request))
            except NiRefusal as refusal:
                context.set_trailing_metadata((("ni-error", str(refusal.code)),))
                context.abort(self._grpc.StatusCode.UNKNOWN, refusal.text)

        return self._grpc.unary_unary_rpc_method_handler(
            answer,
            request_deserializer=getattr(self._messages, f"{function}Request").FromString,
            response_serializer=response.SerializeToString,
        )

    def _wait(self, context: Any) -> None:
        """Waits until the card answers; ends the call if it never does."""
        while context.is_active() and not self._misbehaviour.answers(time.monotonic()):
            if self._misbehaviour.is_unplugged or self._closing.is_set():
                context.abort(self._grpc.StatusCode.UNAVAILABLE, "the cable is out")
            time.sleep(_POLL)
        if not context.is_active():
            context.abort(self._grpc.StatusCode.CANCELLED, "the caller has given up")
