"""A serial port that is not there: a pseudo terminal behind a link, which can be unplugged."""

import os
import select
import termios
import threading
import tty
from contextlib import suppress
from pathlib import Path

_BYTES = 4096
_SPEED = 5  # in the list of termios attributes: the output speed
_SPEEDS = {
    getattr(termios, f"B{baud}"): baud for baud in (2400, 9600, 19200, 38400, 57600, 115200)
}


class PtyPort:
    """A pseudo terminal without line discipline, to which a symbolic link leads.

    Unplugged, there is neither terminal nor link, and who has it open gets errors; plugged in
    again, there is a new terminal. A real adapter that is plugged in again finds its udev link so.

    One thread plugs and reads; others may write.

    Attributes:
        link: the symbolic link to the terminal.
    """

    def __init__(self, link: Path | str):
        """Describes a port that is not plugged in.

        Args:
            link: path for the symbolic link.
        """
        self.link = Path(link)
        self._terminal: _Terminal | None = None

    @property
    def baud(self) -> int | None:
        """The speed that the client has set [bit/s]; None: unplugged, or an unusual one."""
        terminal = self._terminal
        return None if terminal is None else terminal.baud

    @property
    def is_plugged(self) -> bool:
        """Whether there is a terminal."""
        return self._terminal is not None

    def follow(self, is_unplugged: bool) -> None:
        """Plugs in or unplugs, unless it is so already.

        Args:
            is_unplugged: true to unplug it, false to plug it in.
        """
        if is_unplugged:
            self.unplug()
        elif not self.is_plugged:
            self.plug_in()

    def plug_in(self) -> None:
        """Opens a terminal and has the link lead to it."""
        self._terminal = _Terminal()
        # Renamed into place, so that the link is never missing or leads elsewhere.
        fresh = self.link.with_name(f"{self.link.name}.new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self._terminal.path)
        fresh.replace(self.link)

    def unplug(self) -> None:
        """Takes the link and the terminal away, if they are there."""
        terminal, self._terminal = self._terminal, None
        if terminal is not None:
            self.link.unlink(missing_ok=True)
            terminal.close()

    def read(self, timeout: float) -> bytes:
        """Bytes that have come; none after a time without any [s]."""
        terminal = self._terminal
        return b"" if terminal is None else terminal.read(timeout)

    def write(self, data: bytes) -> None:
        """Writes, unless it is unplugged, or the terminal is full because it is not read."""
        terminal = self._terminal
        if terminal is not None:
            terminal.write(data)


class _Terminal:
    """A pseudo terminal, from its opening to its end."""

    def __init__(self) -> None:
        # The far end stays open here, or the near one would fail while no client has it open.
        self._near, self._far = os.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        self.path = os.ttyname(self._far)
        self._lock = threading.Lock()
        self._is_closed = False

    @property
    def baud(self) -> int | None:
        return _SPEEDS.get(termios.tcgetattr(self._far)[_SPEED])

    def close(self) -> None:
        with self._lock:
            self._is_closed = True
            os.close(self._near)
            os.close(self._far)

    def read(self, timeout: float) -> bytes:
        if not select.select([self._near], [], [], timeout)[0]:
            return b""
        with suppress(OSError):
            return os.read(self._near, _BYTES)
        return b""

    def write(self, data: bytes) -> None:
        with self._lock, suppress(BlockingIOError):
            if not self._is_closed:
                os.write(self._near, data)
