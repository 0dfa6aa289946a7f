"""A controller behind a bus in the place of a machine's own, by its table of ports."""

from collections.abc import Sequence
from typing import Any

from pydrake.systems.framework import System

from parapod.diagrams.wiring import outputs_of
from parapod.systems.hardware.buses.address import Address
from parapod.systems.hardware.buses.controller import BusController
from parapod.systems.hardware.buses.message import Signal

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
    table = machine.table
    signals = {n: Signal(p.size, p.unit, p.neutral, p.twist) for n, p in table.items()}

    def outputs(systems: Sequence[System]) -> dict[str, Signal]:
        ports = {name: port for each in systems for name, port in outputs_of(each).items()}
        return {
            name: signals.get(name, Signal(0))._replace(size=port.size())
            for name, port in ports.items()
        }

    job, own = outputs(sources), outputs(() if usual is None else [usual])
    return BusController(
        address,
        {port.name: signals[port.name] for port in machine.outputs},
        {port.name: signals[port.name] for port in machine.inputs if port.name not in job},
        job,
        {n: each for n, each in own.items() if n not in table or table[n].direction != "in"},
        period,
        patience=patience,
    )
