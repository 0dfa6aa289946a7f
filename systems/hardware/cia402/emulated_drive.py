"""One CiA 402 drive of any maker, emulated: its firmware, in its maker's objects and units.

Drive state machine; profile and cyclic velocity, positions, currents or torques; homing where it
is; digital inputs and outputs; faults.
"""

import math
from functools import partial
from typing import Any, NamedTuple

from parapod.systems.core.elementwise import clamp
from parapod.systems.hardware.canopen import HEARTBEAT_CONSUMED, HEARTBEAT_PRODUCED, Entry, wrapped
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.makers import EPOS2, Maker
from parapod.systems.hardware.cia402.settings import Control
from parapod.systems.hardware.cia402.states import STATUSWORDS, DriveState, is_energised, obeyed
from parapod.systems.hardware.emulation.canopen_slave import (
    CanopenSlave,
    SlaveLine,
    process_data_defaults,
)

# What an EPOS2 adds to CiA 402's bits: offsets measured, and voltage enabled [EPOS2 firmware
# specification, states of the drive].
_OFFSETS_MEASURED, _VOLTAGE_ENABLED = 0x0100, 0x0010
_RPM = 2.0 * math.pi / 60.0  # [rad/s]
# Error register: generic, voltage, communication (CiA 301).
_GENERIC, _VOLTAGE, _COMMUNICATION = 0x01, 0x04, 0x10
# Functions of an EPOS2's inputs 1 to 6 as the maker delivers it: general purpose A to C, home,
# positive and negative limit switch [EPOS2 24/5 Hardware Reference, 4.5]; which of them are shown;
# and the functions of its outputs (assumption: the last one shows a fault, so that a driver that
# relies on it is found out).
_DELIVERED = {
    **dict(zip(EPOS2.inputs.function, (15, 14, 13, 2, 1, 0), strict=True)),
    EPOS2.inputs.ones[0]: 0xE007,
    **dict(zip(EPOS2.outputs.function, (15, 14, 13, 0), strict=True)),
}
# Rated current of an emulated motor [mA].
RATED = 4000

# A motor stands below this share of its demand; the integral part of its velocity's control then
# takes the current to its limit within this time [s] (assumption).
_STANDING, _WINDING_UP = 0.02, 0.05


class EmulatedMotor(NamedTuple):
    """Identity of an emulated controller, and the motor that it drives.

    Attributes:
        gear: turn of the motor [rad] for one unit of the axis, rad or m.
        pulses: encoder pulses per turn of the motor; four counts each.
        maker: maker of the drive, whose identity, objects and units it has.
        profile: number of the profile that it says it has; 402, except in tests.
        vendor: vendor that it says it is of; None: the maker.
        hardware: model that it says it is; None: the first one of the maker.
        position_offset: counts that the controller shows when it is switched on.
        sign: -1 where the motor's positive direction is the axis's negative one.
        force_per_current: force or torque of the axis by the motor's current [N/A or N m/A].
    """

    gear: float = 26.0
    pulses: int = 500
    maker: Maker = EPOS2
    profile: int = objects.DRIVE_PROFILE
    vendor: int | None = None
    hardware: int | None = None
    position_offset: int = 0
    sign: int = 1
    force_per_current: float = 0.0


class MeasuredMotor(NamedTuple):
    """Measurements of a controller's sensors, in the unit of the axis.

    Attributes:
        position: position of the axis [rad or m].
        velocity: velocity of the axis [rad/s or m/s].
        current: current of the motor, positive where the axis pushes [A].
    """

    position: float = 0.0
    velocity: float = 0.0
    current: float = 0.0


class Cia402Node:
    """One drive; the simulation reads `velocity`, moves the motor and sets `measured`.

    What is emulated is the controller's firmware: states, ramps of its profile, limits, whole
    rpm, counts. How fast and how well the motor then follows the ramp is the machine's matter.

    Attributes:
        state: state of the drive.
        measured: readings of its sensors.
        position: position where the axis is to be in position mode [rad or m]: the set value while
            operation is enabled, otherwise where the axis has stopped.
    """

    def __init__(
        self, node_id: int, line: SlaveLine, motor: EmulatedMotor, switched_on_at: float = 0.0
    ):
        """Creates a node, switched on just now, and puts it on the line.

        Args:
            node_id: its address.
            line: the bus.
            motor: motor that it drives.
            switched_on_at: position of the axis [rad or m], from which it counts.
        """
        self._motor, self._maker, self._zero = motor, motor.maker, switched_on_at
        self._per_rpm = motor.maker.per_rpm(4 * motor.pulses)
        self.state = DriveState.SWITCH_ON_DISABLED
        self.measured = MeasuredMotor(switched_on_at)
        self._history: list[int] = []  # from the newest to the oldest error
        self._inputs, self._is_supplied = [False] * len(motor.maker.inputs.bits), True
        self._controlword, self._demand, self._stepped = 0, 0.0, -math.inf
        self.position = switched_on_at
        self._homing = 0  # bits of the statusword about a homing
        self._held_up = 0.0  # how long the motor has stood against its demand [s]
        lose = partial(self.trip, objects.HEARTBEAT_LOST, _GENERIC | _COMMUNICATION)
        self._slave = CanopenSlave(node_id, _defaults(node_id, motor), line, lose)
        self._slave.node.add_read_callback(self._on_read)
        self._slave.node.add_write_callback(self._on_write)

    @property
    def velocity(self) -> float:
        """Velocity that the axis is to have [rad/s or m/s]; 0 unless operation is enabled."""
        if self.state is not DriveState.OPERATION_ENABLED:
            return 0.0
        return self._motor.sign * self._demand * _RPM / self._motor.gear

    @property
    def force(self) -> float:
        """Force or torque of the axis [N or N m]; 0 unless it runs in a mode for that.

        Its velocity is not limited (assumption: the drive's own limit may not help).
        """
        if not self._runs(Control.FORCE):
            return 0.0
        return self._motor.force_per_current * self._current

    @property
    def outputs(self) -> tuple[bool, ...]:
        """Whether its digital outputs 1, 2, ... are on.

        They stay as they are when the heartbeat is lost, and in a fault (assumption).
        """
        pins, slave = self._maker.outputs, self._slave
        state = slave.written(pins.state)
        if pins is not EPOS2.outputs:
            return tuple(bool(state & pins.mask(k + 1)) for k in range(len(pins.bits)))
        for mask in pins.ones:
            state &= slave.get(mask)
        for polarity in pins.zeros:
            state ^= slave.get(polarity)
        return tuple(bool(state >> slave.get(entry) & 1) for entry in pins.function)

    def hear(self, can_id: int, now: float) -> None:
        """Takes note of a frame at a time [s], which may be the master's heartbeat."""
        self._slave.hear(can_id, now)

    def trip(self, code: int, register: int = _GENERIC) -> None:
        """Makes the drive fail, with the code of an error and bits of the error register."""
        if self.state is DriveState.FAULT:
            return
        self.state = DriveState.FAULT_REACTION_ACTIVE
        self._history = [code, *self._history][: objects.HISTORY_SIZE]
        self._slave.node.emcy.send(code, register)

    def supply(self, is_there: bool) -> None:
        """Has the motor's supply there or not; the controller's electronics have their own.

        Without it the drive is in a fault at once, its power stage off, and cannot be reset
        (assumption: with and without power alike).
        """
        self._is_supplied = is_there
        if not is_there and self.state is not DriveState.FAULT:
            self.trip(min(self._maker.undervoltage), _GENERIC | _VOLTAGE)
            self.state, self._demand = DriveState.FAULT, 0.0

    def connect(self, number: int, has_voltage: bool) -> None:
        """Puts voltage to the digital input of a number, from 1, or takes it away."""
        self._inputs[number - 1] = has_voltage

    @property
    def _functions(self) -> int:
        """State of the digital inputs: of an EPOS2, of their functionalities."""
        pins, slave = self._maker.inputs, self._slave
        if pins is not EPOS2.inputs:
            return sum(pins.mask(k) for k, is_on in enumerate(self._inputs, start=1) if is_on)
        mask, polarity = slave.get(pins.ones[0]), slave.get(pins.zeros[0])
        active = 0
        for function, has_voltage in zip(pins.function, self._inputs, strict=True):
            bit = 1 << slave.get(function)
            active |= bit if has_voltage != bool(polarity & bit) else 0
        return active & mask

    def step(self, now: float) -> None:
        """Moves on to a time [s]."""
        self._slave.step(now)
        elapsed = max(0.0, now - self._stepped) if math.isfinite(self._stepped) else 0.0
        self._stepped = now
        self._demand = self._ramped(elapsed)
        self.position = self._led(elapsed)
        stands = abs(self._rpm) < _STANDING * abs(self._demand)
        self._held_up = self._held_up + elapsed if stands and abs(self._demand) >= 1.0 else 0.0
        if self._has_quick_stop and is_energised(self.state):
            self.state = DriveState.QUICK_STOP_ACTIVE
        if self.state is DriveState.FAULT_REACTION_ACTIVE and self._demand == 0.0:
            self.state = DriveState.FAULT
        error = abs(self.position - self.measured.position)
        largest = self._way(self._slave.get(objects.MAX_FOLLOWING_ERROR))
        if error > largest and self._runs(Control.POSITION):
            self.trip(objects.FOLLOWING_ERROR)

    @property
    def _has_quick_stop(self) -> bool:
        """Whether an EPOS2 executes a quick stop that one of its inputs asks for."""
        pins = self._maker.inputs
        if pins is not EPOS2.inputs or pins.quick_stop is None:
            return False
        stops = self._slave.written(pins.zeros[1]) & 1 << pins.quick_stop
        return bool(stops and stops & self._functions)

    def _runs(self, control: Control) -> bool:
        """Whether the drive runs in a mode for what is commanded."""
        if self.state is not DriveState.OPERATION_ENABLED:
            return False
        mode = self._slave.get(objects.MODE)
        return any(mode == each.number for each in self._maker.modes[control])

    def _setting(self, control: Control) -> int:
        """Set value of the modes for what is commanded."""
        return self._slave.get(self._maker.modes[control][0].setting)

    def _milliamperes(self, value: float, is_relative: bool) -> float:
        """Current of a value in the drive's unit."""
        return 1e-3 * RATED * value if is_relative else value

    def _way(self, counts: float) -> float:
        """Way of the axis [rad or m] for counts of its motor."""
        return counts * 2.0 * math.pi / (4 * self._motor.pulses * self._motor.gear)

    def _led(self, elapsed: float) -> float:
        """Position that is demanded next: the set value, or where a stop leads [rad or m]."""
        motor = self._motor
        if self._runs(Control.POSITION):
            counts = wrapped(self._setting(Control.POSITION) - motor.position_offset, 32)
            return self._zero + motor.sign * self._way(counts)
        return self.position + motor.sign * self._demand * _RPM / motor.gear * elapsed

    @property
    def _rpm(self) -> float:
        """Velocity of the motor as its sensor shows it [rpm]."""
        return self._motor.sign * self.measured.velocity * self._motor.gear / _RPM

    @property
    def _current(self) -> float:
        """Current of the motor [A], up to the limit, which one that is held up soon has."""
        maker = self._maker
        raw = self._slave.get(maker.current_limit)
        limit = 1e-3 * self._milliamperes(raw, maker.is_relative)
        if self._held_up > _WINDING_UP:
            return self._motor.sign * math.copysign(limit, self._demand)
        current = self.measured.current
        if self._runs(Control.FORCE):
            is_torque = maker.rated_current is not None
            setting = self._milliamperes(self._setting(Control.FORCE), is_torque)
            current = 1e-3 * self._motor.sign * setting
        return float(clamp(current, -limit, limit))

    def _ramped(self, elapsed: float) -> float:
        """Velocity of the motor that is demanded next [rpm]."""
        slave = self._slave
        if self._runs(Control.POSITION):
            return self._rpm  # with which a stop begins
        if self.state is DriveState.OPERATION_ENABLED:
            if not self._runs(Control.VELOCITY):
                return 0.0
            limits = [
                slave.get(entry) / self._per_rpm
                for entry in self._maker.speed_limits.get(Control.VELOCITY, ())
                if entry != objects.MAX_MOTOR_VELOCITY
            ]
            limit, goal = min(limits, default=math.inf), slave.get(objects.TARGET_VELOCITY)
            target = float(clamp(goal / self._per_rpm, -limit, limit))
            if slave.get(objects.MODE) == objects.CYCLIC_VELOCITY.number:
                return target
            faster = abs(target) > abs(self._demand)
            rate = slave.get(objects.ACCELERATION if faster else objects.DECELERATION)
        elif is_energised(self.state) or self.state is DriveState.FAULT_REACTION_ACTIVE:
            target, rate = 0.0, slave.get(objects.QUICK_STOP_DECELERATION)
        else:
            return 0.0
        step = rate / self._per_rpm * elapsed
        return float(clamp(target, self._demand - step, self._demand + step))

    def _find_home(self) -> None:
        """Makes the place where the axis is its home, if the method says so.

        There are no switches by which another method would find it (assumption: it then fails).
        """
        is_here = self._slave.get(objects.HOMING_METHOD) in objects.HOMING_HERE
        self._homing = objects.HOMING_ATTAINED if is_here else objects.HOMING_ERROR
        if is_here:
            self._zero = self.measured.position
            self._motor = self._motor._replace(position_offset=0)

    def _on_read(self, index: int, subindex: int = 0, **_: Any) -> int | None:
        motor, current = self._motor, self._maker.current
        if index == objects.ERROR_COUNT.index:
            errors = [len(self._history), *self._history]
            return errors[subindex] if subindex < len(errors) else 0
        if index == objects.STATUSWORD.index:
            powered = _VOLTAGE_ENABLED if is_energised(self.state) else 0
            homing = self._homing if self._slave.get(objects.MODE) == objects.HOMING else 0
            return STATUSWORDS[self.state] | _OFFSETS_MEASURED | powered | homing
        if index == objects.POSITION.index:
            turns = (self.measured.position - self._zero) * motor.gear / (2.0 * math.pi)
            counts = round(motor.sign * 4 * motor.pulses * turns) + motor.position_offset
            return wrapped(counts, 32)
        if index == objects.VELOCITY.index:
            return wrapped(round(self._rpm * self._per_rpm), 32)
        if (index, subindex) == (current.index, current.subindex):
            unit = 1e3 / RATED if self._maker.is_relative else 1.0
            return wrapped(round(1e3 * motor.sign * self._current * unit), 8 * current.size)
        inputs = self._maker.inputs.state
        return self._functions if (index, subindex) == (inputs.index, inputs.subindex) else None

    def _on_write(self, index: int, data: bytes, **_: Any) -> None:
        if index == objects.ERROR_COUNT.index and not any(data):
            self._history = []
        if index != objects.CONTROLWORD.index:
            return
        word = objects.CONTROLWORD.unpack(data)
        if word & ~self._controlword & objects.HOMING_START:
            self._find_home()
        before, after = self.state, obeyed(self.state, self._controlword, word)
        self._controlword = word
        if before is DriveState.FAULT and not self._is_supplied:
            return
        self.state = after
        if before is DriveState.FAULT and self.state is not before:
            self._slave.node.emcy.reset()


def _defaults(node_id: int, motor: EmulatedMotor) -> dict[Entry, int]:
    """The object dictionary as the maker delivers it."""
    maker, (resolution, factor) = motor.maker, motor.maker.resolution
    modes = [mode for modes in maker.modes.values() for mode in modes]
    zero = [objects.ERROR_COUNT, *objects.ERROR_HISTORY, HEARTBEAT_CONSUMED, HEARTBEAT_PRODUCED]
    zero += [objects.CONTROLWORD, objects.STATUSWORD, objects.DISABLE_OPTION]
    zero += [objects.POSITION, objects.VELOCITY, maker.current]
    zero += [objects.HOME_OFFSET, objects.HOMING_METHOD, *objects.HOMING_SPEEDS]
    zero += [objects.HOMING_ACCELERATION, objects.PROFILE_TYPE, objects.TARGET_VELOCITY]
    zero += [entry for mode in modes for entry in mode.target.entries]
    zero += [entry for entry, _ in maker.fixed]
    for pins in (maker.inputs, maker.outputs):
        zero += [pins.state, *pins.function, *pins.ones, *pins.zeros]
    if any(mode.number == objects.CYCLIC_POSITION.number for mode in modes):
        zero += [objects.PERIOD, objects.PERIOD_EXPONENT]
    hardware = next(iter(maker.models), 0) if motor.hardware is None else motor.hardware
    return {
        **dict.fromkeys(zero, 0),
        **{entry: 25000 for entries in maker.speed_limits.values() for entry in entries},
        **(_DELIVERED if maker is EPOS2 else {}),
        **({} if maker.rated_current is None else {maker.rated_current: RATED}),
        objects.DEVICE_TYPE: 0x0002_0000 | motor.profile,
        objects.VENDOR: maker.vendor if motor.vendor is None else motor.vendor,
        objects.PRODUCT: hardware << 16,
        objects.MAX_FOLLOWING_ERROR: 2000,
        resolution: 4 * motor.pulses // factor,
        objects.ABORT_CONNECTION: objects.ABORT_BY_QUICK_STOP,
        objects.MODE: 1,
        objects.ACCELERATION: 10000,
        objects.DECELERATION: 10000,
        objects.QUICK_STOP_DECELERATION: 10000,
        maker.current_limit: 10_000,
        **process_data_defaults(node_id),
    }
