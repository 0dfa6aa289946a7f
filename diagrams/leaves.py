"""Diagrams taken apart: their leaf systems, and which output each of their inputs reads."""

from collections.abc import Hashable
from typing import Any

from pydrake.systems.framework import Diagram, System

from parapod.diagrams.wiring import leaf_systems
from parapod.systems.core.leaf_system import laws_of

# Leaf systems are known by their positions among all of a diagram.
type Sources = dict[tuple[int, int], tuple[int, int]]


def flattened(diagram: Diagram) -> tuple[list[System], Sources]:
    """Leaf systems of a diagram of any depth, and its wiring without the levels between.

    Args:
        diagram: the diagram.

    Returns:
        The leaf systems; and by position and input of a leaf system, position and output of the
        leaf system that it reads. Inputs that nothing drives are left out.
    """
    leaves = list(leaf_systems(diagram))
    position = {id(leaf): i for i, leaf in enumerate(leaves)}
    sources: Sources = {}
    _collect(diagram, position, sources)
    return leaves, sources


def _collect(diagram: Diagram, position: dict[int, int], sources: Sources) -> None:
    for (reader, input_port), (giver, output_port) in diagram.connection_map().items():
        giver, output_port = output_of_leaf(giver, output_port)
        source = position[id(giver)], int(output_port)
        for leaf, port in inputs_of_leaves(reader, input_port):
            sources[position[id(leaf)], int(port)] = source
    for part in diagram.GetSystems():
        if isinstance(part, Diagram):
            _collect(part, position, sources)


def output_of_leaf(system: Any, port: Any) -> tuple[System, Any]:
    """The leaf system's output that a system shows."""
    while isinstance(system, Diagram):
        system, port = system.get_output_port_locator(port)
    return system, port


def inputs_of_leaves(system: Any, port: Any) -> list[tuple[System, Any]]:
    """Inputs of leaf systems that a system hands an input to."""
    if not isinstance(system, Diagram):
        return [(system, port)]
    locators = system.GetInputPortLocators(port)
    return [leaf for part, index in locators for leaf in inputs_of_leaves(part, index)]


def wiring_of(diagram: Diagram) -> Hashable:
    """All that a diagram must share with another for their runs to be rows of one simulation."""
    systems, sources = flattened(diagram)
    return tuple(map(_form, systems)), frozenset(sources.items())


def _form(system: Any) -> Hashable:
    """Kind, ports, state and timing of a leaf system."""
    inputs = (system.get_input_port(i) for i in range(system.num_input_ports()))
    outputs = (system.get_output_port(i) for i in range(system.num_output_ports()))
    context = system.AllocateContext()
    states = range(context.num_discrete_state_groups())
    laws = laws_of(system)
    if laws is not None:
        timings = [(update.period, update.offset) for update in laws.sampled]
    else:
        timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
        timings = [] if timing is None else [(timing.period_sec(), timing.offset_sec())]
    return (
        type(system),
        tuple((port.get_name(), port.size()) for port in (*inputs, *outputs)),
        tuple(context.get_discrete_state(k).size() for k in states),
        tuple(timings),
    )
