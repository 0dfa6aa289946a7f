"""The terrain simulator's controller: from what a terrain asks to sliders, and the leg's own."""

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, System
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.own_controller import own_system
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.wiring import add, export_inputs, outputs_of
from parapod.systems.terrain_simulator.cells import FootForce
from parapod.systems.terrain_simulator.guard import SingularityGuard, SingularityGuardParams
from parapod.systems.terrain_simulator.hip_support import HipSupport
from parapod.systems.terrain_simulator.load_estimator import LoadEstimator

# Period with which a leg may be controlled that nothing moves [s].
_ANY_PERIOD = 1e-3
# The machine's signals, by the names of the ports inside that take them.
_TAKEN = {
    "position_measured": "sliders.position",
    "current": "sliders.current",
    "emergency_stop": "sliders.emergency_stop",
    "force": "cells.force",
    "position": "leg.position",
    "velocity": "leg.velocity",
    "hip_measured": "hip.position",
    "hip_rate": "hip.velocity",
}
# And those that it shows.
_SHOWN = {
    "sliders.position_command": "position_command",
    "sliders.brake": "brake",
    "hip.brake": "hip_brake",
    "hip.force_command": "force_command",
    "belt.brake": "brake",
    "leg.torque_command": "torque_command",
    "pose_desired": "pose_desired",
    "share": "share",
    "foot_load": "load",
    "load_estimated": "load_estimated",
    "pose_estimated": "pose_estimated",
}


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

    Inputs: the measurements of the table above; of the source `pose_asked` (3), `plate_motion`
    (9), `foot_desired` (6), `foot_force_desired` (1), `stance` (1), `hip_force` (1),
    `hip_desired` (2).
    Outputs: those of the other table.

    Args:
        scenario: its `machine`, `leg` and `control` are used.
    """
    machine = scenario.machine
    geometry, sliders = machine.geometry, machine.sliders
    builder = DiagramBuilder()
    params = SingularityGuardParams(limits=sliders.limits, braking=sliders.max_acceleration_m_s2)
    systems = (
        add(builder, SingularityGuard(geometry, params, scenario.control.period)),
        add(builder, make_leg_controller(scenario)),
        add(builder, HipSupport(scenario.hip.support, scenario.control.period)),
        add(builder, FootForce(machine.cells_geometry)),
        add(builder, LoadEstimator(geometry, machine.masses, sliders.force_per_current_N_A)),
    )
    outputs = {name: port for system in systems for name, port in outputs_of(system).items()}
    outputs["hip_brake"] = outputs["brake"]
    export_inputs(builder, systems, _TAKEN)
    if not scenario.drives_leg:  # nothing but its brake would carry the slide
        outputs["hip_brake"] = add(builder, ConstantVectorSource(np.ones(1))).get_output_port()
    for signal, name in _SHOWN.items():
        builder.ExportOutput(outputs[name], signal)
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram
