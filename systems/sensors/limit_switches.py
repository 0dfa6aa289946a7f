"""Limit switches of the legs: ends of the stroke and contact with the ground."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.elementwise import where
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import has_value, read


@dataclass(frozen=True)
class LimitSwitchesParams:
    """Points at which the switches close.

    Attributes:
        extended: extension at and beyond which a leg is fully extended [m].
        retracted: extension at and below which a leg is fully retracted [m].
        contact_force: force at and above which a foot stands on the ground [N].
    """

    extended: float = 1.0
    retracted: float = 0.0
    contact_force: float = 5.0


class LimitSwitches(LeafSystem):
    """Three switches a leg: extended, retracted, ground contact.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | n | m | extensions of the legs |
    | in `contact_force` | n | N | forces of the ground on the feet; unconnected: none |
    | out `limits` | 3n | 0/1 | extended (n), retracted (n), ground contact (n) |

    No state: the output follows the inputs, without hysteresis.

    Bad input: a NaN closes no switch; infinite values count as very large ones.
    """

    def __init__(self, legs: int = 4, params: LimitSwitchesParams = LimitSwitchesParams()) -> None:
        super().__init__()
        self.set_name("limit_switches")
        self.legs, self.params = legs, params
        self._extension: Any = self.DeclareVectorInputPort("extension", legs)
        self._contact_force: Any = self.DeclareVectorInputPort("contact_force", legs)
        self.DeclareVectorOutputPort(
            "limits",
            3 * legs,
            self._calc_limits,
            prerequisites_of_calc={self._extension.ticket(), self._contact_force.ticket()},
        )

    def _calc_limits(self, context: Context, output: BasicVector) -> None:
        params = self.params
        extensions = read(self._extension, context)
        if has_value(self._contact_force, context):
            forces = read(self._contact_force, context)
        else:
            forces = [0.0] * self.legs
        switches = (
            [where(d >= params.extended, 1.0, 0.0) for d in extensions]
            + [where(d <= params.retracted, 1.0, 0.0) for d in extensions]
            + [where(force >= params.contact_force, 1.0, 0.0) for force in forces]
        )
        output.SetFromVector(np.array(switches))
