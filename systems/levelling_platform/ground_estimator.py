"""Estimate of the ground's inclination at touchdown (section 6.2)."""

from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from parapod.systems.core.elementwise import all_finite
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import is_on, read_array, read_or_zeros
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import estimate_ground, unevenness


class GroundEstimator(LeafSystem):
    """Ground inclination from extensions and attitude, sampled once the trigger has risen.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | 4 | m | measured extensions, all feet on the ground |
    | in `attitude` | 2 | rad | estimated roll and pitch of the platform |
    | in `attitude_error` | 1 | rad | how far off that may be; unconnected: 0 |
    | in `trigger` | 1 | - | the estimate is taken once this has risen above 0.5 |
    | out `ground` | 2 | rad | estimated roll and pitch of the ground; 0 before the first |
    | out `valid` | 1 | - | 1 once there is an estimate |
    | out `foot_offsets` | 4 | m | how far each foot stands above that ground |

    The ground is the plane of least squares through the feet; the offsets are what is left, of
    uneven ground and of legs that are not built as drawn. The feet move by millimetres only, so
    what was measured at touchdown stays valid.

    State: discrete, ground (2), valid (1), offsets (4), last trigger (1), updated every period.

    Bad input: a sample whose extensions or attitude are not finite, or cannot be built, is not
    taken, nor is one whose attitude may be further off than `settled`; the trigger stays armed,
    the next period tries again, and nothing is valid meanwhile.
    """

    def __init__(
        self,
        geometry: PlatformGeometry = PlatformGeometry(),
        period: float = 0.01,
        settled: float = 1e-3,
    ):
        """Creates the estimator.

        Args:
            geometry: the platform.
            period: period of its updates [s].
            settled: largest error of an attitude that has settled [rad] (design choice: twice what
                the ADIS16448's noise shows of a platform at rest, and less than a third of the
                paper's .2 deg).
        """
        super().__init__()
        self.set_name("ground_estimator")
        self._geometry, self._settled = geometry, settled
        self._extension = self.DeclareVectorInputPort("extension", 4)
        self._attitude = self.DeclareVectorInputPort("attitude", 2)
        self._error = self.DeclareVectorInputPort("attitude_error", 1)
        self._trigger = self.DeclareVectorInputPort("trigger", 1)
        self.DeclareStateOutputPort("ground", self.DeclareDiscreteState(2))
        self.DeclareStateOutputPort("valid", self.DeclareDiscreteState(1))
        self.DeclareStateOutputPort("foot_offsets", self.DeclareDiscreteState(LEG_COUNT))
        self.DeclareDiscreteState(1)  # the last trigger
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_estimate)

    def _update_estimate(self, context: Context, discrete_state: Any) -> None:
        triggered = is_on(self._trigger, context)
        if triggered == (context.get_discrete_state(3)[0] > 0.5):
            return
        if triggered:
            extension = read_array(self._extension, context)
            attitude = read_array(self._attitude, context)
            ground = estimate_ground(self._geometry, extension, attitude)
            has_settled = read_or_zeros(self._error, context)[0] <= self._settled
            if not (has_settled and all_finite(ground)):
                discrete_state.set_value(1, np.zeros(1))
                return
            discrete_state.set_value(0, ground)
            discrete_state.set_value(1, np.ones(1))
            discrete_state.set_value(2, unevenness(self._geometry, extension))
        discrete_state.set_value(3, np.array([float(triggered)]))
