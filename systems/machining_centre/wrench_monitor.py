"""Watches how much more a clamped centre could resist."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.elementwise import Elementwise
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_batch
from parapod.systems.core.rows import answer_of, common, number_of
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.statics import CentreMasses
from parapod.systems.machining_centre.wrench import index_alone

# Fewer limbs do not hold a platform by their legs alone.
_FEWEST = 3
_HUGE = 1e9  # loads are not taken for larger [N, N m]


class WrenchMonitor(LeafSystem):
    """Wrench index of the posture, and the margin that drill and weight leave.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pose_desired` | 6 | m, rad | of the platform |
    | in `feet` | 6n | m, rad | of the feet |
    | in `clamps_closed` | n | 0/1 | which feet are clamped |
    | in `tool_force` | 2 | N, N m | thrust and torque of the drill |
    | out `wrench_index` | 1 | - | w_minmax, Eq. (28); 0 with fewer than three limbs clamped |
    | out `wrench_margin` | 1 | N | resisted in every direction, less what drill and weight need |

    Moments are divided by r_c. The thrust is along the platform's third axis, whatever its
    direction: the needed force is never underestimated.

    State: discrete, the index (1), updated every period, as postures change slowly; the margin
    follows the drill's load at once.

    Bad input: a posture that is not finite, or that the legs do not hold, has index 0.

    Args:
        geometry: the centre.
        largest_leg_force: largest force of each leg, pushing and pulling [N].
        masses: masses of the centre.
        period: between two looks at the posture [s].
    """

    def __init__(
        self,
        geometry: CentreGeometry = CentreGeometry(),
        largest_leg_force: float = 1000.0,
        masses: CentreMasses = CentreMasses(),
        period: float = 0.1,
    ):
        super().__init__()
        self.set_name("wrench_monitor")
        self._geometry, self._total = geometry, geometry.legs * largest_leg_force
        self._down = float(np.linalg.norm(masses.weight(geometry)))
        self._pose = self.DeclareVectorInputPort("pose_desired", 6)
        self._feet = self.DeclareVectorInputPort("feet", 6 * geometry.limbs)
        self._clamps = self.DeclareVectorInputPort("clamps_closed", geometry.limbs)
        self._force = self.DeclareVectorInputPort("tool_force", 2)
        state = {self.discrete_state_ticket(self.DeclareDiscreteState(1))}
        self.DeclareVectorOutputPort("wrench_index", 1, self._calc_index, state)
        margin = state | {self._force.ticket()}
        self.DeclareVectorOutputPort("wrench_margin", 1, self._calc_margin, margin)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        state.set_value(0, np.array([self._index(context)]))

    def _index(self, context: Context) -> Elementwise:
        is_clamped = common(read_batch(self._clamps, context) > 0.5)
        clamped = (np.flatnonzero(is_clamped) + 1).tolist()
        pose, feet = read_batch(self._pose, context), read_batch(self._feet, context)
        is_known = answer_of(np.isfinite(np.concatenate((pose, feet), axis=-1)).all(axis=-1))
        if len(clamped) < _FEWEST or not is_known:
            return 0.0
        footholds = feet.reshape(*pose.shape[:-1], -1, 6)
        return number_of(np.nan_to_num(index_alone(self._geometry, pose, footholds, clamped)))

    def _calc_index(self, context: Context, output: BasicVector) -> None:
        output[0] = context.get_discrete_state(0)[0]

    def _calc_margin(self, context: Context, output: BasicVector) -> None:
        # A load that is not finite counts as zero.
        force = np.nan_to_num(read_batch(self._force, context), posinf=0.0, neginf=0.0)
        thrust, torque = np.moveaxis(np.clip(force, -_HUGE, _HUGE), -1, 0)
        load = np.hypot(np.abs(thrust) + self._down, torque / self._geometry.platform_radius)
        output[0] = context.get_discrete_state(0)[0] * self._total - number_of(load)
