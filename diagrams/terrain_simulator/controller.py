"""The terrain simulator's controller: from what a terrain asks to sliders, and the leg's own."""

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.wiring import add, inputs_of, outputs_of
from parapod.systems.terrain_simulator.cells import CELLS, FootForce
from parapod.systems.terrain_simulator.guard import SingularityGuard, SingularityGuardParams
from parapod.systems.terrain_simulator.hip_support import HipSupport
from parapod.systems.terrain_simulator.load_estimator import MASSES, LoadEstimator

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


def make_leg_controller(scenario: TerrainBenchScenario) -> LeafSystem:
    """The leg's own controller, as the impedance of a round foot."""
    return scenario.leg.under_test.make_controller(scenario.control.period)


def make_controller(scenario: TerrainBenchScenario) -> Diagram:
    """Wires the guard and the controllers of leg and hip, by the names of their ports.

    Inputs: the measurements of the table above; of the source `pose_asked` (3), `plate_motion`
    (9), `foot_desired` (6), `foot_force_desired` (1), `stance` (1), `hip_force` (1),
    `hip_desired` (2).
    Outputs: those of the other table.

    Args:
        scenario: its `configuration`, `leg`, `sliders` and `control` are used.
    """
    geometry, configuration = scenario.geometry, scenario.configuration
    builder = DiagramBuilder()
    params = SingularityGuardParams(
        limits=scenario.sliders.limits, braking=scenario.sliders.max_acceleration_m_s2
    )
    systems = (
        add(builder, SingularityGuard(geometry, params, scenario.control.period)),
        add(builder, make_leg_controller(scenario)),
        add(builder, HipSupport(scenario.hip.support, scenario.control.period)),
        add(builder, FootForce(CELLS[configuration])),
        add(
            builder,
            LoadEstimator(geometry, MASSES[configuration], scenario.sliders.force_per_current_N_A),
        ),
    )
    outputs = {name: port for system in systems for name, port in outputs_of(system).items()}
    outputs["hip_brake"] = outputs["brake"]
    taken: set[str] = set()
    for system in systems:
        for name, sink in inputs_of(system).items():
            signal = _TAKEN.get(name, name)
            if signal in taken:
                builder.ConnectInput(signal, sink)
            else:
                builder.ExportInput(sink, signal)
                taken.add(signal)
    if not scenario.drives_leg:  # nothing but its brake would carry the slide
        outputs["hip_brake"] = add(builder, ConstantVectorSource(np.ones(1))).get_output_port()
    for signal, name in _SHOWN.items():
        builder.ExportOutput(outputs[name], signal)
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram
