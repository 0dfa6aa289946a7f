"""Arrays with labels as bytes: between two of one sender only the values differ."""

import struct
from array import array
from collections.abc import Sequence
from typing import Any

from parapod.systems.hardware.buses.ros2.messages import labels_of

type Labels = Sequence[tuple[str, int]]

# Bytes of a value.
_SIZE = 8


class Arrays:
    """Float64MultiArrays of a program, as they are on the wire.

    The library takes and gives bytes as well as messages, and needs a tenth of the time for them.
    It makes the first array of each kind, and reads the first one that comes: their bytes end with
    the values, in the computer's own order, and what precedes these stays.
    """

    def __init__(self, kind: Any, dimension: Any, serialized: Any, deserialized: Any):
        """Keeps what makes messages.

        Args:
            kind: class of the arrays.
            dimension: class of their labels.
            serialized: gives the bytes of a message.
            deserialized: gives the message of bytes and a class.
        """
        self._kind, self._dimension = kind, dimension
        self._serialized, self._deserialized = serialized, deserialized
        self._beginnings: dict[tuple[str, ...], bytes] = {}
        self._labels: dict[bytes, Labels] = {}
        # Lengths of the beginnings that are known, and the number of values after each.
        self._lengths: dict[int, dict[int, None]] = {}

    def encoded(self, names: tuple[str, ...], stamp: float, values: Sequence[float]) -> bytes:
        """Bytes of an array.

        Args:
            names: names of the values.
            stamp: the time [s].
            values: values, one for each name.
        """
        numbers = array("d", (stamp, *values))
        if names not in self._beginnings:
            one = self._kind(data=numbers)
            one.layout.dim = [
                self._dimension(label=label, size=size, stride=size)
                for label, size in labels_of(names)
            ]
            self._beginnings[names] = self._serialized(one)[: -_SIZE * len(numbers)]
        return self._beginnings[names] + numbers.tobytes()

    def decoded(self, data: bytes) -> tuple[Labels, Sequence[float]]:
        """Labels and values of an array.

        Args:
            data: its bytes.
        """
        for count in self._lengths.get(len(data), ()):
            start = len(data) - _SIZE * count
            labels = self._labels.get(data[:start])
            if labels is not None:
                return labels, struct.unpack_from(f"{count}d", data, start)
        message = self._deserialized(data, self._kind)
        labels = [(each.label, each.size) for each in message.layout.dim]
        values = tuple(message.data)
        end = struct.pack(f"{len(values)}d", *values)
        if data.endswith(end):
            self._labels[data[: len(data) - len(end)]] = labels
            self._lengths.setdefault(len(data), {})[len(values)] = None
        return labels, values
