"""Punctuality of the loop without devices, and what a log costs it on emulated ones."""

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from rich.console import Console

from benchmarks.deadlines import busy
from benchmarks.report import Measurement
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.output.options import RunOptions
from parapod.sims.real_machine.job import run_on_hardware
from parapod.sims.real_machine.own_emulator import own_emulator
from parapod.sims.real_machine.punctuality import measure_punctuality
from parapod.sims.real_machine.real_time import DeadlineError, Timing
from parapod.systems.hardware.device import DeviceError

_PHYSICS = ("--backend", "kinematic")
# Runs with and without a log, and how long each is [s].
_TURNS, _TURN = 3, 5.0


def run(console: Console) -> list[Measurement]:
    return _punctuality(console) + _logging(console)


def _logging(console: Console) -> list[Measurement]:
    """Deadlines that are missed with a log and without, in turns; alone and on a busy computer."""
    results = []
    for others in (0, 2 * len(os.sched_getaffinity(0))):
        misses: dict[bool, list[float]] = {False: [], True: []}
        late: dict[bool, list[float]] = {False: [], True: []}
        # In the computer's own time, by which it is judged.
        emulator = own_emulator(PLATFORM.experiment, "--rate=1", *_PHYSICS)
        with emulator, busy(others), tempfile.TemporaryDirectory() as folder:
            for is_logged in (False, True) * _TURNS:
                log = Path(folder, "log.mcap") if is_logged else None
                timing = _timing_of_a_turn(RunOptions(console=console, log=log))
                misses[is_logged].append(timing.missed)
                late[is_logged] += timing.period_error
        where = f"{others} busy processes" if others else "alone"
        for is_logged, words in ((False, "no log"), (True, "a log")):
            turns = ", ".join(f"{count:g}" for count in misses[is_logged])
            error = 1e3 * float(np.percentile(late[is_logged], 99.0))
            results += [
                Measurement(
                    f"missed of {_TURNS} x {_TURN:g} s with {words}, {where} ({turns})",
                    sum(misses[is_logged]),
                    "",
                ),
                Measurement(f"period error, 99 %, with {words}, {where}", error, "ms"),
            ]
    return results


def _timing_of_a_turn(options: RunOptions) -> Timing:
    """Timing of a short run, all of whose deadlines count as missed if it was ended early."""
    scenario = LevellingScenario(backend="hardware")
    wheels: Any = scenario.hardware.drivers[2]
    wheels.heartbeat_timeout_ms = 1000.0
    loop = ClosedLoop(PLATFORM, scenario)
    try:
        return run_on_hardware(loop, Simulator(loop), _TURN, options, "logging")
    except (DeadlineError, DeviceError) as error:
        options.console.print(f"  {error}", highlight=False)
        every = round(_TURN / scenario.control.period)
        timing = Timing(scenario.control.period, missed=every)
        timing.add(0.0, 0.0)
        timing.add(_TURN, 0.0)
        return timing


def _punctuality(console: Console) -> list[Measurement]:
    """Punctuality of the loop without devices; the machine's own wake-up beside it."""
    results = []
    scenario = LevellingScenario(backend="mock")
    for p in measure_punctuality(PLATFORM, scenario, (100.0, 200.0, 500.0), 5.0, console):
        late, alone = 1e3 * p.period_error[1], 1e3 * p.wake_up[1]
        cost = 1e3 * p.cost[1]
        results += [
            Measurement(
                f"period error, 99 %, {p.rate:g} Hz (wake-up alone {alone:.2f} ms)", late, "ms"
            ),
            Measurement(f"tick, 99 %, {p.rate:g} Hz", cost, "ms", 1e3 / p.rate, None, True),
        ]
    return results
