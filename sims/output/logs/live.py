"""A log that grows while the machine moves, written by a process of its own.

Whoever logs hands the numbers to the kernel and goes on: encoding them would keep Python's lock
from the threads that talk to the devices, and a disk may stand still for a second. The process
reads them from a pipe, which holds some seconds. It ends when the pipe does, however the program
at its other end has ended, and leaves a whole file.
"""

import fcntl
import json
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from parapod.sims.output.atomic import check_writable
from parapod.sims.output.companion import Companion
from parapod.systems.core.errors import OutputError
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import quoted_path
from parapod.systems.hardware.clock import calendar_time_ns

_CAPACITY = 1 << 20  # capacity of the pipe, the most that an ordinary user gets [bytes]
# How long the process may take to begin, and to write what is left with the drawing [s]; how often
# one looks.
_BEGINNING, _ENDING, _LOOK = 60.0, 60.0, 0.01
READY = b"ready\n"
# Numbers before those of the ports: stamp [ns], as bits of an integer, and time.
HEAD = 2


class LiveLog:
    """Writes samples to an MCAP file; the loop waits neither for the disk nor for an encoder.

    The messages (see `McapWriter`) are stamped with the wall clock, so that logs of several
    programs can be laid over each other. A file that cannot be written is reported at once, and
    again by an error at the end; meanwhile the program goes on.

    Attributes:
        lost: number of samples that are not in the file, because the disk was too slow.
        process: number of the process that writes; None before the beginning.
    """

    def __init__(
        self,
        path: Path,
        units: Mapping[str, str],
        sizes: Sequence[int],
        metadata: Mapping[str, str],
        tell: Callable[[str], None] = lambda text: None,
    ):
        """Describes the log; the file is made by entering the context.

        Args:
            path: path of the file.
            units: units of each port that is logged, in the order in which `write` is given them.
            sizes: number of elements of each of them.
            metadata: data about the run.
            tell: called with an error as soon as it occurs, perhaps from another thread.

        Raises:
            OutputError: the file cannot be written.
            MissingExtra: mcap or rosbags is not installed.
        """
        check_writable(path)
        need("mcap.writer")
        need("rosbags.typesys")
        self.lost = 0
        self.process: int | None = None
        self._path, self._tell = path, tell
        described = {"path": str(path.absolute()), "units": dict(units), "sizes": [*sizes]}
        self._beginning = json.dumps(described | {"metadata": dict(metadata)})
        self._row = np.zeros(HEAD + sum(sizes))
        self._stamp = self._row.view(np.int64)
        self._places = np.split(self._row[HEAD:], np.cumsum(sizes))[:-1]
        self._rest, self._wrong = b"", ""
        self._is_broken = False  # the process has ended before the log

    def write(self, t: float, values: Sequence[Any]) -> None:
        """Hands over the values of all ports at one time.

        Args:
            t: time of the loop [s].
            values: arrays with the values of the ports.
        """
        if self._is_broken and not self._thread.is_alive():
            self._fail("its process has ended")  # without a word
        if self._wrong or self._is_broken:
            return
        self._stamp[0], self._row[1] = calendar_time_ns(), t
        for place, value in zip(self._places, values, strict=True):
            place[:] = value
        row = self._row.tobytes()
        if len(self._rest) < len(row):
            self._rest += row
        else:
            self._lose()
        with suppress(BlockingIOError):
            self._hand_over()

    def _hand_over(self) -> None:
        """Gives the pipe as much as it takes; why a process has ended `_listen` hears."""
        try:
            self._rest = self._rest[os.write(self._pipe, self._rest) :]
        except BrokenPipeError:
            self._rest, self._is_broken = b"", True

    def _lose(self) -> None:
        self.lost += 1
        if self.lost == 1:
            self._tell(f"{quoted_path(self._path)}: the disk is too slow; samples are left out")

    def _fail(self, reason: str) -> None:
        if not self._wrong:
            self._wrong = f"cannot write {quoted_path(self._path)}: {reason}"
            self._tell(self._wrong)

    def __enter__(self) -> Self:
        self._companion = Companion("parapod.sims.lab.log_process", self._beginning)
        self.process, self._pipe = self._companion.pid, self._companion.sink
        answer = self._companion.answer(_BEGINNING)
        if answer != READY:
            self._companion.end(_ENDING)
            reason = answer.decode(errors="replace").strip() or "its process does not begin"
            raise OutputError(f"cannot write {quoted_path(self._path)}: {reason}", self._path)
        with suppress(OSError, AttributeError):  # elsewhere than on Linux it holds less
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _CAPACITY)
        os.set_blocking(self._pipe, False)
        self._thread = threading.Thread(target=self._listen, name="log", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        deadline = time.monotonic() + _ENDING
        while self._rest and not self._wrong and time.monotonic() < deadline:
            try:
                self._hand_over()
            except BlockingIOError:
                time.sleep(_LOOK)
        if self._companion.end(_ENDING) != 0:
            self._is_broken = True
        self._thread.join()
        if self._is_broken:
            self._fail("its process has ended")
        if self.lost:
            self._tell(f"{quoted_path(self._path)}: {self.lost} samples are missing")
        if self._wrong and error is None:
            raise OutputError(self._wrong, self._path)

    def _listen(self) -> None:
        """Tells what goes wrong in the process while it writes."""
        for line in self._companion.lines():
            self._fail(line.decode(errors="replace").strip())
