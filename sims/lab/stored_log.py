"""Logs that runs have left, read piece by piece: a day of one need not fit into memory."""

import json
import re
import struct
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from parapod.sims.lab.files import Log
from parapod.systems.core.errors import OutputError
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import quoted_path

# Rows that are in memory at once: a few MB of the widest logs.
_PIECE = 1 << 14
_ZIP = b"PK\x03\x04"
# Columns of a table's signal: its name, and where it has several elements the indices of one.
_COLUMN = re.compile(r"(?P<name>[^\[\]]+)(?:\[(?P<index>[\d;]+)\])?")

type Floats = NDArray[Any]
type Piece = tuple[Floats, dict[str, Floats]]


class StoredLog(ABC):
    """A log in a file; its description is read at once, its samples when they are asked for.

    Attributes:
        path: the file.
        shapes: shape of one sample of each signal, by port name.
        metadata: data about the run.
        cut_at: time of the last sample [s] of a log that ends in the middle, known when all
            samples have been read; None: it is whole.
        total: amount of its samples, in rows or bytes.
        done: amount that has been read.
    """

    def __init__(self, path: Path):
        """Reads the description.

        Raises:
            OutputError: the file is missing or is no such log.
            MissingExtra: for an MCAP log, mcap is not installed.
        """
        self.path = path
        self.shapes: dict[str, tuple[int, ...]] = {}
        self.metadata: dict[str, Any] = {}
        self.cut_at: float | None = None
        self.total = self.done = 0
        with self._reading():
            self._describe()

    @property
    def units(self) -> Mapping[str, str]:
        """Units by port name; empty where a log does not tell."""
        told: Any = self.metadata.get("units", {})
        return {name: str(told.get(name, "")) for name in self.shapes}

    def size(self, name: str) -> int:
        """Number of elements of a signal; 0 of one that the log does not have."""
        return int(np.prod(self.shapes[name])) if name in self.shapes else 0

    @abstractmethod
    def _describe(self) -> None:
        """Reads everything but the samples."""

    @abstractmethod
    def _pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        """See `pieces`."""

    def pieces(self, names: Sequence[str] | None = None) -> Iterator[Piece]:
        """Times (k) and samples (k, ...) of signals, piece by piece in the order of time.

        Args:
            names: signals that the log has; None for all.

        Raises:
            OutputError: the file ends where it should not, or holds something else.
        """
        with self._reading():
            yield from self._pieces([*self.shapes] if names is None else names)

    def read(self) -> Log:
        """All of it.

        Raises:
            OutputError: the file ends where it should not, or holds something else.
        """
        times, signals = [np.empty(0)], {name: [self._none(name)] for name in self.shapes}
        for t, samples in self.pieces():
            times.append(t)
            for name, values in samples.items():
                signals[name].append(values)
        joined = {name: np.concatenate(v[1:] or v) for name, v in signals.items()}
        return Log(np.concatenate(times), joined, self.metadata)

    def _none(self, name: str) -> Floats:
        return np.empty((0, *self.shapes[name]))

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Tells in one line of a file that cannot be read."""
        try:
            yield
        except OSError as error:
            raise self._unreadable(error.strerror or str(error)) from error
        except (EOFError, zlib.error, zipfile.BadZipFile) as error:
            raise self._unreadable("it is cut off or damaged") from error
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise self._unreadable("it is not a log of parapod") from error

    def _unreadable(self, reason: str) -> OutputError:
        return OutputError(f"cannot read log {quoted_path(self.path)}: {reason}", self.path)


def open_log(path: Path) -> StoredLog:
    """A log in any of the formats, by its suffix.

    Raises:
        OutputError: the file is missing or is no such log.
        MissingExtra: for an MCAP log, mcap is not installed.
    """
    kinds: dict[str, type[StoredLog]] = {".mcap": McapLog, ".csv": TableLog}
    return kinds.get(path.suffix, ArchiveLog)(path)


class ArchiveLog(StoredLog):
    """A log of numpy's, whose arrays are read side by side."""

    def _describe(self) -> None:
        with open(self.path, "rb") as stream:
            head = stream.read(len(_ZIP))
        if head != _ZIP:
            raise ValueError("no archive")
        with zipfile.ZipFile(self.path) as archive:
            members = [name.removesuffix(".npy") for name in archive.namelist()]
            with archive.open("metadata.npy") as member:
                text = npy.read_array(member, allow_pickle=False)
            self.metadata = dict(json.loads(str(text)))
            (self.total,) = self._shape(archive, "t")
            for name in members:
                if name not in ("t", "metadata"):
                    count, *shape = self._shape(archive, name)
                    if count != self.total:
                        raise ValueError(name)
                    self.shapes[name] = tuple(shape)

    def _shape(self, archive: zipfile.ZipFile, name: str) -> tuple[int, ...]:
        with archive.open(f"{name}.npy") as member:
            shape, _ = _head(member)
        return shape

    def _pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        with ExitStack() as stack:
            archive = stack.enter_context(zipfile.ZipFile(self.path))
            members = {
                name: stack.enter_context(archive.open(f"{name}.npy")) for name in ("t", *names)
            }
            kinds = {name: _head(member)[1] for name, member in members.items()}
            for begin in range(0, self.total, _PIECE):
                count = min(_PIECE, self.total - begin)
                piece = {
                    name: _take(member, kinds[name], (count, *self.shapes.get(name, ())))
                    for name, member in members.items()
                }
                self.done = begin + count
                yield piece.pop("t"), piece


def _head(member: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of the array that follows in a file of numpy's.

    Raises:
        ValueError: not by rows, or objects.
    """
    heads = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    shape, by_columns, kind = heads[npy.read_magic(member)](member)
    if (by_columns and len(shape) > 1) or kind.hasobject:
        raise ValueError("not by rows")
    return shape, kind


def _take(member: IO[bytes], kind: np.dtype[Any], shape: tuple[int, ...]) -> Floats:
    size = kind.itemsize * int(np.prod(shape))
    data = member.read(size)
    if len(data) < size:
        raise EOFError
    return np.frombuffer(data, kind).reshape(shape)


class TableLog(StoredLog):
    """A log of comma-separated values; a last line without an end is left out."""

    def _describe(self) -> None:
        self.total = self.path.stat().st_size
        with self.path.open(encoding="utf-8") as stream:
            self.metadata = dict(json.loads(stream.readline().removeprefix("# ")))
            head = stream.readline().strip().split(",")
            next(self._tables(stream, len(head)), None)  # a table without numbers is refused
        self._columns: dict[str, dict[tuple[int, ...], int]] = {}
        for place, text in enumerate(head):
            found = _COLUMN.fullmatch(text)
            if found is None:
                raise ValueError(text)
            index = tuple(map(int, filter(None, (found["index"] or "").split(";"))))
            self._columns.setdefault(found["name"], {})[index] = place
        for name, places in self._columns.items():
            if name != "t":
                self.shapes[name] = tuple(1 + largest for largest in max(places))
        self._columns["t"]  # each log has one

    def _tables(self, stream: IO[str], width: int) -> Iterator[Floats]:
        while lines := list(islice(stream, _PIECE)):
            if not lines[-1].endswith("\n"):
                lines.pop()
                self.cut_at = np.nan
            if lines:
                self.done += sum(map(len, lines))
                yield np.loadtxt(lines, delimiter=",", ndmin=2).reshape(-1, width)

    def _pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        last = 0.0
        with self.path.open(encoding="utf-8") as stream:
            stream.readline()
            width = len(stream.readline().split(","))
            for table in self._tables(stream, width):
                piece = {}
                for name in names:
                    columns = table[:, list(self._columns[name].values())]
                    piece[name] = columns.reshape(len(table), *self.shapes[name])
                times = table[:, self._columns["t"][()]]
                last = float(times[-1])
                yield times, piece
        if self.cut_at is not None:
            self.cut_at = last


class McapLog(StoredLog):
    """A log in an MCAP file, also one whose writer was killed; what was not finite is NaN.

    The metadata have, beside what the writer was given, the units and, under `wall_time`, the
    wall clock at the first sample [s]. Topics that are no signals, such as drawings, are left out.
    """

    def _describe(self) -> None:
        self.total = self.path.stat().st_size
        self._topics: dict[int, str] = {}
        units: dict[str, str] = {}
        has_begun, missing = False, 1
        for record in self._records():
            match type(record).__name__:
                case "Header":
                    has_begun = True
                case "Metadata":
                    self.metadata |= record.metadata
                case "Channel" if "unit" in record.metadata:
                    # Said again in the summary of a log that was ended in peace.
                    self._topics[record.id] = record.topic
                    units[record.topic] = record.metadata["unit"]
                case "Message":
                    topic = self._topics.get(record.channel_id)
                    if topic is None or topic in self.shapes:
                        continue
                    self.metadata.setdefault("wall_time", 1e-9 * record.log_time)
                    self.shapes[topic] = (len(json.loads(record.data)["value"]),)
                    missing = len(self._topics) - len(self.shapes)
                    if not missing:
                        break
        if not has_begun:
            raise self._unreadable("it holds nothing of an MCAP file")
        for topic in self._topics.values():  # of a log without a whole sample
            self.shapes.setdefault(topic, (0,))
        self.metadata["units"] = units

    def _pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        wanted = {ident: name for ident, name in self._topics.items() if name in names}
        wanted = wanted or dict([*self._topics.items()][:1])
        rows: dict[str, list[Any]] = {name: [] for name in wanted.values()}
        first, last = min(wanted, default=0), max(wanted, default=0)
        times: list[float] = []
        newest, is_whole = 0.0, False
        for record in self._records():
            if (ident := getattr(record, "channel_id", None)) in wanted:
                if not hasattr(record, "data"):
                    continue  # a part of the summary
                data = json.loads(record.data)
                rows[wanted[ident]].append(data["value"])
                if ident == first:
                    times.append(data["t"])
                if ident == last and len(times) >= _PIECE:
                    newest, self.done = times[-1], self._stream.tell()
                    yield self._piece(times, rows, names)
                    times, rows = [], {name: [] for name in rows}
            is_whole = is_whole or type(record).__name__ == "Footer"
        # Of the last sample there may be some ports only.
        count = min([len(times), *map(len, rows.values())])
        if count:
            newest = times[count - 1]
            yield self._piece(times[:count], {n: v[:count] for n, v in rows.items()}, names)
        if not is_whole:
            self.cut_at = newest

    def _piece(
        self, times: Sequence[float], rows: Mapping[str, list[Any]], names: Sequence[str]
    ) -> Piece:
        samples = {name: np.array(rows[name], dtype=float) for name in names}
        return np.array(times, dtype=float), samples

    def _records(self) -> Iterator[Any]:
        """The records of the file, up to where it ends."""
        reader, exceptions = need("mcap.stream_reader"), need("mcap.exceptions")
        with open(self.path, "rb") as stream:
            self._stream = stream
            try:
                yield from reader.StreamReader(stream).records
            except (exceptions.EndOfFile, struct.error):
                return  # in the middle of a record, or of its length
            except exceptions.McapError as error:
                reason = f"it is not an MCAP file: {error}"
                raise self._unreadable(reason) from None
