"""Chair and controller in one diagram, with signals logged."""

from collections.abc import Collection

from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.closed_loop import ClosedLoop, log_ports, output_ports
from parapod.diagrams.idle import idle_inputs
from parapod.diagrams.walking_chair.controller import make_controller
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.walking_chair.station import make_station
from parapod.diagrams.wiring import add, connect


def make_closed_loop(
    scenario: ChairScenario,
    meshcat: Meshcat | None = None,
    log: Collection[str] | None = None,
) -> ClosedLoop[ChairScenario]:
    """Builds the closed loop of a scenario.

    Args:
        scenario: what to build.
        meshcat: where to draw it; None for no drawing.
        log: names of the ports to record, every other sample of the controller; None for all.
    """
    builder = DiagramBuilder()
    station = make_station(scenario, meshcat)
    machine = add(builder, station.diagram)
    controller = add(builder, make_controller(scenario))
    for name in ("legs.position", "legs.current"):
        connect(builder, machine.GetOutputPort(name), controller.GetInputPort(name))
    command = "legs.velocity_command"
    connect(builder, controller.GetOutputPort(command), machine.GetInputPort(command))
    idle_inputs(builder, machine, {})
    ports = output_ports(machine, controller)
    logs = log_ports(builder, ports, 2.0 * scenario.control.period, log)
    diagram = builder.Build()
    diagram.set_name("walking_chair")
    return ClosedLoop(diagram, station, controller, ports, logs)
