"""Forces with which implicit drives hold the joints of a plant under error control."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array


class HoldingForce(LeafSystem):
    """Mean forces of drives p (q_d - q) + d (v_d - v) of a continuous plant.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `state` | n | - | state of the plant |
    | in `desired_state` | 2k | m or rad, and per s | positions and velocities to follow |
    | out `force` | k | N or N m | of the drives, within their limits; to be sampled |

    A plant reports these forces as well, with the velocities at the end of a step. CENIC's damper
    acts by those over the step; where a drive stops within it, both differ by the whole velocity,
    and stiff drives by kilonewtons. Here the velocity is the way since the last sample by the
    period.

    State: discrete, positions at the last sample (k) and 1; all are zero at first, and then the
    velocity is that of the state.

    Bad input: numbers that are not finite are passed on; positions that are not are not kept.

    Args:
        state_size: size n of the plant's state.
        positions: places of the joints' positions (k) in the state.
        velocities: places of their velocities (k) in the state.
        stiffness: p of each drive (k) [N/m or N m/rad].
        damping: d of each drive (k) [N s/m or N m s/rad].
        limit: largest force of each drive (k) [N or N m].
        period: period of the samples [s].
    """

    def __init__(
        self,
        state_size: int,
        positions: Sequence[int],
        velocities: Sequence[int],
        stiffness: ArrayLike,
        damping: ArrayLike,
        limit: ArrayLike = np.inf,
        period: float = 1e-3,
    ):
        super().__init__()
        self.set_name("holding_force")
        count = len(positions)
        self._positions, self._velocities = list(positions), list(velocities)
        self._stiffness, self._damping, self._limit = (
            np.broadcast_to(np.asarray(value, dtype=float), count).copy()
            for value in (stiffness, damping, limit)
        )
        self._count, self._period = count, period
        self._state = self.DeclareVectorInputPort("state", state_size)
        self._desired = self.DeclareVectorInputPort("desired_state", 2 * count)
        self.DeclareDiscreteState(count + 1)
        inputs = {self._state.ticket(), self._desired.ticket()}
        self.DeclareVectorOutputPort("force", count, self._calc_force, inputs | {self.xd_ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        position = read_array(self._state, context)[self._positions]
        if np.isfinite(position).all():
            discrete_state.set_value(0, np.append(position, 1.0))

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        state, desired = read_array(self._state, context), read_array(self._desired, context)
        position = state[self._positions]
        last = context.get_discrete_state(0).value()
        velocity: Array = state[self._velocities]
        if last[-1]:
            velocity = (position - last[:-1]) / self._period
        force = self._stiffness * (desired[: self._count] - position)
        force += self._damping * (desired[self._count :] - velocity)
        output.SetFromVector(np.clip(force, -self._limit, self._limit))
