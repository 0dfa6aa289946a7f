"""Whether recorded poses determine what a calibration asks, and what to record if they do not.

Parameters are counted in their tolerances. A direction in which the data alone are less sure than
one tolerance is one that they do not determine. Most of these do not matter: 30 mm of stroke bend
a leg's curve so little that l_3, l_4, alpha and the encoder's offset nearly act as two numbers. So
a direction is missed only if one tolerance of it moves the feet by more than `NEGLIGIBLE` in the
workspace, against the ground as the inertial sensor sees it. Of the others the tolerances say
enough.

An inertial sensor that leans and four legs that lean with it look alike in every pose on any
ground. Posture against the sensor does not depend on it; how exact the bias by itself is, and with
it the attitude against gravity, is left to the legs' tolerances unless a reference measured it
(`PoseRecording.reference`). The bias's standard deviation says so.
"""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import scipy.linalg  # type: ignore[import-untyped]
from numpy.typing import NDArray

from parapod.systems.errors import UndeterminedCalibration
from parapod.systems.levelling_platform.calibration_equations import StandingEquations
from parapod.systems.levelling_platform.calibration_parameters import (
    BIAS,
    GROUND,
    LEG_WIDTH,
    PARAMETER_COUNT,
    parameter_names,
)
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.legs_to_posture import forward_kinematics
from parapod.systems.levelling_platform.pose_recording import MeasurementNoise, PoseRecording
from parapod.systems.levelling_platform.posture_to_legs import passive_extension

type Floats = NDArray[np.float64]

# Root mean square over the workspace of the four feet's motions together: the .05 mm that the
# optical tracker of Appendix B resolves, for each foot [m].
NEGLIGIBLE = math.sqrt(LEG_COUNT) * 0.05e-3
# A parameter takes part in a direction from this share of the largest one's part on [-].
_PART = 0.25
# So many poses usually do, if they differ.
_ENOUGH_POSES = 15
# Below these spreads a recording hardly leaves one pose.
_SPREAD_ANGLE = math.radians(3.0)
_SPREAD_SHARE_OF_STROKE = 0.5


def check_determined(equations: StandingEquations, tolerance: Floats, sensitivity: Floats) -> None:
    """Refuses a recording that leaves open something that matters.

    Args:
        equations: of the recording.
        tolerance: (36) of the parameters.
        sensitivity: (m, 36) whitened equations by parameters in tolerances.

    Raises:
        UndeterminedCalibration: names the directions and what to record.
    """
    directions = undetermined_directions(equations.nominal, tolerance, sensitivity)
    if len(directions):
        # Ground counts like a bias that looks the same, and not in its wide tolerance.
        directions[:, GROUND] *= tolerance[GROUND] / tolerance[BIAS]
        names = [_in_words(direction) for direction in directions]
        raise UndeterminedCalibration(names, _advice(equations, directions))


def undetermined_directions(
    nominal: PlatformGeometry, tolerance: Floats, sensitivity: Floats
) -> Floats:
    """Directions (k, 36) in tolerances that the data leave open and that matter.

    Each has an entry of 1 at a parameter of its own, which the other directions leave alone, so
    that it reads as: this one, and with it so much of those.

    Args:
        nominal: the machine.
        tolerance: (36) of the parameters.
        sensitivity: (m, 36) whitened equations by parameters in tolerances.
    """
    # All 36 rows, also of fewer equations; of more, no square of their number.
    is_short = len(sensitivity) < tolerance.size
    _, singular, rows = scipy.linalg.svd(sensitivity, full_matrices=is_short)
    known = int((singular >= 1.0).sum())
    left_open = rows[known:].T
    effect = _workspace_effect(nominal) * tolerance
    _, moved, mixing = scipy.linalg.svd(effect @ left_open)
    missed = (left_open @ mixing.T)[:, : int((moved > NEGLIGIBLE).sum())]
    if not missed.size:
        return np.zeros((0, tolerance.size))
    _, triangle, order = scipy.linalg.qr(missed.T, mode="economic", pivoting=True)
    count = missed.shape[1]
    directions = np.empty((count, tolerance.size))
    directions[:, order] = scipy.linalg.solve(triangle[:, :count], triangle)
    return directions


@cache
def _workspace_effect(nominal: PlatformGeometry) -> Floats:
    """What parameters do in the workspace (k, 36): its squares' sum is that of the feet's motions.

    Root mean square over poses on known level ground, root of the sum of squares over feet.
    """
    ends = (nominal.extension_min, nominal.extension_max)
    grid = np.linspace(*ends, 3)
    active = np.stack(np.meshgrid(grid, grid, grid), axis=-1).reshape(-1, 3)
    level = (0.0, 0.0)
    # Three feet always stand: their plane gives the posture, and the fourth leg follows.
    posture = forward_kinematics(nominal, np.insert(active, 3, ends[0], axis=1), level, (0, 1, 2))
    passive = passive_extension(nominal, active, level, posture[:, :2])
    reachable = (passive >= ends[0]) & (passive <= ends[1])
    extension = np.column_stack([active, passive])[reachable]
    n = len(extension)
    workspace = PoseRecording(
        extension,
        posture[reachable, :2],
        posture[reachable, 2],
        np.ones((n, LEG_COUNT), dtype=bool),
        MeasurementNoise(1.0, 1.0, 1.0),
        ground=np.zeros((n, 2)),
    )
    jacobian = StandingEquations(workspace, nominal).jacobian(np.zeros(PARAMETER_COUNT))
    return jacobian.reshape(-1, PARAMETER_COUNT) / math.sqrt(n)


def _in_words(direction: Floats) -> str:
    """As in "leg 3: l_4 and offset together"."""
    names = parameter_names()
    takes_part = np.flatnonzero(np.abs(direction) >= _PART * np.abs(direction).max())
    groups: dict[str, list[str]] = {}
    for k in takes_part.tolist():
        leg, _, name = names[k].rpartition(": ")
        groups.setdefault(leg, []).append(name)
    parts = [f"{leg}: {listed(group)}" if leg else listed(group) for leg, group in groups.items()]
    return listed(parts) + (" together" if len(takes_part) > 1 else "")


def listed(words: Sequence[str]) -> str:
    """Words in a row: "a", "a and b", "a, b and c"."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def _advice(equations: StandingEquations, directions: Floats) -> list[str]:
    """What to record, from what the recording lacks."""
    recording, stroke = equations.recording, equations.nominal
    advice = []
    if recording.height is None:
        advice.append("measured heights")
    if recording.ground is None and np.abs(directions[:, GROUND]).max() >= _PART:
        advice.append(
            "ground of known inclination, or poses with the platform turned around on it"
        )
    if len(recording) < _ENOUGH_POSES:
        advice.append(f"{_ENOUGH_POSES} poses or more")
    spread = dict(zip(("roll", "pitch"), np.ptp(recording.attitude, axis=0), strict=True))
    alike = [axis for axis, angle in spread.items() if angle < _SPREAD_ANGLE]
    if alike:
        advice.append(f"poses that differ in {listed(alike)} by several degrees")
    missed = np.abs(directions[:, : LEG_COUNT * LEG_WIDTH]).reshape(-1, LEG_COUNT, LEG_WIDTH)
    enough = _SPREAD_SHARE_OF_STROKE * (stroke.extension_max - stroke.extension_min)
    still = []
    for i in np.flatnonzero(missed.max(axis=(0, 2), initial=0.0) >= _PART).tolist():
        used = recording.extension[recording.contact[:, i], i]
        if not used.size:
            advice.append(f"poses with leg {i + 1} on the ground")
        elif np.ptp(used) < enough:
            still.append(f"leg {i + 1}")
    if still:
        advice.append(f"poses over more of the stroke of {listed(still)}")
    return advice or ["more poses, or measurements with less noise"]
