"""The DAQmx tasks behind one NI card: what to ask of the driver, and how long to wait for it."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from parapod.systems.hardware.device import DeviceError, DeviceFault, need
from parapod.systems.hardware.ni.settings import NiDaqSettings, expand_channels
from parapod.systems.hardware.ni.watchdog import NiWatchdog

# A driver that has lost its server tries again this often [ms], not ever more rarely, and by
# itself: a connection that others of the same process share would inherit their waiting time.
_CONNECTION = (
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 500),
    ("grpc.use_local_subchannel_pool", 1),
    # A machine is on no other side of a proxy, whatever the environment says.
    ("grpc.enable_http_proxy", 0),
)

# Range of the outputs [V]: that of a Sabertooth 2x25 in analog mode (its manual, "Mode 1: analog
# input").
OUTPUT_MIN, OUTPUT_MAX = 0.0, 5.0

# Edges of signals A and B in one period of A, all counted: X4 decoding.
_COUNTS_PER_PULSE = 4

# DAQmx errors that are not a refusal; the numbers are those of nidaqmx.error_codes.
_FAULTS = {
    -50405: DeviceFault.UNPLUGGED,  # PAL_TRANSFER_ABORTED: a device was removed
    -200324: DeviceFault.UNPLUGGED,  # DEV_ABSENT_OR_UNAVAILABLE
    -200474: DeviceFault.SILENT,  # OPERATION_TIMED_OUT
    -201003: DeviceFault.UNPLUGGED,  # DEV_CANNOT_BE_ACCESSED
}
_EXPIRED = {
    -200644,  # CANT_RESET_EXPIRED_WATCHDOG
    -200678,  # WRITE_FAILED_BECAUSE_WATCHDOG_EXPIRED
}


class WatchdogExpired(DeviceError):
    """The card's watchdog has opened the relay, and keeps it open."""


class BoundedChannel:
    """A gRPC channel on which no call outlasts a common instant.

    The driver library sets no deadlines, so a server that stalls would stop its caller for ever.

    Attributes:
        until: that instant, of the monotonic clock [s].
    """

    def __init__(self, channel: Any):
        self._channel = channel
        self.until = math.inf

    def unary_unary(self, *args: Any, **kwargs: Any) -> Callable[..., Any]:
        """See a gRPC channel; the call has a deadline."""
        made: list[Any] = []

        def call(request: Any, metadata: Any = None) -> Any:
            # Made when first used: each task makes a stub of some 700 calls, and uses ten.
            if not made:
                made.append(self._channel.unary_unary(*args, **kwargs))
            left = max(self.until - time.monotonic(), 0.0)
            return made[0](request, timeout=left, metadata=metadata)

        return call

    def unary_stream(self, *args: Any, **kwargs: Any) -> Any:
        """See a gRPC channel."""
        return self._channel.unary_stream(*args, **kwargs)

    def close(self) -> None:
        """Ends the connection."""
        self._channel.close()


class NiTasks:
    """The tasks of one card: analog outputs, relay, counters, inputs and watchdog.

    Each has a name, made of the card's and of its purpose. A server keeps the tasks of a client
    that is gone, and with them the channels; under its name a successor finds such a task and
    takes its place, so the machine can be stopped without a restart of the server.

    Attributes:
        had_expired: whether the watchdog of an earlier program had opened the relay.
    """

    def __init__(self, settings: NiDaqSettings, name: str):
        """Creates what `open` will open.

        Args:
            settings: the channels, and how to reach them.
            name: name of the card in errors.

        Raises:
            MissingExtra: the driver library is not installed.
        """
        self._settings, self._name, self._target = settings, name, settings.address
        self._nidaqmx = need("nidaqmx")
        self._errors = need("nidaqmx.errors")
        self._constants = need("nidaqmx.constants")
        self._readers = need("nidaqmx.stream_readers")
        self._writers = need("nidaqmx.stream_writers")
        self._tasks: list[Any] = []
        self._counters: list[Any] = []
        self._bits = np.zeros(len(expand_channels(settings.all_inputs)), dtype=bool)
        self._watchdog = NiWatchdog(settings, self._told, self._options)
        self._reset: Future[None] | None = None
        self.had_expired = False
        self._waits = 0.0
        self._channel: BoundedChannel | None = None
        self._pool: ThreadPoolExecutor | None = None
        if self._target:
            grpc = need("grpc")
            # One more for the watchdog, which nothing waits for.
            self._pool = ThreadPoolExecutor(len(settings.counter_names) + 1, name)
            self._channel = BoundedChannel(grpc.insecure_channel(self._target, _CONNECTION))

    def begin(self, seconds: float) -> None:
        """Begins a call of the device: all that follows is over after so many seconds."""
        self._waits = seconds
        if self._channel is not None:
            self._channel.until = time.monotonic() + seconds

    def open(self) -> None:
        """Makes sure that it is the right card, and creates and starts its tasks.

        Raises:
            DeviceError: it is not there, is another one, or refuses a channel.
        """
        with self._told():
            self._identify()
            # Before the tasks of the lines, which an expired one has locked.
            self.had_expired = self._watchdog.take_over()
            self._create_outputs()
            self._create_inputs()
            # Only a task that runs is quick to read and to write, and counts between the reads.
            for task in self._tasks:
                task.start()
        # The arrays have the right shape: asking the card each time would double the calls.
        for stream in (self._relay, self._outputs, self._inputs, *self._counters):
            stream.verify_array_shape = False

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
        asked = [self._pool.submit(self._read_counter, index) for index in each]
        wait(asked)
        return [answer.result() for answer in asked]

    def _read_counter(self, index: int) -> tuple[int, float]:
        with self._told():
            position = self._counters[index].read_one_sample_double(self._waits)
        if not math.isfinite(position):
            raise DeviceError(
                self._name,
                f"{self._settings.counter_names[index]} reads {position} m",
                DeviceFault.CORRUPT,
            )
        return round(position / self._settings.metres_per_count), time.monotonic()

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
            # Calls that did not arrive are told by those that are waited for.
            if not isinstance(error, DeviceError) or error.fault is DeviceFault.FAILED:
                _raise(error)
        self._reset = self._pool.submit(self._watchdog.reset)

    def disarm_watchdog(self) -> None:
        """Stops its timer and unlocks the relay's line, which stays low until it is written."""
        if self._reset is not None:
            wait([self._reset], self._waits)
            self._reset = None
        self._watchdog.disarm()

    def close(self, is_stopped: bool = True) -> None:
        """Gives the channels back and ends the connection; never raises.

        Args:
            is_stopped: whether the relay is known to be open; otherwise the watchdog is left
                armed, and opens it.
        """
        if is_stopped:
            self._watchdog.close()
        for task in self._tasks:
            with suppress(Exception):
                task.close()
        self._tasks.clear()
        if self._pool is not None:
            self._pool.shutdown(wait=False)
        if self._channel is not None:
            with suppress(Exception):
                self._channel.close()

    def _identify(self) -> None:
        system = need("nidaqmx.system")
        device = system.Device(self._settings.device, grpc_options=self._options(""))
        product, expected = device.product_type, self._settings.product
        if product != expected:
            raise DeviceError(
                self._name,
                f"{self._settings.device} is a {product}, not a {expected}",
                DeviceFault.CORRUPT,
            )

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

    def _task(self, role: str) -> Any:
        """A new task, without channels."""
        name = f"parapod_{self._settings.device}_{role}"
        self._tasks.append(self._nidaqmx.Task(name, grpc_options=self._options(name)))
        if self._channel is not None and self._tasks[-1].number_of_channels:
            self._tasks[-1].close()
            self._tasks[-1] = self._nidaqmx.Task(name, grpc_options=self._options(name))
        return self._tasks[-1]

    def _options(self, session: str) -> Any:
        if self._channel is None:
            return None
        return self._nidaqmx.GrpcSessionOptions(self._channel, session)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Tells what the driver library raises as an error of the device."""
        try:
            yield
        except self._errors.RpcError as error:
            raise self._lost(error) from error
        except self._errors.Error as error:
            code = getattr(error, "error_code", 0)
            if code in _EXPIRED:
                raise WatchdogExpired(self._name, str(error)) from error
            fault = _FAULTS.get(code, DeviceFault.FAILED)
            raise DeviceError(self._name, str(error), fault) from error

    def _lost(self, error: Any) -> DeviceError:
        target = self._target
        match getattr(error.rpc_code, "name", ""):
            case "UNAVAILABLE" | "CANCELLED":
                return DeviceError(
                    self._name,
                    f"no NI gRPC Device Server can be reached at {target}",
                    DeviceFault.UNPLUGGED,
                )
            case "DEADLINE_EXCEEDED":
                return DeviceError(
                    self._name,
                    f"the NI gRPC Device Server at {target} did not answer "
                    f"within {self._waits:g} s",
                    DeviceFault.SILENT,
                )
        return DeviceError(self._name, str(error))


def _raise(error: BaseException | None) -> None:
    if error is not None:
        raise error
