"""Small helpers for building diagrams."""

from typing import Any

from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort, System

from parapod.systems.errors import WiringError


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


def _owner(port: InputPort | OutputPort) -> str:
    system: Any = port.get_system()
    return system.get_name()
