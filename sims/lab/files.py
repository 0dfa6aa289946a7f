"""Files that a run leaves behind: complete or not there at all, and readable without Drake."""

import json
import os
import re
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.core.scenario_file import dump_scenario

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

LOG_FORMATS = (".npz", ".mcap", ".csv")
# Names in a log that are not signals, and parameters of numpy's writer, which signals cannot be.
_RESERVED = ("t", "metadata", "file", "allow_pickle")


@dataclass(frozen=True)
class Log:
    """Signals of a run.

    Attributes:
        time: (n,) [s].
        signals: port name -> (n, ...) array, one row per time.
        metadata: data about the run.
    """

    time: "NDArray[np.float64]"
    signals: "dict[str, NDArray[Any]]"
    metadata: dict[str, Any]


def check_writable(path: Path) -> None:
    """Refuses a path that could not be written, before a long run is spent on it.

    Raises:
        OutputError: the folder is missing, there is no permission, or something is in the way.
    """
    # Functions of os.path, because those of pathlib raise where a folder may not be searched.
    target = os.path.realpath(path) if os.path.islink(path) else os.fspath(path)
    folder = os.path.dirname(target) or "."
    if os.path.isdir(target):
        raise _cannot_write(path, "it is a directory")
    if os.path.isfile(folder):
        raise _cannot_write(path, f"{quoted_path(folder)} is not a directory")
    try:
        os.stat(target)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise _cannot_write(path, error.strerror or str(error)) from None
    if os.path.exists(target) and not os.path.isfile(target):
        raise _cannot_write(path, "it is not a regular file")
    if not os.path.isdir(folder):
        raise _cannot_write(path, f"the folder {quoted_path(folder)} does not exist")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise _cannot_write(path, f"no permission to write in {quoted_path(folder)}")
    if os.path.exists(target) and not os.access(target, os.W_OK):
        raise _cannot_write(path, "no permission to replace it")
    try:
        _probe(folder)
    except OSError as error:
        raise _cannot_write(path, error.strerror or str(error)) from None


def check_folder(path: Path) -> None:
    """Refuses a folder that could not be made or written in, before a long run is spent on it.

    Raises:
        OutputError: there is no permission, or something is in the way.
    """
    # The folder itself, or the one in which the missing ones would be made.
    there = os.path.realpath(path)
    while not os.path.lexists(there) and there != os.path.dirname(there):
        there = os.path.dirname(there)
    if os.path.islink(path) and not os.path.exists(path):
        raise _cannot_make(path, "it is a link to nothing")
    if not os.path.isdir(there):
        raise _cannot_make(path, f"{quoted_path(there)} is not a directory")
    if not os.access(there, os.W_OK | os.X_OK):
        raise _cannot_make(path, f"no permission to write in {quoted_path(there)}")
    try:
        with suppress(FileNotFoundError):
            os.stat(path)  # a name may be too long
        _probe(there)
    except OSError as error:
        raise _cannot_make(path, error.strerror or str(error)) from None


def _probe(folder: str) -> None:
    """Writes a file there: what permissions promise, some file systems do not keep."""
    probe = os.path.join(folder, f".parapod-{secrets.token_hex(6)}")
    with open(probe, "xb"):
        pass
    os.unlink(probe)


@contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """A temporary path beside the target, which takes the target's place on success.

    After an exception, Ctrl-C included, the target is as it was and nothing else is left.

    Raises:
        OutputError: the target cannot be written, or nothing was written to the temporary path.
    """
    check_writable(path)
    # Through symbolic links, so that the link stays and the file that it names is replaced.
    target = Path(os.path.realpath(path))
    # The suffix stays last because writers choose a format by it. mkstemp would make the file
    # unreadable to others; a name of our own leaves the permissions to the user's umask.
    temporary = target.with_name(f".parapod-{secrets.token_hex(6)}{target.suffix}")
    try:
        yield temporary
        if not temporary.exists():
            raise _cannot_write(path, "nothing was written")
        os.replace(temporary, target)
    except OSError as error:
        raise _cannot_write(path, error.strerror or str(error)) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_page(path: Path, html: str, title: str) -> None:
    """Writes a page of Meshcat under a title of its own.

    Args:
        path: the file.
        html: page that `Meshcat.StaticHtml` gives.
        title: shown by browsers in tabs and bookmarks.

    Raises:
        OutputError: the file cannot be written.
    """
    named = f"<title>{escape(title)}</title>"
    with atomic_output(path) as temporary:
        html = re.sub("<title>.*?</title>", lambda _: named, html, count=1)
        temporary.write_text(html, encoding="utf-8")


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Writes a JSON document.

    Raises:
        OutputError: the file cannot be written.
        ValueError: a number is not finite, which JSON cannot say; use None.
    """
    text = json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False)
    with atomic_output(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def write_log(
    path: Path,
    time: "ArrayLike",
    signals: "Mapping[str, ArrayLike]",
    metadata: Mapping[str, Any],
) -> None:
    """Writes signals to an .npz file that `numpy.load` reads without pickles.

    The file holds `t` (n,) in seconds, one array (n, ...) per port under the port's name, and
    `metadata`, a JSON text.

    Args:
        path: the file, by custom *.npz.
        time: (n,) [s].
        signals: port name -> (n, ...) numbers, one row per time.
        metadata: anything JSON can say.

    Raises:
        OutputError: the file cannot be written.
        ValueError: a signal that is not numeric, has not one row per time, or takes a name that
            the file needs.
    """
    import numpy as np

    times = np.asarray(time, dtype=float)
    if times.ndim != 1:
        raise ValueError(f"time must be (n,), not {times.shape}")
    arrays = {name: np.asarray(signal) for name, signal in signals.items()}
    for name, array in arrays.items():
        if name in _RESERVED:
            raise ValueError(f"a signal cannot be called '{name}'")
        if array.dtype.kind not in "biufc":
            raise ValueError(f"signal '{name}' is not numeric but {array.dtype}")
        if array.shape[:1] != times.shape:
            raise ValueError(
                f"signal '{name}' is {array.shape}, not one row per {len(times)} times"
            )
    text = np.array(json.dumps(metadata, ensure_ascii=False))
    # An open file, because numpy appends .npz to a path that does not end with it.
    with atomic_output(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, t=times, metadata=text, **arrays)  # type: ignore[arg-type]


def read_log(path: Path) -> Log:
    """Reads a log that a run left behind, in any of the formats.

    Raises:
        OutputError: the file is missing or is no such log.
        MissingExtra: for an MCAP log, mcap is not installed.
    """
    from parapod.sims.lab.stored_log import open_log

    return open_log(path).read()


def _cannot_write(path: Path, reason: str) -> OutputError:
    return OutputError(f"cannot write {quoted_path(path)}: {reason}", path)


def _cannot_make(path: Path, reason: str) -> OutputError:
    return OutputError(f"cannot make the folder {quoted_path(path)}: {reason}", path)


def write_experiment_log(
    path: Path,
    experiment: str,
    scenario: Any,
    time: "ArrayLike",
    signals: "Mapping[str, tuple[ArrayLike, str]]",
) -> None:
    """Writes a log that `read_log` reads, in the format that its suffix says.

    Args:
        path: the file, *.npz, *.mcap or *.csv.
        experiment: its name.
        scenario: scenario that was run.
        time: (n) [s].
        signals: by port, the samples (n, ...) and their unit.

    Raises:
        OutputError: the file cannot be written, or its suffix says no format.
        MissingExtra: for an MCAP log, mcap is not installed.
    """
    check_log(path)
    made = {
        "experiment": experiment,
        "parapod": version("parapod"),
        "scenario": dump_scenario(scenario),
    }
    units = {name: unit for name, (_, unit) in signals.items()}
    samples = {name: values for name, (values, _) in signals.items()}
    if path.suffix == ".mcap":
        from parapod.sims.lab.mcap import write_mcap

        write_mcap(path, time, samples, units, made)
    elif path.suffix == ".csv":
        _write_csv(path, time, samples, made | {"units": units})
    else:
        write_log(path, time, samples, made | {"units": units})


def check_log(path: Path) -> None:
    """Refuses a log whose suffix says no format, before a run is spent on it.

    Raises:
        OutputError: names the formats.
    """
    if path.suffix not in LOG_FORMATS:
        known = ", ".join(LOG_FORMATS)
        raise _cannot_write(path, f"a log's suffix must be one of {known}")


def _write_csv(
    path: Path,
    time: "ArrayLike",
    signals: "Mapping[str, ArrayLike]",
    metadata: Mapping[str, Any],
) -> None:
    """Writes a table with a column for each element of each signal.

    A comment in the first line holds the metadata, the second the names of the columns.
    """
    import numpy as np

    columns, names = [np.asarray(time, dtype=float)], ["t"]
    for name, samples in signals.items():
        values = np.asarray(samples, dtype=float)
        for index in np.ndindex(values.shape[1:]):
            columns.append(values[:, *index])
            names.append(f"{name}[{';'.join(map(str, index))}]" if index else name)
    header = f"# {json.dumps(metadata, ensure_ascii=False)}\n{','.join(names)}"
    with atomic_output(path) as temporary:
        table = np.column_stack(columns)
        np.savetxt(temporary, table, "%.17g", ",", header=header, comments="", encoding="utf-8")
