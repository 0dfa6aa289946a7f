"""Velocity-controlled axes: Maxon motors on EPOS2 24/5 controllers on a CANopen bus."""

import math
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from parapod.systems.hardware.canopen import (
    HEARTBEAT_BASE,
    HEARTBEAT_CONSUMED,
    NMT_PRE_OPERATIONAL,
    NMT_START,
    CanopenBus,
    Entry,
)
from parapod.systems.hardware.device import DeviceError, DeviceFault, Signals
from parapod.systems.hardware.ds402 import (
    FAULT_RESET,
    Controlword,
    DriveState,
    is_energised,
    state_of,
    steps_to_operation,
)
from parapod.systems.hardware.epos2 import objects
from parapod.systems.hardware.epos2.settings import Epos2Params, settings, unwrapped
from parapod.systems.hardware.position_memory import IncrementalDevice

# Polling period while waiting for a state or a standstill [s].
_POLL = 0.002


class Sample(NamedTuple):
    """What a controller says of its motor.

    Attributes:
        state: of the drive; None if the statusword has none of CiA 402's patterns.
        counts: position of the motor.
        rpm: velocity of the motor.
        milliamperes: current of the motor; 0 if it is not measured.
    """

    state: DriveState | None
    counts: int
    rpm: int
    milliamperes: int = 0


class Epos2Controller:
    """A node, as `Epos2` uses it; all methods raise DeviceError and name the node."""

    def __init__(
        self,
        bus: CanopenBus,
        node_id: int,
        params: Epos2Params,
        beat: Callable[[], None],
        clock: Callable[[], float],
    ):
        """Describes a node.

        Args:
            bus: that it is on.
            node_id: its address.
            params: of the drives.
            beat: sends the heartbeat if it is time.
            clock: monotonic [s].
        """
        self._bus, self._id, self._params = bus, node_id, params
        self._beat, self._clock = beat, clock

    @property
    def report_ids(self) -> list[int]:
        """Identifiers of the frames that answer SYNC."""
        return [pdo.base + self._id for pdo in self._params.reports]

    def identify(self) -> None:
        """Makes sure that the node is what it should be."""
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

    def set_up(self) -> None:
        """Takes the power, resets a fault, writes all settings and starts the node."""
        self._set(objects.CONTROLWORD, Controlword.DISABLE_VOLTAGE)
        self.guard(False)
        counts = 4 * self._get(objects.ENCODER_PULSES)
        if counts != self._params.counts_per_turn:
            words = f"is set up for {counts} counts per turn, not {self._params.counts_per_turn}"
            raise self._error(words)
        if self._state() is not DriveState.SWITCH_ON_DISABLED:
            self._reset()
        self._bus.manage(self._id, NMT_PRE_OPERATIONAL)
        for entry, value in settings(self._params, self._id):
            self._set(entry, value)
        self._bus.manage(self._id, NMT_START)

    def guard(self, is_guarded: bool) -> None:
        """Has the node stop its motor when this computer falls silent, or not."""
        self._set(HEARTBEAT_CONSUMED, self._params.guard if is_guarded else 0)

    def recover(self) -> None:
        """Resets a fault for want of heartbeats; refuses any other."""
        if self._state() in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            code = self._get(objects.ERROR_CODE) & 0xFFFF
            if code != objects.HEARTBEAT_LOST:
                raise self._faulty(code)
            self.guard(False)
            self._reset()
        # Nodes may leave the operational state when they miss heartbeats (CiA 301, 0x1029).
        self._bus.manage(self._id, NMT_START)

    def enable(self) -> None:
        """Leads the drive to operation enabled at zero velocity, step by step."""
        self._set(objects.TARGET_VELOCITY, 0)
        state = self._state()
        try:
            steps = steps_to_operation(state or DriveState.NOT_READY_TO_SWITCH_ON)
        except ValueError as error:
            raise self._error(str(error)) from error
        for word, reached in steps:
            self._set(objects.CONTROLWORD, word)
            self._wait_for(reached)

    def command(self, word: Controlword, rpm: int) -> None:
        """Sends a controlword and a velocity of the motor [rpm]; nothing confirms them."""
        self._bus.send(objects.COMMAND.base + self._id, objects.COMMAND.pack(word, rpm))

    def poll(self) -> Sample:
        """Asks for the newest sample by service data."""
        entries = (entry for pdo in self._params.reports for entry in pdo.entries)
        statusword, *rest = (self._get(entry) for entry in entries)
        return Sample(state_of(statusword), *rest)

    def sample(self, frames: Mapping[int, bytes]) -> Sample:
        """The sample that the node's frames carry."""
        try:
            status, motion = (
                pdo.unpack(frames[pdo.base + self._id]) for pdo in self._params.reports
            )
        except KeyError:
            code = self._bus.emergency(self._id)
            if code is not None:
                raise self._faulty(code) from None
            words = f"does not answer SYNC in {self._params.timeout:g} s"
            raise self._error(words, DeviceFault.SILENT) from None
        except struct.error as error:
            raise self._error(
                f"sends frames of wrong length: {error}", DeviceFault.CORRUPT
            ) from None
        statusword, counts = status
        return Sample(state_of(statusword), counts, *motion)

    def check(self, sample: Sample, is_active: bool) -> None:
        """Refuses what a drive measures that does not do what it should."""
        if sample.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            raise self._faulty(self._bus.emergency(self._id))
        if is_active and not is_energised(sample.state):
            raise self._error(f"has lost its power, it is in {sample.state or 'no known state'}")

    def _reset(self) -> None:
        """Resets a fault once the drive has finished its reaction to it."""
        deadline = self._clock() + self._params.stopping_time
        while self._state() is DriveState.FAULT_REACTION_ACTIVE and self._clock() < deadline:
            time.sleep(_POLL)
        for word in FAULT_RESET:
            self._set(objects.CONTROLWORD, word)
        self._wait_for(DriveState.SWITCH_ON_DISABLED)

    def _wait_for(self, wanted: DriveState) -> None:
        deadline = self._clock() + self._params.state_timeout
        while (state := self._state()) is not wanted:
            if self._clock() > deadline:
                code = self._bus.emergency(self._id)
                words = f", {objects.described(code)}" if code else ""
                raise self._error(f"is in {state or 'no known state'}, not in {wanted}{words}")
            time.sleep(_POLL)

    def _state(self) -> DriveState | None:
        return state_of(self._get(objects.STATUSWORD))

    def _get(self, entry: Entry) -> int:
        self._beat()
        return self._bus.get(self._id, entry)

    def _set(self, entry: Entry, value: int) -> None:
        self._beat()
        self._bus.set(self._id, entry, value)

    def _faulty(self, code: int | None) -> DeviceError:
        words = "no EMCY was seen" if code is None else objects.described(code)
        return self._error(f"is in fault: {words}")

    def _error(self, words: str, fault: DeviceFault = DeviceFault.FAILED) -> DeviceError:
        return DeviceError(self._params.name, f"node {self._id} {words}", fault)


# A motor that is slower stands still [rpm]: two counts per millisecond of a 500-pulse encoder.
_STANDSTILL = 60


class Epos2(IncrementalDevice):
    """Velocity-controlled axes, one controller (node) each, in profile velocity mode.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | measure `position` | n | rad or m | of the axes, as the controllers count since power-on |
    | measure `velocity` | n | rad/s or m/s | of the axes |
    | measure `current` | n | A | of the motors, positive where they push; if it is asked for |
    | command `velocity_command` | n | rad/s or m/s | of the axes |
    | command `brake` | 1 | - | above 0.5: stop and hold |

    The brake is the drives' quick stop: they stop on a steeper ramp than a command of zero has,
    hold the axes with power, and ignore velocities until `brake` falls, whatever goes wrong on
    this side. The position goes on counting, so a release needs no homing. Without power, after
    `deactivate` or a fault, nothing holds the axes but the friction of gear and screw.

    **Reference.** The controllers count from zero since their power-on. `position` is absolute
    when the parameters say where the axes are at `configure`, or after `set_reference`.

    **Limits.** With limits nothing moves before there is a reference, and no command, however
    wild, drives an axis out of them: see `SoftLimits`. They are kept at every command and at
    every reading, so also between two commands of a controller that hangs. Axes whose position
    has not been measured for the limits' `lead` are commanded zero, all of them if one node is
    silent or has a fault.

    This computer's heartbeat guards the axes from `activate` to `deactivate`: controllers that
    miss it for `heartbeat_timeout` stop the axes and go to a fault. The calls of this class
    send it, no thread of its own: it must not outlive a thread that hangs. Without power there is
    nothing to guard, and pauses of any length are harmless.
    """

    position_signal = "position"

    def __init__(
        self, params: Epos2Params = Epos2Params(), clock: Callable[[], float] = time.monotonic
    ):
        """Describes the axes; nothing is opened.

        Args:
            params: of the drives and of the bus.
            clock: monotonic [s].
        """
        self._params, self._clock = params, clock
        self.name = params.name
        axes = len(params.node_ids)
        self.measures = {"position": axes, "velocity": axes}
        if params.measures_current:
            self.measures["current"] = axes
        self.commands = {"velocity_command": axes, "brake": 1}
        self._bus: CanopenBus | None = None
        self._controllers: list[Epos2Controller] = []
        self._is_active = self._is_braked = self._is_referenced = False
        self._beaten = self._measured = -math.inf
        self._counts: list[int | None] = []
        self._offset, self._position = [0.0] * axes, [0.0] * axes
        self._wanted: Sequence[float] = (0.0,) * axes
        # Velocities of the motors that have been sent; None: another controlword has.
        self._sent: list[int | None] | None = None

    @property
    def is_referenced(self) -> bool:
        """Whether it is known which positions the counts mean."""
        return self._is_referenced

    def configure(self) -> None:
        """Opens the bus, makes sure of every controller and sets it up, without power.

        A fault from before is reset.

        Raises:
            MissingExtra: a library is not installed.
            DeviceError: a node is silent, not an EPOS2 24/5 with that encoder, or refuses.
        """
        self.close()
        params = self._params
        bus = CanopenBus(self.name, params.node_ids, params.sdo_timeout)
        self._bus = bus
        self._controllers = [
            Epos2Controller(bus, i, params, self._beat, self._clock) for i in params.node_ids
        ]
        self._counts = [None] * len(params.node_ids)
        self._offset, self._is_referenced = [0.0] * len(params.node_ids), False
        try:
            bus.open(params.bus_options)
            bus.listen(self._report_ids)
            for controller in self._controllers:
                controller.identify()
            for controller in self._controllers:
                controller.set_up()
            self.read()
            if params.position_at_start is not None:
                self.set_reference(params.position_at_start)
        except BaseException:
            self.close()
            raise

    def activate(self) -> None:
        """Enables the drives at zero velocity; the axes are held from here on.

        A fault for want of heartbeats is reset, since it tells of this computer's past and not
        of the drive's health.

        Raises:
            DeviceError: a node is silent, refuses, or has another fault; or there are limits,
                and nobody knows the positions.
        """
        self._open_bus()
        if self._params.limits is not None and not self._is_referenced:
            raise DeviceError(self.name, "nobody knows the positions, and there are limits")
        for controller in self._controllers:
            controller.recover()
        self._is_active, self._is_braked = True, False
        try:
            for controller in self._controllers:
                controller.guard(True)
            # A heartbeat is missed only after a first one (CiA 301): no power before that.
            self._beaten = -math.inf
            self._beat()
            for controller in self._controllers:
                controller.enable()
        except BaseException:
            with suppress(DeviceError):
                self.deactivate()
            raise

    def read(self) -> Signals:
        """What the drives measured at the SYNC that this sends.

        Raises:
            DeviceError: a node has a fault or has lost its power, is silent, or sends rubbish.
        """
        self._beat()
        began = self._clock()
        try:
            samples = self._samples()
            for controller, sample in zip(self._controllers, samples, strict=True):
                controller.check(sample, self._is_active)
        except DeviceError:
            with suppress(DeviceError):
                self._restrain()
            raise
        self._position = self._counted(samples)
        self._measured = began
        self._restrain()
        params = self._params
        directed = list(zip(samples, params.directions, strict=True))
        signals = {
            "position": self._position,
            "velocity": [sign * params.velocity(sample.rpm) for sample, sign in directed],
        }
        if params.measures_current:
            signals["current"] = [1e-3 * sign * sample.milliamperes for sample, sign in directed]
        return signals

    def write(self, commands: Signals) -> None:
        """Commands the axes; without power, nothing.

        Raises:
            DeviceError: the bus is gone.
        """
        self._is_braked = commands["brake"][0] > 0.5
        self._command(commands["velocity_command"])

    def neutral(self) -> None:
        """Commands zero velocity; the brake stays as it is.

        Raises:
            DeviceError: the bus is gone.
        """
        self._command((0.0,) * len(self._params.node_ids))

    def deactivate(self) -> None:
        """Stops the axes quickly, waits until they stand, and takes the power away.

        It takes as long as the axes take to stop, `Epos2Params.stopping_time` at most.

        Raises:
            DeviceError: a node is silent; the others have obeyed.
        """
        if self._bus is None:
            return
        was_active = self._is_active
        try:
            if was_active:
                self._send(Controlword.QUICK_STOP)
                self._wait_for_standstill()
        finally:
            self._is_active = False
            self._send(Controlword.DISABLE_VOLTAGE)
        if was_active:
            for controller in self._controllers:
                controller.guard(False)

    def close(self) -> None:
        """Stops the axes, takes their power and closes the bus; never raises."""
        with suppress(Exception):
            self.deactivate()
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _open_bus(self) -> CanopenBus:
        if self._bus is None:
            raise DeviceError(self.name, "not configured", DeviceFault.UNPLUGGED)
        return self._bus

    @property
    def _report_ids(self) -> list[int]:
        return [can_id for controller in self._controllers for can_id in controller.report_ids]

    def _beat(self) -> None:
        """Sends this computer's heartbeat if the last one is old enough."""
        bus, now = self._open_bus(), self._clock()
        if now - self._beaten >= self._params.heartbeat_period:
            bus.send(HEARTBEAT_BASE + self._params.master_id, b"\x05")  # operational
            self._beaten = now

    def _samples(self) -> list[Sample]:
        if not self._params.is_synchronous:
            return [controller.poll() for controller in self._controllers]
        frames = self._open_bus().synchronise(self._report_ids, self._params.timeout)
        return [controller.sample(frames) for controller in self._controllers]

    def _set_reference(self, values: Sequence[float]) -> None:
        self._offset = [0.0] * len(values)
        counted = self._counted(self._samples())
        self._offset = [value - since for value, since in zip(values, counted, strict=True)]
        self._position = [*values]  # the limits are kept from now on
        self._is_referenced = True

    def _counted(self, samples: Sequence[Sample]) -> list[float]:
        """Positions of the axes, with their reference if there is one."""
        pairs = zip(samples, self._counts, strict=True)
        counts = [unwrapped(sample.counts, previous) for sample, previous in pairs]
        self._counts = [*counts]
        params = self._params
        axes = zip(counts, params.directions, self._offset, strict=True)
        return [offset + sign * params.position(count) for count, sign, offset in axes]

    def _command(self, velocities: Sequence[float]) -> None:
        """Sends velocities to drives that have power."""
        self._beat()
        self._wanted = velocities
        if not self._is_active:
            self._send(Controlword.DISABLE_VOLTAGE)
        elif self._is_braked:
            self._send(Controlword.QUICK_STOP)
        else:
            self._send(Controlword.ENABLE_OPERATION, self._targets())

    def _restrain(self) -> None:
        """Slows down axes that have come closer to a limit since they were commanded."""
        if self._params.limits is None or self._sent is None:
            return
        targets = self._targets()
        for i, (controller, target) in enumerate(zip(self._controllers, targets, strict=True)):
            if target != self._sent[i]:
                controller.command(Controlword.ENABLE_OPERATION, target)
                self._sent[i] = target

    def _targets(self) -> list[int]:
        """Velocities of the motors [rpm] for those that are wanted of the axes."""
        params, velocities = self._params, self._wanted
        if (limits := params.limits) is not None:
            is_known = self._clock() - self._measured <= limits.lead
            allowed = limits.allowed(velocities, self._position)
            velocities = allowed if is_known else [0.0] * len(allowed)
        pairs = zip(velocities, params.directions, strict=True)
        return [sign * params.rpm(velocity) for velocity, sign in pairs]

    def _send(self, word: Controlword, rpm: Sequence[int] = ()) -> None:
        """Sends a controlword to all drives, with velocities if it lets them move."""
        self._sent = None if not rpm else [None] * len(rpm)
        for i, controller in enumerate(self._controllers):
            controller.command(word, rpm[i] if rpm else 0)
            if self._sent is not None:
                self._sent[i] = rpm[i]

    def _wait_for_standstill(self) -> None:
        deadline = self._clock() + self._params.stopping_time
        while self._clock() < deadline:
            self._beat()
            if all(abs(sample.rpm) <= _STANDSTILL for sample in self._samples()):
                return
            time.sleep(_POLL)
