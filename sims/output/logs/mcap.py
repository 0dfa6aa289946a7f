"""Logs in MCAP files, one topic for each port."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.sims.output.atomic import atomic_output
from parapod.sims.output.logs.thinning import Snapshots
from parapod.systems.core.extras import need

# Stamp [ns], time [s] and samples of the signals.
type Picture = tuple[int, float, Mapping[str, NDArray[Any]]]
# Takes shapes of samples, and pictures, and draws them; raises a ParapodError where it cannot.
type Draw = Callable[[Mapping[str, tuple[int, ...]], Sequence[Picture]], Iterable[Message]]

# Pictures of the machine: ten a second of some minutes.
_PICTURES = 1500


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


def _schema(name: str, unit: str) -> bytes:
    """JSON schema of the messages of a port."""
    schema = {
        "title": f"parapod.{name}",
        "type": "object",
        "properties": {
            "t": {"type": "number", "description": "time of the loop [s]"},
            "value": {
                "type": "array",
                "description": f"{name} [{unit}]",
                "items": {"type": ["number", "null"]},
            },
        },
        "required": ["t", "value"],
    }
    return json.dumps(schema, ensure_ascii=False).encode()


class McapWriter:
    """Writes samples into a stream, readable up to wherever it ends.

    Each message is `{"t": time, "value": [...]}` in JSON, which Foxglove and every other reader of
    MCAP shows; a number that is not finite is null. There are no chunks: a file that ends in the
    middle can be read up to there (`read_log`, or `mcap recover`).

    Behind the last sample the machine is drawn for Foxglove.
    """

    def __init__(
        self,
        stream: IO[bytes],
        units: Mapping[str, str],
        metadata: Mapping[str, str],
        draw: Draw | None = None,
    ):
        """Writes what comes before the first sample.

        Args:
            stream: open for writing.
            units: units of each port, in the order in which `write` is given them.
            metadata: data about the run.
            draw: draws the machine; None: it is not drawn.

        Raises:
            MissingExtra: mcap is not installed.
        """
        self._stream, self._names, self._drawing = stream, [*units], draw
        self._writer = need("mcap.writer").Writer(stream, use_chunking=False)
        self._writer.start(profile="", library="parapod")
        self._writer.add_metadata("parapod", dict(metadata))
        self._channels = []
        for name, unit in units.items():
            schema = self._writer.register_schema(
                f"parapod.{name}", "jsonschema", _schema(name, unit)
            )
            channel = self._writer.register_channel(name, "json", schema, {"unit": unit})
            self._channels.append(channel)
        self._count = 0
        self._pictures: Snapshots[tuple[int, float, Sequence[Sequence[float]]]] = Snapshots(
            _PICTURES
        )

    def write(self, stamp: int, t: float, values: Sequence[Sequence[float]]) -> None:
        """Writes the values of all ports at one time.

        Args:
            stamp: stamp of the messages [ns].
            t: time of the loop [s].
            values: numbers of each port.
        """
        for channel, numbers in zip(self._channels, values, strict=True):
            data = _encoded(t, numbers)
            self._writer.add_message(channel, stamp, data, stamp, self._count)
        self._pictures.take((stamp, t, values))
        self._count += 1

    def finish(self) -> None:
        """Writes what comes after the last sample."""
        self._stream.flush()
        try:
            self._draw()
        except Exception as error:  # whatever a drawing meets, it must not cost the log
            self._writer.add_metadata("drawing", {"left_out": str(error)})
        self._writer.finish()

    def _draw(self) -> None:
        """Draws the machine.

        Raises:
            ParapodError: the machine cannot be drawn.
        """
        pictures = [
            (stamp, t, {n: np.array(v) for n, v in zip(self._names, values, strict=True)})
            for stamp, t, values in self._pictures.rows
        ]
        if not pictures or self._drawing is None:
            return
        shapes = {name: value.shape for name, value in pictures[0][2].items()}
        channels: dict[str, int] = {}
        for number, message in enumerate(self._drawing(shapes, pictures)):
            if message.topic not in channels:
                schema = self._writer.register_schema(*message.schema)
                channels[message.topic] = self._writer.register_channel(
                    message.topic, message.schema.encoding, schema, {}
                )
            self._writer.add_message(
                channels[message.topic], message.stamp, message.data, message.stamp, number
            )


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
        signals: port name -> (n, ...) samples; each becomes a list of numbers.
        units: port name -> unit.
        metadata: data about the run.
        draw: draws the machine; None: it is not drawn.

    Raises:
        OutputError: the file cannot be written.
        MissingExtra: mcap is not installed.
    """
    times = np.asarray(times, dtype=float)
    arrays = [np.asarray(signals[name], dtype=float) for name in units]
    rows = [array.reshape(len(times), -1) for array in arrays]
    lists = [row.tolist() for row in rows]
    with atomic_output(path) as temporary, open(temporary, "wb") as stream:
        writer = McapWriter(stream, units, metadata, draw)
        for k, t in enumerate(times.tolist()):
            writer.write(round(1e9 * t), t, [each[k] for each in lists])
        writer.finish()


def _encoded(t: float, numbers: Sequence[float]) -> bytes:
    try:
        return json.dumps({"t": t, "value": numbers}, allow_nan=False).encode()
    except ValueError:
        finite_values = [x if x - x == 0.0 else None for x in numbers]
        return json.dumps({"t": t, "value": finite_values}).encode()
