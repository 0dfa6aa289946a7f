"""CiA 402 drives of any maker, emulated on a bus: `virtual`, or SLCAN for other processes.

Drive state machine; profile and cyclic velocity, positions, currents or torques; digital inputs
and outputs; faults. A maker's table says in which objects and units.
"""

import math
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, NamedTuple, Self

from parapod.systems.core.elementwise import clamp
from parapod.systems.core.extras import need
from parapod.systems.hardware.canopen import (
    HEARTBEAT_BASE,
    HEARTBEAT_CONSUMED,
    HEARTBEAT_PRODUCED,
    Entry,
    wrapped,
)
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.makers import EPOS2, Maker
from parapod.systems.hardware.cia402.settings import Control
from parapod.systems.hardware.cia402.switches import SwitchGroup
from parapod.systems.hardware.clock import computer_time, monotonic
from parapod.systems.hardware.ds402 import STATUSWORDS, DriveState, is_energised, obeyed
from parapod.systems.hardware.emulation.canopen_slave import (
    CanopenSlave,
    SlaveLine,
    process_data_defaults,
)
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour, is_supplied
from parapod.systems.hardware.emulation.slcan import SlcanPty

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
        self._position = switched_on_at
        self._homing = 0  # bits of the statusword about a homing
        self._held_up = 0.0  # how long the motor has stood against its demand [s]
        self._slave = CanopenSlave(node_id, _defaults(node_id, motor), line, self._miss_heartbeat)
        self._slave.node.add_read_callback(self._on_read)
        self._slave.node.add_write_callback(self._on_write)

    @property
    def velocity(self) -> float:
        """Velocity that the axis is to have [rad/s or m/s]; 0 unless operation is enabled."""
        if self.state is not DriveState.OPERATION_ENABLED:
            return 0.0
        return self._motor.sign * self._demand * _RPM / self._motor.gear

    @property
    def position(self) -> float:
        """Position where the axis is to be in position mode [rad or m].

        While operation is enabled that is the set value, otherwise where the axis has stopped.
        """
        return self._position

    @property
    def force(self) -> float:
        """Force or torque of the axis [N or N m]; 0 unless it runs in a mode for that.

        There is no limit of its velocity (assumption: the drive's own may not help).
        """
        is_pushing = self._runs(Control.FORCE)
        return self._motor.force_per_current * self._current if is_pushing else 0.0

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
        """Takes note of a frame that may be the master's heartbeat.

        Args:
            can_id: its identifier.
            now: the time [s].
        """
        self._slave.hear(can_id, now)

    def trip(self, code: int, register: int = _GENERIC) -> None:
        """Makes the drive fail.

        Args:
            code: code of the error.
            register: bits of the error register.
        """
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
        """Puts voltage to a digital input, or takes it away.

        Args:
            number: number of the input, from 1.
            has_voltage: true if there is voltage.
        """
        self._inputs[number - 1] = has_voltage

    @property
    def _speed_limits(self) -> tuple[Entry, ...]:
        """Entries of the largest velocity of a profile, in the drive's unit."""
        limits = self._maker.speed_limits.get(Control.VELOCITY, ())
        return tuple(entry for entry in limits if entry != objects.MAX_MOTOR_VELOCITY)

    @property
    def _functions(self) -> int:
        """State of the digital inputs: of an EPOS2, of their functionalities."""
        pins, slave = self._maker.inputs, self._slave
        pairs = list(enumerate(self._inputs, start=1))
        if pins is not EPOS2.inputs:
            return sum(pins.mask(number) for number, has_voltage in pairs if has_voltage)
        mask, polarity = slave.get(pins.ones[0]), slave.get(pins.zeros[0])
        active = 0
        for number, has_voltage in pairs:
            bit = 1 << slave.get(pins.function[number - 1])
            active |= bit if has_voltage != bool(polarity & bit) else 0
        return active & mask

    def step(self, now: float) -> None:
        """Moves on to a time [s]."""
        self._slave.step(now)
        elapsed = max(0.0, now - self._stepped) if math.isfinite(self._stepped) else 0.0
        self._stepped = now
        self._demand = self._ramped(elapsed)
        self._position = self._led(elapsed)
        self._held_up = self._held_up + elapsed if self._is_held_up else 0.0
        if self._has_quick_stop and is_energised(self.state):
            self.state = DriveState.QUICK_STOP_ACTIVE
        if self.state is DriveState.FAULT_REACTION_ACTIVE and self._demand == 0.0:
            self.state = DriveState.FAULT
        error = abs(self._position - self.measured.position)
        if self._is_led and error > self._way(self._slave.get(objects.MAX_FOLLOWING_ERROR)):
            self.trip(objects.FOLLOWING_ERROR)

    @property
    def _has_quick_stop(self) -> bool:
        """Whether an EPOS2 executes a quick stop that one of its inputs asks for."""
        pins = self._maker.inputs
        if pins is not EPOS2.inputs or pins.quick_stop is None:
            return False
        stops = self._slave.written(pins.zeros[1]) & 1 << pins.quick_stop
        return bool(stops and stops & self._functions)

    @property
    def _is_led(self) -> bool:
        """Whether the axis follows set values of its position."""
        return self._runs(Control.POSITION)

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
        if self._is_led:
            setting = self._setting(Control.POSITION)
            return self._zero + motor.sign * self._way(
                wrapped(setting - motor.position_offset, 32)
            )
        return self._position + motor.sign * self._demand * _RPM / motor.gear * elapsed

    @property
    def _rpm(self) -> float:
        """Velocity of the motor as its sensor shows it [rpm]."""
        return self._motor.sign * self.measured.velocity * self._motor.gear / _RPM

    @property
    def _is_held_up(self) -> bool:
        """Whether the motor stands although it should turn."""
        return abs(self._demand) >= 1.0 and abs(self._rpm) < _STANDING * abs(self._demand)

    @property
    def _current(self) -> float:
        """Current of the motor [A], up to the limit, which one that is held up soon has."""
        maker, is_torque = self._maker, self._maker.rated_current is not None
        raw = self._slave.get(maker.current_limit)
        limit = 1e-3 * self._milliamperes(raw, maker.is_relative)
        if self._held_up > _WINDING_UP:
            return self._motor.sign * math.copysign(limit, self._demand)
        current = self.measured.current
        if self._runs(Control.FORCE):
            setting = self._milliamperes(self._setting(Control.FORCE), is_torque)
            current = 1e-3 * self._motor.sign * setting
        return float(clamp(current, -limit, limit))

    def _ramped(self, elapsed: float) -> float:
        """Velocity of the motor that is demanded next [rpm]."""
        if self._is_led:
            return self._rpm  # with which a stop begins
        if self.state is DriveState.OPERATION_ENABLED:
            if not self._runs(Control.VELOCITY):
                return 0.0
            goal = self._slave.get(objects.TARGET_VELOCITY) / self._per_rpm
            limit = min(
                (self._slave.get(e) / self._per_rpm for e in self._speed_limits), default=math.inf
            )
            target = float(clamp(goal, -limit, limit))
            if self._slave.get(objects.MODE) == objects.CYCLIC_VELOCITY.number:
                return target
            faster = abs(target) > abs(self._demand)
            rate = self._slave.get(objects.ACCELERATION if faster else objects.DECELERATION)
        elif is_energised(self.state) or self.state is DriveState.FAULT_REACTION_ACTIVE:
            target, rate = 0.0, self._slave.get(objects.QUICK_STOP_DECELERATION)
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

    def _miss_heartbeat(self) -> None:
        self.trip(objects.HEARTBEAT_LOST, _GENERIC | _COMMUNICATION)

    def _on_read(self, index: int, subindex: int = 0, **_: Any) -> int | None:
        motor = self._motor
        if index == objects.ERROR_COUNT.index:
            errors = [len(self._history), *self._history]
            return errors[subindex] if subindex < len(errors) else 0
        inputs, current = self._maker.inputs.state, self._maker.current
        if (index, subindex) == (inputs.index, inputs.subindex):
            return self._functions
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
        return None

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
    maker = motor.maker
    resolution, factor = maker.resolution
    modes = [mode for modes in maker.modes.values() for mode in modes]
    pins = [
        entry
        for each in (maker.inputs, maker.outputs)
        for entry in (each.state, *each.function, *each.ones, *each.zeros)
    ]
    vendor = maker.vendor if motor.vendor is None else motor.vendor
    hardware = next(iter(maker.models), 0) if motor.hardware is None else motor.hardware
    limits = {entry: 25000 for each in maker.speed_limits.values() for entry in each}
    cyclic = any(mode.number == objects.CYCLIC_POSITION.number for mode in modes)
    none = dict.fromkeys(
        (
            objects.ERROR_COUNT,
            *objects.ERROR_HISTORY,
            HEARTBEAT_CONSUMED,
            HEARTBEAT_PRODUCED,
            maker.current,
            objects.CONTROLWORD,
            objects.STATUSWORD,
            objects.POSITION,
            objects.VELOCITY,
            objects.PROFILE_TYPE,
            objects.HOME_OFFSET,
            objects.HOMING_METHOD,
            *objects.HOMING_SPEEDS,
            objects.HOMING_ACCELERATION,
            objects.TARGET_VELOCITY,
            *pins,
            *(entry for mode in modes for entry in mode.target.entries),
            *(entry for entry, _ in maker.fixed),
            *((objects.PERIOD, objects.PERIOD_EXPONENT) if cyclic else ()),
        ),
        0,
    )
    delivered = {entry: value for entry, value in _DELIVERED.items() if entry in pins}
    return {
        **none,
        **limits,
        **delivered,
        **({} if maker.rated_current is None else {maker.rated_current: RATED}),
        objects.DEVICE_TYPE: 0x0002_0000 | motor.profile,
        objects.VENDOR: vendor,
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


# Signal of the emergency stop within its part.
EMERGENCY_STOP = "emergency_stop"
# Mode of a node by the signal with which a machine commands its axes.
_COMMANDS = {
    "velocity_command": "velocity",
    "position_command": "position",
    "force_command": "force",
    "torque_command": "force",
}
# Longest time between two looks at ramps and heartbeats [s].
_TICK = 0.002
# Service data (CiA 301): identifiers of requests, the command that reads, and the objects that say
# how a node communicates.
_REQUESTS, _UPLOAD, _COMMUNICATION_OBJECTS = range(0x600, 0x680), 0x40, range(0x1000, 0x2000)
# Time for which capacitors feed the drives when their supply has been cut [s] (assumption).
_HOLD_UP = 0.02


def _moves_nothing(message: Any) -> bool:
    """True for a frame that reads, or tells how to communicate: a hundred such set up a node."""
    data = message.data
    if message.arbitration_id not in _REQUESTS or len(data) < 4:
        return False
    return data[0] == _UPLOAD or data[1] | data[2] << 8 in _COMMUNICATION_OBJECTS


class Cia402Nodes:
    """Drives between a bus and the wires of one part of a simulated machine.

    | wire | size | unit | meaning |
    |---|---|---|---|
    | to the machine `<part>.velocity_command` | n | rad/s or m/s | 0 for an axis without power |
    | to the machine `<part>.position_command` | n | rad or m | in its place: see `Cia402Node` |
    | to the machine `<part>.force_command`, `<part>.torque_command` | n | N or N m | ditto |
    | to the machine `<part>.brake` | 1 | - | 1 unless an axis is enabled; if the machine has it |
    | to the machine `<locks>.command` | k | - | of each group of switches; 0: its output is on |
    | from the machine `<part>.position` | n | rad or m | |
    | from the machine `<part>.velocity` | n | rad/s or m/s | |
    | from the machine `<part>.current` | n | A | if the machine has it; not of commanded forces |
    | from the machine `<part>.emergency_stop` | 1 | 0/1 | 1: pressed; if the machine has it |
    | from the machine `<locks>.closed` | k | 0/1 | of each group of switches; 1: voltage |
    | from the machine `supply` | 1 | 0/1 | 0: the motors have none; if the machine has it |

    A pressed emergency stop opens its contact, which otherwise puts voltage to a digital input
    of one node, and cuts the motors' supply of all nodes, not that of their electronics.

    The nodes are on a bus of python-can's interface `virtual`, which this process shares; with
    `link`, an emulated serial adapter brings it to other processes. Entering the context switches
    them on: they count from where the axes are then.

    Nodes that are `off` say nothing but still hear; nodes that are `unplugged` hear nothing
    either, and stop the axes when they miss the master's heartbeat.

    Attributes:
        nodes: the nodes.
        adapter: emulated serial adapter, or None.
        is_stop_wire_broken: true if the wire of the emergency stop's contact is broken.
        broken_wires: switches, as a group's part and a number from 0, whose contact's wire is
            broken.
    """

    def __init__(
        self,
        harness: Harness,
        node_ids: Sequence[int] = (1, 2, 3, 4),
        channel: str = "cia402",
        link: Path | str | None = None,
        misbehaviour: Misbehaviour | None = None,
        motor: EmulatedMotor = EmulatedMotor(),
        part: str = "wheels",
        signs: Sequence[int] = (),
        measures_current: bool = False,
        clock: Callable[[], float] = monotonic,
        stop_contact: tuple[int, int] | None = None,
        hold_up: float = _HOLD_UP,
        switches: Sequence[SwitchGroup] = (),
    ):
        """Prepares the nodes; they answer within a `with` block.

        Args:
            harness: the wires.
            node_ids: addresses, in the order of the axes.
            channel: channel of the interface `virtual`.
            link: path for a symbolic link to the adapter's port; None: no adapter.
            misbehaviour: faults of the devices.
            motor: motor that each of them drives.
            part: part of the machine.
            signs: signs of the motors, in place of the `motor`'s; empty: none.
            measures_current: true if the machine has the wire `current`; else it is zero.
            clock: monotonic [s].
            stop_contact: address of the node, and number of its digital input, at which the
                contact of the emergency stop is; None: nowhere.
            hold_up: time for which the drives are fed when their supply has been cut [s].
            switches: locks and clamps at digital outputs and inputs.
        """
        self._stop_contact, self._hold_up = stop_contact, hold_up
        self._cut_since: float | None = None
        self.is_stop_wire_broken = False
        self._switches = tuple(switches)
        self.broken_wires: set[tuple[str, int]] = set()
        self._harness, self._ids, self.channel = harness, tuple(node_ids), channel
        self._misbehaviour = misbehaviour or Misbehaviour()
        self._clock = clock
        self._motors = [motor._replace(sign=s) for s in signs or (motor.sign,) * len(self._ids)]
        self._part, self._measures_current = part, measures_current
        self.adapter = None if link is None else SlcanPty(channel, link, self._misbehaviour)
        self.nodes: list[Cia402Node] = []
        self._lines: list[SlaveLine] = []
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self._stopping.clear()
        with ExitStack() as stack:
            bus: Any = need("can").Bus(
                interface="virtual", channel=self.channel, ignore_config=True
            )
            stack.callback(bus.shutdown)
            self._lines = [SlaveLine(bus, self._misbehaviour, self._clock) for _ in self._ids]
            rows = zip(self._ids, self._lines, self._motors, self._get("position"), strict=True)
            self.nodes = [Cia402Node(*parts) for parts in rows]
            self._press(self._clock())
            self._touch()
            self._publish()
            thread = threading.Thread(
                target=self._run, args=(bus,), name="CiA 402 nodes", daemon=True
            )
            thread.start()
            stack.callback(thread.join)
            stack.callback(self._stopping.set)
            if self.adapter is not None:
                stack.enter_context(self.adapter)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def states(self) -> tuple[DriveState, ...]:
        """States of the drives."""
        return tuple(node.state for node in self.nodes)

    def trip(self, node_id: int, code: int) -> None:
        """Makes a drive fail.

        Args:
            node_id: its address.
            code: code of the error.
        """
        with self._lock:
            self._node(node_id).trip(code)

    def disconnect(self, node_id: int) -> None:
        """Takes a node off the bus: it hears and says nothing any more.

        Args:
            node_id: its address.
        """
        self._lines[self._ids.index(node_id)].is_connected = False

    def _run(self, bus: Any) -> None:
        tick = -math.inf
        while not self._stopping.is_set():
            message = bus.recv(computer_time(clamp(tick - self._clock(), 0.0, _TICK)))
            with self._lock:
                self._measure()
                # All that has come, before anybody misses a heartbeat among it.
                is_due = message is None
                while message is not None:
                    is_due = is_due or not _moves_nothing(message)
                    self._receive(message)
                    message = bus.recv(0.0)
                now = self._clock()
                if not is_due and now < tick:
                    continue
                tick = now + _TICK
                self._press(now)
                self._touch()
                for line, node in zip(self._lines, self.nodes, strict=True):
                    line.step(now)
                    node.step(now)
                self._publish()

    def _receive(self, message: Any) -> None:
        if self._misbehaviour.is_unplugged:
            return
        now = self._clock()
        is_heartbeat = message.arbitration_id >= HEARTBEAT_BASE
        for line, node in zip(self._lines, self.nodes, strict=True):
            if is_heartbeat and line.is_connected:
                node.hear(message.arbitration_id, now)
            # A frame of the wrong length or to an unknown entry: real nodes ignore it, too.
            with suppress(Exception):
                line.receive(message)

    def _press(self, now: float) -> None:
        """Puts to the nodes what the emergency stop does, or a supply that is lost."""
        name = f"{self._part}.{EMERGENCY_STOP}"
        is_pressed = name in self._harness and self._harness.get(name)[0] > 0.5
        if is_supplied(self._harness) and not is_pressed:
            self._cut_since = None
        elif self._cut_since is None:
            self._cut_since = now
        is_fed = self._cut_since is None or now - self._cut_since < self._hold_up
        for node in self.nodes:
            node.supply(is_fed)
        if self._stop_contact is not None:
            node_id, number = self._stop_contact
            is_closed = not (is_pressed or self.is_stop_wire_broken)
            self._node(node_id).connect(number, is_closed)

    def _node(self, node_id: int) -> Cia402Node:
        return self.nodes[self._ids.index(node_id)]

    def _touch(self) -> None:
        """Puts the contacts of switches to the nodes."""
        for group in self._switches:
            closed = self._harness.get(group.measure)
            for i, (node_id, _, number) in enumerate(group.switches):
                is_whole = (group.part, i) not in self.broken_wires
                self._node(node_id).connect(number, is_whole and closed[i] > 0.5)

    def _measure(self) -> None:
        n = len(self.nodes)
        true = (*self._get("position"), *self._get("velocity"), *self._current())
        shown_values = self._misbehaviour.shown(true, self._clock())
        shown_values = tuple(value if math.isfinite(value) else 0.0 for value in shown_values)
        for i, node in enumerate(self.nodes):
            node.measured = MeasuredMotor(*shown_values[i::n])

    def _current(self) -> tuple[float, ...]:
        return self._get("current") if self._measures_current else (0.0,) * len(self.nodes)

    def _publish(self) -> None:
        for signal, what in _COMMANDS.items():
            if f"{self._part}.{signal}" in self._harness:
                self._set(signal, [getattr(node, what) for node in self.nodes])
        switching = {node_id for group in self._switches for node_id, *_ in group.switches}
        outputs = {node_id: self._node(node_id).outputs for node_id in switching}
        for group in self._switches:
            are_on = [outputs[node_id][k - 1] for node_id, k, _ in group.switches]
            self._harness.set(group.command, [0.0 if is_on else 1.0 for is_on in are_on])
        is_enabled = any(node.state is DriveState.OPERATION_ENABLED for node in self.nodes)
        if f"{self._part}.brake" in self._harness:
            self._set("brake", [0.0 if is_enabled else 1.0])

    def _get(self, signal: str) -> tuple[float, ...]:
        return self._harness.get(f"{self._part}.{signal}")

    def _set(self, signal: str, values: Sequence[float]) -> None:
        self._harness.set(f"{self._part}.{signal}", values)
