"""A multifunction card of National Instruments between controller, motor drivers and encoders."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress

from parapod.systems.hardware.device import DeviceError, DeviceFault, Signals
from parapod.systems.hardware.ni.settings import NiDaqParams, expand_channels
from parapod.systems.hardware.ni.tasks import NiTasks
from parapod.systems.hardware.position_memory import IncrementalDevice

# The counters have 32 bits (X Series User Manual, "Counters").
_COUNTS = 2**32

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
    then, plus `extension_at_start` if the machine is known to stand there (all actuators
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

    Attributes:
        params: the settings.
    """

    position_signal = "extension"

    def __init__(self, params: NiDaqParams = NiDaqParams()):
        self.params = params
        place = f" at {params.target}" if params.target else ""
        self.name = f"{params.product} {params.device}{place}"
        self._size = len(params.counters)
        inputs = len(expand_channels(params.inputs))
        self.measures: Mapping[str, int] = {
            "extension": self._size,
            "velocity": self._size,
            "limits": inputs,
        }
        self.commands: Mapping[str, int] = {"voltage": self._size, "stop": 1}
        self._tasks: NiTasks | None = None
        self._is_active = False
        self._last: tuple[list[int], list[float]] | None = None
        self._forget()

    @property
    def is_referenced(self) -> bool:
        """Whether it is known which extensions the counts mean."""
        return self._is_referenced

    def configure(self) -> None:
        """Opens the connection, identifies the card, and leaves outputs neutral and relay open."""
        self.close()
        tasks = NiTasks(self.params, self.name)
        try:
            tasks.begin(self.params.configure_timeout)
            tasks.open()
            self._tasks = tasks
            self._forget()
            self._set_relay(tasks, False)
            self._write_neutral(tasks)
            if self.params.extension_at_start is not None:
                self._reference(tasks, self.params.extension_at_start)
        except BaseException:
            self._tasks = None
            tasks.begin(self.params.timeout)
            tasks.close()
            raise

    def _set_reference(self, values: Sequence[float]) -> None:
        self._reference(self._begin(), values)

    def activate(self) -> None:
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
        scale = self.params.metres_per_count
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
        voltage = commands["voltage"]
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

    def deactivate(self) -> None:
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
        tasks.begin(self.params.timeout)
        with suppress(Exception):
            self._cut(tasks)
        tasks.close()

    def _begin(self) -> NiTasks:
        """The tasks, with the time of one call before them."""
        if self._tasks is None:
            raise DeviceError(self.name, "is not configured", DeviceFault.UNPLUGGED)
        self._tasks.begin(self.params.timeout)
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
        params = self.params
        if not math.isfinite(voltage):
            return params.neutral
        output = params.neutral + params.span * voltage / params.supply_voltage
        low, high = params.neutral - params.span, params.neutral + params.span
        return min(max(output, low, params.output_min), high, params.output_max)

    def _write_neutral(self, tasks: NiTasks) -> None:
        tasks.write_outputs([self.params.neutral] * self._size)

    def _set_relay(self, tasks: NiTasks, is_on: bool) -> None:
        """Sets the relay if it is not known to be so."""
        if self._relay is not is_on:
            # Where it is after a write that failed, nobody knows.
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
        scale = self.params.metres_per_count
        self._offset = [
            float(value) - scale * count for value, count in zip(values, self._counts, strict=True)
        ]
        self._is_referenced = True
