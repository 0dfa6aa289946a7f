"""A serial CAN adapter on a pseudo terminal, and the protocol (SLCAN) that it speaks.

LAWICEL, CANUSB manual, ASCII commands: each command is a line that ends with a carriage return;
the adapter answers with another, or with a bell if it refuses. Frames travel both ways as
`tIIILDD..` with an identifier of 11 bits in three hexadecimal digits, one digit of length, and
the data; `T` has eight digits for 29 bits.
"""

import threading
from pathlib import Path
from typing import Any, NamedTuple, Self

from parapod.systems.core.extras import need
from parapod.systems.hardware.emulation.harness import Misbehaviour
from parapod.systems.hardware.emulation.pty import PtyPort

END, BELL = b"\r", b"\a"
BITRATES = {
    "S0": 10_000,
    "S1": 20_000,
    "S2": 50_000,
    "S3": 100_000,
    "S4": 125_000,
    "S5": 250_000,
    "S6": 500_000,
    "S7": 800_000,
    "S8": 1_000_000,
}


class Frame(NamedTuple):
    """A data frame.

    Attributes:
        can_id: its identifier.
        data: up to eight bytes.
        is_extended: true if the identifier has 29 bits.
    """

    can_id: int
    data: bytes
    is_extended: bool = False


def encoded(frame: Frame) -> bytes:
    """The line that carries a frame."""
    head = f"T{frame.can_id:08X}" if frame.is_extended else f"t{frame.can_id:03X}"
    return f"{head}{len(frame.data)}{frame.data.hex().upper()}".encode() + END


def decoded(line: str) -> Frame:
    """The frame that a line carries, without its end.

    Raises:
        ValueError: it carries none.
    """
    digits = {"t": 3, "T": 8}.get(line[:1])
    if digits is None:
        raise ValueError(f"{line!r} is not a data frame")
    can_id = int(line[1 : 1 + digits], 16)
    size = int(line[1 + digits : 2 + digits])
    data = bytes.fromhex(line[2 + digits :])
    limit = 1 << (11 if digits == 3 else 29)
    if len(data) != size or size > 8 or can_id >= limit:
        raise ValueError(f"{line!r} has a wrong length or identifier")
    return Frame(can_id, data, digits == 8)


# Time between two looks of the threads at their end and the plug [s].
_CYCLE = 0.005
# Longest SLCAN line; longer input is discarded [bytes].
_LONGEST_LINE = 64
# Frames of a garbled adapter between two damaged lines.
_GARBLED = 7
_DAMAGED = b"t1G4\xfez\r"


class SlcanPty:
    """Joins python-can's interface `virtual` to a pseudo terminal that speaks SLCAN.

    While the misbehaviour is `unplugged` there is no terminal; afterwards there is a new one, to
    which the link leads again: see `PtyPort`.

    Attributes:
        link: the symbolic link to the terminal, for `AxesSettings.channel`.
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
            channel: channel of the interface `virtual`.
            link: path for a symbolic link to the terminal.
            misbehaviour: faults of the device.
            bitrate: bitrate of the other nodes [bit/s]; nothing passes at another one.
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
