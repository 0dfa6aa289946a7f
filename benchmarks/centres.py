"""The machining centres: wrench indices beside brute force, swings, a workspace, whole jobs."""

import io
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import combinations, repeat
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

import parapod
from benchmarks.factor import rate
from benchmarks.report import Measurement
from benchmarks.yardstick import DRAKE, NUMPY, PYTHON, clock, seconds
from parapod.sims.machining_centre.machining import CentreMachining
from parapod.sims.machining_centre.walk import CentreWalk
from parapod.sims.machining_centre.workspace import (
    NAMES,
    CentreWorkspace,
    CentreWorkspaceScenario,
)
from parapod.sims.output.options import RunOptions
from parapod.sims.output.progress import counted
from parapod.systems.machining_centre.kinematics import (
    CentreGeometry,
    LockSet,
    close_locks,
    jacobian,
    swing_inverse,
    wrench_indices,
)

_POSES = 50_000
_BY_FORCE = 40
_TURNS = 5
# Poses a second on one core.
_INDEX_BOUNDS = {3: 150e3, 4: 50e3}
_SWING, _SWING_BOUND = 300, 500.0
_WORKSPACE_BOUND = 60.0  # [s]
# Whole loop of rigid bodies at 1 ms by real time; instants at which a job is stopped.
_LOOP_BOUND, _STOPS = 2.5, 20


def run(console: Console) -> list[Measurement]:
    results = []
    for limbs, name in NAMES.items():
        results += _indices(CentreGeometry(limbs), name)
        results += _swings(CentreGeometry(limbs), name)
    quiet = RunOptions(console=Console(file=io.StringIO()))
    workspace, scenario = CentreWorkspace("centre-workspace"), CentreWorkspaceScenario()
    took, pace = NUMPY.best_beside(lambda: seconds(lambda: workspace.execute(scenario, quiet)), 1)
    results.append(
        Measurement(
            "workspace of both, cells of 12.5 mm",
            *(took, "s", _WORKSPACE_BOUND),
            at_most=True,
            pace=pace,
        )
    )
    for limbs, name in NAMES.items():
        results += _jobs(limbs, name, console)
    return results


def _jobs(limbs: int, name: str, console: Console) -> list[Measurement]:
    """Whole jobs of rigid bodies, and jobs that are stopped at equal distances of time."""
    quiet = RunOptions(console=Console(file=io.StringIO()))
    jobs = []
    for what, experiment in (
        ("centre-machining", CentreMachining("centre-machining")),
        ("centre-walk", CentreWalk("centre-walk")),
    ):
        scenario = parapod.scenario(what, f"machine.limbs={limbs}")
        result, pace = DRAKE.beside(partial(experiment.execute, scenario, quiet))
        metrics = {metric.key: metric.value for metric in result.metrics}
        factor = metrics["realtime_factor"]
        jobs += [
            Measurement(f"{what}, {name}", factor, "x", _LOOP_BOUND, pace=pace),
            Measurement("  bounds broken", float(len(result.broken)), "", 0.0, at_most=True),
        ]
    until = experiment.duration(scenario) / 1.3
    instants = [(number + 0.5) / _STOPS * until for number in range(_STOPS)]
    ended, fresh = 0, get_context("spawn")
    with (
        counted(console, f"stops, {name}", _STOPS) as tell,
        ProcessPoolExecutor(mp_context=fresh) as pool,
    ):
        for number, is_safe in enumerate(pool.map(_ends_safely, repeat(limbs), instants)):
            ended += is_safe
            tell(number + 1)
    jobs.append(
        Measurement(f"stopped {_STOPS} times, {name}: clamped, retracted", ended, "", _STOPS)
    )
    return jobs


def _ends_safely(limbs: int, instant: float) -> bool:
    """True if a walk that is stopped at an instant [s] ends clamped, its drill retracted."""
    scenario = parapod.scenario("centre-walk", f"machine.limbs={limbs}", backend="kinematic")
    scenario.stop_at = instant
    quiet = RunOptions(console=Console(file=io.StringIO()))
    result = CentreWalk("centre-walk").execute(scenario, quiet)
    return not {metric.key for metric in result.broken} & {"clamps_open", "tip_height_mm"}


def _indices(geometry: CentreGeometry, name: str) -> list[Measurement]:
    random = np.random.default_rng(0)
    poses = np.hstack(
        (
            random.uniform((-0.1, -0.1, 0.4), (0.1, 0.1, 0.56), (_POSES, 3)),
            random.uniform(-0.2, 0.2, (_POSES, 3)),
        )
    )
    fast, pace = rate(lambda: wrench_indices(geometry, poses), _POSES, NUMPY, _TURNS)
    few = poses[:_BY_FORCE]
    began = clock()
    by_force = np.array([_nearest_facet(geometry, pose) for pose in few])
    slow = _BY_FORCE / (clock() - began)
    error = float(np.abs(wrench_indices(geometry, few).w_minmax - by_force).max())
    return [
        Measurement(
            f"wrench indices, {name}",
            *(fast / 1e3, "k/s", _INDEX_BOUNDS[geometry.limbs] / 1e3),
            pace=pace,
        ),
        Measurement("  times all facets by numpy", fast / slow, "x"),
        Measurement("  largest difference to these", 1e12 * error, "e-12", 1.0, at_most=True),
    ]


def _nearest_facet(geometry: CentreGeometry, pose: NDArray[np.float64]) -> float:
    H = jacobian(geometry, pose).T / np.repeat((geometry.platform_radius, 1.0), 3)[:, None]
    nearest = np.inf
    for five in combinations(range(geometry.legs), 5):
        _, values, rows = np.linalg.svd(H[:, five].T)
        if values[4] > 1e-9:
            nearest = min(nearest, float(np.abs(rows[5] @ H).sum()))
    return nearest / geometry.legs


def _swings(geometry: CentreGeometry, name: str) -> list[Measurement]:
    home = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
    locks = close_locks(geometry, home, LockSet.printed(geometry, 1))
    way = np.array((0.06, 0.0, 0.03, 0.0, 0.0, 0.0))

    def swing() -> None:
        near = home
        for share in np.linspace(0.0, 1.0, _SWING):
            foot = geometry.footholds[0] + share * way
            near = swing_inverse(geometry, foot, locks, near).pose

    swings, pace = rate(swing, _SWING, PYTHON, 3)
    what = f"swing of a foot, {name}, from the pose before"
    return [Measurement(what, swings, "/s", _SWING_BOUND, pace=pace)]
