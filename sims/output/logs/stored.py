"""Logs that runs have left, read piece by piece: a day of one need not fit into memory."""

import json
import re
import struct
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from parapod.sims.output.logs.part_messages import PartMessage, PartSignal
from parapod.systems.core.errors import OutputError
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import quoted_path

# Rows that are in memory at once: a few MB of the widest logs.
_PIECE = 1 << 14
_ZIP = b"PK\x03\x04"
_BLOCK = 1 << 20  # bytes of an MCAP file that are read at once
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


class PortMessages:
    """Messages of one port in JSON, as older logs have them: `{"t": time, "value": [...]}`.

    Attributes:
        signals: the port's signal, whose size only the messages have.
    """

    def __init__(self, name: str, unit: str, place: int):
        """Describes the messages.

        Args:
            name: name of the port.
            unit: its unit.
            place: its place among all ports of the log.
        """
        self.signals = (PartSignal(name, unit, 0, "value", place),)

    def decoded(self, messages: Sequence[bytes]) -> Piece:
        """Times (n) [s] of messages, and samples (n, size) by name; see `PartMessage`."""
        contents = json.loads(b"[%s]" % b",".join(messages))
        values = np.array([each["value"] for each in contents], dtype=float)
        return np.array([each["t"] for each in contents], dtype=float), {
            self.signals[0].name: values
        }


class McapLog(StoredLog):
    """A log in an MCAP file, also one whose writer was killed.

    The metadata have, beside what the writer was given, the units and, under `wall_time`, the
    wall clock at the first sample [s]. Topics without signals, such as drawings, are left out.
    """

    def _describe(self) -> None:
        self.total = self.path.stat().st_size
        self._channels: dict[int, PartMessage | PortMessages] = {}
        kinds: dict[int, str] = {}
        first: dict[int, Mapping[str, Floats]] = {}
        has_begun = False
        for record in self._records():
            match type(record).__name__:
                case "Header":
                    has_begun = True
                case "Metadata" if record.name == "parapod":
                    self.metadata |= record.metadata
                case "Schema":
                    kinds[record.id] = record.name
                # Said again in the summary of a log that was ended in peace.
                case "Channel" if record.id not in self._channels:
                    if "signals" in record.metadata:
                        self._channels[record.id] = PartMessage.from_metadata(
                            record.topic, kinds[record.schema_id], record.metadata
                        )
                    elif "unit" in record.metadata:
                        self._channels[record.id] = PortMessages(
                            record.topic, record.metadata["unit"], len(self._channels)
                        )
                case "Message" if record.channel_id in self._channels.keys() - first.keys():
                    times, samples = self._channels[record.channel_id].decoded([record.data])
                    first[record.channel_id] = samples
                    self._begin(1e-9 * record.log_time, float(times[0]))
                    if len(first) == len(self._channels):
                        break
        if not has_begun:
            raise self._unreadable("it holds nothing of an MCAP file")
        signals = sorted(
            (signal for channel in self._channels.values() for signal in channel.signals),
            key=lambda signal: signal.place,
        )
        shapes = {
            name: each.shape[1:] for samples in first.values() for name, each in samples.items()
        }
        self.shapes = {each.name: shapes.get(each.name, (each.size,)) for each in signals}
        self.metadata["units"] = {each.name: each.unit for each in signals}

    def _begin(self, stamp: float, time: float) -> None:
        """Notes the stamp of the first sample and its time by the loop [s]."""
        if "wall_time" not in self.metadata:
            self.metadata["wall_time"] = stamp
            # Of a simulation it is the loop's time.
            self.clock = stamp - time if stamp > WALL_CLOCKS else None

    def _pieces(self, names: Sequence[str]) -> Iterator[Piece]:
        channels = {
            ident: channel
            for ident, channel in self._channels.items()
            if any(signal.name in names for signal in channel.signals)
        } or dict([*self._channels.items()][:1])
        messages: dict[int, list[bytes]] = {ident: [] for ident in channels}
        newest, is_whole = 0.0, False

        def piece(count: int) -> Piece:
            nonlocal newest
            samples: dict[str, Floats] = {}
            for ident, channel in channels.items():
                times, decoded = channel.decoded(messages[ident][:count])
                samples |= decoded
                del messages[ident][:count]
            newest = float(times[-1])
            return times, {name: samples[name] for name in names}

        for record in self._records():
            kind = type(record).__name__
            if kind == "Message" and record.channel_id in channels:
                own = messages[record.channel_id]
                own.append(record.data)
                if len(own) >= _PIECE and min(map(len, messages.values())) >= _PIECE:
                    yield piece(_PIECE)
            elif kind == "DataEnd":
                is_whole = True
                break
        # Of the last sample there may be some parts only.
        if count := min(map(len, messages.values()), default=0):
            yield piece(count)
        if not is_whole:
            self.cut_at = newest

    def _records(self) -> Iterator[Any]:
        """The records of the file, up to where it ends."""
        reader, exceptions = need("mcap.stream_reader"), need("mcap.exceptions")
        with open(self.path, "rb", _BLOCK) as stream:
            try:
                for number, record in enumerate(reader.StreamReader(stream).records):
                    if number % _PIECE == 0:
                        self.done = stream.tell()
                    yield record
            except (exceptions.EndOfFile, struct.error, UnicodeDecodeError):
                return  # in the middle of a record, of its length, or of a letter
            except exceptions.McapError as error:
                reason = f"it is not an MCAP file: {error}"
                raise self._unreadable(reason) from None
