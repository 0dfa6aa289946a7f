"""Identify leg geometry, encoder offsets and accelerometer bias from recorded poses.

The poses are simulated or those of a real recording. The machine's dimensions, encoders and
accelerometer are off by what manufacturing leaves. In each pose the encoders, the inertial sensor
and the optical tracker of Appendix B are read; from these the machine is identified, and its
posture is predicted on poses that were not used. A real machine is led through the poses, and
a person with an instrument is asked for its reading.

Each foot that stands gives g(attitude - bias, ground) . P_i(d_i + offset_i) + r = h: least squares
on up to 120 such equations of 30 poses, weighted with their covariance (the four of a pose share
the errors of attitude and height), and on the difference of inertial sensor and tracker (height
.05 mm, inclination .01 deg).

* Eight numbers a leg, not ten: l_6 and l_7 act through the constant part of P_i only. A wrong l_7
  is a wrong l_z, a wrong l_6 is wrong l_x, l_y and l_z. They keep their nominal values.
* Most single lengths stay uncertain, and the posture does not depend on them. 30 mm of stroke bend
  the leg's curve so little that l_3, l_4, alpha and the encoder's offset act as two or three
  numbers, and inclinations of a few degrees hardly show l_x and l_y. The data determine 19 of 34
  directions better than the tolerances; in the others the tolerances decide (weak measurements:
  maximum a posteriori), where one tolerance moves the feet by less than .05 mm. Encoder offsets
  alone are accurate to .15 mm.
* A sensor that leans and four legs that lean with it look alike in every pose, on any ground. With
  the inertial sensor alone the bias is known to .8 mg, however many poses there are; with the
  tracker's inclination to .05 mg. Posture against the sensor is equally exact both ways.
* Unknown ground looks like bias. A platform that is turned on it distinguishes them
  (`ground.known=false poses.turns_deg=[0,180]`); an error of ground that counts as known goes into
  the bias.

A recording that leaves open anything that moves the feet by .05 mm is refused, with the names of
the open directions and the poses that would help. Root mean square errors over 100 other poses,
seeds 0..19 (smallest, median, largest):

| | drawing | calibrated | factor |
|---|---|---|---|
| feet's heights by the posture, with tracker [mm] | .33/1.9/3.8 | .023/.043/.072 | 5.8/38.9/99.1 |
| without tracker, against gravity [mm] | the same | .21/.64/1.2 | .5/2.7/18.3 |
| without tracker, against the corrected sensor | | | 15.1/32.7/93.2 |
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import (
    LevellingScenario,
)
from parapod.diagrams.style import COLOURS
from parapod.sims.lab.experiment import Experiment, Logged
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.calibrate.led import COLUMNS, record_poses
from parapod.sims.levelling_platform.calibrate.recording import (
    Machine,
    SimulatedPoses,
    draw_machine,
    pose_signals,
    read_recording,
    record,
)
from parapod.sims.levelling_platform.calibrate.scenario import CalibrateScenario
from parapod.sims.output.atomic import check_writable
from parapod.sims.output.drawn import LogDrawing
from parapod.sims.output.figures import Figure
from parapod.sims.output.logs.files import check_log
from parapod.sims.output.results import Metric
from parapod.sims.real_machine.answers import Answers, ConsoleAnswers, FileAnswers
from parapod.systems.core.errors import OutputError, ScenarioError
from parapod.systems.core.quoting import quoted_path
from parapod.systems.levelling_platform.calibration.equations import (
    BIAS,
    GROUND,
    IDENTIFIABLE,
    LEG_PARAMETERS,
    LEG_WIDTH,
    equivalent_parameters,
)
from parapod.systems.levelling_platform.calibration.poses import PoseRecording
from parapod.systems.levelling_platform.calibration.predict import (
    Comparison,
    compare,
    cross_validate,
)
from parapod.systems.levelling_platform.calibration.solve import Calibration, calibrate
from parapod.systems.levelling_platform.geometry import ANGLES, LEG_COUNT, PlatformGeometry

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

type Floats = NDArray[np.float64]
# Improvement of the predicted posture over that by the drawing that calibration must give.
IMPROVEMENT = 5.0
# Errors of the model that the paper calls almost exact, against the simulated machine (section 7).
_EXACT = {"height": 0.3, "roll": 0.07, "pitch": 0.07}  # [mm, deg, deg]
# The paper's errors of the drawing against its prototype (section 7).
_PROTOTYPE = {"height": 1.0, "roll": 0.2, "pitch": 0.1}  # [mm, deg, deg]
# Standard deviations by which chi^2 may be above its mean.
_CHI2_SPREAD = 5.0


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
    machine = PLATFORM
    drawing = LogDrawing(
        PLATFORM, plots=("attitude_estimated", "height_measured", "legs.extension")
    )
    backends = ("kinematic", "hardware")
    takes = "5 s"

    def machine_scenario(self, scenario: CalibrateScenario) -> LevellingScenario:
        """The machine on its feet, for its emulation."""
        return scenario.levelling

    def check(self, scenario: CalibrateScenario) -> None:
        """Refuses what a real machine cannot do, and a file that would be lost.

        Raises:
            ScenarioError: names the key.
            OutputError: the recording cannot be written, or is there already.
        """
        if scenario.backend != "hardware" or scenario.recording:
            return
        if any(scenario.poses.turns_deg):
            key = "poses.turns_deg"
            raise ScenarioError(f"{key} must be [0] on hardware: nothing turns the platform", key)
        path = Path(scenario.measuring.poses_file)
        check_log(path)
        check_writable(path)
        if path.exists():
            raise OutputError(
                f"measuring.poses_file: {quoted_path(path)} is there already; calibrate with it "
                f"by recording={quoted_path(path)}, or name another one",
                path,
            )

    def run(self, scenario: CalibrateScenario, runner: Runner) -> Identified:
        """Identifies a simulated machine, or the one that a recording is of.

        Raises:
            UndeterminedCalibration: the poses do not determine the machine; says what would.
            OutputError: the recording cannot be read.
            RefusedRequest: a real machine that does not stand on its feet.
        """
        if scenario.recording and runner.options.log is not None:
            raise OutputError(
                "--log has nothing to write: the poses are read from a recording",
                runner.options.log,
            )
        if scenario.backend == "hardware" and not scenario.recording:
            self._lead(scenario, runner)
            return _of_recording(replace(scenario, recording=scenario.measuring.poses_file))
        return _of_recording(scenario) if scenario.recording else _of_simulation(scenario)

    def _lead(self, scenario: CalibrateScenario, runner: Runner) -> None:
        """Leads the real machine through the poses, which are written after each one."""
        measuring = scenario.measuring
        answers: Answers = ConsoleAnswers(runner.console)
        if measuring.answers_file:
            columns = COLUMNS if scenario.poses.tracked else COLUMNS[:1]
            answers = FileAnswers(runner.console, Path(measuring.answers_file), columns)
        path = Path(measuring.poses_file)

        def write(recording: PoseRecording) -> None:
            self.write_log(path, scenario, *pose_signals(recording))

        record_poses(scenario, scenario.levelling, answers, write, runner)

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

    def identified(self, scenario: CalibrateScenario, data: Identified) -> Mapping[str, Any]:
        """Legs, encoder offsets and bias, which belong together."""
        return identified_values(data.calibration)

    def draw(self, scenario: CalibrateScenario, data: Identified) -> Iterable[Figure]:
        """Parameters and residuals."""
        tolerance = scenario.tolerances.tolerances.of_parameters(scenario.machine.geometry)
        truth = None
        if (machine := data.machine) is not None:
            truth = equivalent_parameters(
                machine.geometry, scenario.machine.geometry, machine.offsets, machine.bias
            )
            truth[GROUND] = scenario.ground.inclination
        return figures(data.calibration, tolerance, truth, data.comparison)


def identified_values(calibration: Calibration) -> dict[str, Any]:
    """A calibration by the keys of the machine's scenario."""
    legs = [
        {
            f"{name}_{'deg' if name in ANGLES else 'mm'}": round(
                (math.degrees(1.0) if name in ANGLES else 1e3) * getattr(leg, name), 5
            )
            for name in IDENTIFIABLE
        }
        for leg in calibration.geometry.deviations
    ]
    return {
        "control.encoder_offsets_mm": [round(1e3 * x, 5) for x in calibration.offsets.tolist()],
        "control.inclination_bias_deg": [
            round(math.degrees(x), 6) for x in calibration.bias.tolist()
        ],
        "control.leg_deviations": legs,
    }


def _of_simulation(scenario: CalibrateScenario) -> Identified:
    random = np.random.default_rng(scenario.seed)
    machine = draw_machine(scenario, random)
    poses, unused = record(scenario, machine, random)
    drawing = scenario.machine.geometry
    calibration = calibrate(poses.recording, drawing, scenario.tolerances.tolerances)
    # Attitudes that a noise-free, corrected inertial sensor shows.
    postures = unused.posture.copy()
    postures[:, :2] += machine.bias - calibration.bias
    return Identified(
        poses.recording,
        calibration,
        _predict(calibration, drawing, unused, unused.posture),
        f"{len(unused.recording)} other poses, against the truth",
        machine,
        _predict(calibration, drawing, unused, postures),
    )


def _predict(
    calibration: Calibration,
    drawing: PlatformGeometry,
    poses: SimulatedPoses,
    posture: Floats,
) -> Comparison:
    """Predicts poses on ground that is known."""
    return compare(calibration, drawing, poses.recording, posture, poses.ground)


def _of_recording(scenario: CalibrateScenario) -> Identified:
    recording = read_recording(Path(scenario.recording), scenario)
    tolerances = scenario.tolerances.tolerances
    return Identified(
        recording,
        calibrate(recording, scenario.machine.geometry, tolerances),
        cross_validate(recording, scenario.machine.geometry, tolerances),
        f"{len(recording)} poses held out, against what was measured in them",
    )


def prediction_metrics(
    comparison: Comparison, least: float | None, is_bounded: bool, where: str
) -> list[Metric]:
    """Errors before and after, and what was gained.

    Args:
        comparison: comparison of poses that were not used.
        least: smallest improvement allowed, or None.
        is_bounded: true if the calibrated errors have bounds.
        where: words that say of which poses and against what.
    """
    metrics = [
        Metric(
            "improvement_factor",
            comparison.improvement,
            at_least=least,
            meaning="error of the four feet's heights that a predicted posture implies, root mean "
            f"square: drawing by calibrated; {where}",
        ),
        Metric(
            "foot_error_mm",
            1e3 * comparison.calibrated.size,
            "mm",
            meaning="error of a foot, calibrated",
        ),
        Metric(
            "nominal_foot_error_mm",
            1e3 * comparison.nominal.size,
            "mm",
            meaning="error of a foot, drawing",
        ),
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
                    meaning=f"largest error of a predicted {name}, "
                    + ("drawing" if prefix else "calibrated"),
                )
            )
    return metrics


def fit_metrics(calibration: Calibration) -> list[Metric]:
    """Measure how well data and model agree, and how sure the parameters are."""
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
            meaning="ratio of the residual's variance to the noise's; 1 if model and noise are "
            "right",
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
            meaning="standard deviation of the bias, the larger of roll and pitch",
        ),
        Metric("accel_bias_roll_mg", roll, "mg", meaning="bias that makes the roll too large"),
        Metric("accel_bias_pitch_mg", pitch, "mg", meaning="bias that makes the pitch too large"),
        Metric(
            "condition",
            calibration.condition,
            meaning="condition number of the poses' sensitivity, scaled by tolerances",
        ),
    ]


def truth_metrics(
    calibration: Calibration, machine: Machine, sensed: Comparison, is_tracked: bool
) -> list[Metric]:
    """Measure how far the calibration is from the simulated machine."""
    bias = np.abs(calibration.bias - machine.bias).max()
    offset = np.abs(calibration.offsets - machine.offsets).max()
    return [
        Metric(
            "sensed_improvement_factor",
            sensed.improvement,
            at_least=IMPROVEMENT,
            meaning="largest improvement of a posture, against the corrected inertial sensor",
        ),
        Metric(
            "accel_bias_error_mg",
            1e3 * float(bias),
            "mg",
            0.25 if is_tracked else None,
            meaning="error of the estimated sensor bias, the larger of roll and pitch",
        ),
        Metric(
            "offset_error_mm",
            1e3 * float(offset),
            "mm",
            meaning="error of the worst encoder offset, for which l_3, l_4 and alpha make up",
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
            f"determined by tolerances only, to +- {sure:.2f} mg"
        )
    return notes


_DEG = float(np.degrees(1.0))
_CALIBRATED, _OTHER = COLOURS[0], COLOURS[1]
# Range of errors in the drawing, as a share of the largest one.
_DECADES = 1e-3
# Parameters as people write them.
_SYMBOLS = {"beta": r"$\beta$", "alpha": r"$\alpha$", "offset": "offset"}


def figures(
    calibration: Calibration, tolerance: Floats, truth: Floats | None, comparison: Comparison
) -> tuple[Figure, ...]:
    """Figures of a calibration.

    Args:
        calibration: the result.
        tolerance: (36) of the parameters.
        truth: (36) parameters of the simulated machine, or None.
        comparison: on poses that were not used.
    """
    note = "" if truth is None else " Crosses: the simulated machine."
    return (
        Figure(
            "calibrate_parameters",
            "Calibrated parameters",
            "Deviations from the drawing in tolerances, with one standard deviation; shaded: what "
            "the tolerances alone say. Only combinations of l_3, l_4, alpha and offset are sure: "
            f"together they place the foot to a few hundredths of a millimetre.{note}",
            partial(_draw_parameters, calibration, tolerance, truth),
            (10.0, 3.6),
        ),
        Figure(
            "calibrate_residuals",
            "Posture predicted on poses that were not used",
            "Share of the poses whose error is smaller, for the drawing and for the calibrated "
            "machine.",
            partial(_draw_residuals, comparison),
            (9.0, 3.0),
        ),
    )


def _draw_parameters(
    calibration: Calibration, tolerance: Floats, truth: Floats | None, canvas: "Canvas"
) -> None:
    ratios = [LEG_WIDTH] * LEG_COUNT + [2]
    panels = canvas.subplots(1, len(ratios), sharey=True, gridspec_kw={"width_ratios": ratios})
    legs = [slice(LEG_WIDTH * i, LEG_WIDTH * (i + 1)) for i in range(LEG_COUNT)]
    names = [_SYMBOLS.get(name, rf"${name[0]}_{name[2]}$") for name in LEG_PARAMETERS]
    for i, (axes, part) in enumerate(zip(panels, [*legs, BIAS], strict=True)):
        is_leg = i < LEG_COUNT
        _draw_group(axes, calibration, tolerance, truth, part)
        axes.set_title(f"leg {i + 1}" if is_leg else "bias", fontsize=9)
        labels = names if is_leg else ["roll", "pitch"]
        axes.set_xticks(range(len(labels)), labels, rotation=90 if not is_leg else 0)
        for label in axes.get_xticklabels():
            if label.get_text() == "offset":
                label.set_rotation(90)
        axes.grid(visible=False, axis="x")
    panels[0].set_ylabel("deviation [tolerances]")
    handles, labels = panels[0].get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8)


def _draw_group(
    axes: "Axes", calibration: Calibration, tolerance: Floats, truth: Floats | None, part: slice
) -> None:
    unit = tolerance[part]
    x = np.arange(len(unit))
    spread = float((calibration.prior[part] / unit).max())
    axes.axhspan(-spread, spread, color="0.92", zorder=0, label="tolerance alone")
    axes.axhline(0.0, color="0.6", linewidth=0.8, zorder=1)
    if truth is not None:
        axes.plot(x, truth[part] / unit, "x", color=_OTHER, markersize=6, label="simulated")
    axes.errorbar(
        x,
        calibration.parameters[part] / unit,
        calibration.standard_deviations[part] / unit,
        fmt="o",
        color=_CALIBRATED,
        markersize=4,
        capsize=2,
        label="calibrated",
    )
    axes.set_xlim(-0.6, len(unit) - 0.4)


def _draw_residuals(comparison: Comparison, canvas: "Canvas") -> None:
    panels = canvas.subplots(1, 3, sharey=True)
    columns = (("height", "mm", 2, 1e3), ("roll", "deg", 0, _DEG), ("pitch", "deg", 1, _DEG))
    for axes, (name, unit, column, scale) in zip(panels, columns, strict=True):
        for label, prediction, colour in (
            ("drawing", comparison.nominal, _OTHER),
            ("calibrated", comparison.calibrated, _CALIBRATED),
        ):
            error = np.sort(np.abs(prediction.posture[:, column])) * scale
            share = np.arange(1, len(error) + 1) / len(error)
            axes.step(error, 100.0 * share, where="post", color=colour, label=label)
        axes.set_xscale("log")
        # Errors that happen to be next to nothing would take most of the axis.
        axes.set_xlim(
            left=_DECADES * float(np.abs(comparison.nominal.posture[:, column]).max()) * scale
        )
        axes.set_xlabel(f"error of {name} [{unit}]")
    panels[0].set_ylabel("share of the poses [%]")
    panels[0].legend(loc="upper left", fontsize=8)
