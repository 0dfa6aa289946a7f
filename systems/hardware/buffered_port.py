"""A serial port that is read in one piece, for a library that reads byte by byte."""

from typing import Any


class BufferedPort:
    """A pyserial port whose single bytes come from what has been read at once.

    python-can's SLCAN interface asks the system for every byte; with the frames of a dozen nodes
    that takes milliseconds of each cycle. Everything else is the port's own.
    """

    def __init__(self, port: Any):
        """Wraps a port.

        Args:
            port: of pyserial, open.
        """
        self._port = port
        self._buffer = bytearray()

    def read(self, size: int = 1) -> bytes:
        """Up to so many bytes; fewer if the port's timeout passes meanwhile."""
        if not self._buffer:
            self._buffer += self._port.read(max(size, self._port.in_waiting))
        taken = bytes(self._buffer[:size])
        del self._buffer[:size]
        return taken

    @property
    def in_waiting(self) -> int:
        """How many bytes can be read at once."""
        return len(self._buffer) or self._port.in_waiting

    @property
    def write_timeout(self) -> float | None:
        """Longest time for a write [s]; None for ever."""
        timeout: float | None = self._port.write_timeout
        return timeout

    @write_timeout.setter
    def write_timeout(self, timeout: float | None) -> None:
        self._port.write_timeout = timeout

    def reset_input_buffer(self) -> None:
        """Forgets what has come and not been read."""
        self._buffer.clear()
        self._port.reset_input_buffer()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)
