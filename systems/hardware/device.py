"""Life cycle, signals and failures that all devices have in common.

A library that only one part needs is imported when its device is configured, see
`parapod.systems.core.extras`. A part that the machine does not have is `NotFitted`.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from enum import IntEnum
from types import TracebackType
from typing import Self

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.quoting import printable
from parapod.systems.hardware.clock import standing_still
from parapod.systems.hardware.exclusive import InUse, only_program

type Signals = Mapping[str, Sequence[float]]


_LONGEST_NAME = 240  # longest name of a device with its address, in messages [characters]


class DeviceFault(IntEnum):
    """Codes of the ports `status.fault`."""

    NONE = 0
    """Nothing is wrong."""

    SILENT = 1
    """Does not answer, or not in time."""

    CORRUPT = 2
    """Answers with a wrong checksum, length or identity, or with what cannot be."""

    FAILED = 3
    """Answers that it has failed."""

    UNPLUGGED = 4
    """The connection is gone."""

    NO_COMMAND = 5
    """The controller has fallen silent; the outputs are neutral."""


class DeviceError(ParapodError):
    """A device that does not obey; the text has the device's own words.

    Attributes:
        device: its name and address.
        fault: in which way.
        words: message, in one line and without its name.
    """

    def __init__(self, device: str, message: str, fault: DeviceFault = DeviceFault.FAILED):
        self.device, self.fault, self.words = device, fault, printable(message)
        super().__init__(f"{printable(device, _LONGEST_NAME)}: {self.words}")


class Device(ABC):
    """A part of the machine, as the bus behind which it sits shows it.

    Its life is that of ros2_control's hardware: `configure` opens the connection, makes sure that
    the right device answers, sets it up, and leaves its outputs neutral and without power;
    `activate` gives them power; `deactivate` takes it away; `close` ends the connection, and may
    come at any time. After `configure` one thread at a time calls the device.

    Calls block, but none for longer than the device's timeout.

    Attributes:
        name: kind and place of the device, as errors call it.
        watchdog: mechanism that makes the outputs neutral when no program speaks to the device, as
            in "without heartbeats its drives stop within 0.1 s"; "": nothing does.
        remarks: facts to print when the device starts, once it is configured or active,
            such as a fault from before; sentences without the device's name.
        place: resource that only one program may command, see `only_program`; "": none.
        stamp: time of devices at which what `read` returned was measured [s]; None: when it was
            asked for.
        is_asked: false if measurements come by themselves, and `read` returns the newest.
        sends_every: mean time between those that have come of late [s]; infinite: not known.
        on_measured: called when one of those has come, from any thread; set by who reads them.
        measures: the signals that `read` returns, and their sizes.
        commands: the signals that `write` takes, and their sizes.
        fail_safe: those of the commands that are switches; 1 is the safe side of each (stopped,
            braked, closed), and so is whatever is near neither 0 nor 1, see `switched`.
    """

    name: str
    place: str = ""
    watchdog: str = ""
    remarks: Sequence[str] = ()
    stamp: float | None = None
    is_asked: bool = True
    sends_every: float = math.inf
    on_measured: Callable[[], None] | None = None
    measures: Mapping[str, int] = {}
    commands: Mapping[str, int] = {}
    fail_safe: Collection[str] = ()

    @abstractmethod
    def configure(self) -> None:
        """Opens the connection and sets up the device; nothing is energised.

        Raises:
            MissingExtra: the library is not installed.
            DeviceError: it is not there, is another one, or refuses; nothing stays open.
        """

    def activate(self) -> None:  # noqa: B027 (sensors have nothing to energise)
        """Gives power to neutral outputs.

        Raises:
            DeviceError: it refuses.
        """

    def read(self) -> Signals:
        """The newest measurements, in SI units.

        Raises:
            DeviceError: there are none.
        """
        return {}

    def write(self, commands: Signals) -> None:  # noqa: B027
        """Puts commands, in SI units, to the outputs; what is not finite is neutral.

        Of a switch, see `fail_safe`, whatever is near neither 0 nor 1 is the safe side.

        Raises:
            DeviceError: they did not arrive.
        """

    def neutral(self) -> None:  # noqa: B027
        """Puts to the outputs what does not move anything; may come before `activate`.

        Raises:
            DeviceError: it did not arrive.
        """

    def deactivate(self) -> None:
        """Takes the power from the outputs.

        Raises:
            DeviceError: it did not arrive.
        """
        self.neutral()

    @abstractmethod
    def close(self) -> None:
        """Makes the outputs neutral if it can and ends the connection; never raises."""

    def __enter__(self) -> Self:
        """Configures the device, which no other program may have open.

        Raises:
            MissingExtra: the library is not installed.
            DeviceError: see `configure`; or another program has it open.
        """
        with ExitStack() as stack:
            try:
                stack.enter_context(only_program(self.place))
            except (InUse, OSError) as error:
                raise DeviceError(self.name, str(error)) from error
            stack.callback(self.close)
            with standing_still():
                self.configure()
            self._program = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        with standing_still():
            self._program.close()


class NotFitted(Device):
    """Takes commands and does nothing; shows zeros."""

    def __init__(self, name: str, measures: Mapping[str, int], commands: Mapping[str, int]):
        """Creates it.

        Args:
            name: name of the part.
            measures: signals that are shown as zeros, and their sizes.
            commands: signals that are ignored, and their sizes.
        """
        self.name = f"{name} (not fitted)"
        self.measures, self.commands = dict(measures), dict(commands)

    def configure(self) -> None:
        """Does nothing."""

    def read(self) -> Signals:
        """Zeros."""
        return {name: (0.0,) * size for name, size in self.measures.items()}

    def close(self) -> None:
        """Does nothing."""
