"""Commands of switches, such as brakes, stops, locks and clamps, of devices and in simulations."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

# A command is near a side of a switch that is no farther from it [-].
_NEAR = 0.5


def switched(command: float) -> bool | None:
    """Side of a command of a switch: False near 0, True near 1, None where it is near neither.

    None is what no controller means, such as NaN, an infinity, -1 or 1e300: the device then takes
    the safe side, and nothing that is latched is acknowledged.
    """
    if abs(command) <= _NEAR:
        return False
    return True if abs(command - 1.0) <= _NEAR else None


def are_safe(commands: ArrayLike) -> NDArray[np.bool_]:
    """Which commands have a switch on its safe side, 1: all but those near 0, see `switched`."""
    return ~(np.abs(np.asarray(commands, dtype=float)) <= _NEAR)
