"""One drive on its bus: identity, set-up, enabling, commands and samples."""

import math
import struct
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from typing import NamedTuple

from parapod.systems.hardware.canopen import NMT_PRE_OPERATIONAL, NMT_START, CanopenBus, Entry
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.makers import MAKERS, Pins, maker_of
from parapod.systems.hardware.cia402.set_up import (
    mode_of,
    outputs_pdo,
    process_data,
    reports,
    set_up_of,
)
from parapod.systems.hardware.cia402.settings import AxesSettings, Control
from parapod.systems.hardware.cia402.states import (
    FAULT_RESET,
    Controlword,
    DriveState,
    is_energised,
    state_of,
    steps_to_operation,
)
from parapod.systems.hardware.clock import sleep
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ethercat import EthercatBus

type Bus = CanopenBus | EthercatBus

_FAULTS = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)

# Polling period while waiting for a state or a standstill [s].
POLL = 0.002
# A motor that is slower stands still [rpm]: two counts per millisecond of a 500-pulse encoder.
STANDSTILL = 60
# A tuned velocity loop lags no more behind its ramp [s]: 40 ms is what controllers reckon with.
_LAG = 0.05


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
        inputs: state of the digital inputs, a bit each; None: not measured.
    """

    state: DriveState | None
    counts: int
    rpm: float
    milliamperes: float = 0.0
    inputs: int | None = None


class Cia402Controller:
    """A node, as `Cia402Device` uses it; all methods raise DeviceError and name the node."""

    def __init__(
        self,
        bus: Bus,
        node_id: int,
        settings: AxesSettings,
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
        self._bus, self.id, self._settings, self._timing = bus, node_id, settings, timing
        self._beat, self._clock = beat, clock
        self._maker = maker = MAKERS[settings.drive]
        self._mode, self._reports = mode_of(settings), reports(settings, node_id)
        self._report_entries = [entry for pdo in self._reports for entry in pdo.entries]
        self.report_ids = [pdo.base + node_id for pdo in self._reports]
        # Units of the drive for one rpm, and for one of what is commanded: rpm, count or mA.
        self._per_rpm = maker.per_rpm(settings.counts_per_turn)
        self._per_mA, self._rated = 1.0, 1000.0
        self._outputs = settings.outputs_of(node_id)
        # Bits of digital outputs that are not ours to switch; None: no output is ours yet.
        self._other_outputs: int | None = None
        self.name = f"node {node_id}" + (f" ({axis})" if axis else "")
        # Whether a quick stop of ours may still be the reason why it stops.
        self._was_stopped = False
        # What its newest fault is; None while it has none, or nothing is known about it.
        self._code: int | None = None
        self._no_supply = (
            f"has no supply for its motor, {maker.described(min(maker.undervoltage))}: "
            "is the emergency stop pressed?"
        )

    def identify(self) -> None:
        """Makes sure that the node is a drive of the settings' maker."""
        try:
            profile = self._get(objects.DEVICE_TYPE)
        except DeviceError as error:
            if error.fault is not DeviceFault.SILENT:
                raise
            others = ", ".join(map(str, self._bus.answering())) or "none"
            words = f"does not answer; nodes that do: {others}"
            raise self._error(words, DeviceFault.SILENT) from error
        if profile & 0xFFFF != objects.DRIVE_PROFILE:
            words = f"is not a CiA 402 drive: its device type (0x1000) is 0x{profile:08X}"
            raise self._error(words, DeviceFault.CORRUPT)
        vendor, product = self._get(objects.VENDOR), self._get(objects.PRODUCT)
        maker = self._maker
        if (other := maker_of(vendor, product)) is not maker:
            of_other = f"{other.name}, " if other else ""
            models = ", ".join(f"{name}: 0x{code:04X}" for code, name in maker.models.items())
            raise self._error(
                f"is {of_other}vendor 0x{vendor:X}, hardware 0x{product >> 16:04X}, and not an "
                f"{maker.name} (0x{maker.vendor:X}{models and '; ' + models}), as `drive: "
                f"{self._settings.drive}` says: units of another maker",
                DeviceFault.CORRUPT,
            )

    def set_up(self) -> list[str]:
        """Takes the power, resets a fault, writes all settings and starts the node.

        Returns:
            Remarks about faults from before, each without the node's name.
        """
        self._set(objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
        self.guard(False)
        resolution, factor = self._maker.resolution
        counts = factor * self._get(resolution)
        if counts != self._settings.counts_per_turn:
            words = f"is set up for {counts} counts per turn, not {self._settings.counts_per_turn}"
            raise self._error(words)
        is_needed = self._maker.is_relative or self._settings.control is Control.FORCE
        if is_needed and (rated := self._maker.rated_current) is not None:
            self._rated = float(self._get(rated))
            if self._rated == 0.0:
                raise self._error(f"knows no rated current of its motor ({rated} is 0)")
            self._per_mA = 1000.0 / self._rated
        state = self._state()
        remarks = self._past(state)
        if state is not DriveState.SWITCH_ON_DISABLED:
            try:
                self._reset()
            except DeviceError:
                # Without its motor's supply it can be set up, and read, but not enabled.
                if self._fault_code() not in self._maker.undervoltage:
                    raise
                remarks = [self._no_supply]
        if remarks and remarks != [self._no_supply]:
            self._set(objects.ERROR_COUNT, 0)  # each is reported once
        self._bus.manage(self.id, NMT_PRE_OPERATIONAL)
        for entry, value in set_up_of(self._settings, self._rated):
            self._set(entry, value)
        self._bus.carry(self.id, process_data(self._settings, self.id))
        for number, key in self._settings.inputs_of(self.id).items():
            self._claim(self._maker.inputs, number, key)
        self._bus.manage(self.id, NMT_START)
        return remarks

    def _claim(self, pins: Pins, number: int, key: str = "") -> None:
        """Makes a digital input show whether there is voltage on it, or an output obey.

        What the node does with its others stays as it is.
        """
        function = pins.function[number - 1] if pins.function else None
        if function and key and self._get(function) == pins.quick_stop:
            raise self._error(f"has its quick stop at digital input {number}; give another {key}")
        for entry in pins.zeros:
            self._set(entry, self._get(entry) & ~pins.word_bit(number))
        for entry in pins.ones:
            self._set(entry, self._get(entry) | pins.word_bit(number))
        if not key:
            self._other_outputs = self._get(pins.state) & ~self._bits(self._outputs)
            self._set(pins.state, self._other_outputs)
        if function:  # only now: it shows nothing but the state from the beginning
            self._set(function, pins.bits[number - 1])

    def set_up_outputs(self) -> None:
        """Switches its digital outputs off that are ours, and makes them obey."""
        for number in self._outputs:
            self._claim(self._maker.outputs, number)

    def _bits(self, numbers: Collection[int]) -> int:
        """Bits of digital outputs in the entry that switches them."""
        return sum(self._maker.outputs.mask(number) for number in numbers)

    def switch(self, on: Collection[int]) -> None:
        """Switches these digital outputs on, and all others of ours off; nothing confirms it."""
        if self._other_outputs is not None:
            state = self._other_outputs | self._bits(on)
            self._bus.command(self.id, outputs_pdo(self._settings), state)

    def switch_off(self) -> None:
        """Switches all of its digital outputs off that are ours, and makes sure of it."""
        if self._other_outputs is not None:
            self._set(self._maker.outputs.state, self._other_outputs)

    def _past(self, state: DriveState | None) -> list[str]:
        """Remarks about the errors in the node's history, those since it was switched on."""
        count = min(self._get(objects.ERROR_COUNT), objects.HISTORY_SIZE)
        codes = [self._get(entry) & 0xFFFF for entry in objects.ERROR_HISTORY[:count]]
        errors = [self._maker.described(code) for code in codes]
        if state not in _FAULTS:
            return [f"remembers errors from before: {', '.join(errors)}"] if errors else []
        older = f"; before that: {', '.join(errors[1:])}" if errors[1:] else ""
        newest = errors[0] if errors else "its history does not say which"
        return [f"was in a fault from before, which has been reset: {newest}{older}"]

    def guard(self, is_guarded: bool) -> None:
        """Has the node stop its motor when this computer falls silent, or not."""
        self._beat()
        self._bus.guard(self.id, self._settings.heartbeat_timeout if is_guarded else 0.0)

    def recover(self) -> None:
        """Resets a fault for want of heartbeats or of the motor's supply; refuses any other."""
        if self._state() in _FAULTS:
            code = self._fault_code()
            if code not in (objects.HEARTBEAT_LOST, *self._maker.undervoltage):
                raise self._faulty(code)
            self.guard(False)
            try:
                self._reset()
            except DeviceError:
                if code in self._maker.undervoltage and self._fault_code() == code:
                    raise self._faulty(code) from None
                raise
        # Nodes may leave the operational state when they miss heartbeats (CiA 301, 0x1029).
        self._bus.manage(self.id, NMT_START)

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
        setting = self._get(objects.POSITION) if self._mode.is_place else 0
        self._set(self._mode.setting, setting)
        if self._mode.offset is not None:
            self._set(self._mode.offset, 0)
        return setting

    def speed(self, rpm: float) -> int:
        """Velocity in the drive's unit."""
        return round(rpm * self._per_rpm)

    def current(self, milliamperes: float) -> int:
        """Current, or torque, in the drive's unit for a current of its motor."""
        return round(milliamperes * self._per_mA)

    def command(self, word: Controlword, setting: int, offset: int = 0) -> None:
        """Sends a controlword and a set value; nothing confirms them.

        Args:
            word: controlword.
            setting: velocity or current of the motor in the drive's unit, or its position
                [counts], which counts only with a controlword that lets the drive run, before
                which it arrives.
            offset: velocity that is fed forward to a position, in the drive's unit.
        """
        self._was_stopped = self._was_stopped or word is Controlword.QUICK_STOP
        if self._mode.is_place:
            if word is Controlword.ENABLE_OPERATION:
                self.steer(setting, offset)
            self._bus.command(self.id, self._mode.command, word)
        else:
            self._bus.command(self.id, self._mode.command, word, setting)

    def steer(self, setting: int, offset: int = 0) -> None:
        """Sends a set value, see `command`, which a drive that does not run ignores."""
        values = (setting,) if self._mode.offset is None else (setting, offset)
        self._bus.command(self.id, self._mode.target, *values)

    def begin_homing(self) -> None:
        """Has a drive that runs begin to look for its home by its own method."""
        settings, speed = self._settings, self._settings.homing_speed_rpm
        deceleration = settings.quick_stop_deceleration * settings.rpm_per_unit
        self._set(objects.HOME_OFFSET, 0)
        self._set(objects.HOMING_METHOD, settings.homing_method or 0)
        for entry, rpm in zip(objects.HOMING_SPEEDS, (speed, 0.1 * speed), strict=True):
            self._set(entry, max(1, self.speed(rpm)))
        self._set(objects.HOMING_ACCELERATION, max(1, self.speed(deceleration)))
        self._set(objects.MODE, objects.HOMING)
        for word in (0, objects.HOMING_START):  # it obeys the edge
            self._set(objects.CONTROLWORD, Controlword.ENABLE_OPERATION | word)

    def is_home(self) -> bool:
        """Whether it has found its home."""
        word = self._get(objects.STATUSWORD)
        if word & objects.HOMING_ERROR or state_of(word) is not DriveState.OPERATION_ENABLED:
            method = self._settings.homing_method
            raise self._error(f"does not find its home by method {method} (0x6098)")
        return word & objects.HOMING_ATTAINED == objects.HOMING_ATTAINED

    def end_homing(self) -> int:
        """Leads it back to its mode, at rest; the set value with which it stays where it is."""
        setting = self._rest()
        self._set(objects.MODE, self._mode.number)
        self._set(objects.CONTROLWORD, Controlword.ENABLE_OPERATION)
        return setting

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

    def sample(self, frames: Mapping[int, bytes] | None) -> Sample:
        """The sample that the node's frames carry; None: it is asked for it by service data."""
        entries, maker = self._report_entries, self._maker
        values = [*map(self._get, entries)] if frames is None else self._unpacked(frames)
        shown_by = dict(zip(entries, values, strict=True))
        return Sample(
            state_of(shown_by[objects.STATUSWORD]),
            shown_by[objects.POSITION],
            shown_by[objects.VELOCITY] / self._per_rpm,
            (1e-3 * self._rated if maker.is_relative else 1.0) * shown_by.get(maker.current, 0),
            shown_by.get(maker.inputs.state),
        )

    def _unpacked(self, frames: Mapping[int, bytes]) -> list[int]:
        """Values of all reports, in their order."""
        pairs = zip(self._reports, self.report_ids, strict=True)
        try:
            return [value for pdo, can_id in pairs for value in pdo.unpack(frames[can_id])]
        except KeyError:
            code = self._bus.emergency(self.id)
            if code is not None:
                raise self._faulty(code) from None
            words = f"does not answer SYNC in {self._timing.timeout:g} s"
            raise self._error(words, DeviceFault.SILENT) from None
        except struct.error as error:
            words = f"sends frames of wrong length: {error}"
            raise self._error(words, DeviceFault.CORRUPT) from None

    def inputs(self, sample: Sample) -> list[bool]:
        """Whether there is voltage at the inputs 1, 2, ...; false at those that are not shown."""
        return [bool((sample.inputs or 0) >> bit & 1) for bit in self._maker.inputs.bits]

    def is_stop_pressed(self, sample: Sample) -> bool:
        """Whether the contact of the emergency stop at this node is open."""
        return not self.inputs(sample)[self._settings.stop_input - 1]

    def check(
        self, sample: Sample, is_active: bool, is_running: bool, is_stopped: bool, has_power: bool
    ) -> None:
        """Refuses the measurements of a drive that does not obey.

        Args:
            sample: newest one.
            is_active: true if the drive has been activated.
            is_running: true if it should have obeyed a command to run by now.
            is_stopped: true if the emergency stop is pressed: it may stop, and lose its supply.
            has_power: true if its motor should have power by now.
        """
        if sample.state in _FAULTS:
            if self._code is None:
                self._code = self._fault_code()
            # Without power it may be without its motor's supply as well.
            may_starve = is_stopped or not is_active
            if not may_starve or self._code not in self._maker.undervoltage:
                raise self._faulty(self._code)
            return
        self._code = None
        if is_stopped:
            return
        if has_power and not is_energised(sample.state):
            raise self._error(f"has lost its power, it is in {sample.state or 'no known state'}")
        if not is_running:
            return
        if sample.state is DriveState.QUICK_STOP_ACTIVE:
            words = "stays in a quick stop of this program, and has not obeyed its release"
            if not self._was_stopped:
                words = f"stops, which this program did not ask for: {self._stopper()}"
            raise self._error(words)
        self._was_stopped = False

    def _stopper(self) -> str:
        """Reason for the drive's stop, in words."""
        inputs = self._maker.inputs
        with suppress(DeviceError):
            if inputs.quick_stop and self._get(inputs.state) >> inputs.quick_stop & 1:
                return "its digital input for a quick stop is active, as by the emergency stop"
        return "is there a stop button?"

    def _fault_code(self) -> int | None:
        """Code of the fault that the drive is in; None if neither EMCY nor history tell it."""
        code = self._bus.emergency(self.id)
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
                code = self._bus.emergency(self.id)
                words = f", {self._maker.described(code)}" if code else ""
                raise self._error(
                    f"is in {state or 'no known state'}, not in {state_wanted}{words}"
                )
            sleep(POLL)

    def _state(self) -> DriveState | None:
        return state_of(self._get(objects.STATUSWORD))

    def _get(self, entry: Entry) -> int:
        self._beat()
        return self._bus.get(self.id, entry)

    def _set(self, entry: Entry, value: int) -> None:
        self._beat()
        self._bus.set(self.id, entry, value)

    def _faulty(self, code: int | None) -> DeviceError:
        if code in self._maker.undervoltage:
            return self._error(self._no_supply)
        words = "no EMCY was seen" if code is None else self._maker.described(code)
        return self._error(f"is in fault: {words}")

    def _error(self, words: str, fault: DeviceFault = DeviceFault.FAILED) -> DeviceError:
        return DeviceError(self._settings.name, f"{self.name} {words}", fault)


def stopping_time(settings: AxesSettings, timing: Timing) -> float:
    """Longest time that a quick stop may take, until every motor stands [s]."""
    ramp = settings.max_velocity / settings.quick_stop_deceleration
    fastest = max(settings.rpm(settings.max_velocity), STANDSTILL)
    return ramp + _LAG * math.log(fastest / STANDSTILL) + timing.timeout
