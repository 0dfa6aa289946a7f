"""A controller behind a bus in the place of a machine's own, by its table of ports."""

from collections.abc import Sequence
from typing import Any

from pydrake.systems.framework import System

from parapod.diagrams.wiring import outputs_of
from parapod.systems.hardware.buses.address import Address
from parapod.systems.hardware.buses.controller import BusController

# Longest wait for commands at an instant of a simulation, before its parts are neutral [s]: a
# simulation waits for a controller on a busy computer.
PATIENCE = 2.0


def bus_controller(
    machine: Any,
    period: float,
    address: Address,
    usual: System | None = None,
    sources: Sequence[System] = (),
    patience: float = PATIENCE,
) -> BusController:
    """The controller at an address.

    Args:
        machine: a `Machine`, as its scenario has it.
        period: period of its controllers [s].
        address: address of the bus.
        usual: the machine's own controller, whose signals may be published; None: it has none.
        sources: sources of commands beside it.
        patience: see `BusController` [s].
    """
    job = {name: port.size() for each in sources for name, port in outputs_of(each).items()}
    commands = {port.name: port for port in machine.inputs if port.name not in job}
    own = {} if usual is None else outputs_of(usual)
    return BusController(
        address,
        {port.name: port.size for port in machine.outputs},
        {name: port.size for name, port in commands.items()},
        {name: port.neutral for name, port in commands.items()},
        job,
        {
            name: port.size()
            for name, port in own.items()
            if name not in machine.table or machine.table[name].direction != "in"
        },
        period,
        units={name: port.unit for name, port in machine.table.items()},
        twists={name: port.twist for name, port in machine.table.items() if port.twist},
        patience=patience,
    )
