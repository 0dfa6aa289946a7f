"""Reference that moves between the steps of drives, for a plant under error control."""

import math

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array

# Groups of the state, and the share of the drives' step that is none.
_BEFORE, _UPDATED, _STEP = range(3)
_NONE = 1e-6


class MovingReference(LeafSystem):
    """Positions and velocities of drives where a step of the integrator is to arrive.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `arrival` | 2n | m or rad, and per s | where drives are at the end of their step |
    | out `now` | 2n | m or rad, and per s | to lead a plant to in the step that begins |
    | out `during` | 2n | m or rad, and per s | the same in the step that ends |

    CENIC asks for a reference where its step begins, and takes it for one that stands still: the
    bodies go there until its end, however short it is. Led to the end of the drives' step by
    several of its own they would rush ahead in the first ones. So they are led to where the drives
    are at the end of the integrator's step. Drives move between two updates by a cubic polynomial
    of their positions and velocities at both. A step of the integrator is taken to be as long as
    the longest one since the last update, or the first as that between the two before, and to end
    where that of the drives does.

    State: discrete, the arrival before the last update (2n); the time of this update, and the
    longest step between it and the one before; and the time at the end of the integrator's last
    step, with the longest one since an update and the time of that. Times are infinite at first,
    and until the second update what is shown is the arrival.

    Bad input: numbers that are not finite are passed on, those of an arrival until it is the one
    before the last.

    Args:
        count: number of drives n.
        time_step: time between two updates [s].
    """

    def __init__(self, count: int, time_step: float = 1e-3):
        super().__init__()
        self.set_name("moving_reference")
        self._count, self._time_step = count, time_step
        self._arrival = self.DeclareVectorInputPort("arrival", 2 * count)
        self.DeclareDiscreteState(2 * count)
        self.DeclareDiscreteState(BasicVector(np.array((math.inf, math.inf))))
        self.DeclareDiscreteState(BasicVector(np.array((math.inf, 0.0, math.inf))))
        tickets = {self._arrival.ticket(), self.xd_ticket()}
        self.DeclareVectorOutputPort(
            "now", 2 * count, self._calc_now, tickets | {self.time_ticket()}
        )
        self.DeclareVectorOutputPort("during", 2 * count, self._calc_during, tickets)
        self.DeclarePerStepDiscreteUpdateEvent(self._end_step)
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0.0, self._update)

    def _end_step(self, context: Context, discrete_state: DiscreteValues) -> None:
        now, (updated, _) = context.get_time(), self._last_update(context)
        discrete_state.set_value(_STEP, np.array((now, self._longest(context), updated)))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._end_step(context, discrete_state)
        longest = self._longest(context) or math.inf
        discrete_state.set_value(_BEFORE, read_array(self._arrival, context))
        discrete_state.set_value(_UPDATED, np.array((context.get_time(), longest)))

    def _last_update(self, context: Context) -> list[float]:
        """Time of the last update, and the longest step before it."""
        update: list[float] = context.get_discrete_state(_UPDATED).value().tolist()
        return update

    def _longest(self, context: Context) -> float:
        """The longest step since the last update, with the one that ends now; 0: none."""
        end, longest, since = context.get_discrete_state(_STEP).value().tolist()
        updated, _ = self._last_update(context)
        duration = max(context.get_time() - end, 0.0)
        return float(max(longest, duration) if since == updated else duration)

    def _calc_now(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._at_end_of_step(context, context.get_time()))

    def _calc_during(self, context: Context, output: BasicVector) -> None:
        last = float(context.get_discrete_state(_STEP).value()[0])
        output.SetFromVector(self._at_end_of_step(context, last))

    def _at_end_of_step(self, context: Context, start: float) -> Array:
        """Positions and velocities (2n) at the end of a step that starts then."""
        arrival = read_array(self._arrival, context)
        updated, longest = self._last_update(context)
        _, longest_since, since = context.get_discrete_state(_STEP).value().tolist()
        if since == updated and longest < math.inf and longest_since > _NONE * self._time_step:
            longest = longest_since
        step, n = self._time_step, self._count
        s = (start - updated + longest) / step
        if not s < 1.0 - _NONE:
            return arrival
        s = max(s, 0.0)
        before = context.get_discrete_state(_BEFORE).value()
        way = arrival[:n] - before[:n]
        v_0, v_1 = step * before[n:], step * arrival[n:]
        position = before[:n] + s * (
            v_0 + s * (3.0 * way - 2.0 * v_0 - v_1 + s * (v_0 + v_1 - 2.0 * way))
        )
        velocity = v_0 + s * (
            2.0 * (3.0 * way - 2.0 * v_0 - v_1) + 3.0 * s * (v_0 + v_1 - 2.0 * way)
        )
        return np.concatenate((position, velocity / step))
