"""A pure function worked out by another process, for a machine that waits for nothing."""

import logging
import os
import subprocess
import sys
import weakref
from collections.abc import Callable
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

_LOG = logging.getLogger(__name__)


class Background[R]:
    """A pure function of lists of floats, whose results come once they have been worked out.

    A call returns None until then, and waits for nothing. While the process is at work other
    arguments wait for it, of which it takes those that are asked for when it is ready.

    The process begins at once, with ordinary priority, and ends with this object or the program,
    however that ends; Ctrl-C does not reach it. One that ends by itself is named in a line of the
    log, and there are no further results.

    Attributes:
        pid: number of the process.

    Args:
        function: can be pickled, and does not raise.
    """

    def __init__(self, function: Callable[..., R]):
        self._connection, theirs = Pipe()
        with theirs:
            # Not `multiprocessing`, whose process would run a script that drives a machine anew.
            process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                start_new_session=True,
            )
        self.pid = process.pid
        self._end = weakref.finalize(self, _end, process, self._connection)
        self._connection.send(function)
        self._is_at_work = False
        self._last: tuple[tuple[Any, ...], R] | None = None

    def __call__(self, *arguments: Any) -> R | None:
        """The function's result; None until it is there."""
        if self._is_at_work and self._try(self._connection.poll):
            self._last, self._is_at_work = self._try(self._connection.recv), False
        if self._last is not None and self._last[0] == arguments:
            return self._last[1]
        if not self._is_at_work:
            self._is_at_work = True
            self._try(lambda: self._connection.send(arguments))
        return None

    def _try[T](self, call: Callable[[], T]) -> T | None:
        """A call's result; None once the process has ended, which is told the first time."""
        try:
            return call() if self._end.alive else None
        except (EOFError, OSError):
            self._end()
            _LOG.warning("process %d, which works out answers, has ended: none follow", self.pid)
            return None


def _end(process: subprocess.Popen[bytes], connection: Connection) -> None:
    connection.close()
    process.kill()
    process.wait()


def _serve(connection: Connection) -> None:
    """Works out results until the program at the other end ends."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with suppress(EOFError, ConnectionError):
        function = connection.recv()
        while True:
            arguments = connection.recv()
            connection.send((arguments, function(*arguments)))


if __name__ == "__main__":
    _serve(Connection(int(sys.argv[1])))
