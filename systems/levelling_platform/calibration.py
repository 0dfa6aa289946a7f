"""Calibration of the levelling platform: leg dimensions, encoder offsets and accelerometer bias.

From poses in which the platform stood still (`PoseRecording`), by least squares on the equations
of all feet that stand (`StandingEquations`). Each parameter's tolerance is taken as one more, weak
measurement (maximum a posteriori): it decides in the directions in which the data say next to
nothing and which hardly move the platform. A recording that leaves open what does move it is
refused (`check_determined`).
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg  # type: ignore[import-untyped]
import scipy.optimize  # type: ignore[import-untyped]
from numpy.typing import NDArray

from parapod.systems.levelling_platform.calibration_determinacy import check_determined
from parapod.systems.levelling_platform.calibration_equations import StandingEquations
from parapod.systems.levelling_platform.calibration_parameters import (
    BIAS,
    GROUND,
    PARAMETER_COUNT,
    Tolerances,
    deviated,
    offsets_of,
)
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.pose_recording import PoseRecording

type Floats = NDArray[np.float64]

# Next to the rounding of the residuals.
_CONVERGED = 1e-15
# Half width of a uniform distribution by its standard deviation.
_UNIFORM = np.sqrt(3.0)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a recording says about the machine.

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
        degrees_of_freedom: of `chi2`, which it should be near: the equations less the parameters,
            of which one that data and tolerance share counts by the data's share.
        condition: largest over smallest singular value of the data's sensitivity to the parameters
            in tolerances.
        determined: of how many directions the data alone are surer than a tolerance.
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
        """Of the parameters (36)."""
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
        tolerances: how far it may be from that.

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

    found = scipy.optimize.least_squares(
        residual,
        np.zeros(PARAMETER_COUNT),
        jacobian,
        method="lm",
        ftol=_CONVERGED,
        xtol=_CONVERGED,
        gtol=_CONVERGED,
    )
    return start + prior * found.x
