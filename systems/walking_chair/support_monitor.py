"""Holds the gait while the payload is too close to tipping the chair over."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.caching import declare_cached
from parapod.systems.ports import read
from parapod.systems.walking_chair.gait_support import GaitSupport
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import ChairMasses, Passenger
from parapod.systems.walking_chair.walk import Walk


@dataclass(frozen=True)
class SupportMonitorParams:
    """How far the centre of mass must be inside the support polygon.

    Attributes:
        required: smallest margin with which a step is begun [m]. Feet and branches give way: of a
            margin computed rigidly some 4 mm are lost under 57 kg.
        regained: by how much more the margin must be before the gait goes on [m].
    """

    required: float = 0.010
    regained: float = 0.005


class SupportMonitor(LeafSystem):
    """The support margin of this phase of the gait and of the next, and whether to hold.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `gait_time` | 1 | s | the gait's clock |
    | in `payload` | 3 | kg, m, m | mass of the payload, and x and y of its centre from S |
    | out `margin` | 1 | m | smallest distance of the centre of mass from the polygon's edge |
    | out `hold` | 1 | 0/1 | whether no further step may be made |

    State: discrete, whether the gait is held, updated every period.

    Bad input: with a payload that is not finite the margin is minus infinity, and the gait held.

    Args:
        walk: the gaits.
        params: see `SupportMonitorParams`.
        geometry: the chair.
        masses: of the chair without payload.
        period: of the state [s].
    """

    def __init__(
        self,
        walk: Walk = Walk(),
        params: SupportMonitorParams = SupportMonitorParams(),
        geometry: ChairGeometry = ChairGeometry(),
        masses: ChairMasses = ChairMasses(),
        period: float = 0.2,
    ):
        super().__init__()
        self.set_name("support_monitor")
        self._params, self._walk = params, walk
        self._support = GaitSupport(geometry, walk, masses)
        self._time = self.DeclareVectorInputPort("gait_time", 1)
        self._payload = self.DeclareVectorInputPort("payload", 3)
        index = self.DeclareDiscreteState(1)
        inputs = {self._time.ticket(), self._payload.ticket()}
        self._margin = declare_cached(self, "smallest_margin", self._smallest_margin, inputs)
        self.DeclareVectorOutputPort("margin", 1, self._calc_margin, {self._margin.ticket})
        self.DeclareStateOutputPort("hold", index)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_hold)

    def _smallest_margin(self, context: Context) -> float:
        mass, x, y = payload = read(self._payload, context)
        if not all(map(math.isfinite, payload)):
            return -math.inf
        passenger = Passenger(max(0.0, mass), x, y)
        now = self._walk.phase_at(read(self._time, context)[0])
        coming = range(now, min(now + 2, len(self._walk.phases)))
        return min(self._support.margin(phase, passenger) for phase in coming)

    def _calc_margin(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([self._margin.of(self, context)]))

    def _update_hold(self, context: Context, discrete_state: Any) -> None:
        held: Any = context.get_discrete_state_vector()
        params = self._params
        required = params.required + (params.regained if held[0] > 0.5 else 0.0)
        holds = not self._margin.of(self, context) >= required
        discrete_state.set_value(np.array([float(holds)]))
