"""Small helpers for building diagrams."""

from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort, System
from pydrake.systems.primitives import Demultiplexer, MatrixGain

from parapod.systems.core.errors import WiringError


def add[S: System](builder: DiagramBuilder, system: S, name: str = "") -> S:
    """Adds a system to a diagram, under a name if one is given, and returns it with its type."""
    if name:
        system.set_name(name)
    builder.AddSystem(system)
    return system


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


def split_states(
    builder: DiagramBuilder, name: str, states: OutputPort, groups: int
) -> list[OutputPort]:
    """Takes (all positions, all velocities) apart, as model instances of a plant want them.

    Args:
        builder: of the diagram.
        name: of what is taken apart.
        states: positions of all groups, then velocities of all groups.
        groups: into how many parts of equal size.

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
