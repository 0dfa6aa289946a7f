"""The walking chair: real-time factors, and what ten cycles with a passenger come to."""

from rich.console import Console

from benchmarks.factor import measured_factor
from benchmarks.report import Measurement
from benchmarks.yardstick import DRAKE, PYTHON
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario, GaitScenario
from parapod.sims.output.options import RunOptions
from parapod.sims.walking_chair.walk import ChairWalk

_CASES = (
    # backend, time step [s], floor, aim
    ("multibody", 1e-3, 2.5, None),
    ("multibody", 5e-3, 10.0, None),
    ("kinematic", 1e-3, 5.0, None),
)
# Simulated time that is measured: standing, lifting, and most of a swing [s].
_DURATION = 10.0
_CYCLES = 10


def run(console: Console) -> list[Measurement]:
    results = []
    for backend, time_step, floor, aim in _CASES:
        name = backend if backend == "kinematic" else f"{backend}, {1e3 * time_step:g} ms"
        console.print(f"  chair, {name} ...", highlight=False)
        scenario = ChairScenario(backend=backend)
        scenario.plant.time_step = time_step
        yardstick = PYTHON if backend == "kinematic" else DRAKE
        loop = ClosedLoop(CHAIR, scenario, log=())
        results.append(measured_factor(f"chair, {name}", loop, _DURATION, yardstick, floor, aim))
    return results + _ten_cycles(console)


def _ten_cycles(console: Console) -> list[Measurement]:
    """A long way forward and back, with bodies and contact."""
    gait = GaitScenario(cycles=_CYCLES, way="forward and back")
    times = (
        ChairWalk("chair-walk")
        .execute(ChairScenario(gait=gait), RunOptions(console=console))
        .as_json()
    )
    bounds = (
        ("drift", "drift_mm", "mm", 5.0),
        ("tilt", "tilt_deg", "deg", 0.1),
        ("force", "peak_force_N", "N", 250.0),
        ("loop error", "loop_error_um", "um", 1.0),
    )
    return [
        Measurement(f"chair, {_CYCLES} cycles and back: {name}", times[key], unit, bound,
                    at_most=True)
        for name, key, unit, bound in bounds
    ]  # fmt: skip
