"""A machine seen through its ports, whatever stands behind them."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import (
    Context,
    Diagram,
    DiagramBuilder,
    EventStatus,
    System,
)
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.machine import Machine
from parapod.diagrams.ports import Behind, Port
from parapod.diagrams.simulators import simulator_of
from parapod.diagrams.wiring import add, inputs_of, outputs_of
from parapod.systems.core.errors import WiringError


class Station[S](Diagram):
    """A machine seen through its ports.

    Every backend of a machine has the ports of its table, by name, size and unit; a simulated one
    has `truth.*` besides, and the beginning of the scenario as its default context.

    Attributes:
        machine: the machine.
        scenario: the scenario that it was built from.
        behind: systems behind the ports.
    """

    def __init__(self, machine: Machine[S], scenario: S, meshcat: Meshcat | None = None):
        """Builds the station of a scenario's backend.

        Args:
            machine: the machine.
            scenario: its `backend` decides what stands behind the ports.
            meshcat: draws a simulated machine there; None for no drawing.

        Raises:
            ScenarioError: unknown backend, or drivers that do not make a machine.
            WiringError: a backend without the machine's ports.
        """
        super().__init__()
        self.machine, self.scenario = machine.for_scenario(scenario), scenario
        builder = DiagramBuilder()
        self.behind = self.machine.behind(builder, scenario, meshcat)
        _export(builder, self.machine, self.behind)
        builder.BuildInto(self)
        self.set_name("station")

    def __repr__(self) -> str:
        return f"<station of {self.machine.title}, {getattr(self.scenario, 'backend', '')}>"

    def reset(self, root_context: Context, scenario: S | None = None) -> None:
        """Puts the station at its beginning.

        Nothing is rebuilt: the same station serves any seed, ground and imperfection.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: the scenario that a simulation begins with; None for the one that the
                station was built from. What is built in, such as dimensions and sample periods,
                stays.
        """
        self.behind.reset(root_context, self.scenario if scenario is None else scenario)

    def simulator(self, context: Context | None = None) -> Simulator:
        """A simulator of the station alone, with its integrator and its monitor.

        Args:
            context: context to simulate in, which the simulator takes; None for a default one.
        """
        return simulator_of(self, context, self.monitor)

    @property
    def monitor(self) -> Callable[[Context], EventStatus] | None:
        """Monitor that its simulator needs, see `Behind.between_steps`; None: none."""
        between = self.behind.between_steps
        if between is None:
            return None

        def look(root_context: Context) -> EventStatus:
            between(root_context)
            return EventStatus.DidNothing()

        return look

    @contextmanager
    def active(self) -> Iterator[None]:
        """Lets the machine obey; a real one is configured, activated, and neutral at the end."""
        with self.behind.active():
            yield


def _export(builder: DiagramBuilder, machine: Machine[Any], behind: Behind) -> None:
    """Exports the ports by the machine's table.

    Raises:
        WiringError: names the port that is missing, unknown or of another size.
    """
    is_simulated = any(name in behind.outputs for name in (port.name for port in machine.truth))
    outputs = (*machine.outputs, *(machine.truth if is_simulated else ()))
    ports_found = dict(behind.outputs)
    for port in machine.outputs:
        if port.default is not None and port.name not in ports_found:
            default = np.full(port.size, port.default)
            source = add(builder, ConstantVectorSource(default), port.name)
            ports_found[port.name] = source.get_output_port()
    _compare(machine, machine.inputs, behind.inputs, "input")
    _compare(machine, outputs, ports_found, "output")
    for port in machine.inputs:
        builder.ExportInput(behind.inputs[port.name], port.name)
    for port in outputs:
        builder.ExportOutput(ports_found[port.name], port.name)


def _compare(
    machine: Machine[Any],
    declared: tuple[Port, ...],
    outputs: Mapping[str, Any],
    kind: str,
) -> None:
    names = [port.name for port in declared]
    has = machine.inputs if kind == "input" else (*machine.outputs, *machine.truth)
    for name in outputs:
        if name not in names:
            declared_names = ", ".join(port.name for port in has)
            raise WiringError(f"{machine.title} has no {kind} '{name}'; it has: {declared_names}")
    for port in declared:
        if port.name not in outputs:
            raise WiringError(f"nothing stands behind the {kind} '{port.name}' of {machine.title}")
        size = outputs[port.name].size()
        if size != port.size:
            raise WiringError(
                f"{kind} '{port.name}' of {machine.title} has {port.size} elements, "
                f"what stands behind it {size}"
            )


def check_ports(
    machine: Machine[Any], plant: System, controller: System, sources: Iterable[System]
) -> None:
    """Refuses a system that cannot take the place of a machine's station.

    It needs the inputs that the controller drives, and the outputs that controller and sources of
    commands read; each other port may be left out.

    Args:
        machine: the machine.
        plant: the system.
        controller: the controller.
        sources: sources of commands.

    Raises:
        WiringError: names the port that is missing, unknown or of another size.
    """
    driven = set(outputs_of(controller))
    read = {name for system in (controller, *sources) for name in inputs_of(system)}
    for kind, declared, outputs, names_used in (
        ("input", machine.inputs, inputs_of(plant), driven),
        ("output", (*machine.outputs, *machine.truth), outputs_of(plant), read),
    ):
        ports_needed = tuple(
            port for port in declared if port.name in outputs or port.name in names_used
        )
        _compare(machine, ports_needed, outputs, kind)
