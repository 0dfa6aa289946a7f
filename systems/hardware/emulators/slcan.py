"""The serial line protocol of CAN adapters (SLCAN): LAWICEL, CANUSB manual, ASCII commands.

Each command is a line that ends with a carriage return; the adapter answers with another, or with
a bell if it refuses. Frames travel both ways as `tIIILDD..` with an identifier of 11 bits in three
hexadecimal digits, one digit of length, and the data; `T` has eight digits for 29 bits.
"""

from typing import NamedTuple

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
        is_extended: whether the identifier has 29 bits.
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
