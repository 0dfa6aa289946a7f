"""Files of logs in all their formats, readable without Drake."""

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from parapod.sims.output.atomic import atomic_output
from parapod.sims.output.logs.mcap import Draw, write_mcap
from parapod.sims.output.logs.stored import Log, open_log
from parapod.sims.output.moment import moment
from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.core.scenario_file import dump_scenario

LOG_FORMATS = (".npz", ".mcap", ".csv")
# Names in a log that are not signals, and parameters of numpy's writer, which signals cannot be.
_RESERVED = ("t", "metadata", "file", "allow_pickle")


def write_log(
    path: Path,
    time: ArrayLike,
    signals: Mapping[str, ArrayLike],
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
        OutputError: the file is missing, or is not a log.
        MissingExtra: for an MCAP log, mcap is not installed.
    """
    return open_log(path).read()


def write_experiment_log(
    path: Path,
    experiment: str,
    scenario: Any,
    time: ArrayLike,
    signals: Mapping[str, tuple[ArrayLike, str]],
    draw: Draw | None = None,
) -> None:
    """Writes a log that `read_log` reads, in the format that its suffix says.

    Args:
        path: the file, *.npz, *.mcap or *.csv.
        experiment: its name.
        scenario: scenario that was run.
        time: (n) [s].
        signals: samples (n, ...) and their unit, by port.
        draw: draws the machine into an *.mcap; None: it is not drawn.

    Raises:
        OutputError: the file cannot be written, or its suffix says no format.
        MissingExtra: for an MCAP log, mcap is not installed.
    """
    check_log(path)
    metadata = {
        "experiment": experiment,
        "parapod": version("parapod"),
        "scenario": dump_scenario(scenario),
        "written": moment(),
    }
    units = {name: unit for name, (_, unit) in signals.items()}
    samples = {name: values for name, (values, _) in signals.items()}
    if path.suffix == ".mcap":
        write_mcap(path, time, samples, units, metadata, draw)
    elif path.suffix == ".csv":
        _write_csv(path, time, samples, metadata | {"units": units})
    else:
        write_log(path, time, samples, metadata | {"units": units})


def check_log(path: Path) -> None:
    """Refuses a log whose suffix says no format, before a run is spent on it.

    Raises:
        OutputError: names the formats.
    """
    if path.suffix not in LOG_FORMATS:
        formats = ", ".join(LOG_FORMATS)
        raise OutputError(
            f"cannot write {quoted_path(path)}: a log's suffix must be one of {formats}", path
        )


def _write_csv(
    path: Path,
    time: ArrayLike,
    signals: Mapping[str, ArrayLike],
    metadata: Mapping[str, Any],
) -> None:
    """Writes a table with a column for each element of each signal.

    A comment in the first line holds the metadata, the second the names of the columns.
    """
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
