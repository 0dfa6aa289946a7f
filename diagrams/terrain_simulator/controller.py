"""The terrain simulator's controller: from what a terrain asks to sliders, and the leg's own."""

import numpy as np
from pydrake.systems.framework import Diagram, System
from pydrake.systems.primitives import ConstantVectorSource, PassThrough

from parapod.diagrams.own_controller import own_system
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.wiring import named, wired
from parapod.systems.terrain_simulator.cells import FootForce
from parapod.systems.terrain_simulator.guard import SingularityGuard, SingularityGuardParams
from parapod.systems.terrain_simulator.hip_support import HipSupport
from parapod.systems.terrain_simulator.load_estimator import LoadEstimator

# Period with which a leg may be controlled that nothing moves [s].
_ANY_PERIOD = 1e-3
# Signals by the names of the ports inside.
_SIGNALS = {
    "position_measured": "sliders.position",
    "position_command": "sliders.position_command",
    "current": "sliders.current",
    "emergency_stop": "sliders.emergency_stop",
    "brake": "sliders.brake",
    "force": "cells.force",
    "position": "leg.position",
    "velocity": "leg.velocity",
    "torque_command": "leg.torque_command",
    "hip_measured": "hip.position",
    "hip_rate": "hip.velocity",
    "force_command": "hip.force_command",
    "load": "foot_load",
}
_SHOWN = (
    *("sliders.position_command", "sliders.brake", "hip.force_command", "leg.torque_command"),
    *("pose_desired", "share", "foot_load", "load_estimated", "pose_estimated"),
    *("belt.brake", "hip.brake"),
)


def make_leg_controller(scenario: TerrainBenchScenario) -> System:
    """The leg's controller: its own, or one that the scenario names.

    Raises:
        ScenarioError: see `own_system`; or it cannot be sampled with the period.
    """
    if not scenario.leg.controller:
        return scenario.leg.under_test.make_controller(scenario.leg_period or _ANY_PERIOD)
    name = scenario.leg.controller
    return own_system("leg.controller", name, scenario, outputs=("torque_command",))


def make_controller(scenario: TerrainBenchScenario) -> Diagram:
    """Wires the guard and the controllers of leg and hip, by the names of their ports.

    Inputs: measurements of the table above; of the source `pose_asked` (3), `plate_motion`
    (9), `foot_desired` (6), `foot_force_desired` (1), `stance` (1), `hip_force` (1),
    `hip_desired` (2).
    Outputs: those of `_SHOWN`.

    Args:
        scenario: its `machine`, `leg` and `control` are used.
    """
    machine, period = scenario.machine, scenario.control.period
    geometry, sliders = machine.geometry, machine.sliders
    params = SingularityGuardParams(limits=sliders.limits, braking=sliders.max_acceleration_m_s2)
    # Without drives of the leg nothing but its brake would carry the slide.
    hip_brake = PassThrough(1) if scenario.drives_leg else ConstantVectorSource(np.ones(1))
    systems = (
        SingularityGuard(geometry, params, period),
        make_leg_controller(scenario),
        HipSupport(scenario.hip.support, period),
        FootForce(machine.cells_geometry),
        LoadEstimator(geometry, machine.masses, sliders.force_per_current_N_A),
        (named("belt_brake", PassThrough(1)), {"u": "sliders.brake", "y": "belt.brake"}),
        (
            named("hip_brake", hip_brake),
            {"u": "sliders.brake", "y": "hip.brake", "y0": "hip.brake"},
        ),
    )
    return wired("controller", systems, _SHOWN, _SIGNALS)
