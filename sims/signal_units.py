"""Units of the machines' signals, for logs."""

from collections.abc import Mapping

from numpy.typing import ArrayLike

from parapod.diagrams.machine import Machine
from parapod.diagrams.machines import MACHINES


def unit_of(name: str, machine: Machine | None = None) -> str:
    """Unit of a signal, by the name of its port.

    Args:
        name: of the port.
        machine: that has it; None for whichever has.

    Raises:
        KeyError: no machine has it, or several have it in different units.
    """
    if name.startswith("fault."):
        return "s" if name.endswith(".extra_age") else "0/1"
    if machine is not None:
        return machine.units[name]
    units = {m.units[name] for m in MACHINES if name in m.units}
    if len(units) != 1:
        raise KeyError(f"{name}: {', '.join(sorted(units)) or 'no machine has it'}")
    return units.pop()


def with_units[T: ArrayLike](
    signals: Mapping[str, T], machine: Machine | None = None
) -> dict[str, tuple[T, str]]:
    """The signals, each with its unit; see `unit_of`."""
    return {name: (samples, unit_of(name, machine)) for name, samples in signals.items()}
