"""The terrain simulator: real-time factors of walking legs, and the bounds of whole runs."""

import io
from typing import Any

from rich.console import Console

import parapod
from benchmarks.factor import measured_factor
from benchmarks.report import Measurement
from benchmarks.yardstick import DRAKE, PYTHON
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.terrain_simulator.machine import TERRAIN_BENCH
from parapod.sims.lab.experiment import Experiment
from parapod.sims.output.options import RunOptions
from parapod.sims.terrain_simulator.course import BenchCourse
from parapod.sims.terrain_simulator.leg import BenchLeg
from parapod.sims.terrain_simulator.walk import BenchWalking

_FLYING = (
    "machine.configuration=treadmill",
    *("gait.speed_m_s=2.75", "gait.duty=0.4", "gait.ramp=0.3"),
)
_CASES: tuple[tuple[str, tuple[str, ...], float, float | None], ...] = (
    # what, settings, floor, aim
    ("trot on the pedal", (), 2.0, 3.0),
    ("flying trot on the treadmill", _FLYING, 2.0, 3.0),
    ("kinematic", ("backend=kinematic",), 3.0, None),
)
# Simulated time that is measured: standing, running up, and a stride [s].
_DURATION = 4.0
_RUNS: tuple[tuple[str, Experiment[Any, Any], tuple[str, ...]], ...] = (
    ("bench-walk, trot", BenchWalking("bench-walk"), ()),
    ("bench-walk, flying trot", BenchWalking("bench-walk"), _FLYING),
    ("bench-course", BenchCourse("bench-course"), ()),
    ("bench-leg", BenchLeg("bench-leg"), ()),
)


def run(console: Console) -> list[Measurement]:
    results = []
    for what, settings, floor, aim in _CASES:
        console.print(f"  {what} ...", highlight=False)
        loop = ClosedLoop(TERRAIN_BENCH, parapod.scenario("bench-walk", *settings), log=())
        # Bodies at every millisecond push Python out of the caches, as those of the yardstick do.
        yardstick = PYTHON if what == "kinematic" else DRAKE
        results.append(measured_factor(f"{what}, 1 ms", loop, _DURATION, yardstick, floor, aim))
    quiet = RunOptions(console=Console(file=io.StringIO()))
    for what, experiment, settings in _RUNS:
        console.print(f"  {what} ...", highlight=False)
        result = experiment.execute(parapod.scenario(experiment.name, *settings), quiet)
        broken = float(len(result.broken))
        results.append(Measurement(f"{what}: bounds broken", broken, "", 0.0, at_most=True))
    return results
