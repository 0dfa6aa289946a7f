"""A multifunction card of National Instruments between controller, motor drivers and encoders."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress

from parapod.systems.core.switching import switched
from parapod.systems.hardware.device import DeviceError, DeviceFault, Signals
from parapod.systems.hardware.ni.session import CONFIGURE_TIMEOUT, WatchdogExpired
from parapod.systems.hardware.ni.settings import NiDaqSettings, expand_channels
from parapod.systems.hardware.ni.tasks import OUTPUT_MAX, OUTPUT_MIN, NiTasks
from parapod.systems.hardware.position_memory import IncrementalDevice

# The counters have 32 bits (X Series User Manual, "Counters").
_COUNTS = 2**32

# Output voltage at which an actuator stands still, and its change to full supply voltage [V]: of a
# Sabertooth 2x25 in analog mode (its manual, "Mode 1: analog input").
_NEUTRAL, _SPAN = 2.5, 2.5

# A digital input is on above this.
_SET = 0.5

# Shares of the watchdog's timeout after which it is reset: by a write, when the loop's work is
# done and nothing waits, as often as the default loop writes; by a read, where no writes come.
_RESET_BY_WRITE, _RESET_BY_READ = 0.09, 0.25
# Shortest timeout of the watchdog [s]: of a loop at 100 Hz that misses a reading.
_SHORTEST_WATCHDOG = 0.02


class NiDaq(IncrementalDevice):
    """Motor drivers with analog inputs, encoders and limit switches on one card.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | measure `extension` | n | m | of the actuators, from the encoders |
    | measure `velocity` | n | m/s | mean since the last `read`; 0 at the first one |
    | measure `limits` | m | 0/1 | digital inputs, in the order of the channel string |
    | measure `emergency_stop` | 1 | 0/1 | pressed, or pressed before and still latched |
    | command `voltage` | n | V | at the actuators, within plus and minus the supply voltage |
    | command `stop` | 1 | - | above 0.5: no power for the drives |

    Voltage u of supply U is the output neutral + span u / U. The relay is closed while the device
    is active and no stop is asked; whenever it is open, the outputs are neutral. So they are after
    `configure`, which refuses the wrong card and the wrong channels before it writes anything.

    **Reference.** Incremental encoders know no absolute position: the counters begin at zero when
    the device is configured, and lose everything when it is closed. `extension` is the way since
    then, plus `extension_at_start_mm` if the machine is known to stand there (all actuators
    retracted, say); else it is worth nothing until `set_reference` has given what the present
    counts mean: see `is_referenced`. Counts are followed through the wrap of the counters, if
    less than half of their range lies between two reads. The resolution of `velocity` is one
    count in the time between the reads.

    **End switches.** Where the settings say at which extensions they close, a reference that they
    contradict is refused by `configure`.

    **Emergency stop.** Its feedback contact is read in one call with the limit switches; there is
    no `emergency_stop` without `stop_input`. A reading at which it is pressed opens the relay and
    makes the outputs neutral, whatever is commanded, even if nothing is. This is latched, so that
    a program that hangs does not drive on when the button is released: the relay stays open, and
    `emergency_stop` 1, until a command with a stop of 1 (not NaN) comes while the button is
    released, or the device is deactivated and activated again.

    **Hold.** The outputs are timed by software: the card holds the last voltage when this program
    or its computer dies or the network fails. `close` and every exit of a `with` block leave them
    neutral, but nothing in this program can when it is killed. Then the card's own watchdog opens
    the relay: it is armed by `activate` and reset by reads and writes, and it expires when
    nothing has reached the card for `watchdog_ms`. X Series cards have it for digital lines, so
    the outputs hold even then. When it has expired under a living program, every `write` raises
    until a stop or a new activation, as above. A card without one, or that refuses it, is
    used all the same, and `remarks` say so; such a machine needs another watchdog between relay
    line and relay, or motor drivers in a serial mode with a timeout.

    **Sessions.** A server keeps the tasks of a client that is gone. The next device of the same
    card takes them over, even from a client that lives; that one then gets errors. Two programs
    must not drive one machine.

    Bad input: a voltage that is not finite is neutral; a stop that is near neither 0 nor 1 is one.
    """

    position_signal = "extension"

    def __init__(self, settings: NiDaqSettings, drives_motors: bool = True):
        """Describes the card; nothing is opened.

        Args:
            settings: channels of the card, and its place.
            drives_motors: true if it takes voltages; otherwise its outputs stay neutral, and
                nothing should be connected to them.

        Raises:
            ValueError: settings that do not fit together.
        """
        _check(settings)
        self._settings, self._drives_motors = settings, drives_motors
        self.name, self.place = f"{settings.product} {settings.place}", settings.place
        self._size = len(settings.counter_names)
        super().__init__(settings.extensions_path, self._size, settings.part)
        self._limits = len(expand_channels(settings.inputs))
        self.measures: Mapping[str, int] = {
            "extension": self._size,
            "velocity": self._size,
            "limits": self._limits,
            **({"emergency_stop": 1} if settings.stop_input else {}),
        }
        motors = {"voltage": self._size} if drives_motors else {}
        self.commands: Mapping[str, int] = {**motors, "stop": 1}
        self.fail_safe = ("stop",)
        self._tasks: NiTasks | None = None
        self._is_active = self._is_pressed = self._is_latched = False
        self._last: tuple[list[int], list[float]] | None = None
        self._forget()

    @property
    def is_referenced(self) -> bool:
        """Whether it is known which extensions the counts mean."""
        return self._is_referenced

    def _open(self) -> None:
        """Opens the connection, identifies the card, and leaves outputs neutral and relay open."""
        self.close()
        tasks = NiTasks(self._settings, self.name)
        with tasks.opening(CONFIGURE_TIMEOUT):
            self._forget()
            # At power-up and after a reset the outputs are at 0 V, which is full speed.
            self._set_relay(tasks, False)
            self._write_neutral(tasks)
            self._open_watchdog(tasks)
            if self._settings.extension_at_start is not None:
                self._reference(tasks, self._settings.extension_at_start)
        self._tasks = tasks

    def _set_reference(self, values: Sequence[float]) -> None:
        self._reference(self._begin(), values)

    def _contradiction(self) -> str:
        """See `IncrementalDevice`."""
        settings, measured, size = self._settings, self.read(), self._size
        tolerance, limits = 1e-3 * settings.switch_tolerance_mm, measured["limits"]
        for name, end, sign, switches in (
            ("extended", settings.extended_mm, 1.0, limits[:size]),
            ("retracted", settings.retracted_mm, -1.0, limits[size : 2 * size]),
        ):
            if end is None or len(switches) < size:
                continue
            rows = zip(measured["extension"], switches, strict=True)
            for i, (x, switch) in enumerate(rows, start=1):
                beyond = sign * (x - 1e-3 * end)
                if abs(beyond) > tolerance and (switch > _SET) != (beyond > 0.0):
                    state = "closed" if switch > _SET else "open"
                    return (
                        f"the switch '{name}' of {settings.part} {i}, which closes at {end:g} mm, "
                        f"is {state}, but its extension should be {1e3 * x:.1f} mm"
                    )
        return ""

    def _energise(self) -> None:
        """Closes the relay, with neutral outputs, unless the emergency stop is pressed."""
        tasks = self._begin()
        self._write_neutral(tasks)
        self._take_inputs(tasks)
        self._is_latched = self._is_pressed
        if self._is_pressed:
            self._remark(
                f"the emergency stop is pressed ({self._settings.stop_input} is low), so the "
                'relay stays open; without such a contact, say stop_input: ""'
            )
        self._arm(tasks)
        self._set_relay(tasks, not self._is_latched)
        self._is_active = True

    def read(self) -> Signals:
        """Extensions, velocities, limit switches and emergency stop."""
        tasks = self._begin()
        stamps = self._count(tasks)
        limits = self._take_inputs(tasks)
        if self._is_active:
            self._reset_watchdog(tasks, _RESET_BY_READ)
            self._obey_stop(tasks)
        scale = self._settings.metres_per_count
        velocity = (0.0,) * self._size
        if self._last is not None:
            velocity = tuple(
                scale * (count - old) / (stamp - then) if stamp > then else 0.0
                for count, stamp, old, then in zip(self._counts, stamps, *self._last, strict=True)
            )
        self._last = self._counts, stamps
        extension = tuple(
            offset + scale * count
            for offset, count in zip(self._offset, self._counts, strict=True)
        )
        measured = {"extension": extension, "velocity": velocity, "limits": limits}
        if self._settings.stop_input:
            measured["emergency_stop"] = (float(self._is_pressed or self._is_latched),)
        return measured

    def write(self, commands: Signals) -> None:
        """Puts voltages to the outputs, and opens the relay on a stop.

        While the device is not active, or the emergency stop latched, whatever is asked is
        neutral.

        Raises:
            WatchdogExpired: the card has opened the relay by itself; until a stop is commanded.
            DeviceError: the commands did not arrive.
        """
        tasks = self._begin()
        voltage = commands["voltage"] if self._drives_motors else (0.0,) * self._size
        if len(voltage) != self._size:
            raise ValueError(f"voltage has {self._size} elements, not {len(voltage)}")
        stop = switched(*commands["stop"])
        is_driven = self._is_active and stop is False and not self._is_latched
        if is_driven:
            self._set_relay(tasks, True)
        if is_driven and self._relay:
            tasks.write_outputs([self._output(value) for value in voltage])
        else:
            self._cut(tasks)
        if self._is_active and stop:
            self._acknowledge(tasks)
        if self._is_active:
            self._reset_watchdog(tasks, _RESET_BY_WRITE)
        if self._has_expired:
            raise WatchdogExpired(
                self.name,
                "its watchdog has opened the relay, because nothing had reached the card for "
                f"{self._settings.watchdog_timeout:g} s; until a stop, or another start",
            )

    def neutral(self) -> None:
        """Makes the outputs neutral."""
        self._write_neutral(self._begin())

    def _release(self) -> None:
        """Makes the outputs neutral, opens the relay, and then disarms the watchdog."""
        self._is_active = False
        tasks = self._begin()
        try:
            self._write_neutral(tasks)
        finally:
            self._set_relay(tasks, False)
        self._disarm(tasks)
        self._is_latched = False

    def close(self) -> None:
        """Makes the outputs neutral, opens the relay, and gives the card back."""
        tasks, self._tasks, self._is_active = self._tasks, None, False
        if tasks is None:
            return
        tasks.begin()
        with suppress(Exception):
            self._cut(tasks)
            self._disarm(tasks)
        tasks.close()

    def _begin(self) -> NiTasks:
        """The tasks, with the time of one call before them."""
        if self._tasks is None:
            raise DeviceError(self.name, "is not configured", DeviceFault.UNPLUGGED)
        self._tasks.begin()
        return self._tasks

    def _forget(self) -> None:
        """Nothing is known of a card that was not spoken to."""
        self._relay: bool | None = None
        self._is_referenced = False
        self._offset = [0.0] * self._size
        self._counts = [0] * self._size
        self._last = None
        self._is_pressed = self._is_latched = False
        self._has_expired = False

    def _output(self, voltage: float) -> float:
        """The output voltage for one at the actuator [V]."""
        if not math.isfinite(voltage):
            return _NEUTRAL
        output = _NEUTRAL + _SPAN * voltage / self._settings.supply_voltage
        return min(max(output, OUTPUT_MIN), OUTPUT_MAX)

    def _write_neutral(self, tasks: NiTasks) -> None:
        tasks.write_outputs([_NEUTRAL] * self._size)

    def _set_relay(self, tasks: NiTasks, is_on: bool) -> None:
        """Sets the relay if it is not known to be so; one that the watchdog has opened stays."""
        if self._relay is is_on or self._has_expired:
            return
        # After a write that failed its position is not known.
        self._relay = None
        try:
            tasks.write_relay(is_on)
        except WatchdogExpired:
            self._relay, self._has_expired = False, True
            return
        self._relay = is_on

    def _cut(self, tasks: NiTasks) -> None:
        """Opens the relay at once, then makes the outputs neutral."""
        try:
            self._set_relay(tasks, False)
        finally:
            self._write_neutral(tasks)

    def _take_inputs(self, tasks: NiTasks) -> tuple[float, ...]:
        """Reads the digital inputs; gives the limit switches, and keeps the emergency stop."""
        values = tasks.read_inputs()
        self._is_pressed = any(value < _SET for value in values[self._limits :])
        return values[: self._limits]

    def _obey_stop(self, tasks: NiTasks) -> None:
        """Opens the relay while the emergency stop is latched."""
        self._is_latched = self._is_latched or self._is_pressed
        if self._is_latched and self._relay is not False:
            self._cut(tasks)

    def _acknowledge(self, tasks: NiTasks) -> None:
        """Ends a latched stop whose cause is over; the relay stays open."""
        self._is_latched = self._is_pressed
        if self._has_expired:
            self._disarm(tasks)
            self._arm(tasks)

    def _open_watchdog(self, tasks: NiTasks) -> None:
        """Prepares the card's watchdog, or remarks that there is none."""
        self.watchdog, self.remarks = "", []
        timeout = self._settings.watchdog_timeout
        if tasks.watchdog.had_expired:
            self._remark("the watchdog of an earlier program had opened the relay; it is cleared")
        if timeout == 0.0:
            self._remark("no watchdog of its own: watchdog_ms is 0")
            return
        try:
            tasks.watchdog.open()
            self.watchdog = f"without this program the card opens the relay within {timeout:g} s"
        except DeviceError as error:
            self._do_without(error)

    def _do_without(self, error: DeviceError) -> None:
        """Goes on without a watchdog that was refused; not if nothing has answered."""
        if error.fault is not DeviceFault.FAILED:
            raise error
        self.watchdog = ""
        self._remark(f"no watchdog of its own: {error.words}")

    def _remark(self, text: str) -> None:
        self.remarks = [*self.remarks, text]

    def _arm(self, tasks: NiTasks) -> None:
        """Arms the watchdog if there is one."""
        if not self.watchdog:
            return
        try:
            tasks.watchdog.arm()
        except DeviceError as error:
            self._do_without(error)

    def _disarm(self, tasks: NiTasks) -> None:
        """Disarms the watchdog if it is armed; the relay is open before and afterwards."""
        if not tasks.watchdog.is_armed:
            return
        tasks.watchdog.disarm()
        self._has_expired = False
        # The line was locked; what is written to it counts from now on.
        self._relay = None
        self._set_relay(tasks, False)

    def _reset_watchdog(self, tasks: NiTasks, share: float) -> None:
        """Starts the watchdog's timer anew if that is due; notes that it has run out."""
        try:
            if not self._has_expired:
                tasks.watchdog.reset(share)
        except WatchdogExpired:
            self._relay, self._has_expired = False, True
            self._write_neutral(tasks)

    def _count(self, tasks: NiTasks) -> list[float]:
        """Reads the counters and follows them through their wrap; returns when [s]."""
        readings = tasks.read_counters()
        self._counts = [
            before + (count - before + _COUNTS // 2) % _COUNTS - _COUNTS // 2
            for before, (count, _) in zip(self._counts, readings, strict=True)
        ]
        return [stamp for _, stamp in readings]

    def _reference(self, tasks: NiTasks, values: Sequence[float]) -> None:
        self._count(tasks)
        scale = self._settings.metres_per_count
        self._offset = [
            float(value) - scale * count for value, count in zip(values, self._counts, strict=True)
        ]
        self._is_referenced = True


def _check(settings: NiDaqSettings) -> None:
    """Refuses settings that do not fit together."""
    settings.device  # noqa: B018 (the channels are of one card, or it says which)
    counters, size = settings.counter_names, len(expand_channels(settings.outputs))
    if len(counters) != size:
        raise ValueError(
            f"each of the {size} outputs needs one counter, not {', '.join(counters)}"
        )
    if settings.stop_input and len(expand_channels(settings.stop_input)) != 1:
        raise ValueError(f"stop_input must be one line, not {settings.stop_input}")
    if 0.0 < settings.watchdog_timeout < _SHORTEST_WATCHDOG:
        raise ValueError(
            f"watchdog_ms must be 0 or at least {1e3 * _SHORTEST_WATCHDOG:g}, "
            f"not {settings.watchdog_ms:g}"
        )
    start = settings.extension_at_start
    if start is not None and len(start) != size:
        raise ValueError(f"extension_at_start must be {size} values, not {start}")
