"""Predictions of a calibrated machine on poses that were not used, and their errors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from parapod.systems.core.triples import dot
from parapod.systems.levelling_platform.calibration.equations import (
    Tolerances,
    ground_in_heading,
)
from parapod.systems.levelling_platform.calibration.poses import PoseRecording
from parapod.systems.levelling_platform.calibration.solve import Calibration, calibrate
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import normal_of, to_platform

type Floats = NDArray[np.float64]
# Most calibrations that cross-validation makes.
_FOLDS = 50


@dataclass(frozen=True, eq=False)
class Prediction:
    """Errors of predicted postures.

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
        nominal: error with the lengths of the drawing.
        calibrated: error with the calibrated lengths.
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
        is_held_out = np.arange(len(recording)) % folds == fold
        others, unused = recording[~is_held_out], recording[is_held_out]
        calibration = calibrate(others, nominal, tolerances)
        ground = unused.ground
        if ground is None:
            assert calibration.ground is not None
            ground = ground_in_heading(calibration.ground, unused.turned)
        attitude = unused.attitude - calibration.bias
        if unused.reference is not None:
            attitude = np.where(unused.referenced[:, None], unused.reference, attitude)
        assert unused.height is not None
        posture = np.column_stack([attitude, unused.height])
        parts.append(compare(calibration, nominal, unused, posture, ground))
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
    """Heights (n, 4) that feet in a posture would have above the ground with its error [m]."""
    normal = normal_of(*ground.T)
    right, wrong = (to_platform(normal, *p[:, :2].T) for p in (posture, posture + error))
    feet = []
    for i, leg in enumerate(geometry.legs):
        foot = foot_to_centre(leg, extension[:, i])
        feet.append(error[:, 2] - dot(wrong, foot) + dot(right, foot))
    return np.stack(feet, axis=-1)
