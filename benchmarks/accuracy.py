"""Errors over step sizes, seeds and grounds, and of both engines on public problems."""

from pathlib import Path

import numpy as np
from pydrake.systems.analysis import Simulator
from rich.console import Console

from benchmarks import closed_loops
from benchmarks.report import Measurement
from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.model import DRAWN
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.scenario import (
    GroundScenario,
    LevellingScenario,
    WaypointScenario,
)
from parapod.systems.levelling_platform.kinematics import forward_kinematics

_LOG = ("truth.posture", "truth.extension", "truth.loop_error", "posture_desired_state")
# The grounds that the stroke can level, out to its edge: roll, pitch [deg].
# Roll and pitch of the ground [deg].
_GROUNDS: tuple[tuple[float, float], ...] = (
    *((0.0, 0.0), (5.0, 0.0), (0.0, 5.0), (-5.0, 0.0), (0.0, -5.0)),
    *((4.0, 2.0), (2.0, 4.0), (-4.0, 2.0), (-2.0, -4.0), (3.0, 3.0)),
)


def model_error(time_step: float, leg_model: str = "full") -> dict[str, float]:
    """Kinematic model against the multibody plant, moving on a 5 deg slope.

    The model is fed the extensions that the actuators really had; the paper's comparison with
    its co-simulation (Figs. 8 and 9) is the same.
    """
    scenario = LevellingScenario(ground=GroundScenario(0.0, 5.0))
    scenario.machine.sensors = SensorScenario(0.0, False, 0.0, 0.0)
    scenario.machine.actuators.gain_error = 0.0
    scenario.plant.time_step, scenario.plant.leg_model = time_step, leg_model
    scenario.job.estimate_at = 2.0
    scenario.job.waypoints = [
        WaypointScenario(4.0, 0.3, -0.8, 4.0),
        WaypointScenario(5.5, -0.3, 0.8, -4.0),
    ]
    loop = ClosedLoop(PLATFORM, scenario, log=_LOG)
    signals = _simulate(loop, scenario, 9.0)
    moving = signals["t"] > scenario.job.estimate_at
    predicted = forward_kinematics(DRAWN, signals["truth.extension"], scenario.ground.inclination)
    error = np.abs(signals["truth.posture"] - predicted)[moving].max(axis=0)
    return {
        "angle_deg": float(np.degrees(error[:2]).max()),
        "height_mm": 1e3 * float(error[2]),
        "closure_um": 1e6 * float(signals["truth.loop_error"][moving].max()),
    }


def run(console: Console, out: Path | None = None) -> list[Measurement]:
    """Measures all of it.

    Args:
        console: console to print on.
        out: file of the picture of closed loops, or None.
    """
    results = []
    closures = {}
    for step in (5e-4, 1e-3, 2e-3):
        console.print(f"  model against plant at {1e3 * step:g} ms ...", highlight=False)
        error = model_error(step)
        closures[step] = error["closure_um"]
        if step == 1e-3:
            results += [
                Measurement("model against plant, 1 ms: angle", error["angle_deg"], "deg", 0.02,
                            at_most=True),
                Measurement("model against plant, 1 ms: height", error["height_mm"], "mm", 0.1,
                            at_most=True),
                Measurement("loops' closure error, 1 ms", error["closure_um"], "um", 5.0,
                            at_most=True),
            ]  # fmt: skip
    results.append(
        Measurement("  closure at 2 ms over 1 ms (4: dt^2)", closures[2e-3] / closures[1e-3], "x")
    )
    results.append(
        Measurement("  closure at 1 ms over .5 ms", closures[1e-3] / closures[5e-4], "x")
    )
    for backend, count in (("kinematic", 100), ("multibody", len(_GROUNDS))):
        console.print(f"  {count} seeds and 10 grounds, {backend} ...", highlight=False)
        results += _levelling(backend, count)
    return results + closed_loops.run(console, out)


def _levelling(backend: str, count: int) -> list[Measurement]:
    """Largest inclination of the platform, 6 s after it began."""
    scenario = LevellingScenario(backend=backend)
    loop = ClosedLoop(PLATFORM, scenario, log=_LOG)
    worst = np.zeros(3)
    for seed in range(count):
        scenario.seed = seed
        roll, pitch = _GROUNDS[seed % len(_GROUNDS)]
        scenario.ground = GroundScenario(roll, pitch)
        signals = _simulate(loop, scenario, 12.0)
        error = np.abs(signals["truth.posture"] - (0.0, 0.0, 0.477))[signals["t"] > 9.0]
        worst = np.maximum(worst, error.max(axis=0))
    name = f"level, {backend}, {count} seeds"
    roll, pitch = (float(np.degrees(angle)) for angle in worst[:2])
    return [
        Measurement(f"{name}: |roll|", roll, "deg", 0.2, at_most=True),
        Measurement(f"{name}: |pitch|", pitch, "deg", 0.2, at_most=True),
        Measurement(f"{name}: height", 1e3 * float(worst[2]), "mm", 2.0, at_most=True),
    ]


def _simulate(
    loop: ClosedLoop, scenario: LevellingScenario, duration: float
) -> dict[str, np.ndarray]:
    simulator = Simulator(loop)
    context = simulator.get_mutable_context()
    loop.reset(context, scenario)
    simulator.Initialize()
    simulator.AdvanceTo(duration)
    recording = loop.recording(context)
    return dict(recording) | {"t": recording.time}
