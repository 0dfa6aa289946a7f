"""What sits on the chair, from the motors' currents."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, LeafSystem

from parapod.systems.ports import read_array
from parapod.systems.walking_chair.branches import BRANCHES
from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.leg import leg_corners
from parapod.systems.walking_chair.leg_forward import up_of_lengths
from parapod.systems.walking_chair.masses import GRAVITY, ChairMasses
from parapod.systems.walking_chair.statics import corner_jacobians

# A payload that is lighter has no place that is worth knowing [kg].
_LIGHT = 5.0


@dataclass(frozen=True)
class PayloadEstimatorParams:
    """How currents become forces, and forces a payload.

    Attributes:
        force_per_current: C_t of Eq. (55) [N/A]: the largest thrust (Eq. 53) at the rated 3 A.
        time_constant: of the estimate's filter [s].
    """

    force_per_current: float = 427.3 / 3.0
    time_constant: float = 0.5


class PayloadEstimator(LeafSystem):
    """Mass and place of the payload from currents, Eq. (55), while the chair hardly accelerates.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | 12 | m | lengths of the branches |
    | in `current` | 12 | A | of their motors, positive where they push |
    | out `payload` | 3 | kg, m, m | mass of the payload, and x and y of its centre from S |

    The forces of a leg's three branches tell of the forces on its foot's three corners, as far
    as these are vertical: of the ground's less the foot's own weight, whether it stands or hangs.
    Over all legs they add up to the weight above the feet, and their centre is below the centre
    of mass. Friction forces between the feet do no work when the body rises, so that they leave
    the mass alone; the centre they shift, by some millimetres.

    State: discrete, the filtered estimate (3), updated every period; the first sample is taken
    as it is.

    Bad input: a sample with a value that is not finite, with lengths of which no leg can be
    built, or of a chair that does not bear its own weight (as before the first measurement) is
    left out.

    Args:
        params: see `PayloadEstimatorParams`.
        geometry: the chair.
        masses: of the chair without payload.
        period: between samples [s].
    """

    def __init__(
        self,
        params: PayloadEstimatorParams = PayloadEstimatorParams(),
        geometry: ChairGeometry = ChairGeometry(),
        masses: ChairMasses = ChairMasses(),
        period: float = 0.2,
    ):
        super().__init__()
        self.set_name("payload_estimator")
        self._params, self._geometry, self._masses = params, geometry, masses
        self._share = -math.expm1(-period / params.time_constant)
        count = len(BRANCHES)
        self._position = self.DeclareVectorInputPort("position", count)
        self._current = self.DeclareVectorInputPort("current", count)
        estimate = self.DeclareDiscreteState(3)
        self.DeclareDiscreteState(1)  # whether there has been a sample
        self.DeclareStateOutputPort("payload", estimate)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_estimate)

    def _update_estimate(self, context: Context, discrete_state: Any) -> None:
        sample = self._sample(context)
        if not np.isfinite(sample).all():
            return
        last: Any = context.get_discrete_state(0)
        begun: Any = context.get_discrete_state(1)
        share = self._share if begun[0] > 0.5 else 1.0
        discrete_state.set_value(0, last.value() + share * (sample - last.value()))
        discrete_state.set_value(1, np.ones(1))

    def _sample(self, context: Context) -> NDArray[np.float64]:
        """Mass and place (3); NaN for what cannot be told."""
        unknown = np.full(3, np.nan)
        current = read_array(self._current, context).reshape(LEG_COUNT, 3)
        leg, masses = self._geometry.leg, self._masses
        up = up_of_lengths(leg, read_array(self._position, context).reshape(LEG_COUNT, 3))
        if not (np.isfinite(up).all() and np.isfinite(current).all()):
            return unknown
        loads = self._vertical_forces(up, current) / GRAVITY
        mass = loads.sum() - (masses.total - LEG_COUNT * masses.foot_end)
        if mass < -_LIGHT:
            return unknown
        if mass < _LIGHT:
            return np.array((mass, 0.0, 0.0))
        corners = np.einsum("lij,lkj->lki", self._geometry.R_SA, leg_corners(leg, up))
        corners = corners + self._geometry.p_SA[:, None, :]
        place = np.einsum("lk,lki->i", loads, corners)[:2] / mass
        return np.array((mass, *place))

    def _vertical_forces(
        self, up: NDArray[np.float64], current: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(4, 3) vertical forces on the corners that the branches' forces tell of [N]."""
        thrust = self._params.force_per_current * current
        by_branch = -corner_jacobians(self._geometry.leg, up)[..., 2, :]  # (4, corner, branch)
        solved = np.linalg.solve(np.swapaxes(by_branch, -1, -2), thrust[..., None])
        return solved[..., 0]
