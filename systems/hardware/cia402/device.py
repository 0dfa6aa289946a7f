"""Axes on CiA 402 drives on a CANopen bus, whatever is commanded of them."""

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress

from parapod.systems.core.switching import switched
from parapod.systems.hardware.canopen import CanopenBus, wrapped
from parapod.systems.hardware.cia402.controller import (
    POLL,
    STANDSTILL,
    Bus,
    Cia402Controller,
    Sample,
    Timing,
    stopping_time,
)
from parapod.systems.hardware.cia402.set_up import check
from parapod.systems.hardware.cia402.settings import AxesSettings
from parapod.systems.hardware.cia402.states import Controlword, DriveState
from parapod.systems.hardware.cia402.switches import SwitchBoard
from parapod.systems.hardware.clock import monotonic, sleep
from parapod.systems.hardware.device import DeviceError, DeviceFault, Signals
from parapod.systems.hardware.ethercat import EthercatBus
from parapod.systems.hardware.position_memory import IncrementalDevice

# Longest time until a drive leaves a quick stop of this program [s].
_OBEYING = 0.05
_RELEASED = (0.0,)  # brake of axes that are not commanded to brake
# Longest time that counts between two commands [s]: two periods at 100 Hz. After a longer pause an
# axis goes on from where it is, and makes up for nothing.
LONGEST = 0.02
# Longest time until a drive has found its home by itself [s]; a long screw takes its time.
_HOMING = 120.0
# Silences of a node while axes stop after which that is an error.
_SILENCES = 2
# Time for which nodes are asked whether their power is gone, once one of them was silent [s].
_CONFIRMING = 0.3


class Cia402Device(IncrementalDevice):
    """Axes, one controller (node) each, and locks and clamps at the controllers' digital outputs.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | measure `position` | n | rad or m | of the axes, as the controllers count since power-on |
    | measure `velocity` | n | rad/s or m/s | of the axes |
    | measure `current` | n | A | of the motors, positive where they push; if it is asked for |
    | measure `emergency_stop` | 1 | 0/1 | 1: pressed, or its wire is broken; with `stop_node` |
    | measure `<part>.closed` | k | 0/1 | 1: the contact of a lock or clamp says closed |
    | command `brake` | 1 | - | 0: released; all else: stop and hold; with `has_brake` |
    | command `<part>.command` | k | - | of locks or clamps; 0: open, 1: closed |

    What else is commanded, a mode of operation says: `Cia402Velocities`, `Cia402Positions` and
    `Cia402Forces`, whose axes nothing holds.

    The brake is the drives' quick stop: they stop on a ramp of its own, which is steeper than that
    of a command, hold the axes with power, and ignore set values until `brake` falls, whatever
    goes wrong on this side. The position goes on counting, so a release needs no homing. Without
    power, after `deactivate` or a fault, nothing holds the axes but the friction of gear and
    screw. For `Cia402Forces`, which have no such ramp, it is another.

    **Switches.** Locks and clamps are closed by springs and opened by power. `configure` closes
    all, once no axis has power. From `activate` to `deactivate` each is as it is commanded, also
    while axes are braked. While the emergency stop or a failure keeps the axes stopped none is
    opened. One that closes while something moves breaks. So `neutral` neither opens nor closes
    any; a command that is near neither 0 nor 1, such as NaN, brakes all axes, and closes its
    switch once they stand; and the end stops the axes first and then closes all. A contact
    without voltage says "not closed", also one with a broken wire.

    **Emergency stop.** A contact of it, closed while it is not pressed, is at a digital input of
    `stop_node`, whose status frame carries it. While it is open all drives have a quick stop,
    whatever is commanded. After its release they keep it until a `brake` of 1 has been
    commanded, or `activate` called: nothing moves on by itself. Drives that then stop by
    themselves, or lose their motors' supply, are not errors while it is pressed: readings go on.
    Without power none is an error for want of its supply. `activate` refuses a pressed one.

    **One for all.** Where axes share a load (`stops_together`), one that fails, loses its power
    or stops by itself has all others stop quickly at the reading that tells it, and stay so as
    after an emergency stop. For a node that is silent see "Limits" of `Cia402Velocities`, and
    "Silence" of `Cia402Positions` and of `Cia402Forces`.

    **Reference.** The controllers count from zero since their power-on. `position` is absolute
    when the settings say where the axes are at `configure`, or after `set_reference`. Where there
    are limits, nothing gets power before. While an axis looks for its end (`seek_reference`) there
    are no limits, and its motor's current is that of `homing_current_a` at most. With a
    `homing_method` it is the drives that look, one after another, when `activate` is called then:
    by their own method, with switches at their own inputs, and the positions are known after it.

    **Guard.** This computer's heartbeat guards the axes from `activate` to `deactivate`:
    controllers that miss it for the settings' `heartbeat_timeout_ms` stop the axes by a quick stop
    and go to a fault. With the time for the quick stop that should be less than 0.2 s. The calls
    of this class send the heartbeat, no thread of its own: it must not outlive a thread that
    hangs. Without power there is nothing to guard, and pauses of any length are harmless.
    """

    position_signal = "position"

    # Whether drives that are stopped hold the axes, with power, and the command that stops them:
    # on a ramp, or by taking the power of those that have none.
    _holds, _braking = True, Controlword.QUICK_STOP

    def __init__(
        self,
        settings: AxesSettings,
        timing: Timing = Timing(),
        is_synchronous: bool = True,
        clock: Callable[[], float] = monotonic,
    ):
        """Describes the axes; nothing is opened.

        Args:
            settings: settings of the drives and of the bus.
            timing: times of bus and drives.
            is_synchronous: reads by SYNC and process data, 2 frames per node; otherwise by
                service data, 6 frames per node one after another and 2 more for the current, for
                buses on which others send SYNC.
            clock: monotonic [s].

        Raises:
            ValueError: settings that do not fit together.
        """
        check(settings, timing.heartbeat_period)
        self._timing, self._clock, self._is_synchronous = timing, clock, is_synchronous
        self._directions = settings.directions
        self._switches = SwitchBoard(settings.switches)
        self.name, self.place = settings.name, settings.place
        within = f"{settings.heartbeat_timeout + stopping_time(settings, timing):.2g} s"
        self.watchdog = f"without this computer's heartbeats the drives stop within {within}"
        axes = len(settings.node_ids)
        super().__init__(settings.positions_path, axes, settings.part)
        current = {"current": axes} if settings.measures_current else {}
        stop = {} if settings.stop_node is None else {"emergency_stop": 1}
        motion = {"position": axes, "velocity": axes}
        self.measures = motion | current | stop | self._switches.measures
        self.command_signal = settings.command_signal
        brake = {"brake": 1} if settings.has_brake else {}
        self.commands = {self.command_signal: axes} | brake | self._switches.commands
        self.fail_safe = (*brake, *self._switches.commands)
        self._bus: Bus | None = None
        self._controllers: list[Cia402Controller] = []
        self._report_ids: list[int] = []
        # Controller at which the emergency stop's contact is.
        self._stop_controller: Cia402Controller | None = None
        self._is_active = self._is_braked = self._is_referenced = False
        self._may_have_power = False
        # Whether all axes stood at the newest reading.
        self._stands = False
        # Whether the emergency stop is pressed, and whether it or a failure keeps the axes braked.
        self._is_pressed = self._is_stopped = False
        self._beaten = self._measured = -math.inf
        self._counts: list[int | None] = []
        self._offset, self._position, self._velocity = ([0.0] * axes for _ in range(3))
        # The controlword that was sent last, and since when.
        self._word, self._worded = Controlword.DISABLE_VOLTAGE, -math.inf
        # The newest command; None: the axes are to stay where they are.
        self._wanted: Sequence[float] | None = None
        # Whether the axes have limits, so that they need a reference.
        self._has_limits = False
        self._adopt(settings)

    def _adopt(self, settings: AxesSettings) -> None:
        """Goes by these settings from now on; while axes look for their ends without limits."""
        self._settings = settings

    @property
    def is_referenced(self) -> bool:
        """Whether it is known which positions the counts mean."""
        return self._is_referenced

    def seek_reference(self) -> None:
        """See `IncrementalDevice`; with little force, and without limits."""
        super().seek_reference()
        self._adopt(self._settings.seeking)

    def _open(self) -> None:
        """Opens the bus, makes sure of every controller and sets it up, without power.

        A fault from before is reset, and reported in `remarks`.

        Raises:
            MissingExtra: a library is not installed.
            DeviceError: a node is silent, not a drive of that maker with that encoder, or refuses.
        """
        self.close()
        settings = self._settings
        names = settings.axis_names or ("",) * len(settings.node_ids)
        kind = EthercatBus if settings.interface == "ethercat" else CanopenBus
        bus: Bus = kind(self.name, settings.node_ids, self._timing.sdo_timeout)
        self._bus = bus
        self._controllers = [
            Cia402Controller(bus, i, settings, self._timing, self._beat, self._clock, axis)
            for i, axis in zip(settings.node_ids, names, strict=True)
        ]
        self._report_ids = [can_id for each in self._controllers for can_id in each.report_ids]
        at_stop = (each for each in self._controllers if each.id == settings.stop_node)
        self._stop_controller = next(at_stop, None)
        self.remarks, self._is_pressed, self._is_stopped = (), False, False
        self._switches.close_all()
        self._counts = [None] * len(settings.node_ids)
        self._offset, self._is_referenced = [0.0] * len(settings.node_ids), False
        try:
            bus.open(settings.bus_options)
            bus.listen(self._report_ids)
            for controller in self._controllers:
                controller.identify()
            self.remarks = together({each.name: each.set_up() for each in self._controllers})
            for controller in self._controllers:  # no axis has power any more
                controller.set_up_outputs()
            self.read()
            if settings.position_at_start is not None:
                self.set_reference(settings.position_at_start)
        except BaseException:
            self.close()
            raise

    def _energise(self) -> None:
        """Enables the drives at rest; the axes are held from here on.

        A fault for want of heartbeats, or of a supply that is there again, is reset, since it
        tells of this computer's past, or the emergency stop's, and not of the drive's health.

        Raises:
            DeviceError: a node is silent, refuses, or has another fault; or there are limits,
                and the positions are not known; or the emergency stop is pressed.
        """
        self._open_bus()
        if self._has_limits and not self._is_referenced:
            raise DeviceError(self.name, "the positions are not known, and there are limits")
        if (stop := self._stop_controller) is not None:
            self._samples()
            if self._is_pressed:
                number = self._settings.stop_input
                where = f"the emergency stop at digital input {number} of {stop.name}"
                raise DeviceError(self.name, f"{where} is pressed, or its wire is broken")
        for controller in self._controllers:
            controller.recover()
        # Axes that their drives do not hold stay braked until a command says otherwise.
        self._is_active, self._is_braked, self._is_stopped = True, not self._holds, False
        word, state = Controlword.SWITCH_ON, DriveState.SWITCHED_ON
        if self._holds:
            word, state = Controlword.ENABLE_OPERATION, DriveState.OPERATION_ENABLED
        try:
            for controller in self._controllers:
                controller.guard(True)
            # A heartbeat is missed only after a first one (CiA 301): no power before that.
            self._beaten = -math.inf
            self._beat()
            settings = [controller.enable(state) for controller in self._controllers]
            self._word, self._worded, self._wanted = word, self._clock(), None
            if self._is_homing and self._settings.homing_method is not None:
                settings = self._home()
            self._begin(settings)
        except BaseException:
            with suppress(DeviceError):
                self._release()
            raise

    def _home(self) -> list[int]:
        """Has one drive after another find its home, while the others are held.

        Returns:
            Set values with which the axes then stay where they are.
        """
        positions, settings = self._settings.position_at_home or (), []
        for controller in self._controllers:
            controller.begin_homing()
            deadline = self._clock() + _HOMING
            while not controller.is_home():
                self._samples()
                if self._is_pressed:
                    raise DeviceError(self.name, "the emergency stop is pressed")
                if self._clock() > deadline:
                    text = f"{controller.name} has found no home in {_HOMING:g} s"
                    raise DeviceError(self.name, text)
                sleep(POLL)
            settings.append(controller.end_homing())
        # The counts are zero at the homes from now on.
        self._counts, self._offset = [None] * len(positions), [*positions]
        self._position = self._counted(self._samples())
        self._is_referenced = True
        return settings

    def read(self) -> Signals:
        """Measurements of the drives at the SYNC that this sends.

        Raises:
            DeviceError: a node has a fault or has lost its power, is silent, or sends rubbish.
        """
        self._beat()
        began = self._clock()
        try:
            samples = self._samples()
            self._check(samples, began)
        except DeviceError:
            with suppress(DeviceError):
                self._restrain()
            raise
        self._position = self._counted(samples)
        self._measured = began
        self._restrain()
        settings = self._settings
        signals = {"position": self._position, "velocity": self._velocity}
        if settings.measures_current:
            directed = zip(samples, self._directions, strict=True)
            signals["current"] = [1e-3 * sign * sample.milliamperes for sample, sign in directed]
        if settings.stop_node is not None:
            signals["emergency_stop"] = [float(self._is_pressed)]
        pairs = zip(self._controllers, samples, strict=True)
        inputs = {controller.id: controller.inputs(sample) for controller, sample in pairs}
        return signals | dict(self._switches.measured(inputs))

    def write(self, commands: Signals) -> None:
        """Commands the axes; without power, nothing.

        Raises:
            DeviceError: the bus is gone.
        """
        brake = switched(*commands.get("brake", _RELEASED))
        self._is_braked = brake is not False or not self._switches.is_clear(commands)
        if brake and not self._is_pressed:
            self._is_stopped = False
        self._command(commands[self.command_signal])
        if self._is_active:
            self._switches.obey(commands, not self._is_stopped, self._stands_by_now)
            self._switch()

    def neutral(self) -> None:
        """Has the axes stay where they are; brake, locks and clamps stay as they are.

        Raises:
            DeviceError: the bus is gone.
        """
        self._command(None)

    def _release(self) -> None:
        """Stops the axes quickly, waits until they stand, takes the power and confirms that.

        Then all switches are closed. It takes as long as the axes take to stop, `stopping_time` at
        most, and as the nodes take to answer.

        Raises:
            DeviceError: a node is silent, does not stop, or keeps its power; the others have
                obeyed.
        """
        if self._bus is None:
            return
        self._may_have_power |= self._is_active
        self._is_active = False
        self._switches.close_all()
        with ExitStack() as stack:
            if self._may_have_power:
                stack.callback(self._confirm_no_power)
            # Nothing is held by a motor any more when springs begin to close.
            stack.callback(self._switch)
            stack.callback(self._send, Controlword.DISABLE_VOLTAGE)
            # Otherwise nothing would slow the axes, and a brake closes only without power.
            if self._may_have_power and self._holds:
                self._come_to_rest()

    def _confirm_no_power(self) -> None:
        """Takes the power again, in a way that the nodes answer, and lets them forget us.

        It closes the switches in that way, too. Once a node was silent the others have less time
        for their answers: the machine's other devices wait for their own stop meanwhile.
        """
        bus, timing = self._open_bus(), self._timing
        deadline, first_error = self._clock() + _CONFIRMING, None
        try:
            for controller in self._controllers:
                try:
                    if first_error is None or self._clock() < deadline:
                        controller.disable()
                        controller.switch_off()
                except DeviceError as error:
                    first_error = first_error or error
                    if error.fault is DeviceFault.SILENT:
                        bus.sdo_timeout = min(timing.timeout, timing.sdo_timeout)
        finally:
            bus.sdo_timeout = timing.sdo_timeout
        if first_error is not None:
            raise first_error
        self._may_have_power = False

    def close(self) -> None:
        """Stops the axes, takes their power and closes the bus; never raises."""
        with suppress(Exception):
            self._release()
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()

    def _open_bus(self) -> Bus:
        if self._bus is None:
            raise DeviceError(self.name, "not configured", DeviceFault.UNPLUGGED)
        return self._bus

    def _beat(self) -> None:
        """Sends this computer's heartbeat if the last one is old enough."""
        bus, now = self._open_bus(), self._clock()
        if now - self._beaten >= self._timing.heartbeat_period:
            bus.beat()
            self._beaten = now

    def _samples(self) -> list[Sample]:
        """Newest sample of each node; what the emergency stop says has been obeyed already."""
        frames = None
        if self._is_synchronous:
            frames = self._open_bus().synchronise(self._report_ids, self._timing.timeout)
        if (stop := self._stop_controller) is not None:
            try:
                self._is_pressed = stop.is_stop_pressed(stop.sample(frames))
                if self._is_pressed:
                    self._stop()
            except DeviceError:  # another node may be silent, too
                if frames is None:
                    raise
        return [controller.sample(frames) for controller in self._controllers]

    def _set_reference(self, values: Sequence[float]) -> None:
        self._offset = [0.0] * len(values)
        counted = self._counted(self._samples())
        self._offset = [value - since for value, since in zip(values, counted, strict=True)]
        self._position = [*values]  # limits are kept from now on
        self._is_referenced = True

    def _counted(self, samples: Sequence[Sample]) -> list[float]:
        """Positions of the axes, with their reference if there is one."""
        self._stands = all(abs(sample.rpm) <= STANDSTILL for sample in samples)
        directed = zip(samples, self._directions, strict=True)
        self._velocity = [sign * self._settings.velocity(s.rpm) for s, sign in directed]
        pairs = zip(samples, self._counts, strict=True)
        counts = [unwrapped(sample.counts, previous) for sample, previous in pairs]
        self._counts = [*counts]
        axes = zip(counts, self._directions, self._offset, strict=True)
        return [offset + sign * self._settings.position(count) for count, sign, offset in axes]

    @property
    def _stands_by_now(self) -> bool:
        """Whether a reading since the newest controlword shows that all axes stand."""
        return self._stands and self._measured > self._worded

    def _command(self, command: Sequence[float] | None) -> None:
        """Sends set values to drives that have power; None: they stay where they are."""
        self._beat()
        self._wanted = command
        is_dropped = command is None and not self._holds
        if not self._is_active:
            self._send(Controlword.DISABLE_VOLTAGE)
        elif self._is_braked or self._is_stopped or not self._may_run() or is_dropped:
            self._send(self._braking)
        else:
            self._run()

    def _switch(self) -> None:
        """Sends the nodes what their digital outputs are to be."""
        for controller in self._controllers:
            controller.switch(self._switches.outputs_on(controller.id))

    @abstractmethod
    def _run(self) -> None:
        """Sends set values to drives that may run."""

    def _begin(self, settings: Sequence[int]) -> None:
        """Takes note of set values with which the drives have been enabled."""

    def _restrain(self) -> None:
        """Has axes slow down where the newest measurement calls for it."""

    def _may_run(self) -> bool:
        """Whether drives that nothing keeps stopped may run again."""
        return True

    def _check(self, samples: Sequence[Sample], now: float) -> None:
        """Refuses drives that do not obey; the others may have to stop for them.

        Raises:
            DeviceError: names the first of them.
        """
        is_told = self._is_active and self._word is Controlword.ENABLE_OPERATION
        is_running = is_told and now - self._worded > _OBEYING
        has_power = self._is_active if self._holds else is_running
        try:
            for controller, sample in zip(self._controllers, samples, strict=True):
                controller.check(sample, self._is_active, is_running, self._is_pressed, has_power)
        except DeviceError:
            if self._settings.stops_together:
                self._stop()
            raise

    def _stop(self) -> None:
        """Has all drives stop quickly, and stay so until the brake has been commanded."""
        if self._is_active and not self._is_stopped:
            self._is_stopped = True
            self._send(self._braking)

    def _send(
        self, word: Controlword, settings: Sequence[int] = (), offsets: Sequence[int] = ()
    ) -> None:
        """Sends a controlword to all drives, with set values if it lets them move.

        One that lets them run is sent once: again and again it would end a quick stop of others.
        """
        is_new = word is not self._word or not settings
        if word is not self._word:
            self._word, self._worded = word, self._clock()
        zeros = (0,) * len(self._controllers)
        axes = zip(self._controllers, settings or zeros, offsets or zeros, strict=True)
        for controller, setting, offset in axes:
            if is_new:
                controller.command(word, setting, offset)
            else:
                controller.steer(setting, offset)

    def _come_to_rest(self) -> None:
        """Stops the axes quickly, and waits until they stand; nodes may be silent for a moment."""
        self._send(Controlword.QUICK_STOP)
        deadline, silences = self._clock() + stopping_time(self._settings, self._timing), 0
        while True:
            self._beat()
            try:
                speeds = [abs(sample.rpm) for sample in self._samples()]
            except DeviceError as error:
                silences += 1
                if error.fault is not DeviceFault.SILENT or silences > _SILENCES:
                    raise
            else:
                if max(speeds) <= STANDSTILL:
                    return
                if self._clock() > deadline:
                    node = self._controllers[speeds.index(max(speeds))].id
                    text = f"node {node} does not stop: {max(speeds):.0f} rpm"
                    raise DeviceError(self.name, text)
            sleep(POLL)


def together(remarks: Mapping[str, Sequence[str]]) -> list[str]:
    """Remarks of nodes, which are given by their names, each once with all names that say it."""
    who: dict[str, list[str]] = {}
    for name, remark in remarks.items():
        for words in remark:
            who.setdefault(words, []).append(name)
    return [f"{', '.join(names)}: {words}" for words, names in who.items()]


def unwrapped(counts: int, previous: int | None) -> int:
    """A position after the `previous` one, without jumps of a 32-bit counter [counts]."""
    return counts if previous is None else previous + wrapped(counts - previous)
