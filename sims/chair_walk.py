"""The walking chair carries a passenger a few steps, with bodies, contact and closed loops."""

from dataclasses import replace
from functools import partial

import numpy as np
from pydrake.geometry import Meshcat

from parapod.diagrams.walking_chair.closed_loop import make_closed_loop
from parapod.diagrams.walking_chair.scenario import BACKENDS, SIMULATED, ChairScenario
from parapod.sims.chair_live import stay_live
from parapod.sims.chair_walk_figures import figures
from parapod.sims.chair_walk_metrics import NEEDED, measure
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.job import Task, run_task
from parapod.sims.results import Result
from parapod.sims.simulate import make_viewer
from parapod.systems.core.errors import ScenarioError
from parapod.systems.walking_chair.checks import check_forces, check_gait
from parapod.systems.walking_chair.model import CHAIR_GEOMETRY
from parapod.systems.walking_chair.support import GaitSupport


def run(scenario: ChairScenario, options: RunOptions) -> Result:
    """Runs the walk.

    Raises:
        ScenarioError: a scenario whose parts do not fit together.
        StrokeExceeded, SpeedExceeded, ForceExceeded: the gait is more than a branch can do.
        SupportLost: the passenger would come too close to tipping the chair over.
        OutputError: a file cannot be written.
    """
    check_walk(scenario)
    task = Task(
        what="chair-walk",
        machine="The chair",
        scenario=scenario,
        until=scenario.begin + scenario.gait.walk.duration + scenario.end,
        needed=NEEDED,
        make_loop=partial(make_closed_loop, scenario),
        make_scene=partial(make_scene, scenario),
    )
    done = run_task(task, options, SIMULATED)
    result = measure(scenario, done.time, done.signals, task.until / done.elapsed)
    result = figures(result, scenario, done.time, done.signals)
    if done.meshcat is not None and options.meshcat and options.live:
        go_live = partial(stay_live, scenario, done.meshcat, options.console)
        return replace(result, afterwards=go_live)
    return result


def check_walk(scenario: ChairScenario) -> None:
    """Refuses a walk before the first step.

    Raises:
        ScenarioError: names the key.
        StrokeExceeded, SpeedExceeded, ForceExceeded: the gait is more than a branch can do.
        SupportLost: the passenger would come too close to tipping the chair over.
    """
    plant, control = scenario.plant, scenario.control
    if scenario.backend == "multibody" and control.period < plant.time_step:
        raise ScenarioError(
            f"control.period = {control.period:g} s is below plant.time_step = "
            f"{plant.time_step:g} s",
            "control.period",
        )
    walk, passenger = scenario.gait.walk, scenario.passenger.passenger
    for gait in walk.gaits:
        check_gait(CHAIR_GEOMETRY, gait, 1e-3 * scenario.drives.max_velocity_mm_s)
    required = 1e-3 * control.support_margin_mm
    GaitSupport(CHAIR_GEOMETRY, walk).check(passenger, required)
    check_forces(CHAIR_GEOMETRY, walk, passenger)


def make_scene(scenario: ChairScenario) -> Meshcat:
    """A scene around the chair's way."""
    walk = scenario.gait.walk
    ends = [gait.end[1] for gait in walk.gaits]
    middle = 0.5 * float(np.mean((min(0.0, *ends), max(0.0, *ends))))
    return make_viewer(camera=(2.6, 2.7 + middle, 1.5), target=(0.0, middle, 0.80))


EXPERIMENT = Experiment(
    name="chair-walk",
    summary="The walking chair carries a passenger a few steps forward and back.",
    scenario=ChairScenario,
    backends=BACKENDS,
    run=run,
)
