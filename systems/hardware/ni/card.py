"""A multifunction card of National Instruments between controller, motor drivers and encoders."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress

from parapod.systems.hardware.device import DeviceError, DeviceFault, Signals
from parapod.systems.hardware.ni.settings import NiDaqSettings, expand_channels
from parapod.systems.hardware.ni.tasks import OUTPUT_MAX, OUTPUT_MIN, NiTasks
from parapod.systems.hardware.position_memory import IncrementalDevice

# The counters have 32 bits (X Series User Manual, "Counters").
_COUNTS = 2**32

# Output voltage at which an actuator stands still, and its change to full supply voltage [V]: of a
# Sabertooth 2x25 in analog mode (its manual, "Mode 1: analog input").
_NEUTRAL, _SPAN = 2.5, 2.5

# Longest time to configure [s]; a driver that has to be loaded first takes seconds.
_CONFIGURE_TIMEOUT = 10.0

# A flag is set above this; NaN counts as set.
_SET = 0.5


class NiDaq(IncrementalDevice):
    """Motor drivers with analog inputs, encoders and limit switches on one card.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | measure `extension` | n | m | of the actuators, from the encoders |
    | measure `velocity` | n | m/s | mean since the last `read`; 0 at the first one |
    | measure `limits` | m | - | digital inputs, 0 or 1, in the order of the channel string |
    | command `voltage` | n | V | at the actuators, within plus and minus the supply voltage |
    | command `stop` | 1 | - | above 0.5: no power for the drives |

    Voltage u of supply U is the output neutral + span u / U. The relay is closed while the device
    is active and no stop is asked; whenever it is open, the outputs are neutral. So they are after
    `configure`, which refuses the wrong card and the wrong channels before it writes anything.

    **Reference.** Incremental encoders know no absolute position: the counters begin at zero when
    the device is configured, and lose everything when it is closed. `extension` is the way since
    then, plus `extension_at_start_mm` if the machine is known to stand there (all actuators
    retracted, say); else it is worth nothing until `set_reference` has told what the present
    counts mean: see `is_referenced`. Counts are followed through the wrap of the counters, if
    less than half of their range lies between two reads. The resolution of `velocity` is one
    count in the time between the reads.

    **Hold.** The outputs are timed by software: the card holds the last voltage, and the relay,
    when this program or its computer dies or the network fails, and the actuators go on moving.
    `close` and every exit of a `with` block leave them neutral, but nothing in this program can
    when it is killed. A machine needs what acts without it: end switches that cut the current of
    their direction, an emergency stop in the supply, and a watchdog that opens the relay, such as
    the card's own for digital lines (X Series User Manual, "Watchdog Timer"), one between relay
    line and relay, or motor drivers in a serial mode with a timeout.

    **Sessions.** A server keeps the tasks of a client that is gone. The next device of the same
    card takes them over, even from a client that lives; that one then gets errors. Two programs
    must not drive one machine.

    Bad input: a voltage that is not finite is neutral; a stop that is NaN is one.
    """

    position_signal = "extension"

    def __init__(self, settings: NiDaqSettings, drives_motors: bool = True):
        """Describes the card; nothing is opened.

        Args:
            settings: channels of the card, and its place.
            drives_motors: whether it takes voltages; otherwise its outputs stay neutral, and
                nothing should be connected to them.

        Raises:
            ValueError: settings that do not fit together.
        """
        _check(settings)
        self._settings, self._drives_motors = settings, drives_motors
        place = f" at {settings.address}" if settings.target else ""
        self.name = f"{settings.product} {settings.device}{place}"
        self.place = f"{settings.device}{place}"
        self._size = len(settings.counter_names)
        super().__init__(settings.extensions_path, self._size, settings.part)
        inputs = len(expand_channels(settings.inputs))
        self.measures: Mapping[str, int] = {
            "extension": self._size,
            "velocity": self._size,
            "limits": inputs,
        }
        motors = {"voltage": self._size} if drives_motors else {}
        self.commands: Mapping[str, int] = {**motors, "stop": 1}
        self._tasks: NiTasks | None = None
        self._is_active = False
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
        try:
            tasks.begin(_CONFIGURE_TIMEOUT)
            tasks.open()
            self._tasks = tasks
            self._forget()
            self._set_relay(tasks, False)
            self._write_neutral(tasks)
            if self._settings.extension_at_start is not None:
                self._reference(tasks, self._settings.extension_at_start)
        except BaseException:
            self._tasks = None
            tasks.begin(self._settings.timeout)
            tasks.close()
            raise

    def _set_reference(self, values: Sequence[float]) -> None:
        self._reference(self._begin(), values)

    def _energise(self) -> None:
        """Closes the relay, with neutral outputs."""
        tasks = self._begin()
        self._write_neutral(tasks)
        self._set_relay(tasks, True)
        self._is_active = True

    def read(self) -> Signals:
        """Extensions, velocities and limit switches."""
        tasks = self._begin()
        stamps = self._count(tasks)
        limits = tasks.read_inputs()
        scale = self._settings.metres_per_count
        velocity = (0.0,) * self._size
        if self._last is not None:
            velocity = tuple(
                scale * (count - old) / (stamp - then) if stamp > then else 0.0
                for count, stamp, old, then in zip(self._counts, stamps, *self._last, strict=True)
            )
        self._last = self._counts, stamps
        return {
            "extension": tuple(
                offset + scale * count
                for offset, count in zip(self._offset, self._counts, strict=True)
            ),
            "velocity": velocity,
            "limits": limits,
        }

    def write(self, commands: Signals) -> None:
        """Puts voltages to the outputs, and opens the relay on a stop.

        While the device is not active, whatever is asked is neutral.
        """
        tasks = self._begin()
        voltage = commands["voltage"] if self._drives_motors else (0.0,) * self._size
        if len(voltage) != self._size:
            raise ValueError(f"voltage has {self._size} elements, not {len(voltage)}")
        (stop,) = commands["stop"]
        if self._is_active and stop <= _SET:
            self._set_relay(tasks, True)
            tasks.write_outputs([self._output(value) for value in voltage])
        else:
            self._cut(tasks)

    def neutral(self) -> None:
        """Makes the outputs neutral."""
        self._write_neutral(self._begin())

    def _release(self) -> None:
        """Makes the outputs neutral and opens the relay."""
        self._is_active = False
        tasks = self._begin()
        try:
            self._write_neutral(tasks)
        finally:
            self._set_relay(tasks, False)

    def close(self) -> None:
        """Makes the outputs neutral, opens the relay, and gives the card back."""
        tasks, self._tasks, self._is_active = self._tasks, None, False
        if tasks is None:
            return
        tasks.begin(self._settings.timeout)
        with suppress(Exception):
            self._cut(tasks)
        tasks.close()

    def _begin(self) -> NiTasks:
        """The tasks, with the time of one call before them."""
        if self._tasks is None:
            raise DeviceError(self.name, "is not configured", DeviceFault.UNPLUGGED)
        self._tasks.begin(self._settings.timeout)
        return self._tasks

    def _forget(self) -> None:
        """Nothing is known of a card that was not spoken to."""
        self._relay: bool | None = None
        self._is_referenced = False
        self._offset = [0.0] * self._size
        self._counts = [0] * self._size
        self._last = None

    def _output(self, voltage: float) -> float:
        """The output voltage for one at the actuator [V]."""
        if not math.isfinite(voltage):
            return _NEUTRAL
        output = _NEUTRAL + _SPAN * voltage / self._settings.supply_voltage
        return min(max(output, OUTPUT_MIN), OUTPUT_MAX)

    def _write_neutral(self, tasks: NiTasks) -> None:
        tasks.write_outputs([_NEUTRAL] * self._size)

    def _set_relay(self, tasks: NiTasks, is_on: bool) -> None:
        """Sets the relay if it is not known to be so."""
        if self._relay is not is_on:
            # After a write that failed its position is not known.
            self._relay = None
            tasks.write_relay(is_on)
            self._relay = is_on

    def _cut(self, tasks: NiTasks) -> None:
        """Opens the relay at once, then makes the outputs neutral."""
        try:
            self._set_relay(tasks, False)
        finally:
            self._write_neutral(tasks)

    def _count(self, tasks: NiTasks) -> list[float]:
        """Reads the counters and follows them through their wrap; tells when [s]."""
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
    start = settings.extension_at_start
    if start is not None and len(start) != size:
        raise ValueError(f"extension_at_start must be {size} values, not {start}")
