"""Arrays with labels as ROS 2 has them on the wire: the bytes of a Float64MultiArray."""

import struct
from collections.abc import Sequence
from functools import lru_cache

from parapod.systems.hardware.buses.message import WrongMessage
from parapod.systems.hardware.buses.ros2.messages import labels_of

type Labels = Sequence[tuple[str, int]]

# Headers of plain CDR, and the orders of its bytes [OMG DDSI-RTPS 2.5, 10.2].
_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
_HEADER = b"\x00\x01\x00\x00"


def encoded(names: Sequence[str], stamp: float, values: Sequence[float]) -> bytes:
    """Bytes of an array whose first value is the time; the library takes ten times as long.

    Args:
        names: names of the values.
        stamp: the time [s].
        values: values, one for each name.
    """
    return _beginning(tuple(names)) + struct.pack(f"<{1 + len(values)}d", stamp, *values)


@lru_cache(maxsize=256)
def _beginning(names: tuple[str, ...]) -> bytes:
    """The bytes before the values."""
    labels = labels_of(names)
    data = bytearray(struct.pack("<I", len(labels)))
    for label, size in labels:
        text = label.encode() + b"\0"
        data += struct.pack("<I", len(text)) + text
        data += bytes(-len(data) % 4) + struct.pack("<II", size, size)
    data += struct.pack("<II", 0, 1 + len(names))
    return _HEADER + data + bytes(-len(data) % 8)


def decoded(data: bytes) -> tuple[Labels, Sequence[float]]:
    """Labels and values of an array.

    Args:
        data: its bytes.

    Raises:
        WrongMessage: other bytes.
    """
    try:
        order, body, at = _ORDERS[data[:2]], data[4:], 4
        labels = []
        for _ in range(*struct.unpack_from(f"{order}I", body)):
            (length,) = struct.unpack_from(f"{order}I", body, at)
            end = at + 4 + length
            label = body[at + 4 : end - 1].decode()
            end += -end % 4
            labels.append((label, *struct.unpack_from(f"{order}I", body, end)))
            at = end + 8  # the stride says nothing more
        (count,) = struct.unpack_from(f"{order}I", body, at + 4)
        at += 8 + -at % 8
        return labels, struct.unpack_from(f"{order}{count}d", body, at) if count else ()
    except (KeyError, ValueError, struct.error) as error:
        raise WrongMessage(f"is not a Float64MultiArray: {error}") from None
