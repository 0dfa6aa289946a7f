"""Wheel drives: Maxon motors on EPOS2 24/5 positioning controllers on a CANopen bus."""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from parapod.systems.hardware import epos2_objects as objects
from parapod.systems.hardware.canopen_bus import CanopenBus
from parapod.systems.hardware.device import Device, DeviceError, DeviceFault, Signals
from parapod.systems.hardware.ds402 import Controlword
from parapod.systems.hardware.epos2_controller import Epos2Controller, Sample
from parapod.systems.hardware.epos2_setup import Epos2Params, unwrapped

# How often wheels that should stop are looked at [s].
_POLL = 0.002
# A motor that is slower stands still [rpm]: two counts per millisecond of a 500-pulse encoder.
_STANDSTILL = 60


class Epos2(Device):
    """Velocity-controlled wheels, one controller (node) each, in profile velocity mode.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | measure `position` | n | rad | of the wheels, as the controllers count since power-on |
    | measure `velocity` | n | rad/s | of the wheels |
    | command `velocity_command` | n | rad/s | of the wheels |
    | command `brake` | 1 | - | above 0.5: stop and hold |

    The brake is the drives' quick stop: they stop on a steeper ramp than a command of zero has,
    hold the wheels with power, and ignore velocities until `brake` falls, whatever goes wrong on
    this side. The position goes on counting, so a release needs no homing. Without power, after
    `deactivate` or a fault, nothing holds the wheels but the gear's friction.

    This computer's heartbeat guards the wheels from `activate` to `deactivate`: controllers that
    miss it for `heartbeat_timeout` stop the wheels and go to a fault. The calls of this class
    send it, no thread of its own: it must not outlive a thread that hangs. Without power there is
    nothing to guard, and pauses of any length are harmless.
    """

    def __init__(
        self, params: Epos2Params = Epos2Params(), clock: Callable[[], float] = time.monotonic
    ):
        """Describes the wheels; nothing is opened.

        Args:
            params: of the drives and of the bus.
            clock: monotonic [s].
        """
        self._params, self._clock = params, clock
        self.name = params.name
        wheels = len(params.node_ids)
        self.measures = {"position": wheels, "velocity": wheels}
        self.commands = {"velocity_command": wheels, "brake": 1}
        self._bus: CanopenBus | None = None
        self._controllers: list[Epos2Controller] = []
        self._is_active = self._is_braked = False
        self._beaten = -math.inf
        self._counts: list[int | None] = []

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
        try:
            bus.open(params.bus_options)
            bus.listen(self._report_ids)
            for controller in self._controllers:
                controller.identify()
            for controller in self._controllers:
                controller.set_up()
            self.read()
        except BaseException:
            self.close()
            raise

    def activate(self) -> None:
        """Enables the drives at zero velocity; the wheels are held from here on.

        A fault for want of heartbeats is reset, since it tells of this computer's past and not
        of the drive's health.

        Raises:
            DeviceError: a node is silent, refuses, or has another fault.
        """
        self._open_bus()
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
        """Positions and velocities of the wheels at the SYNC that this sends.

        Raises:
            DeviceError: a node has a fault or has lost its power, is silent, or sends rubbish.
        """
        self._beat()
        samples = self._samples()
        for controller, sample in zip(self._controllers, samples, strict=True):
            controller.check(sample, self._is_active)
        pairs = zip(samples, self._counts, strict=True)
        counts = [unwrapped(sample.counts, previous) for sample, previous in pairs]
        self._counts = [*counts]
        return {
            "position": [self._params.angle(count) for count in counts],
            "velocity": [self._params.velocity(sample.rpm) for sample in samples],
        }

    def write(self, commands: Signals) -> None:
        """Commands the wheels; without power, nothing.

        Raises:
            DeviceError: the bus is gone.
        """
        self._is_braked = commands["brake"][0] > 0.5
        self._command([self._params.rpm(v) for v in commands["velocity_command"]])

    def neutral(self) -> None:
        """Commands zero velocity; the brake stays as it is.

        Raises:
            DeviceError: the bus is gone.
        """
        self._command([0] * len(self._params.node_ids))

    def deactivate(self) -> None:
        """Stops the wheels quickly, waits until they stand, and takes the power away.

        It takes as long as the wheels take to stop, `Epos2Params.stopping_time` at most.

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
        """Stops the wheels, takes their power and closes the bus; never raises."""
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
            bus.send(objects.HEARTBEAT_BASE + self._params.master_id, b"\x05")  # operational
            self._beaten = now

    def _samples(self) -> list[Sample]:
        if not self._params.is_synchronous:
            return [controller.poll() for controller in self._controllers]
        frames = self._open_bus().synchronise(self._report_ids, self._params.timeout)
        return [controller.sample(frames) for controller in self._controllers]

    def _command(self, rpm: Sequence[int]) -> None:
        """Sends velocities to drives that have power."""
        self._beat()
        if not self._is_active:
            self._send(Controlword.DISABLE_VOLTAGE)
        elif self._is_braked:
            self._send(Controlword.QUICK_STOP)
        else:
            self._send(Controlword.ENABLE_OPERATION, rpm)

    def _send(self, word: Controlword, rpm: Sequence[int] | None = None) -> None:
        targets = [0] * len(self._controllers) if rpm is None else rpm
        for controller, target in zip(self._controllers, targets, strict=True):
            controller.command(word, target)

    def _wait_for_standstill(self) -> None:
        deadline = self._clock() + self._params.stopping_time
        while self._clock() < deadline:
            self._beat()
            if all(abs(sample.rpm) <= _STANDSTILL for sample in self._samples()):
                return
            time.sleep(_POLL)
