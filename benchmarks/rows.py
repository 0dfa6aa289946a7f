"""Speed of many closed loops that are simulated side by side, beside one loop in Drake."""

import os
import resource
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from pydrake.systems.analysis import Simulator
from rich.console import Console

import parapod
from benchmarks.report import Measurement
from benchmarks.yardstick import NUMPY, Pace, seconds
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.side_by_side import LoopRows
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.lab.work import LocalCrew


@dataclass(frozen=True)
class _Case:
    """Loops that are measured.

    Attributes:
        name: title in the table.
        experiment: experiment whose loop it is.
        duration: simulated time [s].
        counts: numbers of rows.
        aimed: the one for which the aim is; 0: there is none.
        aim: simulated time of all rows by that of the computer [-].
        settings: settings of the scenario.
        cores: number of threads that the plant's engine has.
        varied: key of which each row has another value, so that it has a machine of its own.
        on_grounds: true if each row stands on another ground, of up to 3 deg.
    """

    name: str
    experiment: str
    duration: float
    counts: tuple[int, ...]
    aimed: int
    aim: float
    settings: tuple[str, ...] = ("backend=kinematic",)
    cores: int = 1
    varied: str = ""
    on_grounds: bool = False


_REDUCED = ("backend=mujoco", "plant.leg_model=reduced", "plant.time_step=0.005")
_BODIES = ("backend=mujoco",)
# Rows that stand alike have the same numbers for seconds, and are many times as fast as others.
_CASES = (
    _Case("level", "level", 8.0, (1, 10, 100, 1000, 4000), 1000, 5000.0, on_grounds=True),
    _Case("level, briefly", "level", 1.0, (10_000,), 0, 0.0, on_grounds=True),
    _Case(
        "level, each its own legs", "level", 4.0, (100,), 100, 500.0, varied="machine.legs.l_4_mm"
    ),
    _Case("chair-walk", "chair-walk", 2.0, (10, 300, 1000), 1000, 1000.0),
    _Case("centre-walk", "centre-walk", 2.0, (10, 300, 1000), 1000, 1000.0),
    _Case("bench-walk", "bench-walk", 2.0, (10, 300, 1000), 1000, 1000.0),
    _Case(
        "level, MuJoCo, reduced legs, two cores, grounds",
        "level",
        2.0,
        (256,),
        256,
        300.0,
        _REDUCED,
        2,
        on_grounds=True,
    ),
    _Case("level, MuJoCo, reduced legs, two cores", "level", 2.0, (256,), 256, 300.0, _REDUCED, 2),
    _Case("level, MuJoCo, two cores", "level", 0.5, (256,), 256, 40.0, _BODIES, 2),
    _Case(
        "chair-walk, MuJoCo, two cores",
        "chair-walk",
        0.5,
        (256,),
        256,
        40.0,
        _BODIES,
        2,
    ),
)


def run(console: Console) -> list[Measurement]:
    results = []
    for case in _CASES:
        console.print(f"  {case.name} ...", highlight=False)
        with LocalCrew(1) as crew:  # a process as those of a study
            factor, pace = crew.executor.submit(_drake, case).result()
            title = f"one loop in Drake's simulator, {case.name}"
            results.append(Measurement(title, factor, "x", pace=pace))
            for count in case.counts:
                factor, pace, memory = crew.executor.submit(_rows, case, count).result()
                aim = case.aim if count == case.aimed else None
                title = f"{count} rows, {case.name}"
                results.append(Measurement(title, factor, "x", None, aim, pace=pace))
            results.append(Measurement(f"memory of a row, {case.name}", memory, "kB"))
    return results


def _loop(case: _Case, scenario: Any) -> ClosedLoop[Any]:
    """A loop with the signals that a study records."""
    experiment: Any = find_experiment(case.experiment)
    loop: ClosedLoop[Any] = experiment.loop(scenario, log=experiment.needed(scenario))
    return loop


def _drake(case: _Case) -> tuple[float, Pace]:
    simulator = Simulator(_loop(case, parapod.scenario(case.experiment, *case.settings)))
    simulator.Initialize()
    time, pace = NUMPY.beside(lambda: seconds(lambda: simulator.AdvanceTo(case.duration)))
    return case.duration / time, pace


def _rows(case: _Case, count: int) -> tuple[float, Pace, float]:
    """Real-time factor of all rows together, the pace, and the memory of a row [kB]."""
    os.environ["OMP_NUM_THREADS"] = str(case.cores)
    scenarios = [_scenario(case, row) for row in range(count)]
    loops: Any = _loop(case, scenarios[0])
    before = _resident()
    if case.varied:
        loops = [_loop(case, scenario) for scenario in scenarios]
    rows = LoopRows(loops, scenarios)
    measure = seconds if case.cores == 1 else _by_the_wall
    time, pace = NUMPY.beside(lambda: measure(lambda: rows.advance_to(case.duration)))
    return count * case.duration / time, pace, (_resident() - before) / count


def _by_the_wall(work: Callable[[], object]) -> float:
    """Duration of work of several threads [s]."""
    began = perf_counter()
    work()
    return perf_counter() - began


def _scenario(case: _Case, row: int) -> Any:
    settings = [*case.settings, f"seed={row}"]
    if case.varied:
        usual: Any = parapod.scenario(case.experiment)
        for part in case.varied.split("."):
            usual = getattr(usual, part)
        settings.append(f"{case.varied}={usual * (1.0 + 1e-5 * row)}")
    if case.on_grounds:
        roll, pitch = (6.0 * (row * share % 1.0) - 3.0 for share in (0.618034, 0.414214))
        settings += [f"ground.roll_deg={roll:.4f}", f"ground.pitch_deg={pitch:.4f}"]
    return parapod.scenario(case.experiment, *settings)


def _resident() -> float:
    """Memory that the process has now [kB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1024.0
