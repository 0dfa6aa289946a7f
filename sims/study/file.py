"""File of a study: a Parquet table with one row a run, which survives whatever ends the program.

Each outcome is appended at once to a journal beside the table, a line of JSON each. From time to
time, and at the end, the table is written anew from all outcomes and takes the old one's place;
the journal is there as long as the study is not over, or was killed.
"""

import fcntl
import json
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from parapod.sims.output.atomic import atomic_output, check_writable
from parapod.sims.output.results import Metric
from parapod.sims.study.records import Column, Records
from parapod.sims.study.runs import Outcome
from parapod.systems.core.errors import OutputError
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import quoted_path, show

if TYPE_CHECKING:
    import pyarrow  # type: ignore[import-untyped]

SUFFIX = ".parquet"
_JOURNAL = ".journal"  # behind the name of the table
# Key of the table's metadata under which the study stands.
_STUDY = b"parapod.study"
# Shortest time between two writings of the table, which take a small share of the time [s].
_WRITE_PERIOD, _WRITE_SHARE = 5.0, 0.03
_LIMITS = ("bound", "at_least")
# Texts of a metric that are written once.
_WORDS = ("unit", "meaning", "undefined")


class StudyFile:
    """The file of a study while it is carried out."""

    def __init__(self, path: Path, study: Mapping[str, Any], records: Records, stream: IO[bytes]):
        """Goes on with a file; see `open_file`."""
        self._path, self._study, self._records, self._stream = path, study, records, stream
        self._known: set[str] = set()
        self._written, self._pause = time.monotonic(), _WRITE_PERIOD

    def begin(self) -> None:
        """Appends the study itself."""
        self._append({"study": self._study})

    def add(self, outcome: Outcome) -> None:
        """Appends an outcome.

        Raises:
            OutputError: the file cannot be written.
        """
        new = [metric for metric in outcome.metrics if metric.key not in self._known]
        lines = [{"metric": m.key} | {name: getattr(m, name) for name in _WORDS} for m in new]
        self._known.update(metric.key for metric in new)
        metrics = [[m.key, float(m.value), m.bound, m.at_least] for m in outcome.metrics]
        row: dict[str, Any] = {"run": outcome.run, "metrics": metrics, "error": outcome.error}
        if self._records.sampling.is_searched:
            row["values"] = self._records.sampling.values(outcome.run)
        self._append(*lines, row)
        if time.monotonic() - self._written > self._pause:
            self.write()

    def _append(self, *lines: Mapping[str, Any]) -> None:
        try:
            self._stream.write(b"".join(json.dumps(line).encode() + b"\n" for line in lines))
            self._stream.flush()
        except OSError as error:
            raise OutputError(
                f"cannot write {quoted_path(_journal(self._path))}: {error.strerror}", self._path
            ) from error

    def write(self) -> None:
        """Writes the table.

        Raises:
            OutputError: it cannot be written.
        """
        started = time.monotonic()
        table = to_table(self._study, self._records)
        with atomic_output(self._path) as temporary:
            need("pyarrow.parquet").write_table(table, temporary)
        self._written = time.monotonic()
        self._pause = max(_WRITE_PERIOD, (self._written - started) / _WRITE_SHARE)


def _journal(path: Path) -> Path:
    return path.with_name(f"{path.name}{_JOURNAL}")


@contextmanager
def open_file(
    path: Path, study: Mapping[str, Any], records: Records, resume: bool
) -> Iterator[StudyFile]:
    """Opens the file of a study, for one program at a time; the table is complete at the end.

    Args:
        path: the table, *.parquet.
        study: the study, as JSON can say it.
        records: takes what the file has already.
        resume: true to go on with an existing file.

    Raises:
        OutputError: the file is there and is not to be gone on with, is of another study, is being
            written, or cannot be written.
        MissingExtra: pyarrow is not installed.
    """
    check_path(path)
    need("pyarrow.parquet")
    journal = _journal(path)
    before = [file for file in (path, journal) if file.exists()]
    with _locked(path, journal) as stream:
        try:
            if before and not resume:
                raise OutputError(
                    f"{quoted_path(before[0])} is there already: --resume goes on with its "
                    "study, and another study needs a file of its own",
                    path,
                )
            _read_table(path, study, records)
            complete = _read_journal(path, study, records, stream)
        except BaseException:
            if journal not in before:
                journal.unlink()
            raise
        stream.truncate(complete)  # a line that was cut off counts for nothing
        stream.seek(complete)
        file = StudyFile(path, study, records, stream)
        try:
            if not complete:
                file.begin()
            file.write()
            yield file
        finally:
            if records.done.any():
                file.write()
            elif path not in before:
                path.unlink(missing_ok=True)
            journal.unlink()


def check_path(path: Path) -> None:
    """Refuses a path that is not that of a table, or that could not be written.

    Raises:
        OutputError: says why.
    """
    if path.suffix != SUFFIX:
        raise OutputError(f"{quoted_path(path)}: the table of a study is a {SUFFIX} file", path)
    check_writable(path)


def _locked(path: Path, journal: Path) -> IO[bytes]:
    stream = os.fdopen(os.open(journal, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666), "r+b")
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        stream.close()
        raise OutputError(f"another study is being written to {quoted_path(path)}", path) from None
    return stream


def _read_table(path: Path, study: Mapping[str, Any], records: Records) -> None:
    """Takes the rows of a table, if it is there.

    Raises:
        OutputError: it is none of this study.
    """
    if not path.exists():
        return
    table, metadata = load_table(path)
    _compare(path, metadata["study"], study)
    from_table(table, metadata["metrics"], records)


def _read_journal(
    path: Path, study: Mapping[str, Any], records: Records, stream: IO[bytes]
) -> int:
    """Takes the lines of a journal; returns the length of those that are complete [byte].

    Raises:
        OutputError: it is none of this study.
    """
    complete = 0
    about: dict[str, dict[str, Any]] = {}
    for line in stream:
        try:
            item = json.loads(line) if line.endswith(b"\n") else None
        except ValueError:
            item = None
        if item is None:
            break
        complete += len(line)
        if "study" in item:
            _compare(path, item["study"], study)
        elif "metric" in item:
            about[item.pop("metric")] = item
        else:
            metrics = [
                Metric(key, value, bound=bound, at_least=at_least, **about[key])
                for key, value, bound, at_least in item["metrics"]
            ]
            if "values" in item:
                records.sampling.take(item["run"], item["values"])
            records.add(Outcome(item["run"], tuple(metrics), item["error"]))
    return complete


def load_table(path: Path) -> "tuple[pyarrow.Table, dict[str, Any]]":
    """A table, and what its file says of the study and its metrics.

    Raises:
        OutputError: it cannot be read, or is not the table of a study.
        MissingExtra: pyarrow is not installed.
    """
    arrow = need("pyarrow")
    try:
        table = need("pyarrow.parquet").read_table(path)
    except (OSError, arrow.ArrowException) as error:
        reason = getattr(error, "strerror", None) or "it is not a Parquet file"
        raise OutputError(f"cannot read {quoted_path(path)}: {reason}", path) from None
    text = (table.schema.metadata or {}).get(_STUDY)
    if text is None:
        raise OutputError(f"{quoted_path(path)} is not the table of a study", path)
    metadata: dict[str, Any] = json.loads(text)
    return table, metadata


def _compare(path: Path, there: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Refuses a file of another study, by the first thing in which it differs."""
    for name, ours in here.items():
        theirs = there.get(name)
        if theirs != ours:
            key, theirs, ours = _first_difference(name, theirs, ours)
            raise OutputError(
                f"{quoted_path(path)} is of another study: there {key} = {show(theirs)}, "
                f"here {show(ours)}",
                path,
            )


def _first_difference(name: str, there: Any, here: Any) -> tuple[str, Any, Any]:
    """Dotted key and the two values."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in (*here, *there):
            if there.get(key) != here.get(key):
                return _first_difference(f"{name}.{key}", there.get(key), here.get(key))
    return name, there, here


def to_table(study: Mapping[str, Any], records: Records) -> "pyarrow.Table":
    """The runs that have been carried out, as a table, see `docs/studies.md`.

    Args:
        study: the study, as JSON can say it.
        records: runs of the study.

    Raises:
        MissingExtra: pyarrow is not installed.
    """
    arrow = need("pyarrow")
    runs = np.flatnonzero(records.done)
    columns: dict[str, Any] = {"run": arrow.array(runs)}
    values = [records.sampling.values(run) for run in runs.tolist()]
    for i, variable in enumerate(records.sampling.variables):
        columns[variable.key] = arrow.array(_of_one_type([row[i] for row in values]))
    about = []
    for column in records.columns:
        missing = ~column.is_there[runs]
        columns[column.key] = arrow.array(column.values[runs], mask=missing, from_pandas=False)
        item: dict[str, Any] = {name: getattr(column, name) for name in ("key", *_WORDS)}
        for name in _LIMITS:
            limits = getattr(column, name)
            item[name] = column.limit(limits)
            if item[name] is None and not np.isnan(limits).all():
                key = f"{column.key}.{name}"
                columns[key] = arrow.array(limits[runs], mask=np.isnan(limits[runs]))
        about.append(item | {"place": column.place})
    columns["passed"] = arrow.array(records.passed[runs])
    broken = records.broken()
    columns["broken"] = arrow.array([broken[run] for run in runs.tolist()])
    columns["error"] = arrow.array([records.errors.get(run, "") for run in runs.tolist()])
    metadata = {_STUDY: json.dumps({"study": study, "metrics": about}).encode()}
    return arrow.table(columns).replace_schema_metadata(metadata)


def from_table(
    table: "pyarrow.Table", about: Sequence[Mapping[str, Any]], records: Records
) -> None:
    """Takes the rows of a table.

    Args:
        table: table from `to_table`.
        about: metrics in its metadata.
        records: takes them.
    """
    runs = table["run"].to_numpy()
    if records.sampling.is_searched:
        keys = [variable.key for variable in records.sampling.variables]
        for run, row in zip(runs.tolist(), table.select(keys).to_pylist(), strict=True):
            records.sampling.take(run, list(row.values()))
    records.done[runs] = True
    for run, error in zip(runs.tolist(), table["error"].to_pylist(), strict=True):
        if error:
            records.errors[run] = error
    for item in about:
        metric = Metric(item["key"], math.nan, **{name: item.get(name, "") for name in _WORDS})
        column = Column.empty(metric, records.sampling.runs)
        values = table[item["key"]]
        column.is_there[runs] = values.is_valid().to_numpy()
        column.values[runs] = values.to_numpy()
        for name in _LIMITS:
            limits, key = getattr(column, name), f"{item['key']}.{name}"
            if key in table.column_names:
                limits[runs] = table[key].to_numpy()
            elif item[name] is not None:
                limits[runs] = item[name]
        column.place = tuple(item["place"])
        records.add_column(column)


def _of_one_type(values: list[Any]) -> list[Any]:
    """Values of a column: numbers, booleans or texts as they are, others as JSON."""
    if all(isinstance(value, bool) for value in values):
        return values
    for kind in (int, float, str):
        if all(isinstance(value, kind) and not isinstance(value, bool) for value in values):
            return values
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in values):
        return [float(value) for value in values]
    return [json.dumps(value) for value in values]
