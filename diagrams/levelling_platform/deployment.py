"""Station, supervised controller and an operator in one diagram, with its signals logged."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, Demultiplexer, LogVectorOutput

from parapod.diagrams.levelling_platform.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.idle import idle_inputs
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.station import make_station
from parapod.diagrams.levelling_platform.supervised_controller import make_supervised_controller
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.operator_script import OperatorScript, Step


def make_deployment(
    scenario: LevellingScenario,
    steps: Sequence[Step],
    posture: tuple[float, float, float],
    meshcat: Meshcat | None = None,
    log: Collection[str] | None = None,
) -> ClosedLoop:
    """Builds the machine with its supervisor and an operator.

    Args:
        scenario: the machine's.
        steps: what the operator does.
        posture: that the operator asks for at first [rad, rad, m].
        meshcat: where to draw it; None for no drawing.
        log: names of the ports to record at the controller's period; None for all of them.
    """
    builder = DiagramBuilder()
    station = make_station(scenario, meshcat)
    machine = add(builder, station.diagram)
    controller = add(builder, make_supervised_controller(scenario))
    operator = add(builder, OperatorScript(steps, posture, scenario.control.period))
    for name in ("legs.extension", "legs.limits", "imu.gyro", "imu.accel", "wheels.velocity"):
        connect(builder, machine.GetOutputPort(name), controller.GetInputPort(name))
    for name in ("legs.voltage", "wheels.velocity_command", "wheels.brake"):
        connect(builder, controller.GetOutputPort(name), machine.GetInputPort(name))
    arm = add(builder, Demultiplexer(2), "arm_command_parts")
    connect(builder, controller.GetOutputPort("arm_command"), arm.get_input_port(0))
    for i, name in enumerate(("turntable.position_command", "arm.position_command")):
        connect(builder, arm.get_output_port(i), machine.GetInputPort(name))
    for name in ("operator", "drive_request", "posture_request", "arm_request"):
        connect(builder, operator.GetOutputPort(name), controller.GetInputPort(name))
    connect(builder, controller.GetOutputPort("phase"), operator.GetInputPort("phase"))
    healthy = add(builder, ConstantVectorSource(np.zeros(1)), "healthy")
    connect(builder, healthy.get_output_port(), controller.GetInputPort("severity"))
    idle_inputs(builder, machine)
    systems: tuple[Any, ...] = (machine, controller, operator)
    ports = {
        system.get_output_port(i).get_name(): system.get_output_port(i)
        for system in systems
        for i in range(system.num_output_ports())
    }
    logs = {
        name: LogVectorOutput(port, builder, scenario.control.period)
        for name, port in ports.items()
        if log is None or name in log
    }
    diagram = builder.Build()
    diagram.set_name("levelling_platform")
    return ClosedLoop(diagram, station, controller, logs)
