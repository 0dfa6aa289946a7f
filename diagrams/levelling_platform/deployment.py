"""Station, supervised controller and an operator in one diagram, with its signals logged."""

from collections.abc import Collection, Sequence

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Adder, Demultiplexer, MatrixGain

from parapod.diagrams.closed_loop import log_ports, output_ports
from parapod.diagrams.idle import idle_inputs
from parapod.diagrams.levelling_platform.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.fault_points import FaultPoints
from parapod.diagrams.levelling_platform.ports import IDLE
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.station import make_station
from parapod.diagrams.levelling_platform.supervised_controller import make_supervised_controller
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.scripts import OperatorScript, Step

# Elements of `status.age` that the signals belong to.
_DEVICES = {"legs.extension": 0, "imu.gyro": 1, "imu.accel": 1}


def make_deployment(
    scenario: LevellingScenario,
    steps: Sequence[Step],
    posture: tuple[float, float, float],
    meshcat: Meshcat | None = None,
    log: Collection[str] | None = None,
    injectable: Collection[str] = (),
) -> ClosedLoop:
    """Builds the machine with its supervisor and an operator.

    Args:
        scenario: the machine's.
        steps: what the operator does.
        posture: that the operator asks for at first [rad, rad, m].
        meshcat: where to draw it; None for no drawing.
        log: names of the ports to record at the controller's period; None for all of them.
        injectable: ports into which faults may be injected later.
    """
    builder = DiagramBuilder()
    station = make_station(scenario, meshcat)
    machine = add(builder, station.diagram)
    controller = add(builder, make_supervised_controller(scenario))
    operator = add(builder, OperatorScript(steps, posture, scenario.control.period))
    faults = FaultPoints(
        builder, scenario.control.period, scenario.faults, scenario.seed, injectable
    )
    for name in ("legs.extension", "legs.limits", "imu.gyro", "imu.accel", "wheels.velocity"):
        seen = faults.seen(machine.GetOutputPort(name), name)
        connect(builder, seen, controller.GetInputPort(name))
    for name in ("legs.voltage", "legs.stop", "wheels.velocity_command", "wheels.brake"):
        seen = faults.seen(controller.GetOutputPort(name), name)
        connect(builder, seen, machine.GetInputPort(name))
    age = _add_ages(builder, machine.GetOutputPort("status.age"), faults)
    connect(builder, age, controller.GetInputPort("status.age"))
    arm = add(builder, Demultiplexer(2), "arm_command_parts")
    connect(builder, controller.GetOutputPort("arm_command"), arm.get_input_port(0))
    for i, name in enumerate(("turntable.position_command", "arm.position_command")):
        connect(builder, arm.get_output_port(i), machine.GetInputPort(name))
    for name in ("operator", "drive_request", "arm_request"):
        connect(builder, operator.GetOutputPort(name), controller.GetInputPort(name))
    asked = faults.seen(operator.GetOutputPort("posture_request"), "posture_command")
    connect(builder, asked, controller.GetInputPort("posture_request"))
    connect(builder, controller.GetOutputPort("phase"), operator.GetInputPort("phase"))
    idle_inputs(builder, machine, IDLE)
    ports = output_ports(machine, controller, operator) | faults.ports()
    logs = log_ports(builder, ports, scenario.control.period, log)
    diagram = builder.Build()
    diagram.set_name("levelling_platform")
    return ClosedLoop(diagram, station, controller, ports, logs, faults)


def _add_ages(builder: DiagramBuilder, age: OutputPort, faults: FaultPoints) -> OutputPort:
    """The devices' ages with what faults add to them."""
    late = {name: i for name, i in _DEVICES.items() if name in faults.injectors}
    if not late:
        return age
    total = add(builder, Adder(1 + len(late), 4), "ages")
    connect(builder, age, total.get_input_port(0))
    for k, (name, device) in enumerate(late.items(), start=1):
        part = add(builder, MatrixGain(np.eye(4)[:, [device]]), f"age_of_{name}")
        connect(builder, faults.injectors[name].GetOutputPort("extra_age"), part.get_input_port())
        connect(builder, part.get_output_port(), total.get_input_port(k))
    port: OutputPort = total.get_output_port()
    return port
