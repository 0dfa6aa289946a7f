"""The kinematic model beside the multibody plant: Figs. 8 to 11 of the paper.

The platform moves in roll, pitch and height; the model solves Eqs. (10) to (12) for the drawing,
the ground's inclination and the encoders' extensions, and is compared with where the platform is:
once with legs as drawn on a slope of 5 deg (Figs. 8, 9), once with manufacturing errors on the
nearly level floor of the prototype (Figs. 10, 11).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.levelling_platform.scenario import GroundScenario, LevellingScenario
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.levelling_job import run_job
from parapod.sims.posture_errors import error_metrics, in_deg_and_mm, posture_figure
from parapod.sims.results import Metric, Result
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY

_NEEDED = ("truth.posture", "legs.extension")
_BOUNDS = (0.02, 0.1)
# What the paper found: in its co-simulation, and between its model and its prototype.
_SIMULATED = (0.07, 0.07, 0.3)
_MEASURED = (0.2, 0.1, 1.0)
# Ground of the experiment with the prototype (section 3.3.2).
_FLOOR = GroundScenario(roll_deg=0.1, pitch_deg=-0.3)
# The platform settles on its feet first [s].
_STANDING = 0.5


def run(scenario: LevellingScenario, options: RunOptions) -> Result:
    """Compares model and plant.

    The scenario's `plant.length_error_mm` and `plant.angle_error_deg` are those of the second
    comparison, on the prototype's floor.

    Raises:
        ScenarioError: a scenario whose parts do not fit together.
        UnreachablePosture: a posture is out of reach.
        OutputError: a file cannot be written.
    """
    drawn = replace(scenario, plant=replace(scenario.plant, length_error_mm=0, angle_error_deg=0))
    built = replace(scenario, ground=_FLOOR)
    quiet = replace(options, meshcat=False, html=None, log=None, graphviz=None)
    metrics: list[Metric] = []
    figures = []
    for case, watched, prefix, bounds, paper, figure, of in (
        (drawn, options, "", _BOUNDS, _SIMULATED, "fig08_09", "as drawn, on a slope"),
        (
            built,
            quiet,
            "perturbed_",
            (None, None),
            _MEASURED,
            "fig10_11",
            "as built, on a floor",
        ),
    ):
        time, truth, model = _compare(case, watched)
        meaning = f"largest difference of model and plant, legs {of}"
        metrics += error_metrics(truth - model, prefix, bounds, paper, meaning)
        caption = f"Kinematic model and multibody plant, legs {of} (the paper's {_named(figure)})."
        lines = {"multibody plant": truth, "kinematic model": model}
        title = f"Model and plant, legs {of}"
        figures.append(posture_figure(figure, title, caption, time, lines, "multibody plant"))
    return Result(
        "validate-kinematics",
        scenario.backend,
        scenario.seed,
        tuple(metrics),
        figures=tuple(figures),
    )


def _compare(
    scenario: LevellingScenario, options: RunOptions
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Times (n) [s], and postures (n, 3) of plant and model [deg, deg, mm]."""
    job = run_job(scenario, options, "validate-kinematics", _NEEDED)
    standing = job.time >= _STANDING
    # The three active legs, as the paper's Eqs. (10) to (12) have it.
    model = forward_kinematics(
        MODEL_GEOMETRY,
        job.signals["legs.extension"][standing],
        scenario.ground.inclination,
        legs=(0, 1, 2),
    )
    truth = job.signals["truth.posture"][standing]
    return job.time[standing], in_deg_and_mm(truth), in_deg_and_mm(model)


def _named(figure: str) -> str:
    first, second = (int(part) for part in figure.removeprefix("fig").split("_"))
    return f"Figs. {first} and {second}"


EXPERIMENT = Experiment(
    name="validate-kinematics",
    summary="The kinematic model beside the multibody plant, with legs as drawn and as built.",
    scenario=LevellingScenario,
    backends=("multibody",),
    run=run,
)
