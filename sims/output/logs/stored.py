"""Logs that runs have left, read piece by piece: a day of one need not fit into memory."""

import json
import re
import struct
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from parapod.systems.core.errors import OutputError
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import quoted_path

# Rows that are in memory at once: a few MB of the widest logs.
_PIECE = 1 << 14
_ZIP = b"PK\x03\x04"
# Of MCAP: bytes before the first record, kinds of records, and of each kind and length; of a
# message its channel, and all that is before its data; and bytes that are read at once.
_MAGIC, _MESSAGE, _CHUNK, _DATA_END = 8, 0x05, 0x06, 0x0F
_RECORD, _CHANNEL, _HEAD = struct.Struct("<BQ"), struct.Struct("<H"), 22
_BLOCK = 1 << 22
# Stamps below this are times of a simulation [s]: as a date it is in 2001.
WALL_CLOCKS = 1e9
# Columns of a table's signal: its name, and where it has several elements the indices of one.
_COLUMN = re.compile(r"(?P<name>[^\[\]]+)(?:\[(?P<index>[\d;]+)\])?")

type Floats = NDArray[Any]
type Piece = tuple[Floats, dict[str, Floats]]


@dataclass(frozen=True)
class Log:
    """Signals of a run.

    Attributes:
        time: (n,) [s].
        signals: port name -> (n, ...) array, one row per time.
        metadata: data about the run.
    """

    time: NDArray[np.float64]
    signals: dict[str, NDArray[Any]]
    metadata: dict[str, Any]


class StoredLog(ABC):
    """A log in a file; its description is read at once, its samples when they are asked for.

    Attributes:
        path: the file.
        shapes: shape of one sample of each signal, by port name.
        metadata: data about the run.
        clock: wall-clock time at the loop's time 0 [s]; None of what was simulated.
        shift: time by which its samples are moved [s], so that it fits to another log.
        cut_at: time of the last sample [s] of a log that ends in the middle, known when all
            samples have been read; None: it is whole.
        total: amount of its samples, in rows or bytes.
        done: amount that has been read.
    """

    def __init__(self, path: Path):
        """Reads the description.

        Raises:
            OutputError: the file is missing, or is not a log.
            MissingExtra: for an MCAP log, mcap is not installed.
        """
        self.path = path
        self.shapes: dict[str, tuple[int, ...]] = {}
        self.metadata: dict[str, Any] = {}
        self.clock: float | None = None
        self.shift = 0.0
        self.cut_at: float | None = None
        self.total = self.done = 0
        with self._reading():
            self._describe()

    @property
    def units(self) -> Mapping[str, str]:
        """Units by port name; empty where a log has none."""
        units: Any = self.metadata.get("units", {})
        return {name: str(units.get(name, "")) for name in self.shapes}

    @property
    def sizes(self) -> Mapping[str, int]:
        """Number of elements of each signal, by port name."""
        return {name: int(np.prod(shape)) for name, shape in self.shapes.items()}

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
            for times, samples in self._pieces([*self.shapes] if names is None else names):
                yield times + self.shift, samples

    def ends(self) -> tuple[float, float] | None:
        """Times of the first and the last sample [s]; None: there is none.

        Raises:
            OutputError: the file ends where it should not, or holds something else.
        """
        end_times: list[float] = []
        for times, _ in self.pieces(()):
            end_times = (
                [*end_times[:1], float(times[0]), float(times[-1])] if len(times) else end_times
            )
        return (end_times[0], end_times[-1]) if end_times else None

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
        OutputError: the file is missing, or is not a log.
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
            match = _COLUMN.fullmatch(text)
            if match is None:
                raise ValueError(text)
            index = tuple(map(int, filter(None, (match["index"] or "").split(";"))))
            self._columns.setdefault(match["name"], {})[index] = place
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
    wall clock at the first sample [s]. Topics without signals, such as drawings, are left out.
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
                    message = json.loads(record.data)
                    self._begin(1e-9 * record.log_time, message["t"])
                    self.shapes[topic] = (len(message["value"]),)
                    missing = len(self._topics) - len(self.shapes)
                    if not missing:
                        break
        if not has_begun:
            raise self._unreadable("it holds nothing of an MCAP file")
        for topic in self._topics.values():  # of a log without a whole sample
            self.shapes.setdefault(topic, (0,))
        self.metadata["units"] = units

    def _begin(self, stamp: float, time: float) -> None:
        """Notes the stamp of the first sample and its time by the loop [s]."""
        if "wall_time" not in self.metadata:
            self.metadata["wall_time"] = stamp
            # Of a simulation it is the loop's time.
            self.clock = stamp - time if stamp > WALL_CLOCKS else None

    def _pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        topics = {ident: name for ident, name in self._topics.items() if name in names}
        topics = topics or dict([*self._topics.items()][:1])
        texts: dict[int, list[bytes]] = {ident: [] for ident in topics}
        last = max(topics, default=0)
        newest = 0.0
        self._is_whole = False
        for ident, text in self._messages(topics):
            texts[ident].append(text)
            if ident == last and len(texts[last]) >= _PIECE:
                times, samples = self._piece(topics, texts, names)
                texts = {ident: [] for ident in topics}
                newest = float(times[-1])
                yield times, samples
        # Of the last sample there may be some ports only.
        count = min(map(len, texts.values()), default=0)
        if count:
            rest = {ident: each[:count] for ident, each in texts.items()}
            times, samples = self._piece(topics, rest, names)
            newest = float(times[-1])
            yield times, samples
        if not self._is_whole:
            self.cut_at = newest

    def _piece(
        self, topics: Mapping[int, str], texts: Mapping[int, list[bytes]], names: Sequence[str]
    ) -> Piece:
        """Decodes messages, those of a topic all at once."""
        decoded = {
            topics[ident]: json.loads(b"[%s]" % b",".join(each)) for ident, each in texts.items()
        }
        samples = {
            name: np.array([each["value"] for each in decoded[name]], dtype=float)
            for name in names
        }
        first = next(iter(decoded.values()))
        return np.array([each["t"] for each in first], dtype=float), samples

    def _messages(self, topics: Collection[int]) -> Iterator[tuple[int, bytes]]:
        """Channel and data of each message of some channels, up to where the file ends.

        An hour of a machine is ten million messages, of each of which the library makes an
        object; where there are no chunks, as in logs that parapod writes, all others are skipped.
        """
        with open(self.path, "rb") as stream:
            self.done = stream.seek(_MAGIC)
            rest = b""
            while block := stream.read(_BLOCK):
                data, place = rest + block, 0
                while place + _RECORD.size <= len(data):
                    kind, length = _RECORD.unpack_from(data, place)
                    begin, end = place + _RECORD.size, place + _RECORD.size + length
                    if kind == _CHUNK:
                        yield from self._messages_of_chunks(topics)
                        return
                    if kind == _DATA_END:
                        self._is_whole = True
                        return
                    if end > len(data):
                        break
                    if kind == _MESSAGE:
                        (ident,) = _CHANNEL.unpack_from(data, begin)
                        if ident in topics:
                            yield ident, data[begin + _HEAD : end]
                    place = end
                rest = data[place:]
                self.done = stream.tell()

    def _messages_of_chunks(self, topics: Collection[int]) -> Iterator[tuple[int, bytes]]:
        for record in self._records():
            name = type(record).__name__
            if name == "Message" and record.channel_id in topics:
                yield record.channel_id, record.data
            self._is_whole = self._is_whole or name == "DataEnd"

    def _records(self) -> Iterator[Any]:
        """The records of the file, up to where it ends."""
        reader, exceptions = need("mcap.stream_reader"), need("mcap.exceptions")
        with open(self.path, "rb") as stream:
            try:
                yield from reader.StreamReader(stream).records
            except (exceptions.EndOfFile, struct.error):
                return  # in the middle of a record, or of its length
            except exceptions.McapError as error:
                reason = f"it is not an MCAP file: {error}"
                raise self._unreadable(reason) from None
