"""Cost of an arm that bends: loops beside those with a rigid one, and the tip's kinematics."""

import statistics
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context
from rich.console import Console

from benchmarks.factor import rate
from benchmarks.realtime import CASES, Case
from benchmarks.report import Measurement
from benchmarks.yardstick import DRAKE, NUMPY, seconds
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.arms import FlexibleRod, Rod
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.pointing import make_pointing_controller
from parapod.sims.levelling_platform.inspection import Inspect, InspectScenario
from parapod.sims.real_machine.real_time import RealTimeLoop, percentiles, rehearse, undisturbed
from parapod.systems.arm import flexible_rod
from parapod.systems.core.ports import value_of
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.statics import PAPER_ARM
from parapod.systems.levelling_platform.tip import TipReach

# Loops whose cost is measured; the floor of their speed is judged elsewhere.
_LOOPS = (
    CASES[3],
    CASES[0],
    replace(CASES[2], time_step=5e-3),
    Case("mujoco", "full", 1e-3, DRAKE, 0.0),
)
_BOUND = 1.1
# Simulated time of a turn, and number of turns, of which each loop takes its share [s, -].
_TURN, _TURNS = 0.1, 100
# Points of `inspect` to which the tip goes, the last of which is the hardest, and the time that
# a loop has for them [s].
_WAY, _LONGEST = slice(4, 7), 40.0
# Points of the tip, the largest lean of the arm there [rad], and the bound of their rate [M/s].
_POINTS, _LEAN, _TIP_BOUND = 200_000, 1.3, 1.0


def run(console: Console) -> list[Measurement]:
    results = []
    for case in _LOOPS:
        console.print(f"  {case.name} ...", highlight=False)
        name = f"time by that with a rigid arm, {case.name}"
        results.append(Measurement(name, _cost(case), "x", _BOUND, at_most=True))
    for name, rod in (("rigid", None), ("that bends", flexible_rod.FlexibleRod())):
        results += _tip(name, TipReach(PlatformGeometry(), PAPER_ARM, rod))
    for backend, where in (("kinematic", "in a tick"), ("hardware", "by another process")):
        console.print(f"  the tip put to points, answers {where} ...", highlight=False)
        results += _ticks(f"tick with answers worked out {where}", backend)
    return results


def _cost(case: Case) -> float:
    """Time of the loop with an arm that bends, by that with a rigid one.

    Both take turns, so that whatever else the computer does delays both.
    """
    simulators = []
    for arm in (FlexibleRod(), Rod()):
        scenario = case.scenario()
        scenario.machine.arm = arm
        loop = ClosedLoop(PLATFORM, scenario, log=())
        simulator = Simulator(loop)
        if loop.monitor is not None:
            simulator.set_monitor(loop.monitor)
        simulator.Initialize()
        simulators.append(simulator)
    ratios = []
    for turn in range(1, _TURNS + 1):
        bends, rigid = (seconds(partial(s.AdvanceTo, _TURN * turn)) for s in simulators)
        ratios.append(bends / rigid)
    return statistics.median(ratios)


def _tip(name: str, reach: TipReach) -> list[Measurement]:
    """Rate and error of the inverse kinematics of an arm's tip."""
    random = np.random.default_rng(0)
    height = random.uniform(*reach.heights, _POINTS)
    turn, lean = random.uniform(-3.0, 3.0, _POINTS), random.uniform(0.0, _LEAN, _POINTS)
    points = reach.tip_position(height, np.stack([turn, lean], axis=-1))
    points_a_second, pace = rate(partial(reach.solve, points), _POINTS, NUMPY)
    worst = float(reach.solve(points).error.max())
    what = f"inverse kinematics of the tip, arm {name}"
    return [
        Measurement(what, points_a_second / 1e6, "M/s", _TIP_BOUND, pace=pace),
        Measurement("  largest error", worst * 1e9, "nm", 1000.0, at_most=True),
    ]


def _ticks(name: str, backend: str) -> list[Measurement]:
    """Ticks of a loop in real time that puts the tip to points, its controller as on a backend."""
    scenario = InspectScenario(backend="kinematic")
    inspection = scenario.inspection
    inspection.points = inspection.points[_WAY]
    controller = make_pointing_controller(replace(scenario, backend=backend))
    loop: Any = Inspect("inspect").loop(scenario, controller=controller, log=())
    simulator, script = Simulator(loop), loop.GetSubsystemByName("tip_script")

    def look(root: Context) -> None:
        if value_of(script, "points_done", root)[0] >= len(inspection.points):
            raise StopIteration

    with undisturbed():
        simulator.Initialize()
        rehearse(loop, simulator.get_context())
        running = RealTimeLoop(simulator, scenario.control.period, look, is_strict=False)
        with suppress(StopIteration):
            running.run(_LONGEST)
    _, most, longest = 1e3 * percentiles(running.timing.cost)
    bound = 1e3 * running.timing.period if backend == "hardware" else None
    return [
        Measurement(f"{name}: longest", longest, "ms", bound, at_most=True),
        Measurement("  99 %", most, "ms"),
    ]
