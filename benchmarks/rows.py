"""Speed of many closed loops that are simulated side by side, beside one loop in Drake."""

import resource
from pathlib import Path
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

# Experiments whose loops are measured, simulated time [s], numbers of rows, aims [x].
_CASES: dict[str, tuple[float, tuple[int, ...], float]] = {
    "level": (4.0, (1, 10, 100, 1000, 4000), 5000.0),
    "chair-walk": (2.0, (10, 300), 1000.0),
    "centre-walk": (2.0, (10, 300), 1000.0),
    "bench-walk": (1.0, (10, 300), 1000.0),
}
# Rows of a case for which its aim is.
_AIMED = {"level": 1000, "chair-walk": 300, "centre-walk": 300, "bench-walk": 300}


def run(console: Console) -> list[Measurement]:
    results = []
    for name, (duration, counts, aim) in _CASES.items():
        console.print(f"  {name} ...", highlight=False)
        with LocalCrew(1) as crew:  # a process as those of a study
            factor, pace = crew.executor.submit(_drake, name, duration).result()
            results.append(Measurement(f"one loop in Drake, {name}", factor, "x", pace=pace))
            for count in counts:
                work = crew.executor.submit(_rows, name, duration, count)
                factor, pace, memory = work.result()
                best = aim if count == _AIMED[name] else None
                title = f"{count} rows, {name}"
                results.append(Measurement(title, factor, "x", None, best, pace=pace))
                if count == counts[-1]:
                    results.append(Measurement(f"memory of a row, {name}", memory, "kB"))
    return results


def _loop(name: str) -> ClosedLoop[Any]:
    """The kinematic loop of an experiment, with the signals that a study records."""
    experiment: Any = find_experiment(name)
    scenario = parapod.scenario(name, backend="kinematic")
    loop: ClosedLoop[Any] = experiment.loop(scenario, log=experiment.needed(scenario))
    return loop


def _drake(name: str, duration: float) -> tuple[float, Pace]:
    loop = _loop(name)
    simulator = Simulator(loop)
    simulator.Initialize()
    time, pace = NUMPY.beside(lambda: seconds(lambda: simulator.AdvanceTo(duration)))
    return duration / time, pace


def _rows(name: str, duration: float, count: int) -> tuple[float, Pace, float]:
    """Real-time factor of all rows together, the pace, and the memory of a row [kB]."""
    loop = _loop(name)
    before = _resident()
    scenarios = [parapod.scenario(name, backend="kinematic", seed=seed) for seed in range(count)]
    rows = LoopRows(loop, scenarios)
    time, pace = NUMPY.beside(lambda: seconds(lambda: rows.advance_to(duration)))
    return count * duration / time, pace, (_resident() - before) / count


def _resident() -> float:
    """Memory that the process has now [kB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1024.0
