"""Calibration of the levelling platform: leg dimensions, encoder offsets and accelerometer bias.

From poses in which the platform stood still (`PoseRecording`), by least squares on the equations
of all feet that stand (`StandingEquations`). Each parameter's tolerance is taken as one more, weak
measurement (maximum a posteriori): it decides in the directions in which the data say next to
nothing and which hardly move the platform. A recording that leaves open a direction that does
move it is refused (`check_determined`).

For that, parameters are counted in their tolerances. A direction in which the data alone are less
sure than one tolerance is undetermined. Most of these do not matter: 30 mm of stroke bend a leg's
curve so little that l_3, l_4, alpha and the encoder's offset nearly act as two numbers. So a
direction is missed only if one tolerance of it moves the feet by more than `NEGLIGIBLE` in the
workspace, against the ground as the inertial sensor sees it.

An inertial sensor that leans and four legs that lean with it look alike in every pose on any
ground. Posture against the sensor does not depend on it; the accuracy of the bias by itself, and
with it of the attitude against gravity, is left to the legs' tolerances unless a reference
measured it (`PoseRecording.reference`). The bias's standard deviation says so.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy.linalg  # type: ignore[import-untyped]
import scipy.optimize  # type: ignore[import-untyped]

from parapod.systems.core.errors import UndeterminedCalibration
from parapod.systems.levelling_platform.calibration.equations import (
    BIAS,
    GROUND,
    LEG_WIDTH,
    PARAMETER_COUNT,
    Floats,
    StandingEquations,
    Tolerances,
    deviated,
    offsets_of,
    parameter_names,
)
from parapod.systems.levelling_platform.calibration.poses import MeasurementNoise, PoseRecording
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics, passive_extension

# Root mean square over the workspace of the four feet's motions together: the .05 mm that the
# optical tracker of Appendix B resolves, for each foot [m].
NEGLIGIBLE = math.sqrt(LEG_COUNT) * 0.05e-3
# A parameter takes part in a direction from this share of the largest one's part on [-].
_PART = 0.25
# This number of poses usually suffices, if they differ.
_ENOUGH_POSES = 15
# Below these spreads a recording hardly leaves one pose.
_SPREAD_ANGLE = math.radians(3.0)
_SPREAD_SHARE_OF_STROKE = 0.5


def check_determined(equations: StandingEquations, tolerance: Floats, sensitivity: Floats) -> None:
    """Refuses a recording that leaves open something that matters.

    Args:
        equations: equations of the recording.
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
    rank = int((singular >= 1.0).sum())
    left_open = rows[rank:].T
    effect = _workspace_effect(nominal) * tolerance
    _, strengths, mixing = scipy.linalg.svd(effect @ left_open)
    weak_directions = (left_open @ mixing.T)[:, : int((strengths > NEGLIGIBLE).sum())]
    if not weak_directions.size:
        return np.zeros((0, tolerance.size))
    _, triangle, order = scipy.linalg.qr(weak_directions.T, mode="economic", pivoting=True)
    count = weak_directions.shape[1]
    directions = np.empty((count, tolerance.size))
    directions[:, order] = scipy.linalg.solve(triangle[:, :count], triangle)
    return directions


@cache
def _workspace_effect(nominal: PlatformGeometry) -> Floats:
    """Effect of parameters in the workspace (k, 36), normed to that of the feet's motions.

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
    """Put a direction into words, such as "leg 3: l_4 and offset together"."""
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
    """Advice for the next recording, from what this one lacks."""
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
    sizes = np.abs(directions[:, : LEG_COUNT * LEG_WIDTH]).reshape(-1, LEG_COUNT, LEG_WIDTH)
    enough = _SPREAD_SHARE_OF_STROKE * (stroke.extension_max - stroke.extension_min)
    still = []
    for i in np.flatnonzero(sizes.max(axis=(0, 2), initial=0.0) >= _PART).tolist():
        extensions = recording.extension[recording.contact[:, i], i]
        if not extensions.size:
            advice.append(f"poses with leg {i + 1} on the ground")
        elif np.ptp(extensions) < enough:
            still.append(f"leg {i + 1}")
    if still:
        advice.append(f"poses over more of the stroke of {listed(still)}")
    return advice or ["more poses, or measurements with less noise"]


# Next to the rounding of the residuals.
_CONVERGED = 1e-15
# Half width of a uniform distribution by its standard deviation.
_UNIFORM = np.sqrt(3.0)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of a calibration: the machine according to a recording.

    Attributes:
        geometry: the calibrated dimensions. l_6 and l_7 are nominal: l_x, l_y and l_z answer for
            them (`calibration_parameters`).
        offsets: (4) what is to be added to the encoders' extensions [m].
        bias: (2) error of the inertial sensor's roll and pitch, to be subtracted [rad].
        ground: (2) roll and pitch of the ground where it was not known, else None [rad].
        parameters: (36) all of these as deviations, in the order of `parameter_names`.
        covariance: (36, 36) of the parameters, from data and tolerances.
        prior: (36) standard deviation of the parameters before any data.
        residuals: (n, 4) how far each foot is from the ground [m]; zero in the air.
        chi2: sum of squares of the whitened residuals.
        degrees_of_freedom: expected value of `chi2`: the equations less the parameters, of which
            one that data and tolerance share counts by the data's share.
        condition: largest over smallest singular value of the data's sensitivity to the parameters
            in tolerances.
        determined: number of parameter directions that the data determine better than the
            tolerances.
    """

    geometry: PlatformGeometry
    offsets: Floats
    bias: Floats
    ground: Floats | None
    parameters: Floats
    covariance: Floats
    prior: Floats
    residuals: Floats
    chi2: float
    degrees_of_freedom: float
    condition: float
    determined: int

    @property
    def standard_deviations(self) -> Floats:
        """Standard deviations of the parameters (36)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def chi2_per_dof(self) -> float:
        """Near 1 if machine and measurements are as they were said to be."""
        return self.chi2 / self.degrees_of_freedom


def calibrate(
    recording: PoseRecording,
    nominal: PlatformGeometry,
    tolerances: Tolerances = Tolerances(),
) -> Calibration:
    """Finds what machine was recorded.

    Args:
        recording: the poses.
        nominal: the machine as drawn, or as calibrated before.
        tolerances: tolerances of that.

    Raises:
        UndeterminedCalibration: the recording leaves open something that moves the platform; says
            what, and what to record.
        ValueError: an extension that no leg can have.
    """
    equations = StandingEquations(recording, nominal)
    start, tolerance = equations.start, tolerances.of_parameters(nominal)
    if not np.isfinite(equations.residual(start)).all():
        raise ValueError("an extension is outside of what the legs can be built with")
    check_determined(equations, tolerance, equations.whitened(start)[1] * tolerance)
    prior = tolerance / _UNIFORM
    return _judged(equations, _most_likely(equations, start, prior), prior)


def _judged(equations: StandingEquations, parameters: Floats, prior: Floats) -> Calibration:
    """The most likely parameters with how sure they are."""
    recording = equations.recording
    white, derivatives = equations.whitened(parameters)
    _, singular, rows = scipy.linalg.svd(derivatives * prior, full_matrices=False)
    # Of each direction, the part that the data decide.
    shares = singular**2 / (1.0 + singular**2)
    spread = np.eye(PARAMETER_COUNT) - (rows.T * shares) @ rows
    in_use = singular if recording.ground is None else singular[: GROUND.start]
    return Calibration(
        geometry=deviated(equations.nominal, parameters),
        offsets=offsets_of(parameters).copy(),
        bias=parameters[BIAS].copy(),
        ground=parameters[GROUND].copy() if recording.ground is None else None,
        parameters=parameters,
        covariance=prior[:, None] * spread * prior,
        prior=prior,
        residuals=equations.residual(parameters),
        chi2=float(white @ white),
        degrees_of_freedom=float(equations.count - shares.sum()),
        condition=float(in_use[0] / in_use[-1]) if in_use[-1] > 0.0 else np.inf,
        determined=int((singular * _UNIFORM >= 1.0).sum()),
    )


def _most_likely(equations: StandingEquations, start: Floats, prior: Floats) -> Floats:
    """The parameters of least squares, data and prior together."""

    def residual(scaled: Floats) -> Floats:
        return np.concatenate([equations.whitened(start + prior * scaled)[0], scaled])

    def jacobian(scaled: Floats) -> Floats:
        sensitivity = equations.whitened(start + prior * scaled)[1] * prior
        return np.vstack([sensitivity, np.eye(PARAMETER_COUNT)])

    solution = scipy.optimize.least_squares(
        residual,
        np.zeros(PARAMETER_COUNT),
        jacobian,
        method="lm",
        ftol=_CONVERGED,
        xtol=_CONVERGED,
        gtol=_CONVERGED,
    )
    return start + prior * solution.x
