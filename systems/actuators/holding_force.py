"""Forces with which implicit drives hold the joints of a plant under error control."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array

# Groups of the state.
_STEP, _IMPULSE, _BEGUN = range(3)


class HoldingForce(LeafSystem):
    """Mean forces of drives p (q_d - q) + d (v_d - v) of a continuous plant.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `state` | n | - | state of the plant |
    | in `desired_state` | 2k | m or rad, and per s | positions and velocities to follow |
    | out `force` | k | N or N m | of the drives, within their limits; to be sampled |

    The mean is that since the last update of what leads the drives. A plant reports these forces
    as well, with the velocities at the end of a step of its integrator. CENIC's damper acts by
    those over the step; where a drive stops within it, both differ by the whole velocity, and
    stiff drives by kilonewtons. So each step of the integrator counts here with its own way and
    duration.

    State: discrete, positions (k) and time at the end of the last step; impulses (k) since the
    beginning; and these impulses (k) and the time at the last update. All are zero at first, but
    the times, which are infinite.

    Bad input: numbers that are not finite are passed on; of these no impulse is kept.

    Args:
        state_size: size n of the plant's state.
        positions: places of the joints' positions (k) in the state.
        velocities: places of their velocities (k) in the state.
        stiffness: p of each drive (k) [N/m or N m/rad].
        damping: d of each drive (k) [N s/m or N m s/rad].
        limit: largest force of each drive (k) [N or N m].
        time_step: time between two updates [s].
    """

    def __init__(
        self,
        state_size: int,
        positions: Sequence[int],
        velocities: Sequence[int],
        stiffness: ArrayLike,
        damping: ArrayLike,
        limit: ArrayLike = np.inf,
        time_step: float = 1e-3,
    ):
        super().__init__()
        self.set_name("holding_force")
        count = len(positions)
        self._positions, self._velocities = list(positions), list(velocities)
        self._stiffness, self._damping, self._limit = (
            np.broadcast_to(np.asarray(value, dtype=float), count).copy()
            for value in (stiffness, damping, limit)
        )
        self._count = count
        self._state = self.DeclareVectorInputPort("state", state_size)
        self._desired = self.DeclareVectorInputPort("desired_state", 2 * count)
        nothing = np.append(np.zeros(count), math.inf)
        for group in (nothing, np.zeros(count), nothing):
            self.DeclareDiscreteState(BasicVector(group))
        inputs = {self._state.ticket(), self._desired.ticket()}
        self.DeclareVectorOutputPort(
            "force", count, self._calc_force, inputs | {self.xd_ticket(), self.time_ticket()}
        )
        self.DeclarePerStepDiscreteUpdateEvent(self._end_step)
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0.0, self._update)

    def _end_step(self, context: Context, discrete_state: DiscreteValues) -> None:
        position, impulse = self._moved(context)
        if np.isfinite(impulse).all():
            discrete_state.set_value(_STEP, np.append(position, context.get_time()))
            discrete_state.set_value(_IMPULSE, impulse)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._end_step(context, discrete_state)
        _, impulse = self._moved(context)
        if np.isfinite(impulse).all():
            discrete_state.set_value(_BEGUN, np.append(impulse, context.get_time()))

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        *before, start = context.get_discrete_state(_BEGUN).value()
        elapsed = context.get_time() - start
        if elapsed > 0.0:
            output.SetFromVector((self._moved(context)[1] - before) / elapsed)
        else:
            state = read_array(self._state, context)
            velocity = state[self._velocities]
            output.SetFromVector(self._force(context, state[self._positions], velocity))

    def _moved(self, context: Context) -> tuple[Array, Array]:
        """Positions (k) at the end of a step, and impulses (k) since the beginning."""
        position: Array = read_array(self._state, context)[self._positions]
        *last, time = context.get_discrete_state(_STEP).value()
        impulse: Array = context.get_discrete_state(_IMPULSE).value().copy()
        duration = context.get_time() - time
        if duration > 0.0:
            velocity = (position - last) / duration
            impulse += duration * self._force(context, position, velocity)
        return position, impulse

    def _force(self, context: Context, position: Array, velocity: Array) -> Array:
        """Forces (k) at the end of a step over which the velocity was this."""
        desired = read_array(self._desired, context)
        force = self._stiffness * (desired[: self._count] - position)
        force += self._damping * (desired[self._count :] - velocity)
        return np.clip(force, -self._limit, self._limit)
