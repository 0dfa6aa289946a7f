"""A levelling platform's job, run once: watched, recorded and logged as the options ask."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from parapod.diagrams.closed_loop import ClosedLoop as SimulatedLoop
from parapod.diagrams.levelling_platform.closed_loop import ClosedLoop, make_closed_loop
from parapod.diagrams.levelling_platform.scenario import SIMULATED, LevellingScenario
from parapod.sims.experiment import RunOptions
from parapod.sims.job import Signals, Task, run_task
from parapod.sims.simulate import make_viewer
from parapod.systems.core.errors import ScenarioError


@dataclass(frozen=True)
class Job:
    """A job that has been run.

    Attributes:
        time: (n) times of the samples [s].
        signals: port name -> (n, size) samples.
        scale: share of the waypoints' size that fitted the stroke.
        elapsed: wall-clock time of the simulation [s].
        meshcat: where it was shown, or None.
        again: runs the same job once more.
    """

    time: NDArray[np.float64]
    signals: Signals
    scale: float
    elapsed: float
    meshcat: Meshcat | None
    again: Callable[[], float]


def run_job(
    scenario: LevellingScenario, options: RunOptions, what: str, needed: tuple[str, ...]
) -> Job:
    """Runs a scenario's job.

    Args:
        scenario: the job's.
        options: how it is watched and recorded.
        what: what is going on, for the progress bar.
        needed: ports whose signals are wanted; all of them are recorded for a log.

    Raises:
        ScenarioError: a scenario whose parts do not fit together.
        UnreachablePosture: the level posture is out of reach on this ground.
        OutputError: a file cannot be written.
    """
    check_job(scenario)

    def make_loop(meshcat: Meshcat | None, log: tuple[str, ...] | None) -> ClosedLoop:
        return make_closed_loop(scenario, meshcat, log=log)

    task = Task(
        what=what,
        machine="The platform",
        scenario=scenario,
        until=scenario.job.estimate_at + scenario.job.end,
        needed=needed,
        make_loop=make_loop,
        make_scene=partial(make_scene, scenario),
    )
    done = run_task(task, options, SIMULATED)
    scale = _scale(done.loop, done.simulator)
    return Job(done.time, done.signals, scale, done.elapsed, done.meshcat, done.again)


def _scale(loop: SimulatedLoop[LevellingScenario], simulator: Simulator) -> float:
    script = loop.diagram.GetSubsystemByName("posture_script")
    context = script.GetMyContextFromRoot(simulator.get_context())
    return float(np.asarray(script.GetOutputPort("scale").Eval(context))[0])


def check_job(scenario: LevellingScenario) -> None:
    """Refuses a scenario whose parts do not fit together.

    Raises:
        ScenarioError: names the key.
    """
    job, plant, control = scenario.job, scenario.plant, scenario.control
    times = [waypoint.time for waypoint in job.waypoints]
    for i, (earlier, later) in enumerate(pairwise(times), start=1):
        if later < earlier:
            _refuse(
                f"job.waypoints.{i}.time", later, f"earlier than the waypoint before, {earlier:g}"
            )
    if times and times[0] < job.settled_after:
        why = f"earlier than job.settled_after = {job.settled_after:g}"
        _refuse("job.waypoints.0.time", times[0], why)
    swung = job.arm.start + job.arm.duration
    for what, at in (
        ("job.settled_after", job.settled_after),
        ("the last waypoint", max(times, default=0.0)),
        ("the end of the arm's swing", swung),
    ):
        if job.end <= at:
            _refuse("job.end", job.end, f"not after {what}, {at:g}")
    if scenario.backend == "multibody" and control.period < plant.time_step:
        _refuse("control.period", control.period, f"below plant.time_step = {plant.time_step:g}")


def _refuse(key: str, value: float, why: str) -> None:
    raise ScenarioError(f"{key} = {value:g} s is {why} s", key)


def make_scene(scenario: LevellingScenario) -> Meshcat:
    """A scene in which the ground's slope shows against a horizontal floor."""
    meshcat = make_viewer(camera=(1.5, -5.4, 1.2), target=(0.25, 0.0, 1.0))
    R_WG = RollPitchYaw(*scenario.ground.inclination, 0.0).ToRotationMatrix()
    # Under the slab of `ground.sdf`, which is 2.6 m by 2.2 m and 0.04 m thick.
    rim = np.array([(-1.3, -1.1), (1.3, -1.1), (1.3, 1.1), (-1.3, 1.1)])
    top = R_WG @ np.column_stack([rim, np.full(4, -0.04)]).T
    floor = top[2].min() - 0.05
    vertices = np.hstack([top, np.vstack([top[:2], np.full(4, floor)])])
    sides = [(i, 4 + i, 4 + (i + 1) % 4) for i in range(4)]
    sides += [(i, 4 + (i + 1) % 4, (i + 1) % 4) for i in range(4)]
    meshcat.SetTriangleMesh("/ground", vertices, np.array(sides).T, Rgba(0.50, 0.46, 0.41))
    meshcat.SetObject("/floor", Cylinder(4.5, 0.02), Rgba(0.86, 0.89, 0.91))
    meshcat.SetTransform("/floor", RigidTransform(np.array([0.0, 0.0, floor - 0.01])))
    return meshcat
