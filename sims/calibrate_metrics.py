"""What the experiment `calibrate` measures: posture predicted on poses that were not used."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from parapod.sims.calibrate_machine import Machine, SimulatedPoses
from parapod.sims.results import Metric
from parapod.systems.levelling_platform.calibration.equations import (
    BIAS,
    LEG_PARAMETERS,
    LEG_WIDTH,
    Tolerances,
    ground_in_heading,
)
from parapod.systems.levelling_platform.calibration.poses import PoseRecording
from parapod.systems.levelling_platform.calibration.solve import Calibration, calibrate
from parapod.systems.levelling_platform.geometry import ANGLES, LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import dot, normal_of, to_platform

type Floats = NDArray[np.float64]

# How much better the calibrated machine must predict its posture than the drawing does.
IMPROVEMENT = 5.0
# What the paper calls an almost exact model: its errors against the simulated machine (section 7).
_EXACT = {"height": 0.3, "roll": 0.07, "pitch": 0.07}  # [mm, deg, deg]
# The paper's errors of the drawing against its prototype (section 7).
_PROTOTYPE = {"height": 1.0, "roll": 0.2, "pitch": 0.1}  # [mm, deg, deg]
# How many of its standard deviations chi^2 may be above its mean.
_CHI2_SPREAD = 5.0
# Most calibrations that cross-validation makes.
_FOLDS = 50


@dataclass(frozen=True, eq=False)
class Prediction:
    """How far predicted postures are from what they are compared with.

    Attributes:
        posture: (n, 3) error of roll, pitch, height [rad, rad, m].
        feet: (n, 4) by how much a platform with that error has each foot too high [m]. This makes
            one quantity of angles and heights.
    """

    posture: Floats
    feet: Floats

    @property
    def size(self) -> float:
        """Root mean square of the feet's errors [m]."""
        return float(np.sqrt(np.mean(self.feet**2)))


@dataclass(frozen=True, eq=False)
class Comparison:
    """The same poses predicted with the drawing and with the calibrated machine.

    Attributes:
        nominal: by the drawing.
        calibrated: by the calibration.
    """

    nominal: Prediction
    calibrated: Prediction

    @property
    def improvement(self) -> float:
        """The drawing's error over the calibrated one's [-]."""
        return self.nominal.size / self.calibrated.size


def compare(
    calibration: Calibration,
    nominal: PlatformGeometry,
    recording: PoseRecording,
    posture: Floats,
    ground: Floats,
) -> Comparison:
    """Predicts postures from what the encoders say.

    Args:
        calibration: made of other poses.
        nominal: the drawing.
        recording: the poses (n); one with less than three standing feet is left out.
        posture: (n, 3) what the prediction is compared with [rad, rad, m].
        ground: (n, 2) roll and pitch of the ground [rad].
    """
    read = recording.extension
    machines = ((nominal, read), (calibration.geometry, read + calibration.offsets))
    errors = [
        _predicted(geometry, extension, ground, recording.contact) - posture
        for geometry, extension in machines
    ]
    standing = recording.contact.sum(axis=1) >= 3
    predictions = []
    for error in errors:
        feet = _foot_errors(nominal, read, posture, error, ground)
        predictions.append(Prediction(error[standing], feet[standing]))
    return Comparison(*predictions)


def compare_with_truth(
    calibration: Calibration, nominal: PlatformGeometry, poses: SimulatedPoses
) -> Comparison:
    """Predicted against true postures, on ground that is known."""
    return compare(calibration, nominal, poses.recording, poses.posture, poses.ground)


def compare_with_sensor(
    calibration: Calibration, nominal: PlatformGeometry, poses: SimulatedPoses, machine: Machine
) -> Comparison:
    """Predicted postures against those that a noise-free, corrected inertial sensor shows."""
    shown = poses.posture.copy()
    shown[:, :2] += machine.bias - calibration.bias
    return compare(calibration, nominal, poses.recording, shown, poses.ground)


def cross_validate(
    recording: PoseRecording, nominal: PlatformGeometry, tolerances: Tolerances
) -> Comparison:
    """Predicts each recorded pose with a calibration made of others.

    Compared with the measured posture: inclination by the reference where there is one, else by
    the inertial sensor less its bias.

    Raises:
        UndeterminedCalibration: without some poses the others do not suffice.
    """
    folds = min(_FOLDS, len(recording))
    parts = []
    for fold in range(folds):
        held = np.arange(len(recording)) % folds == fold
        others, unused = recording[~held], recording[held]
        found = calibrate(others, nominal, tolerances)
        ground = unused.ground
        if ground is None:
            assert found.ground is not None
            ground = ground_in_heading(found.ground, unused.turned)
        attitude = unused.attitude - found.bias
        if unused.reference is not None:
            attitude = np.where(unused.referenced[:, None], unused.reference, attitude)
        assert unused.height is not None
        posture = np.column_stack([attitude, unused.height])
        parts.append(compare(found, nominal, unused, posture, ground))
    return Comparison(
        _joined([part.nominal for part in parts]), _joined([part.calibrated for part in parts])
    )


def _joined(parts: list[Prediction]) -> Prediction:
    return Prediction(
        np.vstack([part.posture for part in parts]), np.vstack([part.feet for part in parts])
    )


def _predicted(
    geometry: PlatformGeometry, extension: Floats, ground: Floats, contact: NDArray[np.bool_]
) -> Floats:
    """Posture (n, 3) on the feet that stand; NaN on less than three."""
    posture = forward_kinematics(geometry, extension, ground)
    for lifted in range(LEG_COUNT):
        legs = [i for i in range(LEG_COUNT) if i != lifted]
        rows = ~contact[:, lifted]
        posture[rows] = forward_kinematics(geometry, extension[rows], ground[rows], legs)
    posture[contact.sum(axis=1) < 3] = np.nan
    return posture


def _foot_errors(
    geometry: PlatformGeometry, extension: Floats, posture: Floats, error: Floats, ground: Floats
) -> Floats:
    """How far feet (n, 4) that stand in a posture would be above the ground with its error [m]."""
    normal = normal_of(*ground.T)
    right, wrong = (to_platform(normal, *p[:, :2].T) for p in (posture, posture + error))
    feet = []
    for i, leg in enumerate(geometry.legs):
        foot = foot_to_centre(leg, extension[:, i])
        feet.append(error[:, 2] - dot(wrong, foot) + dot(right, foot))
    return np.stack(feet, axis=-1)


def prediction_metrics(
    comparison: Comparison, least: float | None, is_bounded: bool, where: str
) -> list[Metric]:
    """Errors before and after, and what was gained.

    Args:
        comparison: of poses that were not used.
        least: smallest improvement allowed, or None.
        is_bounded: whether the calibrated errors have bounds.
        where: of which poses and against what, in words.
    """
    metrics = [
        Metric(
            "improvement_factor",
            comparison.improvement,
            at_least=least,
            meaning="error of the four feet's heights that a predicted posture implies, root mean "
            f"square: drawing by calibrated; {where}",
        ),
        Metric("foot_error_mm", 1e3 * comparison.calibrated.size, "mm", meaning="calibrated"),
        Metric("nominal_foot_error_mm", 1e3 * comparison.nominal.size, "mm", meaning="drawing"),
    ]
    for prefix, prediction in (("", comparison.calibrated), ("nominal_", comparison.nominal)):
        roll, pitch, height = np.abs(prediction.posture).max(axis=0).tolist()
        for name, value, unit in (
            ("height", 1e3 * height, "mm"),
            ("roll", math.degrees(roll), "deg"),
            ("pitch", math.degrees(pitch), "deg"),
        ):
            metrics.append(
                Metric(
                    f"{prefix}{name}_error_{unit}",
                    value,
                    unit,
                    _EXACT[name] if is_bounded and not prefix else None,
                    paper=_PROTOTYPE[name] if prefix else None,
                    meaning="largest; " + ("drawing" if prefix else "calibrated"),
                )
            )
    return metrics


def fit_metrics(calibration: Calibration) -> list[Metric]:
    """How well data and model agree, and how sure the parameters are."""
    deviations = calibration.standard_deviations
    legs = deviations[: LEG_COUNT * LEG_WIDTH].reshape(LEG_COUNT, LEG_WIDTH)
    worst = dict(zip(LEG_PARAMETERS, legs.max(axis=0).tolist(), strict=True))
    length = max(worst[name] for name in worst if name not in (*ANGLES, "offset"))
    spread = math.sqrt(2.0 / calibration.degrees_of_freedom)
    roll, pitch = (1e3 * calibration.bias).tolist()
    sure = "largest standard deviation of a leg's"
    return [
        Metric(
            "chi2_per_dof",
            calibration.chi2_per_dof,
            bound=1.0 + _CHI2_SPREAD * spread,
            meaning="1 if model and noise are right",
        ),
        Metric("length_std_mm", 1e3 * length, "mm", meaning=f"{sure} length"),
        Metric(
            "angle_std_deg",
            math.degrees(max(worst[name] for name in ANGLES)),
            "deg",
            meaning=f"{sure} angle",
        ),
        Metric("offset_std_mm", 1e3 * worst["offset"], "mm", meaning=f"{sure} encoder offset"),
        Metric(
            "accel_bias_std_mg",
            1e3 * float(deviations[BIAS].max()),
            "mg",
            meaning="of the bias, the larger of roll and pitch",
        ),
        Metric("accel_bias_roll_mg", roll, "mg", meaning="that makes the roll too large"),
        Metric("accel_bias_pitch_mg", pitch, "mg", meaning="that makes the pitch too large"),
        Metric("condition", calibration.condition, meaning="of the sensitivity, in tolerances"),
    ]


def truth_metrics(
    calibration: Calibration, machine: Machine, sensed: Comparison, is_tracked: bool
) -> list[Metric]:
    """How far the calibration is from the machine that was simulated."""
    bias = np.abs(calibration.bias - machine.bias).max()
    offset = np.abs(calibration.offsets - machine.offsets).max()
    return [
        Metric(
            "sensed_improvement_factor",
            sensed.improvement,
            at_least=IMPROVEMENT,
            meaning="likewise, against the posture that the corrected inertial sensor shows",
        ),
        Metric(
            "accel_bias_error_mg",
            1e3 * float(bias),
            "mg",
            0.25 if is_tracked else None,
            meaning="the larger of roll and pitch",
        ),
        Metric(
            "offset_error_mm",
            1e3 * float(offset),
            "mm",
            meaning="of the worst encoder; l_3, l_4 and alpha make up for it",
        ),
    ]
