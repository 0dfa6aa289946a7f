"""Whether long runs leak memory or drift: ten minutes, and a whole day."""

import gc
import resource
import sys
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from rich.console import Console
from rich.progress import Progress

from benchmarks.report import Measurement
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario, WaypointScenario

_MINUTE = 60.0
_DAY = 24.0 * 3600.0
# After this the memory must be flat [s].
_WARM = _MINUTE
_LEAK = 1.0  # [MB]
_DRIFT_DEG, _DRIFT_MM = 0.02, 0.05


def run(console: Console) -> list[Measurement]:
    """Ten minutes with a posture every few seconds."""
    return _endure(console, "10 minutes", 10.0 * _MINUTE)


def run_day(console: Console) -> list[Measurement]:
    """A day, which takes a quarter of an hour."""
    return _endure(console, "24 hours", _DAY)


def _endure(console: Console, name: str, duration: float) -> list[Measurement]:
    scenario = LevellingScenario(backend="kinematic")
    # The same few postures again and again for the first minutes, then at rest.
    scenario.job.waypoints = [
        WaypointScenario(7.0 + 4.0 * i, 0.5 * (-1) ** i, 0.5 * (i % 3), 5.0 * (i % 2))
        for i in range(120)
    ]
    scenario.job.waypoints.append(WaypointScenario(7.0 + 4.0 * 120))
    loop = ClosedLoop(PLATFORM, scenario, log=())
    simulator = Simulator(loop)
    simulator.Initialize()
    machine = loop.station
    memory, postures = [], []
    times = np.arange(_WARM, duration + 1.0, max(_MINUTE, duration / 200.0))
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task(name, total=duration)
        for time in times:
            simulator.AdvanceTo(float(time))
            gc.collect()
            memory.append(resident())
            context = machine.GetMyContextFromRoot(simulator.get_context())
            postures.append(machine.GetOutputPort("truth.posture").Eval(context))
            bar.update(task, completed=float(time))
    settled = np.array(postures)[times > 7.0 + 4.0 * 121 + 10.0]
    drift = np.ptp(settled, axis=0) if len(settled) else np.zeros(3)
    return [
        Measurement(
            f"memory that grows after the first minute, {name}",
            max(memory) - memory[0],
            "MB",
            _LEAK,
            at_most=True,
        ),
        Measurement(
            f"drift of roll and pitch at rest, {name}",
            float(np.degrees(drift[:2].max())),
            "deg",
            _DRIFT_DEG,
            at_most=True,
        ),
        Measurement(
            f"drift of the height at rest, {name}",
            1e3 * float(drift[2]),
            "mm",
            _DRIFT_MM,
            at_most=True,
        ),
    ]


def resident(process: int | str = "self") -> float:
    """Memory of a process, by default of this one, that is in use now [MB]."""
    status = Path(f"/proc/{process}/statm")
    if status.exists():
        return int(status.read_text().split()[1]) * resource.getpagesize() / 1e6
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e3)
