"""The way from a measurement through the controller to the write, on emulated devices."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from pydrake.systems.analysis import Simulator
from rich.console import Console

from benchmarks.report import Measurement
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.experiment import RunOptions
from parapod.sims.real_machine.job import run_on_hardware
from parapod.sims.real_machine.punctuality import bench_real_time

_DURATION = 15.0  # [s]


def run(console: Console) -> list[Measurement]:
    results = _punctuality(console)
    with _emulator():
        scenario = LevellingScenario(backend="hardware")
        loop = ClosedLoop(PLATFORM, scenario, log=())
        simulator = Simulator(loop)
        timing = run_on_hardware(
            loop, simulator, _DURATION, RunOptions(console=console), "emulated machine"
        )
    results.append(
        Measurement("ticks missed of 1500, emulated machine", timing.missed, "", 15, 0, True)
    )
    for part in ("legs", "wheels"):
        ages = 1e3 * np.array(loop.station.behind.handle.threads[part][0].write_ages)
        period = 1e3 * scenario.control.period
        share = 100.0 * float(np.mean(ages < period))
        median = float(np.median(ages))
        results += [
            Measurement(
                f"{part}: age of measurements when written", median, "ms", period, 5, True
            ),
            Measurement(f"{part}: writes younger than a period", share, "%", 80, 99),
        ]
    return results


def _punctuality(console: Console) -> list[Measurement]:
    """Punctuality of the loop without devices; the machine's own wake-up beside it."""
    results = []
    scenario = LevellingScenario(backend="mock")
    for p in bench_real_time(PLATFORM, scenario, (100.0, 200.0, 500.0), 5.0, console):
        late, alone = 1e3 * p.period_error[1], 1e3 * p.wake_up[1]
        cost = 1e3 * p.cost[1]
        results += [
            Measurement(
                f"period error, 99 %, {p.rate:g} Hz (wake-up alone {alone:.2f} ms)", late, "ms"
            ),
            Measurement(f"tick, 99 %, {p.rate:g} Hz", cost, "ms", 1e3 / p.rate, None, True),
        ]
    return results


@contextmanager
def _emulator() -> Iterator[None]:
    """The emulated machine in another process, in a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="parapod") as folder:
        os.environ["PARAPOD_EMULATOR"] = folder
        command = [
            sys.executable,
            "-m",
            "parapod.sims",
            "emulate",
            "level",
            "--backend",
            "kinematic",
        ]
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        assert process.stderr is not None
        try:
            if not any(line.startswith("ready") for line in process.stderr):
                raise RuntimeError("the emulator does not begin")
            yield
        finally:
            process.terminate()
            process.wait()
            del os.environ["PARAPOD_EMULATOR"]
