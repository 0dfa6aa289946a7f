"""Real-time factors of the closed loop, and what the controller costs."""

import time
from dataclasses import dataclass

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from rich.console import Console

from benchmarks.factor import real_time_factor
from benchmarks.report import Measurement
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
        backend: of the scenario.
        leg_model: of the multibody plant.
        time_step: of the multibody plant [s].
        floor: bound of the real-time factor.
    """

    backend: str
    leg_model: str
    time_step: float
    floor: float

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
    Case("multibody", "full", 1e-3, 4.0),
    Case("multibody", "full", 5e-3, 15.0),
    Case("multibody", "reduced", 1e-2, 30.0),
    Case("kinematic", "full", 1e-2, 60.0),
)
# Simulated time that is measured, long enough for standing, levelling and a posture [s].
_DURATION = 12.0


def run(console: Console) -> list[Measurement]:
    results = []
    for case in CASES:
        console.print(f"  {case.name} ...", highlight=False)
        factor = real_time_factor(platform_loop(case), _DURATION, 2)
        results.append(Measurement(f"real-time factor, {case.name}", factor, "x", case.floor))
    tick = 1e6 * _controller_tick()
    results.append(
        Measurement("controller, one tick of 10 ms", tick, "us", 150.0, 50.0, at_most=True)
    )
    return results


def platform_loop(case: Case) -> ClosedLoop[LevellingScenario]:
    """The whole loop: controller, sensors, actuators, plant."""
    return ClosedLoop(PLATFORM, case.scenario(), log=())


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
    """Seconds a tick of the controller."""
    scenario = LevellingScenario()
    simulator = Simulator(moving_controller(scenario))
    simulator.Initialize()
    simulator.AdvanceTo(0.1)
    seconds = []
    for k in range(1, 6):
        started = time.perf_counter()
        simulator.AdvanceTo(0.1 + k)
        seconds.append((time.perf_counter() - started) * scenario.control.period)
    return min(seconds)
