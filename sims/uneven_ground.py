"""Levelling where the four feet stand at different heights, which the paper leaves out.

At touchdown the extensions tell how far each foot is from the plane that fits all four best, and
from then on every leg is given that much more or less. Heights are counted from that plane.
"""

import numpy as np

from parapod.diagrams.levelling_platform.scenario import SIMULATED, LevellingScenario
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.levelling_job import Job, run_job
from parapod.sims.posture_errors import error_metrics, in_deg_and_mm, posture_figure
from parapod.sims.results import Metric, Result

_NEEDED = (
    "truth.posture",
    "truth.foot_height",
    "posture_desired_state",
    "foot_offsets_estimated",
)
# The bounds of the job on a plane: what the paper's closed loop reached there.
_BOUNDS = (0.2, 2.0)
_LIFT_BOUND = 1.0  # [mm]


def run(scenario: LevellingScenario, options: RunOptions) -> Result:
    """Levels on uneven ground.

    Raises:
        ScenarioError: a scenario whose parts do not fit together.
        UnreachablePosture: the level posture is out of reach on this ground.
        OutputError: a file cannot be written.
    """
    job = run_job(scenario, options, "uneven-ground", _NEEDED)
    heights = np.array(scenario.ground.foot_heights_mm)
    truth = in_deg_and_mm(job.signals["truth.posture"]) - [0.0, 0.0, heights.mean()]
    desired = in_deg_and_mm(job.signals["posture_desired_state"][:, :3])
    settled = job.time >= scenario.job.estimate_at + scenario.job.settled_after
    metrics = (
        *error_metrics(
            (truth - desired)[settled],
            bounds=_BOUNDS,
            meaning="largest after settling, against gravity and the feet's mean height",
        ),
        *_feet(job, heights),
    )
    figure = posture_figure(
        "uneven_ground",
        "Levelling on uneven ground",
        f"The ground under the feet is {heights.tolist()} mm above its plane.",
        job.time,
        {"asked for": desired, "true": truth},
        "asked for",
    )
    return Result("uneven-ground", scenario.backend, scenario.seed, metrics, figures=(figure,))


def _feet(job: Job, heights: np.ndarray) -> list[Metric]:
    lift = 1e3 * job.signals["truth.foot_height"].max(axis=0)
    offsets = 1e3 * job.signals["foot_offsets_estimated"][-1]
    return [
        Metric("unevenness_mm", float(np.ptp(heights)), "mm", meaning="highest less lowest foot"),
        Metric(
            "largest_offset_mm",
            float(np.abs(offsets).max()),
            "mm",
            meaning="largest distance of a foot from the plane that fits all four best",
        ),
        Metric(
            "foot_lift_mm",
            float(lift.max()),
            "mm",
            _LIFT_BOUND,
            meaning="how far a foot leaves the ground",
        ),
    ]


EXPERIMENT = Experiment(
    name="uneven-ground",
    summary="The platform levels itself where its feet stand at different heights.",
    scenario=LevellingScenario,
    backends=SIMULATED,
    run=run,
)
