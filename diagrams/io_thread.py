"""Functions of one's own beside a loop: called in a thread, watched, never waited for."""

from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Self

from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from parapod.diagrams.wiring import add, connect
from parapod.systems.core.errors import ParapodError
from parapod.systems.hardware.device import Device, Signals
from parapod.systems.hardware.io import (
    COMMAND_TIMEOUT,
    STALE_AFTER,
    DeviceThread,
    PartReader,
    PartWriter,
)

type Numbers = Sequence[float]

_MEASUREMENT, _COMMAND = "measurement", "command"


class IoThread(Diagram):
    """Calls of a bus, a socket or a library that block, as a system that does not.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `command` | n | any | numbers to write; with `write` alone |
    | out `measurement` | m | any | the newest numbers that were read; with `read` alone |
    | out `age` | 1 | s | time since that reading was begun |
    | out `fault` | 1 | code | a `DeviceFault` of the last call; 0: none |

    Within `with io:` a thread calls `read` once a period, so early that it ends just before the
    loop takes the numbers, and `write` as soon as there is a command. Nothing in the loop waits.
    `neutral` is called when no command has come for `timeout`, and at the end. What is not finite
    is not written: it is neutral as well.

    State: that of a `PartReader`. The thread is beside the Context: one simulation at a time.

    Bad input: `measurement` is NaN while the newest reading is older than `stale_after`, and as
    long as there is none; a call that raises shows as `fault`, and is tried again.
    """

    def __init__(
        self,
        read: Callable[[], Numbers] | None = None,
        size: int = 0,
        write: Callable[[Numbers], object] | None = None,
        count: int = 0,
        neutral: Callable[[], object] | None = None,
        period: float = 0.01,
        timeout: float = COMMAND_TIMEOUT,
        stale_after: float = STALE_AFTER,
        name: str = "io",
    ):
        """Creates the system; nothing is called yet.

        Args:
            read: returns numbers (m); None: nothing is read.
            size: number m of them.
            write: takes numbers (n); None: nothing is written.
            count: number n of them.
            neutral: has what `write` moves stop; None: `write` of zeros does.
            period: period of the loop and of the readings [s].
            timeout: age from which a command does not count any more [s].
            stale_after: age from which a reading does not count any more [s].
            name: name in messages.

        Raises:
            ParapodError: neither function, or a function without a number.
        """
        super().__init__()
        for function, number, words in ((read, size, "size"), (write, count, "count")):
            if (function is not None) != (number > 0):
                raise ParapodError(f"{name}: {words} must be above 0 with its function alone")
        if read is None and write is None:
            raise ParapodError(f"{name}: there must be a function to read or one to write")
        self._device = _Functions(name, read, size, write, count, neutral)
        self._io = DeviceThread(self._device, period, timeout)
        builder = DiagramBuilder()
        self._reader = add(builder, PartReader(name, [self._io], period, stale_after))
        writer = add(builder, PartWriter(name, [self._io], period))
        connect(builder, self._reader.GetOutputPort("stamp"), writer.GetInputPort("stamp"))
        for port in (*(_MEASUREMENT,) * (read is not None), "age", "fault"):
            builder.ExportOutput(self._reader.GetOutputPort(port), port)
        if write is not None:
            builder.ExportInput(writer.GetInputPort(_COMMAND), _COMMAND)
        builder.BuildInto(self)
        self.set_name(name)

    def __enter__(self) -> Self:
        """Starts the thread.

        Raises:
            DeviceError: the first reading has failed.
        """
        self._device.__enter__()
        try:
            self._io.start()
        except BaseException:
            self._device.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Ends the thread; what it moves is neutral.

        Raises:
            Exception: what `neutral` has raised.
        """
        problem = self._io.stop()
        self._device.__exit__(kind, error, traceback)
        if problem is not None and error is None:
            raise problem

    def reset(self, root_context: Context) -> None:
        """Puts the newest numbers into a root context, so that a loop begins with measurements.

        Raises:
            DeviceError: the last call has failed.
        """
        self._reader.reset(self._reader.GetMyMutableContextFromRoot(root_context))


class _Functions(Device):
    """Functions as a device."""

    def __init__(
        self,
        name: str,
        read: Callable[[], Numbers] | None,
        size: int,
        write: Callable[[Numbers], object] | None,
        count: int,
        neutral: Callable[[], object] | None,
    ):
        self.name = name
        self.measures = {} if read is None else {_MEASUREMENT: size}
        self.commands = {} if write is None else {_COMMAND: count}
        self._read, self._write, self._neutral, self._count = read, write, neutral, count

    def configure(self) -> None:
        """Does nothing: the functions are there."""

    def read(self) -> Signals:
        """See `Device`."""
        if self._read is None:
            return {}
        numbers, (size,) = tuple(map(float, self._read())), self.measures.values()
        if len(numbers) != size:
            raise ParapodError(f"{self.name}: read returned {len(numbers)} numbers, not {size}")
        return {_MEASUREMENT: numbers}

    def write(self, commands: Signals) -> None:
        """See `Device`."""
        numbers = commands[_COMMAND]
        if not all(abs(number) < float("inf") for number in numbers):
            self.neutral()
        elif self._write is not None:
            self._write(numbers)

    def neutral(self) -> None:
        """See `Device`."""
        if self._neutral is not None:
            self._neutral()
        elif self._write is not None:
            self._write((0.0,) * self._count)

    def close(self) -> None:
        """Does nothing: `deactivate` has made it neutral."""
