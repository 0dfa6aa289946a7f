"""An SPI bus behind a Unix socket: what one process emulates, another one transfers to."""

import selectors
import socket
import stat
import struct
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol, Self

from parapod.systems.hardware.emulators.misbehaviour import Misbehaviour

# Before the bytes of a transfer, in both directions: how many they are.
_LENGTH = struct.Struct(">H")
# How often the server looks whether its cable is in its place [s].
_POLL = 0.002
_CHUNK = 4096


class SpiBus(Protocol):
    """A chip on an SPI bus, in the words of spidev's `SpiDev`."""

    def xfer2(self, values: list[int], /) -> Sequence[int]:
        """Sends bytes and receives as many, with the chip selected all the time.

        Raises:
            OSError: nothing could be transferred.
        """

    def close(self) -> None:
        """Ends the connection."""


class SpiSocketClient:
    """A chip on the bus of an `SpiSocketServer`.

    A connection that fails is closed; the next transfer makes another one.
    """

    def __init__(self, path: str | Path, timeout: float):
        """Connects to a server.

        Args:
            path: of its socket.
            timeout: longest time for one transfer [s].

        Raises:
            OSError: there is none.
        """
        self._path, self._timeout = str(path), timeout
        self._socket: socket.socket | None = None
        self._connected(time.monotonic() + timeout)

    def xfer2(self, values: Sequence[int], /) -> list[int]:
        """Sends bytes and receives as many.

        Raises:
            TimeoutError: the server did not answer in time.
            OSError: the connection is gone.
        """
        deadline = time.monotonic() + self._timeout
        try:
            connection = self._connected(deadline)
            connection.sendall(_LENGTH.pack(len(values)) + bytes(values))
            (size,) = _LENGTH.unpack(_received(connection, _LENGTH.size, deadline))
            return list(_received(connection, size, deadline))
        except OSError:
            # What comes later would be taken for the answer to the next transfer.
            self.close()
            raise

    def close(self) -> None:
        """Ends the connection."""
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def _connected(self, deadline: float) -> socket.socket:
        if self._socket is None:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                _limit(self._socket, deadline)
                self._socket.connect(self._path)
            except OSError:
                self.close()
                raise
        _limit(self._socket, deadline)
        return self._socket


class SpiSocketServer:
    """Serves a chip to other processes, from the beginning of a `with` block to its end.

    While the misbehaviour is `unplugged`, there are no connections and no socket; everything else
    is up to the chip.

    Attributes:
        address: of the chip, for `Adis16448SpiParams.address`.
    """

    def __init__(self, path: str | Path, bus: SpiBus, misbehaviour: Misbehaviour | None = None):
        """Creates a server that does not listen yet.

        Args:
            path: of the socket; at most some 100 characters.
            bus: the chip.
            misbehaviour: what it does wrong.
        """
        self._path, self._bus = Path(path), bus
        self.address = f"unix:{path}"
        self._misbehaviour = misbehaviour or Misbehaviour()
        self._listener: socket.socket | None = None
        self._buffers: dict[socket.socket, bytes] = {}
        self._selector = selectors.DefaultSelector()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="SPI socket", daemon=True)

    def __enter__(self) -> Self:
        self._plug_in()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        self._unplug()
        self._selector.close()

    def _plug_in(self) -> None:
        if self._path.exists() and stat.S_ISSOCK(self._path.stat().st_mode):
            # One that a server has left behind which was killed.
            self._path.unlink()
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listener.bind(str(self._path))
        self._listener.listen()
        self._selector.register(self._listener, selectors.EVENT_READ)

    def _unplug(self) -> None:
        for connection in list(self._buffers):
            self._hang_up(connection)
        listener, self._listener = self._listener, None
        if listener is not None:
            self._selector.unregister(listener)
            listener.close()
            self._path.unlink(missing_ok=True)

    def _hang_up(self, connection: socket.socket) -> None:
        del self._buffers[connection]
        self._selector.unregister(connection)
        connection.close()

    def _serve(self) -> None:
        while not self._closing.is_set():
            if self._misbehaviour.is_unplugged:
                self._unplug()
                self._closing.wait(_POLL)
                continue
            if self._listener is None:
                self._plug_in()
            for key, _ in self._selector.select(_POLL):
                if key.fileobj is self._listener:
                    self._accept(self._listener)
                elif isinstance(key.fileobj, socket.socket):
                    self._answer(key.fileobj)

    def _accept(self, listener: socket.socket) -> None:
        connection, _ = listener.accept()
        connection.setblocking(False)
        self._buffers[connection] = b""
        self._selector.register(connection, selectors.EVENT_READ)

    def _answer(self, connection: socket.socket) -> None:
        """Transfers what has come whole; hangs up on a client that is gone or asks too much."""
        try:
            data = connection.recv(_CHUNK)
            if not data:
                raise ConnectionResetError
            self._buffers[connection] += data
            while (values := self._taken(connection)) is not None:
                answer = bytes(self._bus.xfer2(values))
                connection.sendall(_LENGTH.pack(len(answer)) + answer)
        except OSError:
            self._hang_up(connection)

    def _taken(self, connection: socket.socket) -> list[int] | None:
        """The next whole transfer that has come."""
        buffer = self._buffers[connection]
        with suppress(struct.error):
            (size,) = _LENGTH.unpack_from(buffer)
            end = _LENGTH.size + size
            if len(buffer) >= end:
                self._buffers[connection] = buffer[end:]
                return list(buffer[_LENGTH.size : end])
        return None


def _limit(connection: socket.socket, deadline: float) -> None:
    """Makes the next operation end by then."""
    left = deadline - time.monotonic()
    if left <= 0.0:
        raise TimeoutError("timed out")
    connection.settimeout(left)


def _received(connection: socket.socket, size: int, deadline: float) -> bytes:
    """That many bytes."""
    data = b""
    while len(data) < size:
        _limit(connection, deadline)
        chunk = connection.recv(size - len(data))
        if not chunk:
            raise ConnectionResetError("the other end has hung up")
        data += chunk
    return data
