"""Logs in MCAP files, one topic for each part, as ROS 2 has them."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.sims.output.atomic import atomic_output
from parapod.sims.output.logs.part_messages import ENCODING, SCHEMA_ENCODING, part_messages
from parapod.sims.output.logs.thinning import Snapshots
from parapod.systems.core.extras import need

# Stamp [ns], time [s] and samples of the signals.
type Picture = tuple[int, float, Mapping[str, NDArray[Any]]]
# Takes shapes of samples, and pictures, and draws them; raises a ParapodError where it cannot.
type Draw = Callable[[Mapping[str, tuple[int, ...]], Sequence[Picture]], Iterable[Message]]

# Pictures of the machine: ten a second of some minutes.
_PICTURES = 1500
# Longest time for which what has been read is not in the file, hence that of a chunk [s].
FLUSH_PERIOD = 0.2


class Schema(NamedTuple):
    """Name, encoding and text of the schema of a topic."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class Message:
    """One message of a drawing.

    Attributes:
        topic: its topic.
        schema: the topic's.
        stamp: its time [ns].
        data: its content.
    """

    topic: str
    schema: Schema
    stamp: int
    data: bytes


class McapWriter:
    """Writes samples into a stream, readable up to wherever it ends.

    Each part has one message a time (see `PartMessage`), which tools of ROS 2 read, Foxglove and
    PlotJuggler. What is written between two calls of `flush` is a chunk, compressed; a file that
    ends in the middle can be read up to its last whole chunk (`read_log`, or `mcap recover`).
    Behind them is an index, so that readers take messages in the order of time.
    """

    def __init__(
        self,
        stream: IO[bytes],
        units: Mapping[str, str],
        sizes: Sequence[int],
        metadata: Mapping[str, str],
    ):
        """Writes what comes before the first sample.

        Args:
            stream: open for writing.
            units: units of each port, in the order in which `write` is given them.
            sizes: number of elements of each of them.
            metadata: data about the run.

        Raises:
            MissingExtra: mcap or rosbags is not installed.
        """
        self._names, self._ends = [*units], np.cumsum(sizes)
        self._writer = need("mcap.writer").Writer(stream)
        self._writer.start(profile="ros2", library="parapod")
        self._writer.add_metadata("parapod", dict(metadata))
        self._channels: dict[str, int] = {}
        self._parts = []  # with their channels and the places of their numbers in a row
        places = np.split(np.arange(sum(sizes)), self._ends)
        for part in part_messages(units, sizes):
            schema = Schema(part.kind, SCHEMA_ENCODING, part.definition.encode())
            channel = self._register(part.topic, schema, part.metadata)
            row = np.concatenate([places[each.place] for each in part.signals])
            self._parts.append((part, channel, row))
        self._count = 0
        self._pictures: Snapshots[tuple[int, float, NDArray[np.float64]]] = Snapshots(_PICTURES)

    def _register(self, topic: str, schema: Schema, metadata: Mapping[str, str]) -> int:
        """Number of the channel of a topic."""
        if topic not in self._channels:
            number = self._writer.register_schema(*schema)
            self._channels[topic] = self._writer.register_channel(
                topic, ENCODING, number, dict(metadata)
            )
        return self._channels[topic]

    def write(self, stamp: int, t: float, row: NDArray[np.float64]) -> None:
        """Writes the values of all ports at one time.

        Args:
            stamp: stamp of the messages [ns].
            t: time of the loop [s].
            row: numbers of all ports, one after the other.
        """
        for part, channel, places in self._parts:
            data = part.encoded(stamp, t, row[places])
            self._writer.add_message(channel, stamp, data, stamp, self._count)
        self._pictures.take((stamp, t, row.copy()))
        self._count += 1

    def flush(self) -> None:
        """Ends a chunk, and has everything in the file."""
        self._writer.flush()

    def draw(self, draw: Draw) -> None:
        """Draws the machine; where it cannot be drawn, the file says why.

        Args:
            draw: draws the machine.
        """
        self.flush()
        pictures: list[Picture] = [
            (stamp, t, dict(zip(self._names, np.split(row, self._ends[:-1]), strict=False)))
            for stamp, t, row in self._pictures.rows
        ]
        if not pictures:
            return
        try:
            shapes = {name: value.shape for name, value in pictures[0][2].items()}
            for message in draw(shapes, pictures):
                channel = self._register(message.topic, message.schema, {})
                self._writer.add_message(channel, message.stamp, message.data, message.stamp)
        except Exception as error:  # whatever a drawing meets, it must not cost the log
            self._writer.add_metadata("drawing", {"left_out": str(error)})

    def finish(self) -> None:
        """Writes the end of the file."""
        self._writer.finish()


def write_mcap(
    path: Path,
    times: ArrayLike,
    signals: Mapping[str, ArrayLike],
    units: Mapping[str, str],
    metadata: Mapping[str, str],
    draw: Draw | None = None,
) -> None:
    """Writes the log of a simulation, whose messages are stamped with the simulated time.

    Args:
        path: the file.
        times: (n) [s].
        signals: port name -> (n, ...) samples; those at one time become a list of numbers.
        units: port name -> unit.
        metadata: data about the run.
        draw: draws the machine; None: it is not drawn.

    Raises:
        OutputError: the file cannot be written.
        MissingExtra: mcap or rosbags is not installed.
    """
    instants = np.asarray(times, dtype=float).tolist()
    arrays = [np.asarray(signals[name], dtype=float) for name in units]
    columns = [array.reshape(len(instants), -1) for array in arrays]
    rows = np.concatenate([np.empty((len(instants), 0)), *columns], axis=1)
    sizes = [column.shape[1] for column in columns]
    with atomic_output(path) as temporary, open(temporary, "wb") as stream:
        writer, flushed = McapWriter(stream, units, sizes, metadata), -math.inf
        for t, row in zip(instants, rows, strict=True):
            if t - flushed >= FLUSH_PERIOD:
                writer.flush()
                flushed = t
            writer.write(round(1e9 * t), t, row)
        if draw is not None:
            writer.draw(draw)
        writer.finish()
