"""A module that runs as a process of its own, for what a real machine must not wait for.

That is a disk, or a browser. Two pipes lead to it and back. One line tells it how to begin,
and answers with one. It ends when its pipe does, however the program at the other end has ended;
Ctrl-C does not reach it.
"""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator

PIECE = 1 << 16  # bytes that are read at once


class Companion:
    """The process, seen from the program that begins it.

    Attributes:
        pid: its number.
        sink: file descriptor of the pipe to it.
    """

    def __init__(self, module: str, beginning: str):
        """Begins the process.

        Args:
            module: name of the module; it calls `read_beginning` first.
            beginning: line that says how to begin.
        """
        self._process = subprocess.Popen(
            [sys.executable, "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self.pid = self._process.pid
        self.sink = self._process.stdin.fileno()
        self._process.stdin.write(f"{beginning}\n".encode())

    def answer(self, longest: float) -> bytes:
        """The line with which it says that it has begun, or why not; nothing: it does neither.

        Args:
            longest: time that it may take [s].
        """
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], longest)[0]:
            return b""
        return self._process.stdout.readline()

    def lines(self) -> Iterator[bytes]:
        """All further lines, each as soon as it is there, until the process has ended."""
        assert self._process.stdout is not None
        return iter(self._process.stdout)

    def end(self, longest: float) -> int:
        """Ends the pipe and waits for the process; its exit code.

        Args:
            longest: time that it may take before it is killed [s].
        """
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            return self._process.wait(longest)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()


def read_beginning() -> tuple[int, str, bytes]:
    """Pipe from the program, the line that it has begun with, and what came behind that already.

    To be called by the process, which nothing but the end of the pipe ends from now on.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # it ends when there is nothing more to do
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    source, data = sys.stdin.fileno(), b""
    while b"\n" not in data and (piece := os.read(source, PIECE)):
        data += piece
    beginning, _, rest = data.partition(b"\n")
    return source, beginning.decode(), rest
