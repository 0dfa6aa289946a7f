"""Speed of a treadmill's belt, in the form that a plant of rigid bodies takes."""

from typing import Any

from pydrake.common.value import Value
from pydrake.systems.framework import BusValue

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read


class BeltSurface(LeafSystem):
    """Speed of the surface of the body that plays the belt.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `velocity` | 1 | m/s | of the belt, positive to the rear |
    | out `surface_speeds` | abstract | m/s | by the name of the body, as a `BusValue` |

    The body's `drake:surface_velocity_axis` says where the surface goes.

    State: none.

    Bad input: a velocity that is not finite is zero.

    Args:
        body: scoped name of the body.
    """

    def __init__(self, body: str = "treadmill::tread"):
        super().__init__()
        self.set_name("belt_surface")
        self._body = body
        self._velocity = self.DeclareVectorInputPort("velocity", 1)
        self.DeclareAbstractOutputPort(
            "surface_speeds",
            lambda: Value(BusValue()),
            self._calc_speeds,
            {self._velocity.ticket()},
        )

    def _calc_speeds(self, context: Any, output: Any) -> None:
        (velocity,) = read(self._velocity, context)
        bus = BusValue()
        bus.Set(self._body, Value(velocity if abs(velocity) < float("inf") else 0.0))
        output.set_value(bus)
