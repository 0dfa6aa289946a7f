"""Identify leg geometry, encoder offsets and accelerometer bias from recorded poses.

The poses are simulated or those of a real recording. The machine's dimensions, encoders and
accelerometer are off by what manufacturing leaves. In each pose the encoders, the inertial sensor
and the optical tracker of Appendix B are read; from these the machine is identified, and its
posture is predicted on poses that were not used.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.scenario import choice, quantity
from parapod.sims.lab.bench import Bench
from parapod.sims.lab.experiment import Experiment, Logged
from parapod.sims.lab.figures import Figure
from parapod.sims.lab.results import Metric
from parapod.sims.levelling_platform.calibrate_figures import figures
from parapod.sims.levelling_platform.calibrate_poses import (
    Machine,
    SimulatedPoses,
    draw_machine,
    pose_signals,
    read_recording,
    record,
)
from parapod.systems.core.errors import OutputError
from parapod.systems.levelling_platform.calibration.equations import (
    BIAS,
    GROUND,
    LEG_PARAMETERS,
    LEG_WIDTH,
    Tolerances,
    equivalent_parameters,
    ground_in_heading,
)
from parapod.systems.levelling_platform.calibration.poses import MeasurementNoise, PoseRecording
from parapod.systems.levelling_platform.calibration.solve import Calibration, calibrate
from parapod.systems.levelling_platform.geometry import ANGLES, LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.plane import dot, normal_of, to_platform

# Nothing is taken to be measured better than this, whatever the scenario says [m, rad]: beyond it
# the squares of errors, which least squares leaves out, are larger than the errors.
_FINEST = 1e-6
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


@dataclass
class PosesScenario:
    """The poses that are recorded.

    Attributes:
        count: how many there are to calibrate with.
        validation: how many others there are to find out what the calibration is worth.
        tracked: the optical tracker that measures the height measures the inclination too.
        turns_deg: the platform's headings, taken in turn from pose to pose [deg].
    """

    count: int = quantity(30, 1, 300)
    validation: int = quantity(100, 1, 10000)
    tracked: bool = True
    turns_deg: list[float] = quantity([0.0], -360.0, 360.0)


@dataclass
class ToleranceScenario:
    """How far the machine may be from its drawing, either way.

    Attributes:
        length_error_mm: each length of each leg [mm].
        angle_error_deg: each angle of each leg [deg].
        offset_error_mm: each actuator's encoder, a constant [mm].
        accel_bias_mg: the accelerometer on each axis; 1 mg tilts by 1 mrad [mg].
    """

    length_error_mm: float = quantity(0.5, 1e-3, 5.0)
    angle_error_deg: float = quantity(0.2, 1e-3, 2.0)
    offset_error_mm: float = quantity(0.3, 1e-3, 5.0)
    accel_bias_mg: float = quantity(5.0, 1e-3, 50.0)

    @property
    def tolerances(self) -> Tolerances:
        """In SI units."""
        return Tolerances(
            length=1e-3 * self.length_error_mm,
            angle=math.radians(self.angle_error_deg),
            offset=1e-3 * self.offset_error_mm,
            bias=1e-3 * self.accel_bias_mg,
        )


@dataclass
class NoiseScenario:
    """How exact measurements are.

    Attributes:
        encoder_resolution_mm: one count of the encoders; 0 for perfect ones [mm].
        inclination_deg: standard deviation of the inertial sensor at rest, beside its bias [deg].
        height_mm: of the height [mm], Appendix B.
        tracked_inclination_deg: of the tracker's inclination [deg], Appendix B.
    """

    encoder_resolution_mm: float = quantity(0.01, 0.0, 1.0)
    inclination_deg: float = quantity(0.01, 0.0, 1.0)
    height_mm: float = quantity(0.05, 0.0, 5.0)
    tracked_inclination_deg: float = quantity(0.01, 0.0, 1.0)

    @property
    def deviations(self) -> MeasurementNoise:
        """Standard deviations in SI units; a rounding's is the count by the root of 12."""
        return MeasurementNoise(
            extension=max(_FINEST, 1e-3 * self.encoder_resolution_mm / math.sqrt(12.0)),
            attitude=max(_FINEST, math.radians(self.inclination_deg)),
            height=max(_FINEST, 1e-3 * self.height_mm),
            reference=max(_FINEST, math.radians(self.tracked_inclination_deg)),
        )


@dataclass
class KnownGroundScenario:
    """The ground during the recording.

    Attributes:
        known: whether the calibration is told how it is inclined.
        roll_deg: at heading 0 [deg].
        pitch_deg: [deg].
    """

    known: bool = True
    roll_deg: float = quantity(0.0, -15.0, 15.0)
    pitch_deg: float = quantity(0.0, -15.0, 15.0)

    @property
    def inclination(self) -> np.ndarray:
        """Roll and pitch (2) [rad]."""
        return np.radians([self.roll_deg, self.pitch_deg])


@dataclass
class CalibrateScenario:
    """One calibration.

    Attributes:
        backend: "kinematic": the closed forms stand in for the machine.
        seed: of the machine, the poses and the noise.
        recording: a file with recorded poses; empty for simulated ones.
        poses: see `PosesScenario`; of a recording nothing is simulated.
        tolerances: see `ToleranceScenario`.
        noise: see `NoiseScenario`.
        ground: see `KnownGroundScenario`; where a recording says how the ground is inclined,
            that holds.
    """

    backend: str = choice("kinematic", ("kinematic",))
    seed: int = quantity(0, 0, 2**31 - 1)
    recording: str = ""
    poses: PosesScenario = field(default_factory=PosesScenario)
    tolerances: ToleranceScenario = field(default_factory=ToleranceScenario)
    noise: NoiseScenario = field(default_factory=NoiseScenario)
    ground: KnownGroundScenario = field(default_factory=KnownGroundScenario)


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


@dataclass(frozen=True)
class Identified:
    """A machine that has been identified.

    Attributes:
        recording: the poses.
        calibration: parameters and standard deviations.
        comparison: predictions on poses that were not used.
        where: those poses, in words.
        machine: the simulated machine; None for a real one.
        sensed: predictions against the inertial sensor; None for a real machine.
    """

    recording: PoseRecording
    calibration: Calibration
    comparison: Comparison
    where: str
    machine: Machine | None = None
    sensed: Comparison | None = None


class Calibrate(Experiment[CalibrateScenario, Identified]):
    """Calibrates."""

    schema = CalibrateScenario
    backends = ("kinematic",)
    takes = "5 s"

    def run(self, scenario: CalibrateScenario, bench: Bench) -> Identified:
        """Identifies a simulated machine, or the one that a recording is of.

        Raises:
            UndeterminedCalibration: the poses do not determine the machine; says what would.
            OutputError: the recording cannot be read.
        """
        if scenario.recording and bench.options.log is not None:
            raise OutputError(
                "--log has nothing to write: the poses are read from a recording",
                bench.options.log,
            )
        return _of_recording(scenario) if scenario.recording else _of_simulation(scenario)

    def logged(self, scenario: CalibrateScenario, data: Identified) -> Logged:
        """The poses."""
        return pose_signals(data.recording)

    def measure(self, scenario: CalibrateScenario, data: Identified) -> Iterator[Metric]:
        """Predictions, fit, and the truth where it is known."""
        if data.machine is None or data.sensed is None:
            yield from prediction_metrics(data.comparison, 1.0, False, data.where)
            yield from fit_metrics(data.calibration)
            return
        is_tracked = scenario.poses.tracked
        least = IMPROVEMENT if is_tracked else None
        yield from prediction_metrics(data.comparison, least, is_tracked, data.where)
        yield from fit_metrics(data.calibration)
        yield from truth_metrics(data.calibration, data.machine, data.sensed, is_tracked)

    def note(self, scenario: CalibrateScenario, data: Identified) -> Iterable[str]:
        """The parameters with their standard deviations."""
        return _notes(data.calibration, data.recording)

    def draw(self, scenario: CalibrateScenario, data: Identified) -> Iterable[Figure]:
        """Parameters and residuals."""
        tolerance = scenario.tolerances.tolerances.of_parameters(MODEL_GEOMETRY)
        truth = None
        if (machine := data.machine) is not None:
            truth = equivalent_parameters(
                machine.geometry, MODEL_GEOMETRY, machine.offsets, machine.bias
            )
            truth[GROUND] = scenario.ground.inclination
        return figures(data.calibration, tolerance, truth, data.comparison)


def _of_simulation(scenario: CalibrateScenario) -> Identified:
    random = np.random.default_rng(scenario.seed)
    machine = draw_machine(scenario, random)
    poses, unused = record(scenario, machine, random)
    calibration = calibrate(poses.recording, MODEL_GEOMETRY, scenario.tolerances.tolerances)
    return Identified(
        poses.recording,
        calibration,
        compare_with_truth(calibration, MODEL_GEOMETRY, unused),
        f"{len(unused.recording)} other poses, against the truth",
        machine,
        compare_with_sensor(calibration, MODEL_GEOMETRY, unused, machine),
    )


def _of_recording(scenario: CalibrateScenario) -> Identified:
    recording = read_recording(Path(scenario.recording), scenario)
    tolerances = scenario.tolerances.tolerances
    return Identified(
        recording,
        calibrate(recording, MODEL_GEOMETRY, tolerances),
        cross_validate(recording, MODEL_GEOMETRY, tolerances),
        f"{len(recording)} poses held out, against what was measured in them",
    )


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


def _notes(calibration: Calibration, recording: PoseRecording) -> list[str]:
    """The parameters with standard deviations, and how far the data go."""
    notes = ["deviations from the drawing [mm, deg], +- one standard deviation:"]
    values, deviations = calibration.parameters, calibration.standard_deviations
    for i in range(LEG_COUNT):
        cells = []
        for k, name in enumerate(LEG_PARAMETERS, start=LEG_WIDTH * i):
            scale = math.degrees(1.0) if name in ANGLES else 1e3
            cells.append(f"{name} {scale * values[k]:.2f} +- {scale * deviations[k]:.2f}")
        notes.append(f"leg {i + 1}: {', '.join(cells)}")
    notes.append(
        f"the data alone determine {calibration.determined} directions of the parameters, the "
        "tolerances the rest, in which the feet hardly move"
    )
    if calibration.ground is not None:
        roll, pitch = np.degrees(calibration.ground).tolist()
        sure = math.degrees(float(deviations[GROUND].max()))
        notes.append(f"ground: roll {roll:.3f}, pitch {pitch:.3f} +- {sure:.3f} deg")
    if not recording.referenced.any():
        sure = 1e3 * float(deviations[BIAS].max())
        notes.append(
            "no reference of the inclination: a sensor that leans and legs that lean with it are "
            f"told apart by tolerances only, to +- {sure:.2f} mg"
        )
    return notes
