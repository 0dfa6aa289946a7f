"""Messages of ROS 2 with the signals of a part: a topic and a type of its own for each part."""

import json
import re
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from parapod.systems.core.extras import need

ENCODING, SCHEMA_ENCODING = "cdr", "ros2msg"
# Part of the signals whose names have none, such as those of a controller.
LOOP = "loop"
# Between a definition and those that it needs, as MCAP has it for the encoding `ros2msg`
# (https://mcap.dev/spec/registry).
_SEPARATOR = 80 * "="
# Names that signals cannot have: of fields in every message, and of topics with the drawing.
_FIELDS, _TOPICS = ("header", "t"), ("tf", "tf_static", "scene", "robot_description")
# Bytes before the numbers: the encapsulation of little-endian CDR, seconds, nanoseconds, the empty
# `frame_id` with its length, and what aligns the time, which is a double.
_HEAD = struct.Struct("<4BiII4xd")


@dataclass(frozen=True)
class PartSignal:
    """One signal of a part.

    Attributes:
        name: name of its port.
        unit: its unit.
        size: number of its elements; a signal without any has no field.
        field: its field in the message.
        place: its place among all signals of the log.
    """

    name: str
    unit: str
    size: int
    field: str
    place: int


class PartMessage:
    """Messages with the signals of one part at one time.

    A message has a `std_msgs/Header`, the loop's time `t` [s], and a field of fixed size for each
    signal; it is a record of fixed length, whose numbers are decoded for many messages at once.

    Attributes:
        topic: topic of the messages.
        kind: name of their type.
        signals: the signals, in the order of their fields.
    """

    def __init__(self, topic: str, kind: str, signals: Sequence[PartSignal]):
        """Describes the messages.

        Args:
            topic: topic of the messages.
            kind: name of their type.
            signals: the signals, in the order of their fields.
        """
        self.topic, self.kind, self.signals = topic, kind, tuple(signals)
        fields = [("", "<f8", (each.size,)) for each in signals]
        self._record = np.dtype([("", f"V{_HEAD.size - 8}"), ("", "<f8"), *fields])

    @property
    def definition(self) -> str:
        """Definition of the type and of those that it needs, with names and units as comments.

        Raises:
            MissingExtra: rosbags is not installed.
        """
        lines = ["std_msgs/Header header", "float64 t  # time of the loop [s]"]
        for each in self.signals:
            array = f"[{each.size}]" if each.size > 1 else ""
            comment = " ".join(f"{each.name} [{each.unit}]".split())
            lines += [f"float64{array} {each.field}  # {comment}"] if each.size else []
        header = definition_of("std_msgs/msg/Header")
        return "\n".join([*lines, _SEPARATOR, "MSG: std_msgs/Header", header])

    @property
    def metadata(self) -> dict[str, str]:
        """Description of the signals, as metadata of a channel: `signals`, a JSON text."""
        signals = [asdict(each) for each in self.signals]
        return {"signals": json.dumps(signals, ensure_ascii=False)}

    @classmethod
    def from_metadata(cls, topic: str, kind: str, metadata: Mapping[str, str]) -> Self:
        """Messages of a channel.

        Args:
            topic: topic of the channel.
            kind: name of its type.
            metadata: metadata of the channel, as `metadata` says.
        """
        signals = [PartSignal(**each) for each in json.loads(metadata["signals"])]
        return cls(topic, kind, signals)

    def encoded(self, stamp: int, t: float, row: NDArray[np.float64]) -> bytes:
        """One message.

        Args:
            stamp: time of the header [ns].
            t: time of the loop [s].
            row: (n,) numbers of the part's signals, one after the other.
        """
        head = _HEAD.pack(0, 1, 0, 0, *divmod(stamp, 10**9), 1, t)
        return head + row.astype("<f8", copy=False).tobytes()

    def decoded(
        self, messages: Sequence[bytes]
    ) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """Times (n) [s] of messages, and samples (n, size) of the signals by name.

        Raises:
            ValueError: the messages have another length.
        """
        records = np.frombuffer(b"".join(messages), self._record)
        _, *fields = self._record.names or ()
        times, *samples = (records[field] for field in fields)
        return times, {s.name: each for s, each in zip(self.signals, samples, strict=True)}


def part_messages(units: Mapping[str, str], sizes: Sequence[int]) -> list[PartMessage]:
    """Messages of all parts of which there are signals.

    A signal `<part>.<signal>` is the field `<signal>` in the topic `/<part>` of the type
    `parapod_msgs/msg/<Part>`; one without a dot is a field in `/loop`. Where ROS 2 does not admit
    a name, it is changed to one that it does; `PartSignal.name` is as it was.

    Args:
        units: units of the signals, by name.
        sizes: number of elements of each of them.
    """
    parts: dict[str, list[PartSignal]] = {}
    for place, ((name, unit), size) in enumerate(zip(units.items(), sizes, strict=True)):
        part, dot, signal = name.partition(".")
        fields = parts.setdefault(_admissible(part if dot else LOOP, _TOPICS), [])
        field = _admissible(signal if dot else name, {*_FIELDS, *(s.field for s in fields)})
        fields.append(PartSignal(name, unit, int(size), field, place))
    kinds: list[str] = []
    for part in parts:
        kinds.append(_unique("".join(word.capitalize() for word in part.split("_")), kinds, ""))
    return [
        PartMessage(f"/{part}", f"parapod_msgs/msg/{kind}", signals)
        for (part, signals), kind in zip(parts.items(), kinds, strict=True)
    ]


def _admissible(name: str, others: Collection[str]) -> str:
    """A name that ROS 2 admits for a field: lower case, beginning with a letter, single `_`."""
    text = re.sub("[^a-z0-9]+", "_", name.lower()).strip("_")
    return _unique(text if text[:1].isalpha() else f"x_{text}".rstrip("_"), others, "_")


def _unique(name: str, others: Collection[str], link: str) -> str:
    candidates = (name, *(f"{name}{link}{number}" for number in range(2, len(others) + 3)))
    return next(each for each in candidates if each not in others)


@cache
def types() -> Any:
    """Types of messages that ROS 2 has, as rosbags knows them.

    Raises:
        MissingExtra: rosbags is not installed.
    """
    typesys = need("rosbags.typesys")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def definition_of(kind: str) -> str:
    """Definition of a type that ROS 2 has, and of those that it needs.

    Raises:
        MissingExtra: rosbags is not installed.
    """
    text, _ = types().generate_msgdef(kind, ros_version=2)
    return str(text)
