"""What an experiment writes for `--log`: its signals with their units, and its scenario."""

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from parapod.sims.outputs import write_log
from parapod.systems.core.scenario_file import dump_scenario


def write_experiment_log(
    path: Path,
    experiment: str,
    scenario: Any,
    time: ArrayLike,
    signals: Mapping[str, tuple[ArrayLike, str]],
) -> None:
    """Writes a log that `read_log` reads.

    Args:
        path: the file.
        experiment: its name.
        scenario: what was run.
        time: (n) [s].
        signals: by port, the samples (n, ...) and their unit.

    Raises:
        OutputError: the file cannot be written.
    """
    metadata = {
        "experiment": experiment,
        "parapod": version("parapod"),
        "scenario": dump_scenario(scenario),
        "units": {name: unit for name, (_, unit) in signals.items()},
    }
    write_log(path, time, {name: samples for name, (samples, _) in signals.items()}, metadata)
