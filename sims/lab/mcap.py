"""Logs in MCAP files, one topic for each port."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike

from parapod.sims.lab.files import atomic_output
from parapod.systems.core.extras import need

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
    middle can be read up to there (`read_log`, or `mcap recover`).
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
