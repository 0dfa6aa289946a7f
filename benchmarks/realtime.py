"""Real-time factors of the closed loop, and what the controller costs."""

import time

import numpy as np
from pydrake.systems.analysis import Simulator
from rich.console import Console

from benchmarks.factor import real_time_factor
from benchmarks.report import Measurement
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.controller import make_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import LevellingScenario, WaypointScenario

_CASES = (
    # backend, leg model, time step [s], floor, aim
    ("multibody", "full", 1e-3, 4.0, None),
    ("multibody", "full", 5e-3, 15.0, None),
    ("multibody", "reduced", 1e-2, 30.0, None),
    ("kinematic", "full", 1e-2, 60.0, 300.0),
)
# Simulated time that is measured, long enough for standing, levelling and a posture [s].
_DURATION = 12.0


def run(console: Console) -> list[Measurement]:
    results = []
    for backend, leg_model, time_step, floor, aim in _CASES:
        name = f"{backend}, {leg_model}, {1e3 * time_step:g} ms"
        if backend == "kinematic":
            name = "kinematic"
        console.print(f"  {name} ...", highlight=False)
        factor = _real_time_factor(backend, leg_model, time_step)
        results.append(Measurement(f"real-time factor, {name}", factor, "x", floor, aim))
    tick = 1e6 * _controller_tick()
    results.append(
        Measurement("controller, one tick of 10 ms", tick, "us", 150.0, 50.0, at_most=True)
    )
    return results


def _real_time_factor(backend: str, leg_model: str, time_step: float) -> float:
    """Real-time factor of the whole loop: controller, sensors, actuators, plant."""
    scenario = LevellingScenario(backend=backend)
    scenario.plant.leg_model, scenario.plant.time_step = leg_model, time_step
    scenario.job.waypoints = [WaypointScenario(7.0, 1.0, -1.0, 10.0)]
    return real_time_factor(ClosedLoop(PLATFORM, scenario, log=()), _DURATION, 2)


def _controller_tick() -> float:
    """Seconds a tick of the controller alone, moving, with constant measurements."""
    scenario = LevellingScenario()
    controller = make_controller(scenario)
    simulator = Simulator(controller)
    context = simulator.get_mutable_context()
    for name, value in (
        ("legs.extension", np.full(4, 0.41)),
        ("imu.gyro", np.zeros(3)),
        ("imu.accel", np.array([0.0, 0.0, 9.81])),
        ("posture_command", np.array([0.0, 0.0, 0.477])),
        ("estimate_ground", np.array([1.0])),
    ):
        controller.GetInputPort(name).FixValue(context, value)
    simulator.Initialize()
    simulator.AdvanceTo(0.1)
    seconds = []
    for k in range(1, 6):
        started = time.perf_counter()
        simulator.AdvanceTo(0.1 + k)
        seconds.append((time.perf_counter() - started) * scenario.control.period)
    return min(seconds)
