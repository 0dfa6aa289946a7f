"""Logs that grow while the machine moves and survive its end: one MCAP topic for each port."""

import json
import queue
import struct
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from parapod.sims.lab.files import Log, atomic_output, check_writable
from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.hardware.device import need

# Longest time for which what has happened is not in the file [s].
_FLUSH_PERIOD = 0.2
_SCHEMA = {
    "type": "object",
    "properties": {
        "t": {"type": "number", "description": "time of the loop [s]"},
        "value": {"type": "array", "items": {"type": ["number", "null"]}},
    },
}


class McapLog:
    """Writes samples from a thread of its own; whoever logs never waits for the disk.

    Each message is `{"t": time, "value": [...]}` in JSON, which Foxglove and every other reader of
    MCAP shows; a number that is not finite is null. The messages are stamped with the wall clock,
    so that logs of several programs can be laid over each other. There are no chunks: a file that
    ends in the middle can be read up to there (`read_mcap`, or `mcap recover`).
    """

    def __init__(self, path: Path, units: Mapping[str, str], metadata: Mapping[str, str]):
        """Describes the log; the file is made by entering the context.

        Args:
            path: path of the file.
            units: units of each port that is logged, in the order in which `write` is given them.
            metadata: data about the run.

        Raises:
            OutputError: the file cannot be written.
            MissingExtra: mcap is not installed.
        """
        check_writable(path)
        self._path, self._units, self._metadata = path, dict(units), dict(metadata)
        self._queue: queue.SimpleQueue[tuple[int, float, Sequence[Any]] | None] = (
            queue.SimpleQueue()
        )
        self._mcap = need("mcap.writer")
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._error: OSError | None = None

    def write(self, t: float, values: Sequence[Any], stamp: int | None = None) -> None:
        """Hands over the values of all ports at one time.

        Args:
            t: time of the loop [s].
            values: values of the ports, arrays that are not changed any more.
            stamp: stamp of the messages [ns]; None for the wall clock's.
        """
        self._queue.put((time.time_ns() if stamp is None else stamp, t, values))

    def _run(self) -> None:
        try:
            with open(self._path, "wb") as stream:
                self._write_all(stream)
        except OSError as error:
            self._error = error

    def _write_all(self, stream: Any) -> None:
        writer = self._mcap.Writer(stream, use_chunking=False)
        writer.start(profile="", library="parapod")
        writer.add_metadata("parapod", self._metadata)
        schema = writer.register_schema(
            "parapod.Sample", "jsonschema", json.dumps(_SCHEMA).encode()
        )
        channels = [
            writer.register_channel(name, "json", schema, {"unit": unit})
            for name, unit in self._units.items()
        ]
        stream.flush()
        flushed = time.monotonic()
        sequence = 0
        while (item := self._next()) is not None:
            if item:
                stamp, t, values = item
                for channel, value in zip(channels, values, strict=True):
                    writer.add_message(channel, stamp, _encoded(t, value), stamp, sequence)
                sequence += 1
            if time.monotonic() - flushed >= _FLUSH_PERIOD:
                stream.flush()
                flushed = time.monotonic()
        writer.finish()

    def _next(self) -> Any:
        """The next samples; () if there are none for a while; None at the end."""
        try:
            return self._queue.get(timeout=_FLUSH_PERIOD)
        except queue.Empty:
            return ()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._queue.put(None)
        self._thread.join()
        if self._error is not None and error is None:
            reason = self._error.strerror or str(self._error)
            raise OutputError(f"cannot write {quoted_path(self._path)}: {reason}", self._path)


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
    with atomic_output(path) as temporary, McapLog(temporary, units, metadata) as log:
        for k, t in enumerate(times.tolist()):
            log.write(t, [row[k] for row in rows], stamp=round(1e9 * t))


def _encoded(t: float, value: Any) -> bytes:
    numbers = value.tolist()
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
