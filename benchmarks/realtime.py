"""Real-time factors of the closed loop, and what the controller costs."""

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from rich.console import Console

from benchmarks.factor import measured_factor, real_time_factor
from benchmarks.report import Measurement
from benchmarks.yardstick import DRAKE, PYTHON, Yardstick, seconds
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.controller import make_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario, WaypointScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.geometry import LEG_COUNT


@dataclass(frozen=True)
class Case:
    """A loop of the levelling platform.

    Attributes:
        backend: backend of the scenario.
        leg_model: leg model of the multibody plant.
        time_step: time step of the multibody plant [s].
        yardstick: yardstick that most of its work resembles.
        floor: bound of the real-time factor.
        aim: desired value.
    """

    backend: str
    leg_model: str
    time_step: float
    yardstick: Yardstick
    floor: float
    aim: float | None = None

    @property
    def name(self) -> str:
        if self.backend == "kinematic":
            return self.backend
        return f"{self.backend}, {self.leg_model}, {1e3 * self.time_step:g} ms"

    def scenario(self) -> LevellingScenario:
        scenario = LevellingScenario(backend=self.backend)
        scenario.plant.leg_model, scenario.plant.time_step = self.leg_model, self.time_step
        scenario.job.waypoints = [WaypointScenario(7.0, 1.0, -1.0, 10.0)]
        return scenario


CASES = (
    Case("multibody", "full", 1e-3, DRAKE, 4.4, 5.5),
    Case("multibody", "full", 5e-3, DRAKE, 15.0),
    Case("multibody", "reduced", 1e-2, DRAKE, 30.0, 50.0),
    Case("kinematic", "full", 1e-2, PYTHON, 60.0, 150.0),
)
# Drake allocates and frees some thousand blocks at a step; of each size the C library of Linux
# keeps 7 at hand by itself, and as many as this with it.
_TUNABLES = "glibc.malloc.tcache_count=200"
# Of the controller alone [us].
_TICK_BOUND, _TICK_AIM = 60.0, 35.0
# Simulated time in which the controller moves without end [s].
_MOVING = 1.0
# Simulated time that is measured, long enough for standing, levelling and a posture [s].
_DURATION = 12.0


def run(console: Console) -> list[Measurement]:
    results = []
    for case in CASES:
        console.print(f"  {case.name} ...", highlight=False)
        results.append(
            measured_factor(
                case.name, platform_loop(case), _DURATION, case.yardstick, case.floor, case.aim
            )
        )
    results.append(_with_larger_cache_of_blocks(CASES[0]))
    tick, pace = PYTHON.best_beside(_controller_tick, 5)
    results.append(
        Measurement(
            "controller, one tick of 10 ms",
            *(1e6 * tick, "us", _TICK_BOUND, _TICK_AIM),
            at_most=True,
            pace=pace,
        )
    )
    return results


def platform_loop(case: Case) -> ClosedLoop[LevellingScenario]:
    """The whole loop: controller, sensors, actuators, plant."""
    return ClosedLoop(PLATFORM, case.scenario(), log=())


def _with_larger_cache_of_blocks(case: Case) -> Measurement:
    """The same loop in a program that the C library gives a larger cache of blocks."""
    process = subprocess.run(
        [sys.executable, "-m", "benchmarks.realtime", str(CASES.index(case))],
        env=os.environ | {"GLIBC_TUNABLES": _TUNABLES},
        cwd=Path(__file__).parents[1],
        check=True,
        capture_output=True,
        text=True,
    )
    return Measurement(f"  {case.name}, GLIBC_TUNABLES={_TUNABLES}", float(process.stdout), "x")


def moving_controller(scenario: LevellingScenario) -> Diagram:
    """The controller alone with constant measurements, and a posture to move to."""
    builder = DiagramBuilder()
    controller = add(builder, make_controller(scenario))
    for name, value in (
        ("legs.extension", [0.41] * LEG_COUNT),
        ("imu.gyro", [0.0] * 3),
        ("imu.accel", [0.0, 0.0, 9.81]),
        ("posture_command", [0.0, 0.0, 0.477]),
        ("estimate_ground", [1.0]),
    ):
        source = add(builder, ConstantVectorSource(np.array(value)), name)
        connect(builder, source.get_output_port(), controller.GetInputPort(name))
    return builder.Build()


def _controller_tick() -> float:
    """Seconds a tick of the controller, on its way to a posture."""
    scenario = LevellingScenario()
    simulator = Simulator(moving_controller(scenario))
    simulator.Initialize()
    simulator.AdvanceTo(0.1)
    return seconds(lambda: simulator.AdvanceTo(0.1 + _MOVING)) * scenario.control.period / _MOVING


if __name__ == "__main__":
    _case = CASES[int(sys.argv[1])]
    print(real_time_factor(platform_loop(_case), _DURATION, _case.yardstick, 2)[0])
