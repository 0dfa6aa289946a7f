"""Calibration of the levelling platform from recorded poses, on a simulated or a real recording.

The machine's dimensions, encoders and accelerometer are off by what manufacturing leaves. In each
pose the encoders, the inertial sensor and the optical tracker of Appendix B are read; from these
the machine is identified, and its posture is predicted on poses that were not used.
"""

import math
from pathlib import Path

import numpy as np

from parapod.sims.calibrate_figures import figures
from parapod.sims.calibrate_machine import draw_machine, record
from parapod.sims.calibrate_metrics import (
    IMPROVEMENT,
    compare_with_sensor,
    compare_with_truth,
    cross_validate,
    fit_metrics,
    prediction_metrics,
    truth_metrics,
)
from parapod.sims.calibrate_recording import read_recording, write_recording
from parapod.sims.calibrate_scenario import BACKENDS, CalibrateScenario
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.figures import Figure
from parapod.sims.results import Metric, Result
from parapod.sims.unsupported_options import refuse_options
from parapod.systems.levelling_platform.calibration.equations import (
    BIAS,
    GROUND,
    LEG_PARAMETERS,
    LEG_WIDTH,
    equivalent_parameters,
)
from parapod.systems.levelling_platform.calibration.poses import PoseRecording
from parapod.systems.levelling_platform.calibration.solve import Calibration, calibrate
from parapod.systems.levelling_platform.geometry import ANGLES, LEG_COUNT
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY


def run(scenario: CalibrateScenario, options: RunOptions) -> Result:
    """Calibrates.

    Raises:
        UndeterminedCalibration: the poses do not determine the machine; says what would.
        OutputError: a file cannot be read or written, or there is nothing to write to it.
    """
    why = "has nothing to show: no diagram is simulated"
    refuse_options(options, ("meshcat", "html", "graphviz"), why)
    if scenario.recording:
        return _of_recording(scenario, options)
    return _of_simulation(scenario, options)


def _of_simulation(scenario: CalibrateScenario, options: RunOptions) -> Result:
    random = np.random.default_rng(scenario.seed)
    machine = draw_machine(scenario, random)
    poses, unused = record(scenario, machine, random)
    if options.log is not None:
        write_recording(options.log, poses.recording, scenario)
    tolerances, is_tracked = scenario.tolerances.tolerances, scenario.poses.tracked
    calibration = calibrate(poses.recording, MODEL_GEOMETRY, tolerances)
    comparison = compare_with_truth(calibration, MODEL_GEOMETRY, unused)
    sensed = compare_with_sensor(calibration, MODEL_GEOMETRY, unused, machine)
    least = IMPROVEMENT if is_tracked else None
    where = f"{len(unused.recording)} other poses, against the truth"
    metrics = [
        *prediction_metrics(comparison, least, is_tracked, where),
        *fit_metrics(calibration),
        *truth_metrics(calibration, machine, sensed, is_tracked),
    ]
    truth = equivalent_parameters(machine.geometry, MODEL_GEOMETRY, machine.offsets, machine.bias)
    truth[GROUND] = scenario.ground.inclination
    tolerance = tolerances.of_parameters(MODEL_GEOMETRY)
    drawn = figures(calibration, tolerance, truth, comparison)
    notes = _notes(calibration, poses.recording)
    return _result(scenario, metrics, notes, drawn)


def _of_recording(scenario: CalibrateScenario, options: RunOptions) -> Result:
    why = "has nothing to write: the poses are read from a recording"
    refuse_options(options, ("log",), why)
    recording = read_recording(Path(scenario.recording), scenario)
    tolerances = scenario.tolerances.tolerances
    calibration = calibrate(recording, MODEL_GEOMETRY, tolerances)
    comparison = cross_validate(recording, MODEL_GEOMETRY, tolerances)
    where = f"{len(recording)} poses held out, against what was measured in them"
    metrics = [*prediction_metrics(comparison, 1.0, False, where), *fit_metrics(calibration)]
    drawn = figures(calibration, tolerances.of_parameters(MODEL_GEOMETRY), None, comparison)
    return _result(scenario, metrics, _notes(calibration, recording), drawn)


def _result(
    scenario: CalibrateScenario,
    metrics: list[Metric],
    notes: list[str],
    drawn: tuple[Figure, ...],
) -> Result:
    return Result(
        "calibrate", scenario.backend, scenario.seed, tuple(metrics), tuple(notes), drawn
    )


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


EXPERIMENT = Experiment(
    name="calibrate",
    summary=(
        "Leg geometry, encoder offsets and accelerometer bias are identified from recorded poses."
    ),
    scenario=CalibrateScenario,
    backends=BACKENDS,
    run=run,
)
