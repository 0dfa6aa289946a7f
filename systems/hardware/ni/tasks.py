"""The tasks of the card of the legs: what to ask of the driver."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np

from parapod.systems.core.extras import need
from parapod.systems.hardware.clock import monotonic
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ni.session import NiSession
from parapod.systems.hardware.ni.settings import NiDaqSettings, expand_channels
from parapod.systems.hardware.ni.watchdog import NiWatchdog

# Range of the outputs [V]: that of a Sabertooth 2x25 in analog mode (its manual, "Mode 1: analog
# input").
OUTPUT_MIN, OUTPUT_MAX = 0.0, 5.0

# Edges of signals A and B in one period of A, all counted: X4 decoding.
_COUNTS_PER_PULSE = 4


class NiTasks(NiSession[NiDaqSettings]):
    """Analog outputs, relay, counters, inputs and watchdog of one card.

    Attributes:
        watchdog: timer that guards the relay.
    """

    def __init__(self, settings: NiDaqSettings, name: str):
        """See `NiSession`."""
        super().__init__(settings, name)
        self._constants = need("nidaqmx.constants")
        self._writers = need("nidaqmx.stream_writers")
        self._counters: list[Any] = []
        self._bits = np.zeros(len(expand_channels(settings.all_inputs)), dtype=bool)
        self._pool: ThreadPoolExecutor | None = None
        if self._target:
            # One more for the watchdog, which nothing waits for.
            self._pool = ThreadPoolExecutor(len(settings.counter_names) + 1, name)
        self.watchdog = NiWatchdog(self, self._pool)

    def _create(self) -> None:
        # Before the tasks of the lines, which an expired one has locked.
        self.watchdog.take_over()
        settings = self.settings
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
        # The arrays have the right shape: asking the card each time would double the calls.
        for stream in (self._relay, self._outputs, self._inputs, *self._counters):
            stream.verify_array_shape = False

    def write_outputs(self, volts: Sequence[float]) -> None:
        """Puts voltages to the analog outputs [V]."""
        with self.told():
            self._outputs.write_one_sample(np.array(volts, dtype=np.float64), self.waits)

    def write_relay(self, is_on: bool) -> None:
        """Sets the relay's line."""
        with self.told():
            self._relay.write_one_sample_one_line(is_on, self.waits)

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
        with self.told():
            position = self._counters[index].read_one_sample_double(self.waits)
        if not math.isfinite(position):
            raise DeviceError(
                self._name,
                f"{self.settings.counter_names[index]} reads {position} m",
                DeviceFault.CORRUPT,
            )
        return round(position / self.settings.metres_per_count), monotonic()

    def read_inputs(self) -> tuple[float, ...]:
        """The digital inputs, 0 or 1: limit switches, then the emergency stop if there is one."""
        with self.told():
            self._inputs.read_one_sample_multi_line(self._bits, self.waits)
        return tuple(map(float, self._bits))

    def close(self) -> None:
        """See `NiSession`; a watchdog that is armed is left so."""
        self.watchdog.close()
        if self._pool is not None:
            self._pool.shutdown(wait=False)
        super().close()
