"""The levelling platform's job: find out how the ground slopes, level, follow postures, hold.

Until `job.estimate_at` the platform stands still and its attitude filter settles. Then the ground
is estimated, and the platform levels itself at `job.height_mm`, takes the waypoints' postures one
after the other, and holds while the arm swings.
"""

from dataclasses import replace
from functools import partial

from parapod.diagrams.levelling_platform.scenario import BACKENDS, LevellingScenario
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.figures import Figure
from parapod.sims.level_metrics import measure, measured_posture
from parapod.sims.levelling_job import Job, run_job
from parapod.sims.live import stay_live
from parapod.sims.posture_errors import in_deg_and_mm, posture_figure
from parapod.sims.results import Result

# What the metrics are made of; everything else is recorded only for a log. What is true is known
# of simulated machines only; of others what they measure.
_NEEDED = (
    "truth.posture",
    "truth.foot_height",
    "truth.loop_error",
    "posture_desired_state",
    "attitude_estimated",
    "ground_estimated",
    "ground_valid",
    "foot_offsets_estimated",
    "legs.extension",
    "legs.voltage",
)


def run(scenario: LevellingScenario, options: RunOptions) -> Result:
    """Runs the job.

    Raises:
        ScenarioError: a scenario whose parts do not fit together.
        UnreachablePosture: the level posture is out of reach on this ground.
        OutputError: a file cannot be written.
    """
    job = run_job(scenario, options, "level", _NEEDED)
    until = scenario.job.estimate_at + scenario.job.end
    measured = measure(scenario, job.time, job.signals, job.scale, until / job.elapsed)
    result = replace(measured, figures=(_figure(job),))
    if job.meshcat is not None and options.meshcat and options.live:
        go_live = partial(stay_live, scenario, job.meshcat, options.console, job.again)
        return replace(result, afterwards=go_live)
    return result


def _figure(job: Job) -> Figure:
    desired = job.signals["posture_desired_state"][:, :3]
    started = desired[:, 2] > 0.0
    name, posture = "true", job.signals.get("truth.posture")
    if posture is None:
        name, posture = "measured", measured_posture(job.signals)
    lines = {
        "asked for": in_deg_and_mm(desired[started]),
        name: in_deg_and_mm(posture[started]),
    }
    return posture_figure(
        "level",
        "The job",
        "Posture against gravity while the platform levels itself, follows postures and holds.",
        job.time[started],
        lines,
        "asked for",
    )


EXPERIMENT = Experiment(
    name="level",
    summary=(
        "The platform finds out how the ground slopes, levels itself and follows posture commands."
    ),
    scenario=LevellingScenario,
    backends=BACKENDS,
    run=run,
)
