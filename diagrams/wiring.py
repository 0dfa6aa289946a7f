"""Wiring of diagrams: by hand with plain errors, and by the names of ports."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from pydrake.systems.framework import (
    Diagram,
    DiagramBuilder,
    InputPort,
    OutputPort,
    System,
)
from pydrake.systems.primitives import (
    Adder,
    ConstantVectorSource,
    Demultiplexer,
    MatrixGain,
    Multiplexer,
    TrajectorySource,
)
from pydrake.trajectories import Trajectory

from parapod.systems.core.errors import WiringError

# A system and, by the names of its ports, signals of them that have other names.
type Wired = tuple[System, Mapping[str, str]]

_AS_THEY_ARE: Mapping[str, str] = MappingProxyType({})


def named[S: System](name: str, system: S) -> S:
    """Gives a system a name, and returns it."""
    system.set_name(name)
    return system


def add[S: System](builder: DiagramBuilder, system: S, name: str = "") -> S:
    """Adds a system to a diagram, under a name if one is given, and returns it with its type."""
    builder.AddSystem(named(name, system) if name else system)
    return system


def leaf_systems(diagram: Diagram) -> Iterator[System]:
    """The systems in a diagram, of any depth, that are not diagrams themselves."""
    for system in diagram.GetSystems():
        if isinstance(system, Diagram):
            yield from leaf_systems(system)
        else:
            yield system


def connect(builder: DiagramBuilder, source: OutputPort, sink: InputPort) -> None:
    """Connects two ports, as `DiagramBuilder.Connect` does.

    Raises:
        WiringError: the sink has a source already, which Drake answers by ending the process.
    """
    if builder.IsConnectedOrExported(sink):
        raise WiringError(
            f"input port '{sink.get_name()}' of '{_owner(sink)}' is wired already; "
            f"'{source.get_name()}' of '{_owner(source)}' cannot be a second source"
        )
    builder.Connect(source, sink)


def inputs_of(system: System) -> dict[str, InputPort]:
    """Input ports of a system by their names."""
    ports = map(system.get_input_port, range(system.num_input_ports()))
    return {port.get_name(): port for port in ports}


def outputs_of(system: System) -> dict[str, OutputPort]:
    """Output ports of a system by their names."""
    ports = map(system.get_output_port, range(system.num_output_ports()))
    return {port.get_name(): port for port in ports}


def connect_by_name(
    builder: DiagramBuilder,
    systems: Sequence[System],
    through: Callable[[str, OutputPort], OutputPort] = lambda name, port: port,
    skip: Collection[str] = (),
) -> dict[str, OutputPort]:
    """Connects every input of the systems to the output of the same name, where there is one.

    Args:
        builder: builder of the diagram that holds the systems.
        systems: the systems; the outputs of all of them have names of their own.
        through: gives the port that readers of a signal see, once a signal.
        skip: names that are left unconnected.

    Returns:
        All outputs by name.

    Raises:
        WiringError: two outputs of one name, or an output and an input of different sizes.
    """
    outputs: dict[str, OutputPort] = {}
    for system in systems:
        for name, port in outputs_of(system).items():
            _put(outputs, name, port)
    seen_ports: dict[str, OutputPort] = {}
    for system in systems:
        for name, sink in inputs_of(system).items():
            if name not in outputs or name in skip or builder.IsConnectedOrExported(sink):
                continue
            if name not in seen_ports:
                seen_ports[name] = through(name, outputs[name])
            _connect_signal(builder, name, seen_ports[name], sink)
    return outputs


def wired(
    name: str,
    systems: Sequence[System | Wired],
    outputs: Collection[str],
    names: Mapping[str, str] = _AS_THEY_ARE,
    skip: Collection[str] = (),
) -> Diagram:
    """Makes a diagram of systems whose ports are wired by the names of their signals.

    Inputs take the output of their signal; those that have none become one input of the diagram.

    Args:
        name: name of the diagram.
        systems: the systems; beside one, signals of its ports by the ports' names, where they
            differ from what `names` has.
        outputs: signals that the diagram shows.
        names: signals of ports by the ports' names, where the two differ.
        skip: signals that nothing has to give; inputs of theirs are left unconnected.

    Raises:
        WiringError: two outputs or none of a signal, or an output and an input of different sizes.
    """
    builder = DiagramBuilder()
    sinks: list[tuple[str, InputPort]] = []
    sources: dict[str, OutputPort] = {}
    for entry in systems:
        system, own = entry if isinstance(entry, tuple) else (entry, _AS_THEY_ARE)
        add(builder, system)
        signals = {**names, **own}
        for port, source in outputs_of(system).items():
            _put(sources, signals.get(port, port), source)
        sinks += [(signals.get(port, port), sink) for port, sink in inputs_of(system).items()]
    exported: set[str] = set()
    for signal, sink in sinks:
        if signal in sources:
            _connect_signal(builder, signal, sources[signal], sink)
        elif signal in exported:
            builder.ConnectInput(signal, sink)
        elif signal not in skip:
            builder.ExportInput(sink, signal)
            exported.add(signal)
    for signal in outputs:
        if signal not in sources:
            all_names = ", ".join(sorted(sources))
            raise WiringError(f"no system has the output '{signal}'; there are: {all_names}")
        builder.ExportOutput(sources[signal], signal)
    return named(name, builder.Build())


def _put(outputs: dict[str, OutputPort], name: str, port: OutputPort) -> None:
    """Keeps the one output of a name."""
    if name in outputs:
        both = f"'{_owner(outputs[name])}' and '{_owner(port)}'"
        raise WiringError(f"two systems have an output port '{name}': {both}")
    outputs[name] = port


def _connect_signal(
    builder: DiagramBuilder, name: str, source: OutputPort, sink: InputPort
) -> None:
    """Connects an output and an input of one name, which have one size."""
    if source.size() != sink.size():
        raise WiringError(
            f"'{name}' has {source.size()} elements as an output of '{_owner(source)}', "
            f"but {sink.size()} as an input of '{_owner(sink)}'"
        )
    connect(builder, source, sink)


def idle_inputs(builder: DiagramBuilder, system: System, values: Mapping[str, float]) -> None:
    """Puts a constant on every input of a system that nothing drives yet.

    Args:
        builder: builder of the diagram that holds the system.
        system: the system.
        values: value of each input, by its name; 0 for those that are left out.
    """
    for name, port in inputs_of(system).items():
        if not builder.IsConnectedOrExported(port):
            value = np.full(port.size(), values.get(name, 0.0))
            source = add(builder, ConstantVectorSource(value), f"idle.{name}")
            connect(builder, source.get_output_port(), port)


def named_source(name: str, trajectory: Trajectory, derivatives: int = 0) -> Diagram:
    """A source that follows a trajectory, with an output of this name.

    Args:
        name: name of the output.
        trajectory: its values, a column.
        derivatives: number of derivatives that follow the values in the output.
    """
    builder = DiagramBuilder()
    source = add(builder, TrajectorySource(trajectory, derivatives), "trajectory")
    builder.ExportOutput(source.get_output_port(), name)
    return named(name, builder.Build())


def sum_of(builder: DiagramBuilder, ports: Sequence[OutputPort], name: str) -> OutputPort:
    """Sum of output ports of one size; of one port, that port.

    Args:
        builder: builder of the diagram.
        ports: the ports, one or more.
        name: name of what adds them.
    """
    if len(ports) == 1:
        return ports[0]
    total = add(builder, Adder(len(ports), ports[0].size()), name)
    for i, port in enumerate(ports):
        connect(builder, port, total.get_input_port(i))
    return total.get_output_port()


def joined(builder: DiagramBuilder, ports: Sequence[OutputPort], name: str) -> OutputPort:
    """All elements of ports at one, one port or more."""
    joint = add(builder, Multiplexer([port.size() for port in ports]), name)
    for i, port in enumerate(ports):
        connect(builder, port, joint.get_input_port(i))
    return joint.get_output_port()


def first_of(builder: DiagramBuilder, port: OutputPort, count: int, name: str) -> OutputPort:
    """The first elements at a port; the port itself if it has no others."""
    if port.size() == count:
        return port
    parts = add(builder, Demultiplexer([count, port.size() - count]), name)
    connect(builder, port, parts.get_input_port())
    return parts.get_output_port(0)


def split_states(
    builder: DiagramBuilder, name: str, states: OutputPort, groups: int
) -> list[OutputPort]:
    """Takes (all positions, all velocities) apart, as model instances of a plant want them.

    Args:
        builder: builder of the diagram.
        name: name of the states.
        states: positions of all groups, then velocities of all groups.
        groups: number of parts, all of the same size.

    Returns:
        A port for each group with its positions and then its velocities.
    """
    count = states.size() // 2
    size = count // groups
    by_group = np.arange(2 * count).reshape(2, groups, size).swapaxes(0, 1).ravel()
    order = add(builder, MatrixGain(np.eye(2 * count)[by_group]), f"{name}_by_group")
    parts = add(builder, Demultiplexer(2 * count, 2 * size), name)
    connect(builder, states, order.get_input_port())
    connect(builder, order.get_output_port(), parts.get_input_port(0))
    return [parts.get_output_port(i) for i in range(groups)]


def _owner(port: InputPort | OutputPort) -> str:
    system: Any = port.get_system()
    return system.get_name()
