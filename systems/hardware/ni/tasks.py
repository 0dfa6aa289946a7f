"""The tasks of the card of the legs: what to ask of the driver."""

import math
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

import numpy as np

from parapod.systems.core.extras import need
from parapod.systems.hardware.clock import answer_time, monotonic
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ni.session import NiSession
from parapod.systems.hardware.ni.settings import NiDaqSettings, expand_channels
from parapod.systems.hardware.ni.watchdog import NiWatchdog

# Range of the outputs [V]: that of a Sabertooth 2x25 in analog mode (its manual, "Mode 1: analog
# input").
OUTPUT_MIN, OUTPUT_MAX = 0.0, 5.0

# Edges of signals A and B in one period of A, all counted: X4 decoding.
_COUNTS_PER_PULSE = 4


class NiTasks(NiSession):
    """Analog outputs, relay, counters, inputs and watchdog of one card.

    Attributes:
        had_expired: true if the watchdog of an earlier program had opened the relay.
    """

    def __init__(self, settings: NiDaqSettings, name: str):
        """See `NiSession`."""
        super().__init__(settings, name)
        self._settings = settings
        self._constants = need("nidaqmx.constants")
        self._writers = need("nidaqmx.stream_writers")
        self._counters: list[Any] = []
        self._bits = np.zeros(len(expand_channels(settings.all_inputs)), dtype=bool)
        self._watchdog = NiWatchdog(settings, self._told, self._options)
        self._reset: Future[None] | None = None
        self.had_expired = False
        self._pool: ThreadPoolExecutor | None = None
        if self._target:
            # One more for the watchdog, which nothing waits for.
            self._pool = ThreadPoolExecutor(len(settings.counter_names) + 1, name)

    def open(self) -> None:
        """See `NiSession`."""
        super().open()
        # The arrays have the right shape: asking the card each time would double the calls.
        for stream in (self._relay, self._outputs, self._inputs, *self._counters):
            stream.verify_array_shape = False

    def _create(self) -> None:
        # Before the tasks of the lines, which an expired one has locked.
        self.had_expired = self._watchdog.take_over()
        self._create_outputs()
        self._create_inputs()

    def write_outputs(self, volts: Sequence[float]) -> None:
        """Puts voltages to the analog outputs [V]."""
        with self._told():
            self._outputs.write_one_sample(np.array(volts, dtype=np.float64), self._waits)

    def write_relay(self, is_on: bool) -> None:
        """Sets the relay's line."""
        with self._told():
            self._relay.write_one_sample_one_line(is_on, self._waits)

    def read_counters(self) -> list[tuple[int, float]]:
        """Every counter's signed count, and when it was there [s].

        A card on another computer is asked for all of them at once: one after the other would
        take as many times the way there and back.
        """
        each = range(len(self._counters))
        if self._pool is None:
            return [self._read_counter(index) for index in each]
        futures = [self._pool.submit(self._read_counter, index) for index in each]
        wait(futures)
        return [answer.result() for answer in futures]

    def _read_counter(self, index: int) -> tuple[int, float]:
        with self._told():
            position = self._counters[index].read_one_sample_double(self._waits)
        if not math.isfinite(position):
            raise DeviceError(
                self._name,
                f"{self._settings.counter_names[index]} reads {position} m",
                DeviceFault.CORRUPT,
            )
        return round(position / self._settings.metres_per_count), monotonic()

    def read_inputs(self) -> tuple[float, ...]:
        """The digital inputs, 0 or 1: limit switches, then the emergency stop if there is one."""
        with self._told():
            self._inputs.read_one_sample_multi_line(self._bits, self._waits)
        return tuple(map(float, self._bits))

    def open_watchdog(self) -> None:
        """Prepares the card's watchdog, disarmed.

        Raises:
            DeviceError: the card has none, or refuses it for this line.
        """
        self._watchdog.open()

    def arm_watchdog(self) -> None:
        """Starts the card's watchdog."""
        self._watchdog.arm()

    def reset_watchdog(self) -> None:
        """Starts its timer anew; over gRPC without waiting until that has happened.

        Raises:
            WatchdogExpired: it has opened the relay. Over gRPC the next call says so.
        """
        if self._pool is None:
            self._watchdog.reset()
            return
        if self._reset is not None:
            if not self._reset.done():
                return
            error, self._reset = self._reset.exception(), None
            # Calls that did not arrive are named by those that are waited for.
            if not isinstance(error, DeviceError) or error.fault is DeviceFault.FAILED:
                _raise(error)
        self._reset = self._pool.submit(self._watchdog.reset)

    def disarm_watchdog(self) -> None:
        """Stops its timer and unlocks the relay's line, which stays low until it is written."""
        if self._reset is not None:
            wait([self._reset], answer_time(self._waits))
            self._reset = None
        self._watchdog.disarm()

    def close(self, is_stopped: bool = True) -> None:
        """Gives the channels back and ends the connection; never raises.

        Args:
            is_stopped: true if the relay is known to be open; otherwise the watchdog is left
                armed, and opens it.
        """
        if is_stopped:
            self._watchdog.close()
        if self._pool is not None:
            self._pool.shutdown(wait=False)
        super().close()

    def _create_outputs(self) -> None:
        settings = self._settings
        relay = self._task("relay")
        relay.do_channels.add_do_chan(settings.relay)
        self._relay = self._writers.DigitalSingleChannelWriter(relay.out_stream, auto_start=False)
        outputs = self._task("outputs")
        outputs.ao_channels.add_ao_voltage_chan(
            settings.outputs, min_val=OUTPUT_MIN, max_val=OUTPUT_MAX
        )
        self._outputs = self._writers.AnalogMultiChannelWriter(
            outputs.out_stream, auto_start=False
        )

    def _create_inputs(self) -> None:
        settings = self._settings
        # A task takes one counter only.
        for number, channel in enumerate(settings.counter_names):
            task = self._task(f"counter{number}")
            task.ci_channels.add_ci_lin_encoder_chan(
                channel,
                decoding_type=self._constants.EncoderType.X_4,
                units=self._constants.LengthUnits.METERS,
                dist_per_pulse=_COUNTS_PER_PULSE * settings.metres_per_count,
            )
            self._counters.append(self._readers.CounterReader(task.in_stream))
        inputs = self._task("inputs")
        inputs.di_channels.add_di_chan(
            settings.all_inputs, line_grouping=self._constants.LineGrouping.CHAN_FOR_ALL_LINES
        )
        self._inputs = self._readers.DigitalSingleChannelReader(inputs.in_stream)


def _raise(error: BaseException | None) -> None:
    if error is not None:
        raise error
