"""The trotting gait of the walking chair: Figs. 7 and 8, and a body that moves without jerks.

Lengths, velocities and accelerations of all twelve branches with the body moved by Eq. (45) and
by a law without steps of the speed. Nothing is simulated: every number is a closed form.
"""

from parapod.sims.chair_gait_figures import figures
from parapod.sims.chair_gait_metrics import gait_metrics
from parapod.sims.chair_gait_motion import SampledWalk, sample_walk
from parapod.sims.chair_gait_scenario import (
    BACKENDS,
    PRINTED,
    ChairGaitScenario,
    check_walks,
)
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.experiment_log import write_experiment_log
from parapod.sims.results import Metric, Result
from parapod.sims.unsupported_options import refuse_options
from parapod.systems.walking_chair.geometry import ChairGeometry

# A controller's period, over which a step of the velocity is an acceleration [s].
_PERIOD = 0.01


def run(scenario: ChairGaitScenario, options: RunOptions) -> Result:
    """Looks at the gait with both laws.

    Raises:
        ScenarioError: a gait with more cycles than are looked at.
        StrokeExceeded: a gait that takes a branch out of its stroke.
        SpeedExceeded: a gait that is too fast for a branch.
        OutputError: a file cannot be written, or an option has nothing to show.
    """
    why = "has nothing to show: no diagram is simulated"
    refuse_options(options, ("html", "graphviz", "meshcat"), why)
    geometry = ChairGeometry()
    check_walks(scenario, geometry)
    with options.console.status("moving the branches"):
        printed, smooth = (sample_walk(geometry, walk) for walk in scenario.walks)
        metrics = gait_metrics(printed, smooth)
    _write_log(scenario, options, printed, smooth)
    return Result(
        "chair-gait",
        scenario.backend,
        scenario.seed,
        metrics,
        _notes(metrics),
        figures(printed, smooth, scenario.gait.body_law),
    )


def _write_log(
    scenario: ChairGaitScenario, options: RunOptions, printed: SampledWalk, smooth: SampledWalk
) -> None:
    """Writes the log, if one is asked for; both laws have the same times."""
    if options.log is None:
        return
    signals = {}
    for law, walk in ((PRINTED, printed), ("smooth", smooth)):
        count = len(walk.time)
        signals[f"{law}.body_position"] = (walk.body, "m")
        signals[f"{law}.foot_corners"] = (walk.corners.reshape(count, -1), "m")
        for name, unit in (("length", "m"), ("velocity", "m/s"), ("acceleration", "m/s^2")):
            values = getattr(walk.branches, name).reshape(count, -1)
            signals[f"{law}.{name}"] = (values, unit)
    write_experiment_log(options.log, "chair-gait", scenario, printed.time, signals)


def _notes(metrics: tuple[Metric, ...]) -> tuple[str, ...]:
    (step,) = [m.value for m in metrics if m.key == "velocity_step_printed_mm_s"]
    return (
        f"Steps of {step:.2f} mm/s are impulses of acceleration: "
        f"{1e-3 * step / _PERIOD:.2f} m/s^2 over a controller's period of {1e3 * _PERIOD:g} ms. "
        "The paper's smooth accelerations are those of the swing; the body's ramps of Eq. (45) "
        "have none between their ends, and all of them there.",
        "Legs 1 and 4, and legs 2 and 3, are symmetric in time: one does backwards what the other "
        "does. At the same time they differ.",
        "Feet lean while they are not below their hinges. Each leg's reference is the corner that "
        "is lowest then; with E1 for all of them, corners of two feet would go 14.55 mm into the "
        "ground in the paper's gait.",
    )


EXPERIMENT = Experiment(
    name="chair-gait",
    summary="What a step of the walking chair asks of its branches, with and without jerks.",
    scenario=ChairGaitScenario,
    backends=BACKENDS,
    run=run,
)
