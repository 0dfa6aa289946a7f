"""One EPOS2 controller on its bus: identity, set-up, enabling, commands and samples."""

import math
import struct
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from parapod.systems.hardware.canopen import (
    HEARTBEAT_CONSUMED,
    HEARTBEAT_PRODUCED,
    NMT_PRE_OPERATIONAL,
    NMT_START,
    NOT_VALID,
    CanopenBus,
    Entry,
    Pdo,
)
from parapod.systems.hardware.clock import sleep
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ds402 import (
    FAULT_RESET,
    Controlword,
    DriveState,
    is_energised,
    state_of,
    steps_to_operation,
)
from parapod.systems.hardware.epos2 import objects
from parapod.systems.hardware.epos2.settings import Control, Epos2Settings

_FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
_NO_SUPPLY = (
    f"has no supply for its motor, {objects.described(objects.UNDERVOLTAGE)}: "
    "is the emergency stop pressed?"
)

# Polling period while waiting for a state or a standstill [s].
POLL = 0.002
# A motor that is slower stands still [rpm]: two counts per millisecond of a 500-pulse encoder.
STANDSTILL = 60
# A tuned velocity loop lags no more behind its ramp [s]: 40 ms is what controllers reckon with.
_LAG = 0.05


# Node id under which this computer sends its heartbeat.
MASTER_ID = 127


class Timing(NamedTuple):
    """Times that depend on bus and controllers, and not on a machine.

    Attributes:
        heartbeat_period: least time between two heartbeats of this computer [s].
        timeout: longest wait for process data [s].
        sdo_timeout: longest wait for service data [s].
        state_timeout: longest change of the drive's state [s]; an EPOS2 measures current offsets
            before it switches on.
    """

    heartbeat_period: float = 0.02
    timeout: float = 0.05
    sdo_timeout: float = 0.2
    state_timeout: float = 0.5


class Sample(NamedTuple):
    """Sample of a motor, as its controller sends it.

    Attributes:
        state: state of the drive; None if the statusword has none of CiA 402's patterns.
        counts: position of the motor.
        rpm: velocity of the motor.
        milliamperes: current of the motor; 0 if it is not measured.
        inputs: functionalities of digital inputs that are active, a bit each; None: not measured.
    """

    state: DriveState | None
    counts: int
    rpm: int
    milliamperes: int = 0
    inputs: int | None = None


class Condition(NamedTuple):
    """Condition in which a drive should be.

    Attributes:
        is_active: true if it has been activated.
        is_running: true if it should have obeyed a command to run by now.
        is_stopped: true if the emergency stop is pressed: it may stop, and lose its supply.
        has_power: true if its motor should have power by now.
    """

    is_active: bool
    is_running: bool
    is_stopped: bool
    has_power: bool


class Epos2Controller:
    """A node, as `Epos2Device` uses it; all methods raise DeviceError and name the node."""

    def __init__(
        self,
        bus: CanopenBus,
        node_id: int,
        settings: Epos2Settings,
        timing: Timing,
        beat: Callable[[], None],
        clock: Callable[[], float],
        axis: str = "",
    ):
        """Describes a node.

        Args:
            bus: bus with the node.
            node_id: its address.
            settings: settings of the drives.
            timing: times of bus and drives.
            beat: sends the heartbeat if it is time.
            clock: monotonic [s].
            axis: name of its axis in errors.
        """
        self._bus, self._id, self._settings, self._timing = bus, node_id, settings, timing
        self._beat, self._clock, self._reports = beat, clock, reports(settings, node_id)
        self._mode = mode_of(settings)
        self._outputs = settings.outputs_of(node_id)
        # Bits of its digital outputs that are not ours to switch; None: nothing is known of them.
        self._other_outputs: int | None = None
        self.name = f"node {node_id}" + (f" ({axis})" if axis else "")
        # Whether a quick stop of ours may still be the reason why it stops.
        self._was_stopped = False
        # What its newest fault is; None while it has none, or nothing is known about it.
        self._code: int | None = None

    @property
    def report_ids(self) -> list[int]:
        """Identifiers of the frames that answer SYNC."""
        return [pdo.base + self._id for pdo in self._reports]

    def identify(self) -> None:
        """Makes sure that the node is the expected controller."""
        try:
            vendor = self._get(objects.VENDOR)
        except DeviceError as error:
            if error.fault is not DeviceFault.SILENT:
                raise
            others = ", ".join(map(str, self._bus.answering())) or "none"
            words = f"does not answer; nodes that do: {others}"
            raise self._error(words, DeviceFault.SILENT) from error
        hardware = self._get(objects.PRODUCT) >> 16
        if (vendor, hardware) != (objects.MAXON, objects.EPOS2_24_5):
            raise self._error(
                f"is vendor 0x{vendor:X}, hardware 0x{hardware:04X}, and not an EPOS2 24/5 "
                f"(0x{objects.MAXON:X}, 0x{objects.EPOS2_24_5:04X})",
                DeviceFault.CORRUPT,
            )

    def set_up(self) -> list[str]:
        """Takes the power, resets a fault, writes all settings and starts the node.

        Returns:
            Remarks about faults from before, each without the node's name.
        """
        self._set(objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
        self.guard(False)
        counts = 4 * self._get(objects.ENCODER_PULSES)
        if counts != self._settings.counts_per_turn:
            words = f"is set up for {counts} counts per turn, not {self._settings.counts_per_turn}"
            raise self._error(words)
        state = self._state()
        remarks = self._past(state)
        if state is not DriveState.SWITCH_ON_DISABLED:
            try:
                self._reset()
            except DeviceError:
                # Without its motor's supply it can be set up, and read, but not enabled.
                if self._fault_code() != objects.UNDERVOLTAGE:
                    raise
                remarks = [_NO_SUPPLY]
        if remarks and remarks != [_NO_SUPPLY]:
            self._set(objects.ERROR_COUNT, 0)  # each is reported once
        self._bus.manage(self._id, NMT_PRE_OPERATIONAL)
        for entry, value in set_up_of(self._settings, self._id):
            self._set(entry, value)
        self._show_inputs()
        self._bus.manage(self._id, NMT_START)
        return remarks

    def _show_inputs(self) -> None:
        """Has the digital inputs that are measured show whether there is voltage on them.

        What the node does with its other inputs stays as it is.
        """
        for number, key in self._settings.inputs_of(self._id).items():
            function, object_wanted = (
                objects.INPUT_FUNCTION[number - 1],
                objects.general_purpose(number),
            )
            if self._get(function) == objects.QUICK_STOP_FUNCTION:
                raise self._error(
                    f"has its quick stop at digital input {number}; give another {key}"
                )
            self._set(function, object_wanted)
            bit = 1 << object_wanted
            self._set(objects.INPUT_MASK, self._get(objects.INPUT_MASK) | bit)
            for entry in (objects.INPUT_POLARITY, objects.INPUT_EXECUTION):
                self._set(entry, self._get(entry) & ~bit)

    def set_up_outputs(self) -> None:
        """Switches its digital outputs off that are ours, and makes them obey.

        What the node does with its other outputs stays as it is.
        """
        for number in self._outputs:
            function, object_wanted = (
                objects.OUTPUT_FUNCTION[number - 1],
                objects.general_purpose(number),
            )
            bit = 1 << object_wanted
            self._set(objects.OUTPUT_POLARITY, self._get(objects.OUTPUT_POLARITY) & ~bit)
            self._set(objects.OUTPUT_MASK, self._get(objects.OUTPUT_MASK) | bit)
            others = self._get(objects.OUTPUT_STATE) & ~_bits(self._outputs)
            self._other_outputs = others
            self._set(objects.OUTPUT_STATE, others)
            # Only now: it shows nothing but the state from the beginning.
            self._set(function, object_wanted)

    def switch(self, on: Collection[int]) -> None:
        """Switches its digital outputs on, and all others of ours off; nothing confirms it.

        Args:
            on: numbers of the outputs.
        """
        if self._outputs and self._other_outputs is not None:
            pdo, state = objects.OUTPUTS, self._other_outputs | _bits(on)
            self._bus.send(pdo.base + self._id, pdo.pack(state))

    def switch_off(self) -> None:
        """Switches all of its digital outputs off that are ours, and makes sure of it."""
        if self._outputs and self._other_outputs is not None:
            self._set(objects.OUTPUT_STATE, self._other_outputs)

    def _past(self, state: DriveState | None) -> list[str]:
        """Remarks about the errors in the node's history, those since it was switched on."""
        count = min(self._get(objects.ERROR_COUNT), objects.HISTORY_SIZE)
        codes = [self._get(entry) & 0xFFFF for entry in objects.ERROR_HISTORY[:count]]
        descriptions = [objects.described(code) for code in codes]
        if state not in _FAULTS:
            return (
                [f"remembers errors from before: {', '.join(descriptions)}"]
                if descriptions
                else []
            )
        older = f"; before that: {', '.join(descriptions[1:])}" if descriptions[1:] else ""
        what = descriptions[0] if descriptions else "its history does not say which"
        return [f"was in a fault from before, which has been reset: {what}{older}"]

    def guard(self, is_guarded: bool) -> None:
        """Has the node stop its motor when this computer falls silent, or not."""
        # Whose heartbeat, and how long without it [ms].
        guard = MASTER_ID << 16 | round(1e3 * self._settings.heartbeat_timeout)
        self._set(HEARTBEAT_CONSUMED, guard if is_guarded else 0)

    def recover(self) -> None:
        """Resets a fault for want of heartbeats or of the motor's supply; refuses any other."""
        if self._state() in _FAULTS:
            code = self._fault_code()
            if code not in (objects.HEARTBEAT_LOST, objects.UNDERVOLTAGE):
                raise self._faulty(code)
            self.guard(False)
            try:
                self._reset()
            except DeviceError:
                if code == objects.UNDERVOLTAGE and self._fault_code() == code:
                    raise self._faulty(code) from None
                raise
        # Nodes may leave the operational state when they miss heartbeats (CiA 301, 0x1029).
        self._bus.manage(self._id, NMT_START)

    def enable(self, until: DriveState = DriveState.OPERATION_ENABLED) -> int:
        """Leads the drive towards operation enabled at rest, step by step.

        Args:
            until: state in which it is left, if it was not beyond that.

        Returns:
            Set value with which it stays where it is: zero velocity or current, or its position
            [counts].
        """
        setting, self._was_stopped = self._rest(), False
        state = self._state()
        try:
            steps = steps_to_operation(state or DriveState.NOT_READY_TO_SWITCH_ON)
        except ValueError as error:
            raise self._error(str(error)) from error
        for word, reached in steps:
            if word is Controlword.ENABLE_OPERATION:
                setting = self._rest()  # measuring its offsets may have taken long
            self._set(objects.CONTROLWORD, word)
            self._wait_for(reached)
            if reached is until:
                break
        return setting

    def _rest(self) -> int:
        """Gives the drive the set value with which it stays where it is."""
        is_position = self._mode is objects.POSITION_MODE
        setting = self._get(objects.POSITION) if is_position else 0
        self._set(self._mode.setting, setting)
        return setting

    def command(self, word: Controlword, setting: int) -> None:
        """Sends a controlword and a set value; nothing confirms them.

        Args:
            word: controlword.
            setting: velocity [rpm], position [counts] or current [mA] of the motor; a position
                counts only with a controlword that lets the drive run, before which it arrives.
        """
        self._was_stopped = self._was_stopped or word is Controlword.QUICK_STOP
        pdo = self._mode.command
        if self._mode is objects.POSITION_MODE:
            if word is Controlword.ENABLE_OPERATION:
                self.steer(setting)
            self._bus.send(pdo.base + self._id, pdo.pack(word))
        else:
            self._bus.send(pdo.base + self._id, pdo.pack(word, setting))

    def steer(self, setting: int) -> None:
        """Sends a set value, which a drive that does not run ignores.

        Args:
            setting: velocity [rpm], position [counts] or current [mA] of the motor.
        """
        self._bus.send(self._mode.target.base + self._id, self._mode.target.pack(setting))

    def disable(self) -> None:
        """Takes the power, makes sure that it is gone, and lets this computer fall silent.

        A node that keeps its power goes on to wait for heartbeats, without which it stops.
        """
        self._set(objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
        deadline = self._clock() + self._timing.state_timeout
        while is_energised(state := self._state()):
            if self._clock() > deadline:
                raise self._error(f"keeps its power, it is in {state}")
            sleep(POLL)
        self.guard(False)

    def poll(self) -> Sample:
        """Asks for the newest sample by service data."""
        entries = (entry for pdo in self._reports for entry in pdo.entries)
        return self._sample([self._get(entry) for entry in entries])

    def sample(self, frames: Mapping[int, bytes]) -> Sample:
        """The sample that the node's frames carry."""
        try:
            status, motion = (pdo.unpack(frames[pdo.base + self._id]) for pdo in self._reports)
        except KeyError:
            code = self._bus.emergency(self._id)
            if code is not None:
                raise self._faulty(code) from None
            words = f"does not answer SYNC in {self._timing.timeout:g} s"
            raise self._error(words, DeviceFault.SILENT) from None
        except struct.error as error:
            raise self._error(
                f"sends frames of wrong length: {error}", DeviceFault.CORRUPT
            ) from None
        return self._sample([*status, *motion])

    def _sample(self, values: Sequence[int]) -> Sample:
        """The sample of the values of all reports, in their order."""
        entries = (entry for pdo in self._reports for entry in pdo.entries)
        by_entry = dict(zip(entries, values, strict=True))
        return Sample(
            state_of(by_entry[objects.STATUSWORD]),
            by_entry[objects.POSITION],
            by_entry[objects.VELOCITY],
            by_entry.get(objects.CURRENT, 0),
            by_entry.get(objects.INPUT_STATE),
        )

    def inputs(self, sample: Sample) -> list[bool]:
        """Whether there is voltage at the inputs 1, 2, ...; false at those that are not shown."""
        input_bits = sample.inputs or 0
        numbers = range(1, objects.INPUT_COUNT + 1)
        return [bool(input_bits >> objects.general_purpose(number) & 1) for number in numbers]

    def is_stop_pressed(self, sample: Sample) -> bool:
        """Whether the contact of the emergency stop at this node is open."""
        return not self.inputs(sample)[self._settings.stop_input - 1]

    def check(self, sample: Sample, condition: Condition) -> None:
        """Refuses the measurements of a drive that does not obey.

        Args:
            sample: newest one.
            condition: condition in which it should be.
        """
        if sample.state in _FAULTS:
            if self._code is None:
                self._code = self._fault_code()
            # Without power it may be without its motor's supply as well.
            may_starve = condition.is_stopped or not condition.is_active
            if not (may_starve and self._code == objects.UNDERVOLTAGE):
                raise self._faulty(self._code)
            return
        self._code = None
        if condition.is_stopped:
            return
        if condition.has_power and not is_energised(sample.state):
            raise self._error(f"has lost its power, it is in {sample.state or 'no known state'}")
        if not condition.is_running:
            return
        if sample.state is not DriveState.QUICK_STOP_ACTIVE:
            self._was_stopped = False
        elif self._was_stopped:
            raise self._error(
                "stays in a quick stop of this program, and has not obeyed its release"
            )
        else:
            raise self._error(f"stops, which this program did not ask for: {self._stopper()}")

    def _stopper(self) -> str:
        """Reason for the drive's stop, in words."""
        with suppress(DeviceError):
            if self._get(objects.INPUT_STATE) >> objects.QUICK_STOP_FUNCTION & 1:
                return "its digital input for a quick stop is active, as by the emergency stop"
        return "is there a stop button?"

    def _fault_code(self) -> int | None:
        """Code of the fault that the drive is in; None if neither EMCY nor history tell it."""
        code = self._bus.emergency(self._id)
        if code is None:
            with suppress(DeviceError):  # a history without an entry refuses to be read
                code = self._get(objects.ERROR_CODE) & 0xFFFF
        return code or None

    def _reset(self) -> None:
        """Resets a fault once the drive has finished its reaction to it."""
        self._code = None
        deadline = self._clock() + stopping_time(self._settings, self._timing)
        while self._state() is DriveState.FAULT_REACTION_ACTIVE and self._clock() < deadline:
            sleep(POLL)
        for word in FAULT_RESET:
            self._set(objects.CONTROLWORD, word)
        self._wait_for(DriveState.SWITCH_ON_DISABLED)

    def _wait_for(self, state_wanted: DriveState) -> None:
        deadline = self._clock() + self._timing.state_timeout
        while (state := self._state()) is not state_wanted:
            if self._clock() > deadline:
                code = self._bus.emergency(self._id)
                words = f", {objects.described(code)}" if code else ""
                raise self._error(
                    f"is in {state or 'no known state'}, not in {state_wanted}{words}"
                )
            sleep(POLL)

    def _state(self) -> DriveState | None:
        return state_of(self._get(objects.STATUSWORD))

    def _get(self, entry: Entry) -> int:
        self._beat()
        return self._bus.get(self._id, entry)

    def _set(self, entry: Entry, value: int) -> None:
        self._beat()
        self._bus.set(self._id, entry, value)

    def _faulty(self, code: int | None) -> DeviceError:
        if code == objects.UNDERVOLTAGE:
            return self._error(_NO_SUPPLY)
        words = "no EMCY was seen" if code is None else objects.described(code)
        return self._error(f"is in fault: {words}")

    def _error(self, words: str, fault: DeviceFault = DeviceFault.FAILED) -> DeviceError:
        return DeviceError(self._settings.name, f"{self.name} {words}", fault)


def set_up_of(settings: Epos2Settings, node_id: int) -> Iterator[tuple[Entry, int]]:
    """Entries that a controller must have before it may be enabled, in order."""
    stop, mode = settings.quick_stop_deceleration, mode_of(settings)
    yield objects.MODE, mode.number
    yield objects.MAX_VELOCITY, settings.rpm(settings.max_velocity)
    if mode is objects.PROFILE_VELOCITY:
        yield objects.PROFILE_TYPE, 0
        yield objects.TARGET_VELOCITY, 0
        yield objects.ACCELERATION, settings.rpm_per_second(settings.acceleration)
        yield objects.DECELERATION, settings.rpm_per_second(settings.acceleration)
    if mode is objects.CURRENT_MODE:
        yield objects.CURRENT_SETTING, 0
        yield objects.MAX_MOTOR_VELOCITY, settings.rpm(settings.max_velocity)
    if settings.following_error is not None:
        yield objects.MAX_FOLLOWING_ERROR, round(settings.counts(settings.following_error))
    yield (
        objects.QUICK_STOP_DECELERATION,
        settings.rpm_per_second(stop),
    )
    if settings.current_limit is not None:
        yield objects.OUTPUT_CURRENT_LIMIT, round(1e3 * settings.current_limit)
    yield objects.ABORT_CONNECTION, objects.ABORT_BY_QUICK_STOP
    yield HEARTBEAT_PRODUCED, 0
    outputs = (objects.OUTPUTS,) if settings.outputs_of(node_id) else ()
    objects_used = (mode.command, mode.target, *outputs, *reports(settings, node_id))
    for index in objects.COMMUNICATION:
        if index not in {pdo.communication for pdo in objects_used}:
            yield Entry(index, 1, "<I"), _unused_id(index, node_id) | NOT_VALID
    for pdo in objects_used:
        yield from _mapping(pdo, node_id)


def mode_of(settings: Epos2Settings) -> objects.Mode:
    """Mode of operation of the drives."""
    match settings.control:
        case Control.VELOCITY:
            return objects.PROFILE_VELOCITY
        case Control.POSITION:
            return objects.POSITION_MODE
        case Control.FORCE:
            return objects.CURRENT_MODE


def _bits(numbers: Collection[int]) -> int:
    """Bits of the functionalities of digital outputs."""
    return sum(1 << objects.general_purpose(number) for number in numbers)


def _unused_id(index: int, node_id: int) -> int:
    """Predefined identifier of a process data object (CiA 301)."""
    base = 0x200 if index < 0x1800 else 0x180
    return base + 0x100 * (index & 0x3) + node_id


def _mapping(pdo: Pdo, node_id: int) -> Iterator[tuple[Entry, int]]:
    """Sets up a process data object in the order that CiA 301 prescribes: invalid meanwhile."""
    can_id = pdo.base + node_id
    yield Entry(pdo.communication, 1, "<I"), can_id | NOT_VALID
    yield Entry(pdo.communication, 2, "<B"), pdo.transmission
    yield Entry(pdo.mapping, 0, "<B"), 0
    for number, entry in enumerate(pdo.entries, start=1):
        yield Entry(pdo.mapping, number, "<I"), entry.mapping
    yield Entry(pdo.mapping, 0, "<B"), len(pdo.entries)
    yield Entry(pdo.communication, 1, "<I"), can_id


def reports(settings: Epos2Settings, node_id: int) -> tuple[Pdo, Pdo]:
    """Process data with which a node answers SYNC."""
    status = objects.STATUS_AND_INPUTS if settings.inputs_of(node_id) else objects.STATUS
    motion = objects.MOTION_AND_CURRENT if settings.measures_current else objects.MOTION
    return status, motion


def stopping_time(settings: Epos2Settings, timing: Timing) -> float:
    """Longest time that a quick stop may take, until every motor stands [s]."""
    ramp = settings.max_velocity / settings.quick_stop_deceleration
    fastest = max(abs(settings.rpm(settings.max_velocity)), STANDSTILL)
    return ramp + _LAG * math.log(fastest / STANDSTILL) + timing.timeout
