"""Recorded poses in files: what `--log` writes, and what `recording` reads."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.sims.calibrate_scenario import CalibrateScenario
from parapod.sims.experiment_log import write_experiment_log
from parapod.sims.outputs import read_log
from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.levelling_platform.calibration.equations import ground_in_heading
from parapod.systems.levelling_platform.calibration.poses import PoseRecording
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY

# Signal in a file, what it is called in a recording, its width and unit.
_NEEDED = (
    ("legs.extension", "extension", LEG_COUNT, "m"),
    ("attitude_estimated", "attitude", 2, "rad"),
    ("height_measured", "height", 1, "m"),
)
_OPTIONAL = (
    ("legs.contact", "contact", LEG_COUNT, "0/1"),
    ("ground_measured", "ground", 2, "rad"),
    ("attitude_reference", "reference", 2, "rad"),
    ("heading_measured", "heading", 1, "rad"),
)
# Time between two simulated poses [s].
_PERIOD = 10.0


def write_recording(path: Path, recording: PoseRecording, scenario: CalibrateScenario) -> None:
    """Writes poses to a log that `read_recording` and `numpy.load` read.

    Raises:
        OutputError: the file cannot be written.
    """
    signals = {}
    for signal, name, width, unit in (*_NEEDED, *_OPTIONAL):
        values = getattr(recording, name)
        if values is not None:
            signals[signal] = np.reshape(values, (len(recording), width)), unit
    time = _PERIOD * np.arange(len(recording))
    write_experiment_log(path, "calibrate", scenario, time, signals)


def read_recording(path: Path, scenario: CalibrateScenario) -> PoseRecording:
    """Reads recorded poses.

    Ground that the file does not have is the scenario's, if that is known.

    Raises:
        OutputError: the file cannot be read, or is not such a recording; says what is wrong.
    """
    signals = read_log(path).signals
    missing = [signal for signal, *_ in _NEEDED if signal not in signals]
    if missing:
        raise _unusable(path, f"it has no signal {_quoted(missing)}")
    columns: dict[str, Any] = {}
    for signal, name, width, unit in (*_NEEDED, *_OPTIONAL):
        if signal in signals:
            columns[name] = _column(path, signal, signals[signal], width, unit)
    contact = columns.pop("contact", np.ones_like(columns["extension"]))
    try:
        recording = PoseRecording(
            **columns, contact=contact.astype(bool), noise=scenario.noise.deviations
        )
    except ValueError as error:
        raise _unusable(path, str(error)) from None
    _check_plausible(path, recording)
    if recording.ground is None and scenario.ground.known:
        ground = ground_in_heading(scenario.ground.inclination, recording.turned)
        recording = replace(recording, ground=ground)
    return recording


def _column(
    path: Path, signal: str, values: NDArray[Any], width: int, unit: str
) -> NDArray[np.float64]:
    """A signal's values (n, width), or (n) for a single one."""
    n = len(values) if values.ndim else 0
    if values.dtype.kind not in "biuf":
        raise _unusable(path, f"signal '{signal}' is not numeric but {values.dtype}")
    if values.shape not in ((n, width), (n,) if width == 1 else (n, width)):
        wanted = f"(n, {width}) [{unit}]"
        raise _unusable(path, f"signal '{signal}' must be {wanted}, not {values.shape}")
    column = values.astype(float)
    return column.reshape(n) if width == 1 else column


def _check_plausible(path: Path, recording: PoseRecording) -> None:
    """Refuses numbers that no platform has, most likely in other units."""
    leg = MODEL_GEOMETRY.legs[0]
    low, high = leg.l_4 - leg.l_3, leg.l_4 + leg.l_3
    outside = ~((recording.extension > low) & (recording.extension < high))
    if outside.any():
        pose, number = np.argwhere(outside)[0] + 1
        value = recording.extension[outside][0]
        where = f"in pose {pose} leg {number} is {value:g} m long"
        raise _unusable(path, f"{where}, which is not within {low:g}..{high:g} m")
    steep = np.abs(recording.attitude) >= 0.5 * np.pi
    if steep.any():
        pose, value = np.argwhere(steep)[0][0] + 1, recording.attitude[steep][0]
        raise _unusable(path, f"in pose {pose} the platform is inclined by {value:g} rad")


def _quoted(names: list[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _unusable(path: Path, reason: str) -> OutputError:
    return OutputError(f"cannot calibrate with {quoted_path(path)}: {reason}", path)
