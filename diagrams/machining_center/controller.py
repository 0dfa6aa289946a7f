"""The machining centres' controller: from a job and measurements to lengths, locks and clamps."""

from pydrake.systems.framework import Diagram, DiagramBuilder

from parapod.diagrams.machining_center.scenario import CenterScenario
from parapod.diagrams.wiring import add, connect, inputs_of, outputs_of
from parapod.systems.machining_center.feedforward import CenterFeedforward
from parapod.systems.machining_center.posture import CenterPosture
from parapod.systems.machining_center.sequence import SequenceParams
from parapod.systems.machining_center.sequencer import CenterSequencer
from parapod.systems.machining_center.wrench_monitor import WrenchMonitor

# Names of the machine's signals, and of the ports in the controller that take them.
_MEASURED = {
    "legs.position": ("position", "position_measured"),
    "legs.emergency_stop": ("emergency_stop",),
    "locks.closed": ("locks_closed",),
    "clamps.closed": ("clamps_closed",),
    "tool.force": ("tool_force",),
    "stop": ("stop",),
}
_SHOWN = {
    "legs.position_command": "position_command",
    "legs.brake": "brake",
    "locks.command": "locks_command",
    "clamps.command": "clamps_command",
    "pose_desired": "pose_desired",
    "foot_desired": "foot_desired",
    "pose_estimated": "pose",
    "feet_estimated": "feet",
    "phase": "phase",
    "operation": "operation",
    "fault": "fault",
    "loose_limb": "loose_limb",
    "done": "done",
    "wrench_index": "wrench_index",
    "wrench_margin": "wrench_margin",
}


def make_controller(scenario: CenterScenario) -> Diagram:
    """Wires posture, sequencer, feedforward and wrench monitor, by the names of their ports.

    Inputs and outputs are the machine's signals `_MEASURED` and `_SHOWN`; `stop` is an input
    where somebody is to stop the job.

    Args:
        scenario: its job, `control`, `begin` and `stop_at` are used.
    """
    geometry, plan, control = scenario.geometry, scenario.plan, scenario.control
    builder = DiagramBuilder()
    pose, feet = plan.beginning
    params = SequenceParams(begin=scenario.begin, settling=control.settling)
    posture = CenterPosture(geometry, control.period, pose, feet)
    systems = [
        add(builder, system)
        for system in (
            posture,
            CenterSequencer(geometry, plan.job, control.period, params),
            CenterFeedforward(geometry, plan.job, control.period),
            WrenchMonitor(geometry, plan.job.process.largest_leg_force),
        )
    ]
    outputs = {name: port for system in systems for name, port in outputs_of(system).items()}
    outputs["pose_measured"] = outputs["pose"]
    measured = {port: signal for signal, ports in _MEASURED.items() for port in ports}
    exported: dict[str, object] = {}
    for system in systems:
        for name, sink in inputs_of(system).items():
            signal = measured.get(name)
            if signal is None:
                connect(builder, outputs[name], sink)
            elif signal in exported:
                builder.ConnectInput(signal, sink)
            elif signal != "stop" or scenario.stop_at is not None:
                exported[signal] = builder.ExportInput(sink, signal)
    for signal, name in _SHOWN.items():
        builder.ExportOutput(outputs[name], signal)
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram
