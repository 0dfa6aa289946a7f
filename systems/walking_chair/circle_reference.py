"""Gives the drives of one leg the nodes of a circle of its foot."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.walking_chair.foot_circle import FootCircle
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.leg import leg_inverse


class CircleReference(LeafSystem):
    """Lengths of a leg's branches that lead its foot round a circle, node by node.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `position_node` | 3 | m | of the branches UP, UPS, UPS a period after a sample |

    Who samples it at a time t that is a multiple of the period gets the lengths for where Eq. (49)
    has the foot at t + period (section "Control system": discrete position nodes).

    State: discrete, the node that the next sample is given.

    Bad input: there is none; for a circle out of the leg's reach the lengths are NaN.

    Args:
        circle: what the foot follows, from time 0 on.
        geometry: the leg.
        period: between two nodes [s].
    """

    def __init__(
        self,
        circle: FootCircle = FootCircle(),
        geometry: LegGeometry = LegGeometry(),
        period: float = 0.01,
    ):
        super().__init__()
        self.set_name("circle_reference")
        self._circle, self._geometry, self._period = circle, geometry, period
        index = self.DeclareDiscreteState(BasicVector(self._node(period)))
        self.DeclareStateOutputPort("position_node", index)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_node)

    def _node(self, time: float) -> NDArray[np.float64]:
        return leg_inverse(self._geometry, self._circle.motion(time).position)

    def _update_node(self, context: Context, discrete_state: Any) -> None:
        # The next sample is a period ahead, and its node another one.
        discrete_state.set_value(self._node(context.get_time() + 2.0 * self._period))
