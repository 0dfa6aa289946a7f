"""Files that a run leaves behind: complete or not there at all, and readable without Drake."""

import csv
import json
import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.core.scenario_file import dump_scenario

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

LOG_SUFFIXES = (".npz", ".mcap", ".csv")
# Names in a log that are not signals, and parameters of numpy's writer, which signals cannot be.
_RESERVED = ("t", "metadata", "file", "allow_pickle")


@dataclass(frozen=True)
class Log:
    """Signals of a run.

    Attributes:
        time: (n,) [s].
        signals: port name -> (n, ...) array, one row per time.
        metadata: how the run was made.
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
    if not os.path.isdir(folder):
        raise _cannot_write(path, f"the folder {quoted_path(folder)} does not exist")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise _cannot_write(path, f"no permission to write in {quoted_path(folder)}")
    if os.path.exists(target):
        if not os.path.isfile(target):
            raise _cannot_write(path, "it is not a regular file")
        if not os.access(target, os.W_OK):
            raise _cannot_write(path, "no permission to replace it")
    # What the permissions promise, some file systems do not keep.
    probe = os.path.join(folder, f".parapod-{secrets.token_hex(6)}")
    try:
        with open(probe, "xb"):
            pass
        os.unlink(probe)
    except OSError as error:
        raise _cannot_write(path, error.strerror or str(error)) from None


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
    """Reads what `write_log` wrote, or the `.mcap` log of a run on hardware.

    Raises:
        OutputError: the file is missing or is no such log.
        MissingExtra: for an MCAP log, mcap is not installed.
    """
    if path.suffix == ".mcap":
        from parapod.sims.lab.mcap import read_mcap

        return read_mcap(path)

    import zipfile

    import numpy as np

    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        metadata = json.loads(str(arrays.pop("metadata")))
        return Log(arrays.pop("t"), arrays, metadata)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"cannot read log {quoted_path(path)}: {reason}", path) from error
    except (
        KeyError,
        ValueError,
        AttributeError,
        TypeError,
        EOFError,
        zipfile.BadZipFile,
    ) as error:
        raise OutputError(
            f"cannot read log {quoted_path(path)}: it is not a log of parapod", path
        ) from error


def _cannot_write(path: Path, reason: str) -> OutputError:
    return OutputError(f"cannot write {quoted_path(path)}: {reason}", path)


def check_log(path: Path, allowed: Sequence[str] = LOG_SUFFIXES) -> None:
    """Refuses a log whose suffix says no format, before a run is spent on it.

    Raises:
        OutputError: names the suffixes that there are.
    """
    if path.suffix not in allowed:
        known = ", ".join(allowed)
        raise OutputError(f"--log {quoted_path(path)}: its suffix must be one of {known}", path)


def write_experiment_log(
    path: Path,
    experiment: str,
    scenario: Any,
    time: ArrayLike,
    signals: Mapping[str, tuple[ArrayLike, str]],
) -> None:
    """Writes a log in the format of its suffix; `read_log` reads `.npz` and `.mcap`.

    Args:
        path: the file: `.npz` for numpy, `.mcap` for Foxglove, `.csv` for a table.
        experiment: its name.
        scenario: the scenario that was run.
        time: (n) [s].
        signals: by port, the samples (n, ...) and their unit.

    Raises:
        OutputError: the file cannot be written, or its suffix says no format.
        MissingExtra: for an MCAP log, mcap is not installed.
    """
    check_log(path)
    units = {name: unit for name, (_, unit) in signals.items()}
    samples = {name: values for name, (values, _) in signals.items()}
    metadata = {
        "experiment": experiment,
        "parapod": version("parapod"),
        "scenario": dump_scenario(scenario),
    }
    if path.suffix == ".mcap":
        from parapod.sims.lab.mcap import write_mcap

        write_mcap(path, time, samples, units, metadata)
    elif path.suffix == ".csv":
        _write_csv(path, time, samples, units)
    else:
        write_log(path, time, samples, metadata | {"units": units})


def _write_csv(
    path: Path,
    time: ArrayLike,
    samples: Mapping[str, ArrayLike],
    units: Mapping[str, str],
) -> None:
    """A column for each element, with its unit in the first line."""
    import numpy as np

    times = np.asarray(time, dtype=float)
    columns, titles = [times], ["t [s]"]
    for name, values in samples.items():
        elements = np.asarray(values, dtype=float).reshape(len(times), -1).T
        columns += list(elements)
        titles += [f"{name}.{i} [{units[name]}]" for i in range(len(elements))]
    with atomic_output(path) as temporary, temporary.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(titles)
        writer.writerows(zip(*(column.tolist() for column in columns), strict=True))
