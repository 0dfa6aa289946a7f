"""A serial CAN adapter on a pseudo terminal: brings a bus of this process to others."""

import threading
from pathlib import Path
from typing import Any, Self

from parapod.systems.hardware.emulators.misbehaviour import Misbehaviour
from parapod.systems.hardware.emulators.pty_port import PtyPort
from parapod.systems.hardware.emulators.slcan import BELL, BITRATES, END, Frame, decoded, encoded
from parapod.systems.hardware.extras import need

# How often the threads look whether they should end or are unplugged [s].
_CYCLE = 0.005
# A line cannot be longer; what is was never one.
_LONGEST_LINE = 64
# Before every so many frames of a garbled adapter there is a damaged line.
_GARBLED = 7
_DAMAGED = b"t1G4\xfez\r"


class SlcanPty:
    """Joins python-can's interface `virtual` to a pseudo terminal that speaks SLCAN.

    While the misbehaviour is `unplugged` there is no terminal; afterwards there is a new one, to
    which the link leads again: see `PtyPort`.

    Attributes:
        link: the symbolic link to the terminal, for `Epos2Params.channel`.
    """

    def __init__(
        self,
        channel: str,
        link: Path | str,
        misbehaviour: Misbehaviour | None = None,
        bitrate: int = 1_000_000,
    ):
        """Prepares the adapter; it is there within a `with` block.

        Args:
            channel: of the interface `virtual`.
            link: where to put a symbolic link to the terminal.
            misbehaviour: what it does wrong.
            bitrate: of the other nodes [bit/s]; nothing passes at another one.
        """
        self._channel, self._bitrate = channel, bitrate
        self._port = PtyPort(link)
        self.link = self._port.link
        self._misbehaviour = misbehaviour or Misbehaviour()
        self._buffer = b""
        self._selected: int | None = None
        self._is_open = False
        self._forwarded = 0
        self._stopping = threading.Event()
        self._threads: list[threading.Thread] = []
        self._bus: Any = None
        self._message: Any = None

    def __enter__(self) -> Self:
        can = need("can")
        self._message = can.Message
        self._bus = can.Bus(interface="virtual", channel=self._channel, ignore_config=True)
        self._stopping.clear()
        self._reset()
        self._port.plug_in()
        for target in (self._serve, self._forward):
            thread = threading.Thread(target=target, name=f"SLCAN {target.__name__}", daemon=True)
            thread.start()
            self._threads.append(thread)
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        while self._threads:
            self._threads.pop().join()
        self._port.unplug()
        self._bus.shutdown()

    def _reset(self) -> None:
        self._is_open, self._selected, self._buffer = False, None, b""

    def _serve(self) -> None:
        """Obeys the lines that come through the port."""
        while not self._stopping.is_set():
            self._port.follow(self._misbehaviour.is_unplugged)
            if not self._port.is_plugged:
                self._reset()
                self._stopping.wait(_CYCLE)
                continue
            for line in self._lines():
                self._port.write(self._answer(line))

    def _lines(self) -> list[str]:
        """Whole lines that have come, without their ends."""
        *lines, rest = (self._buffer + self._port.read(_CYCLE)).split(END)
        self._buffer = rest[-_LONGEST_LINE:]
        return [line.decode("ascii", "replace") for line in lines]

    def _forward(self) -> None:
        """Passes frames on from the bus to the port."""
        while not self._stopping.is_set():
            message = self._bus.recv(_CYCLE)
            if message is None or not self._passes:
                continue
            frame = Frame(message.arbitration_id, bytes(message.data), message.is_extended_id)
            self._forwarded += 1
            if self._misbehaviour.is_garbled and self._forwarded % _GARBLED == 0:
                self._port.write(_DAMAGED)
            self._port.write(encoded(frame))

    @property
    def _passes(self) -> bool:
        return self._is_open and self._selected == self._bitrate

    def _answer(self, line: str) -> bytes:
        """Does what a line asks; what the adapter says."""
        match line[:1]:
            case "":
                return END
            case "S" if line in BITRATES and not self._is_open:
                self._selected = BITRATES[line]
                return END
            case "O" if self._selected is not None and not self._is_open:
                self._is_open = True
                return END
            case "C":
                self._is_open = False
                return END
            case "V":
                return b"V1013" + END
            case "N":
                return b"NA001" + END
            case "F" if self._is_open:
                return b"F00" + END
            case "t" | "T" if self._is_open:
                return self._sent(line)
        return BELL

    def _sent(self, line: str) -> bytes:
        try:
            frame = decoded(line)
        except ValueError:
            return BELL
        if self._passes:
            self._bus.send(
                self._message(
                    arbitration_id=frame.can_id,
                    data=frame.data,
                    is_extended_id=frame.is_extended,
                )
            )
        return (b"Z" if frame.is_extended else b"z") + END
