"""Small helpers for building diagrams."""

from pydrake.systems.framework import DiagramBuilder, System


def add[S: System](builder: DiagramBuilder, system: S, name: str = "") -> S:
    """Adds a system to a diagram, under a name if one is given, and returns it with its type."""
    if name:
        system.set_name(name)
    builder.AddSystem(system)
    return system
