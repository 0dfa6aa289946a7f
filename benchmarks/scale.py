"""Studies on all cores: runs per second, what one costs the program that sends it out, memory."""

import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console

import parapod
from benchmarks.endurance import resident
from benchmarks.report import Measurement
from parapod.sims.lab.work import LocalCrew
from parapod.sims.study.records import Records
from parapod.sims.study.runs import Outcome
from parapod.sims.study.study import Study

# A job that takes a worker some 30 ms, and one that takes it half a second.
_BRIEF = (
    *("backend=kinematic", "job.estimate_at=0.5", "job.settled_after=0.5", "job.end=1"),
    *("job.waypoints=[]", "job.arm={start: 0.2, duration: 0.2, angle_deg: 5}"),
)
_WHOLE = ("backend=kinematic",)
# Numbers of runs; the first ones, in which workers import and build, are not counted.
_MANY, _FEW, _FIRST = 1000, 60, 0.15
# Rounds in which one worker and two are measured in turns.
_ROUNDS = 3
_MOST_COST = 2.0  # [ms] of the program for a run: a thousand workers with runs of 2 s
_LEAK = 2.0  # [MB]
_EFFICIENCY = 95.0  # [%]


@dataclass(frozen=True)
class _Timed:
    """Time and memory that a study took.

    Attributes:
        rate: runs per second.
        cost: processor time of the program that sends the runs out, for each [s].
        memory: memory of the workers, after each run [MB].
    """

    rate: float
    cost: float
    memory: list[float]


def run(console: Console) -> list[Measurement]:
    results = []
    for what, settings, runs in (("30 ms", _BRIEF, 15 * _FEW), ("0.5 s", _WHOLE, _FEW)):
        one, two = [], []
        for i in range(_ROUNDS):
            console.print(f"  runs of {what}, round {i + 1} of {_ROUNDS} ...", highlight=False)
            one.append(_timed(1, settings, runs // 2).rate)
            two.append(_timed(2, settings, runs).rate)
        share = 100.0 * max(b / (2.0 * a) for a, b in zip(one, two, strict=True))
        results += [
            Measurement(f"runs of {what}, 1 worker", max(one), "1/s"),
            Measurement("  2 workers", max(two), "1/s"),
            Measurement("  efficiency of 2", share, "%", _EFFICIENCY),
        ]
    console.print(f"  {_MANY} runs with one worker ...", highlight=False)
    many = _timed(1, _BRIEF, _MANY)
    count = int(_FIRST * _MANY)
    grown = max(many.memory[count:]) - many.memory[count]
    cost = 1e3 * many.cost
    name = f"memory of a worker that grows over {_MANY} runs"
    return [
        *results,
        Measurement("the program's own time for a run", cost, "ms", _MOST_COST, at_most=True),
        Measurement("  workers that it keeps busy with runs of 1 s", 1e3 / cost, ""),
        Measurement(name, grown, "MB", _LEAK, at_most=True),
    ]


def _timed(workers: int, settings: tuple[str, ...], runs: int) -> _Timed:
    study = Study.make("level", parapod.scenario("level", *settings), {"seed": range(runs)})
    clocks: list[tuple[float, float]] = []
    memory: list[float] = []
    with TemporaryDirectory() as folder, LocalCrew(workers) as crew:

        class Watching(Records):
            """Notes the clocks and the workers' memory whenever a run is done."""

            def add(self, outcome: Outcome) -> None:
                super().add(outcome)
                clocks.append((time.perf_counter(), time.process_time()))
                assert isinstance(crew.executor, ProcessPoolExecutor)
                memory.append(max(map(resident, _children())))

        records = Watching(study.sampling)
        study.carry_out(crew, records, Console(quiet=True), Path(folder) / "study.parquet")
    assert records.done.all()
    assert not records.errors
    first = int(_FIRST * runs)
    wall, own = np.array(clocks[-1]) - np.array(clocks[first])
    count = runs - 1 - first
    return _Timed(count / float(wall), float(own) / count, memory)


def _children() -> list[int]:
    pid = os.getpid()
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
