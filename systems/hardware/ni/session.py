"""A session with one NI card: its connection, its tasks, and its errors."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from typing import Any

from parapod.systems.core.extras import need
from parapod.systems.hardware.clock import answer_time
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ni.settings import NiCardSettings

# A driver that has lost its server tries again this often [ms], not ever more rarely, and by
# itself: a connection that others of the same process share would inherit their waiting time.
_CONNECTION = (
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 500),
    ("grpc.use_local_subchannel_pool", 1),
    # A machine is on no other side of a proxy, whatever the environment says.
    ("grpc.enable_http_proxy", 0),
)
# Longest time until a connection is made [s].
_CONNECTING = 0.1

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
        until: end of the call, by the computer's monotonic clock [s].
    """

    def __init__(self, channel: Any):
        self._channel = channel
        self.until = math.inf

    def unary_unary(self, *args: Any, **kwargs: Any) -> Callable[..., Any]:
        """See a gRPC channel; the call has a deadline."""
        # Made when first used: each task makes a stub of some 700 calls, and uses ten.
        get = cache(partial(self._channel.unary_unary, *args, **kwargs))

        def call(request: Any, metadata: Any = None) -> Any:
            time_left = max(self.until - time.monotonic(), 0.0)
            return get()(request, timeout=time_left, metadata=metadata)

        return call

    def __getattr__(self, name: str) -> Any:
        return getattr(self._channel, name)


# Longest time to configure [s]; a driver that has to be loaded first takes seconds.
CONFIGURE_TIMEOUT = 10.0


class NiSession[S: NiCardSettings](ABC):
    """The tasks that a device has on its card, and the connection to that.

    Each task has a name, made of the card's and of its purpose. A server keeps the tasks of a
    client that is gone, and with them the channels; under its name a successor finds such a task
    and takes its place, so the machine can be stopped without a restart of the server.

    Attributes:
        settings: the channels, and how to reach them.
        waits: longest time for the call that has begun [s].
    """

    def __init__(self, settings: S, name: str):
        """Creates the connection, of which nothing is used yet.

        Args:
            settings: the channels, and how to reach them.
            name: name of the card in errors.

        Raises:
            MissingExtra: the driver library is not installed.
        """
        self.settings, self._name, self._target = settings, name, settings.address
        self._nidaqmx = need("nidaqmx")
        self._errors = need("nidaqmx.errors")
        self._readers = need("nidaqmx.stream_readers")
        self._tasks: list[Any] = []
        self.waits = 0.0
        self._channel: BoundedChannel | None = None
        if self._target:
            grpc = need("grpc")
            longest = ("grpc.min_reconnect_backoff_ms", round(1e3 * answer_time(_CONNECTING)))
            options = (*_CONNECTION, longest)
            self._channel = BoundedChannel(grpc.insecure_channel(self._target, options))

    def begin(self, seconds: float | None = None) -> None:
        """Begins a call of the device and limits the time of all that follows.

        Args:
            seconds: longest time [s]; None: that of the settings.
        """
        self.waits = self.settings.timeout if seconds is None else seconds
        if self._channel is not None:
            self._channel.until = time.monotonic() + answer_time(self.waits)

    @contextmanager
    def opening(self, seconds: float) -> Iterator[None]:
        """Makes sure that it is the right card, and creates and starts its tasks.

        It is closed if that fails, or the body of the `with`.

        Args:
            seconds: longest time for all of that [s].

        Raises:
            DeviceError: it is not there, is another one, or refuses a channel.
        """
        try:
            self.begin(seconds)
            with self.told():
                self._identify()
                self._create()
                # Only one that runs is quick to read and to write, and counts between the reads.
                for task in self._tasks:
                    task.start()
            yield
        except BaseException:
            self.begin()
            self.close()
            raise

    @abstractmethod
    def _create(self) -> None:
        """Creates the tasks."""

    def close(self) -> None:
        """Gives the channels back and ends the connection; never raises."""
        for task in self._tasks:
            with suppress(Exception):
                task.close()
        self._tasks.clear()
        if self._channel is not None:
            with suppress(Exception):
                self._channel.close()

    def _identify(self) -> None:
        system = need("nidaqmx.system")
        name, expected = self.settings.device, self.settings.product
        product = system.Device(name, grpc_options=self.options("")).product_type
        if product != expected:
            words = f"{name} is a {product}, not a {expected}"
            raise DeviceError(self._name, words, DeviceFault.CORRUPT)

    def _task(self, role: str) -> Any:
        """A new task, without channels."""
        name = f"parapod_{self.settings.device}_{role}"
        self._tasks.append(self._nidaqmx.Task(name, grpc_options=self.options(name)))
        if self._channel is not None and self._tasks[-1].number_of_channels:
            self._tasks[-1].close()
            self._tasks[-1] = self._nidaqmx.Task(name, grpc_options=self.options(name))
        return self._tasks[-1]

    def options(self, session: str) -> Any:
        """Options of the driver library for a session; None for a card in this computer."""
        if self._channel is None:
            return None
        return self._nidaqmx.GrpcSessionOptions(self._channel, session)

    @contextmanager
    def told(self) -> Iterator[None]:
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
        server, words, fault = "NI gRPC Device Server", str(error), DeviceFault.FAILED
        match getattr(error.rpc_code, "name", ""):
            case "UNAVAILABLE" | "CANCELLED":
                words = f"no {server} can be reached at {self._target}"
                fault = DeviceFault.UNPLUGGED
            case "DEADLINE_EXCEEDED":
                words = f"the {server} at {self._target} did not answer within {self.waits:g} s"
                fault = DeviceFault.SILENT
        return DeviceError(self._name, words, fault)
