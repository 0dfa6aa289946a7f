"""The machining centres' controller: from a job and measurements to lengths, locks and clamps."""

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, MatrixGain

from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.wiring import add, connect, inputs_of, outputs_of
from parapod.systems.machining_centre.feedforward import CentreFeedforward
from parapod.systems.machining_centre.posture import CentrePosture
from parapod.systems.machining_centre.sequence import SequenceParams
from parapod.systems.machining_centre.sequencer import CentreSequencer
from parapod.systems.machining_centre.wrench_monitor import WrenchMonitor

# The machine's signals, by the names of the ports inside that take them.
_MEASURED = {
    "position_measured": "legs.position",
    "emergency_stop": "legs.emergency_stop",
    "locks_closed": "locks.closed",
    "clamps_closed": "clamps.closed",
    "tool_force": "tool.force",
    "stop": "stop",
    "pose_asked": "pose_asked",
    "limb_asked": "limb_asked",
}
# Periods between two looks at whether the centre rests, where alone its pose is counted.
_LOOKS = 4
# And those that it shows.
_SHOWN = {
    "legs.position_command": "position_command",
    "legs.brake": "brake",
    "locks.command": "locks_command",
    "clamps.command": "clamps_command",
    "pose_desired": "pose_desired",
    "foot_desired": "foot_desired",
    "pose_estimated": "pose",
    "feet_estimated": "feet",
    "length_error": "length_error",
    "phase": "phase",
    "operation": "operation",
    "fault": "fault",
    "loose_limb": "loose_limb",
    "done": "done",
    "wrench_index": "wrench_index",
    "wrench_margin": "wrench_margin",
}


def make_controller(scenario: CentreScenario, is_operated: bool = False) -> Diagram:
    """Wires posture, sequencer, feedforward and wrench monitor, by the names of their ports.

    Inputs: `legs.position` (2n), `legs.current` (2n), `legs.emergency_stop` (1), `locks.closed`
    (4n), `clamps.closed` (n), `tool.force` (2); where a person may end the job, `stop` (1).
    Outputs: those of the table above.

    Where a person operates it: `pose_asked` (6) and `limb_asked` (1).

    Args:
        scenario: its job, `control`, `machine`, `begin` and `stop_at` are used.
        is_operated: true if a person operates it once its job is done.
    """
    geometry, plan, control = scenario.machine.geometry, scenario.plan, scenario.control
    builder = DiagramBuilder()
    params = SequenceParams(begin=scenario.begin, settling=control.settling)
    period = _LOOKS * control.period
    posture = add(builder, CentrePosture(geometry, period, *plan.beginning, is_sampled=True))
    sequencer = add(builder, CentreSequencer(geometry, plan.job, control.period, params))
    feedforward = add(builder, CentreFeedforward(geometry, control.period))
    process = plan.job.process
    wrench = WrenchMonitor(geometry, process.largest_leg_force, process.masses)
    monitor = add(builder, wrench)
    systems = (posture, sequencer, feedforward, monitor)
    outputs = {name: port for system in systems for name, port in outputs_of(system).items()}
    inputs_wanted = {"stop": scenario.stop_at is not None}
    inputs_wanted |= dict.fromkeys(("pose_asked", "limb_asked"), is_operated)
    inputs_in_use = {"legs.position", "legs.current"}
    outputs["position"] = _add_lengths(builder, scenario)
    for system in systems:
        for name, sink in inputs_of(system).items():
            if name in outputs:
                connect(builder, outputs[name], sink)
            elif (signal := _MEASURED[name]) in inputs_in_use:
                builder.ConnectInput(signal, sink)
            elif inputs_wanted.get(signal, True):
                builder.ExportInput(sink, signal)
                inputs_in_use.add(signal)
    for signal, name in _SHOWN.items():
        builder.ExportOutput(outputs[name], signal)
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram


def _add_lengths(builder: DiagramBuilder, scenario: CentreScenario) -> OutputPort:
    """Lengths of legs that yield to their forces: encoders do not see it, but currents show it."""
    legs, count = scenario.machine.legs, scenario.machine.geometry.legs
    by_current = legs.force_per_current_N_A / (1e6 * legs.stiffness_N_um)
    by_current *= float(scenario.control.knows_stiffness)
    yielding = add(builder, MatrixGain(-by_current * np.eye(count)), "yielding")
    lengths = add(builder, Adder(2, count), "lengths")
    builder.ExportInput(lengths.get_input_port(0), "legs.position")
    builder.ExportInput(yielding.get_input_port(), "legs.current")
    connect(builder, yielding.get_output_port(), lengths.get_input_port(1))
    return lengths.get_output_port()
