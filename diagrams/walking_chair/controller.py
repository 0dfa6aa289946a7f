"""The walking chair's controller: from a gait and measurements to velocities of the drives."""

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.compound_position_controller import CompoundPositionController
from parapod.systems.walking_chair.feedforward import ChairFeedforward, EasedStart
from parapod.systems.walking_chair.geometry import BRANCHES
from parapod.systems.walking_chair.payload import PayloadEstimator, PayloadEstimatorParams
from parapod.systems.walking_chair.planner import GaitPlanner
from parapod.systems.walking_chair.support import SupportMonitor, SupportMonitorParams


def make_controller(scenario: ChairScenario, is_operated: bool = False) -> Diagram:
    """Wires gait planner, feedforward, position controllers, payload estimator and monitor.

    Inputs: `legs.position` (12), `legs.current` (12); where a person operates it, `halt` (1).
    Outputs: `legs.velocity_command` (12), `legs.brake` (1), `position_node` (12), `gait_time` (1),
    `support` (4), `done` (1), `payload_estimated` (3), `support_margin` (1), `hold` (1).

    Args:
        scenario: its `machine`, `gait`, `control` and `begin` are used.
        is_operated: true if a person operates it.
    """
    builder = DiagramBuilder()
    control, walk, machine = scenario.control, scenario.walk, scenario.machine
    geometry, masses, drives = machine.geometry, machine.masses, machine.drives
    planner = add(builder, GaitPlanner(walk, geometry, control.period, scenario.begin))
    feedforward = add(builder, ChairFeedforward(geometry))
    start = add(builder, EasedStart(period=control.period))
    drive = CompoundPositionController(control.params(drives), len(BRANCHES), control.period)
    position = add(builder, drive)
    estimator = PayloadEstimatorParams(drives.force_per_current)
    payload = add(builder, PayloadEstimator(estimator, geometry, masses))
    required = SupportMonitorParams(required=1e-3 * control.support_margin_mm)
    monitor = add(builder, SupportMonitor(walk, required, geometry, masses))
    for source, sink in (
        (planner.GetOutputPort("body_motion"), feedforward.GetInputPort("body_motion")),
        (planner.GetOutputPort("foot_motion"), feedforward.GetInputPort("foot_motion")),
        (planner.GetOutputPort("references"), feedforward.GetInputPort("references")),
        (feedforward.GetOutputPort("length"), start.GetInputPort("length")),
        (start.GetOutputPort("position_node"), position.GetInputPort("position_node")),
        (payload.GetOutputPort("payload"), monitor.GetInputPort("payload")),
        (planner.GetOutputPort("gait_time"), monitor.GetInputPort("gait_time")),
        (monitor.GetOutputPort("hold"), planner.GetInputPort("hold")),
    ):
        connect(builder, source, sink)
    measured = builder.ExportInput(position.GetInputPort("position_measured"), "legs.position")
    builder.ConnectInput(measured, payload.GetInputPort("position"))
    builder.ConnectInput(measured, start.GetInputPort("position_measured"))
    builder.ExportInput(payload.GetInputPort("current"), "legs.current")
    if is_operated:
        builder.ExportInput(planner.GetInputPort("halt"), "halt")
    for port, name in (
        (position.GetOutputPort("velocity_command"), "legs.velocity_command"),
        (start.GetOutputPort("position_node"), "position_node"),
        (planner.GetOutputPort("gait_time"), "gait_time"),
        (planner.GetOutputPort("support"), "support"),
        (planner.GetOutputPort("done"), "done"),
        (payload.GetOutputPort("payload"), "payload_estimated"),
        (monitor.GetOutputPort("margin"), "support_margin"),
        (monitor.GetOutputPort("hold"), "hold"),
    ):
        builder.ExportOutput(port, name)
    released = add(builder, ConstantVectorSource(np.zeros(1)), "brake_released")
    builder.ExportOutput(released.get_output_port(), "legs.brake")
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram
