"""Logs in MCAP files, one topic for each port."""

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike

from parapod.sims.lab.files import Log, atomic_output
from parapod.systems.core.errors import OutputError
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import quoted_path

_SCHEMA = {
    "type": "object",
    "properties": {
        "t": {"type": "number", "description": "time of the loop [s]"},
        "value": {"type": "array", "items": {"type": ["number", "null"]}},
    },
}


class McapWriter:
    """Writes samples into a stream, readable up to wherever it ends.

    Each message is `{"t": time, "value": [...]}` in JSON, which Foxglove and every other reader of
    MCAP shows; a number that is not finite is null. There are no chunks: a file that ends in the
    middle can be read up to there (`read_mcap`, or `mcap recover`).
    """

    def __init__(self, stream: IO[bytes], units: Mapping[str, str], metadata: Mapping[str, str]):
        """Writes what comes before the first sample.

        Args:
            stream: open for writing.
            units: units of each port, in the order in which `write` is given them.
            metadata: data about the run.

        Raises:
            MissingExtra: mcap is not installed.
        """
        self._writer = need("mcap.writer").Writer(stream, use_chunking=False)
        self._writer.start(profile="", library="parapod")
        self._writer.add_metadata("parapod", dict(metadata))
        schema = self._writer.register_schema(
            "parapod.Sample", "jsonschema", json.dumps(_SCHEMA).encode()
        )
        self._channels = [
            self._writer.register_channel(name, "json", schema, {"unit": unit})
            for name, unit in units.items()
        ]
        self._count = 0

    def write(self, stamp: int, t: float, values: Sequence[Sequence[float]]) -> None:
        """Writes the values of all ports at one time.

        Args:
            stamp: of the messages [ns].
            t: time of the loop [s].
            values: numbers of each port.
        """
        for channel, numbers in zip(self._channels, values, strict=True):
            data = _encoded(t, numbers)
            self._writer.add_message(channel, stamp, data, stamp, self._count)
        self._count += 1

    def finish(self) -> None:
        """Writes what comes after the last sample."""
        self._writer.finish()


def write_mcap(
    path: Path,
    times: ArrayLike,
    signals: Mapping[str, ArrayLike],
    units: Mapping[str, str],
    metadata: Mapping[str, str],
) -> None:
    """Writes the log of a simulation, whose messages are stamped with the simulated time.

    Args:
        path: the file.
        times: (n) [s].
        signals: port name -> (n, ...) samples; each becomes a list of numbers.
        units: port name -> unit.
        metadata: data about the run.

    Raises:
        OutputError: the file cannot be written.
        MissingExtra: mcap is not installed.
    """
    times = np.asarray(times, dtype=float)
    arrays = [np.asarray(signals[name], dtype=float) for name in units]
    rows = [array.reshape(len(times), -1) for array in arrays]
    lists = [row.tolist() for row in rows]
    with atomic_output(path) as temporary, open(temporary, "wb") as stream:
        writer = McapWriter(stream, units, metadata)
        for k, t in enumerate(times.tolist()):
            writer.write(round(1e9 * t), t, [each[k] for each in lists])
        writer.finish()


def _encoded(t: float, numbers: Sequence[float]) -> bytes:
    try:
        return json.dumps({"t": t, "value": numbers}, allow_nan=False).encode()
    except ValueError:
        known = [x if x - x == 0.0 else None for x in numbers]
        return json.dumps({"t": t, "value": known}).encode()


def read_mcap(path: Path) -> Log:
    """Reads a log, also one whose writer was killed; what was not finite is NaN.

    The metadata have, beside what the writer was given, the units and, under `wall_time`, the
    wall clock at the first sample [s].

    Raises:
        OutputError: it cannot be read, or is not such a log.
        MissingExtra: mcap is not installed.
    """
    contents = _Contents()
    try:
        for record in _records(path):
            contents.add(record)
    except OSError as error:
        reason = error.strerror or error
        raise OutputError(f"cannot read {quoted_path(path)}: {reason}", path) from error
    except (KeyError, TypeError, ValueError) as error:
        raise OutputError(f"{quoted_path(path)} is no log of parapod: {error}", path) from error
    if not contents.has_begun:
        raise OutputError(f"{quoted_path(path)} holds nothing of an MCAP file", path)
    return contents.as_log()


class _Contents:
    """Content of a log, as far as it has been read."""

    def __init__(self) -> None:
        self.has_begun = False
        self._names: dict[int, str] = {}
        self._rows: dict[str, list[Any]] = {}
        self._units: dict[str, str] = {}
        self._metadata: dict[str, Any] = {}
        self._times: list[float] = []

    def add(self, record: Any) -> None:
        match type(record).__name__:
            case "Header":
                self.has_begun = True
            case "Metadata":
                self._metadata |= record.metadata
            case "Channel":
                # Said again in the summary of a log that was ended in peace.
                self._names[record.id] = record.topic
                self._rows.setdefault(record.topic, [])
                self._units[record.topic] = record.metadata.get("unit", "")
            case "Message":
                data = json.loads(record.data)
                self._rows[self._names[record.channel_id]].append(data["value"])
                if record.channel_id == min(self._names):
                    self._times.append(data["t"])
                    self._metadata.setdefault("wall_time", 1e-9 * record.log_time)

    def as_log(self) -> Log:
        # Of the last sample there may be some ports only.
        count = min(map(len, self._rows.values()), default=0)
        signals = {name: np.array(v[:count], dtype=float) for name, v in self._rows.items()}
        return Log(np.array(self._times[:count]), signals, self._metadata | {"units": self._units})


def _records(path: Path) -> Any:
    """The records of a file, up to where it ends."""
    reader, exceptions = need("mcap.stream_reader"), need("mcap.exceptions")
    with open(path, "rb") as stream:
        try:
            yield from reader.StreamReader(stream).records
        except (exceptions.EndOfFile, struct.error):
            return  # in the middle of a record, or of its length
        except exceptions.McapError as error:
            raise OutputError(f"{quoted_path(path)} is not an MCAP file: {error}", path) from None
