"""A machine that is not as drawn, drawn from a seed, and the poses in which it is recorded."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.sims.lab.experiment import Logged
from parapod.sims.levelling_platform.calibrate.scenario import CalibrateScenario
from parapod.sims.output.logs.files import read_log
from parapod.systems.core.errors import OutputError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.levelling_platform.calibration.equations import ground_in_heading
from parapod.systems.levelling_platform.calibration.poses import PoseRecording
from parapod.systems.levelling_platform.geometry import (
    LEG_COUNT,
    PlatformGeometry,
    drawn_deviations,
)
from parapod.systems.levelling_platform.kinematics import forward_kinematics, passive_extension

type Floats = NDArray[np.float64]

# Extensions tried of each active leg; the design picks from all their combinations.
_GRID = 9
# Stroke that the passive leg keeps by the drawing, so that it has enough as built [m].
_MARGIN = 1.5e-3
# An actuator stops this near to its command, either way, which makes its encoder's rounding
# random [m].
_STOP = 0.1e-3
_LEVEL = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Machine:
    """Machine that a simulation knows and calibration is to find.

    Attributes:
        geometry: dimensions as built.
        offsets: (4) what the encoders' extensions lack [m].
        bias: (2) error of the inertial sensor's roll and pitch [rad].
    """

    geometry: PlatformGeometry
    offsets: Floats
    bias: Floats


@dataclass(frozen=True, eq=False)
class SimulatedPoses:
    """Recorded poses, and what they really were.

    Attributes:
        recording: measurements.
        posture: (n, 3) true roll, pitch, height [rad, rad, m].
        ground: (n, 2) true roll and pitch of the ground in the platform's heading [rad].
    """

    recording: PoseRecording
    posture: Floats
    ground: Floats

    def __getitem__(self, poses: slice) -> "SimulatedPoses":
        return SimulatedPoses(self.recording[poses], self.posture[poses], self.ground[poses])


def draw_machine(scenario: CalibrateScenario, random: np.random.Generator) -> Machine:
    """A machine whose every dimension, offset and bias is uniform within its tolerance."""
    tolerances = scenario.tolerances.tolerances
    deviations = drawn_deviations(random, tolerances.length, tolerances.angle)
    return Machine(
        replace(scenario.machine.geometry, deviations=deviations),
        tolerances.offset * random.uniform(-1.0, 1.0, LEG_COUNT),
        tolerances.bias * random.uniform(-1.0, 1.0, 2),
    )


def record(
    scenario: CalibrateScenario, machine: Machine, random: np.random.Generator
) -> tuple[SimulatedPoses, SimulatedPoses]:
    """The poses to calibrate with, and the poses to validate with.

    The active legs 1 to 3 are brought to about their commanded lengths, as their encoders say, and
    the passive leg is lowered until its foot touches: all four feet stand.
    """
    poses = scenario.poses
    drawing = scenario.machine.geometry
    design = spread_commands(drawing, poses.count, int(random.integers(2**31)))
    commands = np.vstack([design, drawn_commands(drawing, poses.validation, random)])
    turns = np.radians(poses.turns_deg or [0.0])
    heading = turns[np.arange(len(commands)) % len(turns)]
    ground = ground_in_heading(scenario.ground.inclination, heading)
    stops = commands + _STOP * random.uniform(-1.0, 1.0, commands.shape)
    active = stops + machine.offsets[:3]
    standing = np.column_stack([active, active[:, 0]])  # the plane is that of legs 1 to 3
    posture = forward_kinematics(machine.geometry, standing, ground, (0, 1, 2))
    passive = passive_extension(machine.geometry, active, ground, posture[:, :2])
    extension = np.column_stack([active, passive])
    recording = _measured(scenario, machine, random, extension, posture)
    if scenario.ground.known:
        recording = replace(recording, ground=ground)
    else:
        recording = replace(recording, heading=heading)
    recorded = SimulatedPoses(recording, posture, ground)
    return recorded[: poses.count], recorded[poses.count :]


def _measured(
    scenario: CalibrateScenario,
    machine: Machine,
    random: np.random.Generator,
    extension: Floats,
    posture: Floats,
) -> PoseRecording:
    n, noise = len(posture), scenario.noise
    read = extension - machine.offsets
    count = 1e-3 * noise.encoder_resolution_mm
    lean = np.radians(noise.inclination_deg) * random.standard_normal((n, 2))
    rise = 1e-3 * noise.height_mm * random.standard_normal(n)
    inclination_noise = np.radians(noise.tracked_inclination_deg) * random.standard_normal((n, 2))
    return PoseRecording(
        extension=count * np.round(read / count) if count > 0.0 else read,
        attitude=posture[:, :2] + machine.bias + lean,
        height=posture[:, 2] + rise,
        contact=np.ones((n, LEG_COUNT), dtype=bool),
        noise=noise.deviations,
        reference=posture[:, :2] + inclination_noise if scenario.poses.tracked else None,
    )


def spread_commands(geometry: PlatformGeometry, count: int, start: int) -> Floats:
    """Extensions of the active legs (count, 3) that lie far apart in the reachable workspace [m].

    Each is the one of a grid that is farthest, in the extensions of all four legs, from those
    before it: corners of the workspace first, then its faces and its inside.

    Args:
        geometry: the platform as drawn.
        count: number of them.
        start: first one of the grid, modulo their number.
    """
    stroke = np.linspace(geometry.extension_min, geometry.extension_max, _GRID)
    grid = np.stack(np.meshgrid(stroke, stroke, stroke), axis=-1).reshape(-1, 3)
    extension = _reachable(geometry, grid)
    chosen = [start % len(extension)]
    distance = np.full(len(extension), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, ((extension - extension[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(np.argmax(distance)))
    return extension[chosen, :3]


def drawn_commands(geometry: PlatformGeometry, count: int, random: np.random.Generator) -> Floats:
    """Extensions of the active legs (count, 3), uniform over the reachable workspace [m]."""
    low, high = geometry.extension_min, geometry.extension_max
    commands = np.empty((0, LEG_COUNT))
    while len(commands) < count:
        candidates = random.uniform(low, high, (2 * count, 3))
        commands = np.vstack([commands, _reachable(geometry, candidates)])
    return commands[:count, :3]


def _reachable(nominal: PlatformGeometry, active: Floats) -> Floats:
    """Extensions of all legs (m, 4) where the passive one has stroke left, by the drawing [m]."""
    standing = np.column_stack([active, active[:, 0]])
    posture = forward_kinematics(nominal, standing, _LEVEL, (0, 1, 2))
    passive = passive_extension(nominal, active, _LEVEL, posture[:, :2])
    low, high = nominal.extension_min + _MARGIN, nominal.extension_max - _MARGIN
    return np.column_stack([active, passive])[(passive >= low) & (passive <= high)]


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


def pose_signals(recording: PoseRecording) -> Logged:
    """Poses as a log that `read_recording` reads."""
    signals = {}
    for signal, name, width, unit in (*_NEEDED, *_OPTIONAL):
        values = getattr(recording, name)
        if values is not None:
            signals[signal] = np.reshape(values, (len(recording), width)), unit
    return _PERIOD * np.arange(len(recording)), signals


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
    _check_plausible(path, recording, scenario.machine.geometry)
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
        kind = f"(n, {width}) [{unit}]"
        raise _unusable(path, f"signal '{signal}' must be {kind}, not {values.shape}")
    column = values.astype(float)
    return column.reshape(n) if width == 1 else column


def _check_plausible(path: Path, recording: PoseRecording, geometry: PlatformGeometry) -> None:
    """Refuses numbers that no platform has, most likely in other units."""
    leg = geometry.legs[0]
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
