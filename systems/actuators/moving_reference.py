"""Reference that moves between the steps of drives, for a plant under error control."""

import math
from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array

_BEFORE, _UPDATED, _STEP = range(3)  # groups of the state
_INSTANT = 1e-6  # below which two times are the same, by the drives' step


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
    the last one that nothing cut, and to end where something is sampled.

    State: discrete, the arrival before the last update (2n); the time of this update, with 1 once
    there is one before; and the time at the end of the integrator's last step, with the length of
    the next one. Times and lengths are infinite at first, and until the second update the arrival
    is shown.

    Bad input: numbers that are not finite are passed on, those of an arrival until it is the one
    before the last.

    Args:
        count: number of drives n.
        time_step: time between two updates [s].
        sampled_every: periods of what else is sampled, from time zero on [s].
    """

    def __init__(self, count: int, time_step: float = 1e-3, sampled_every: Sequence[float] = ()):
        super().__init__()
        self.set_name("moving_reference")
        self._count, self._time_step = count, time_step
        self._periods, self._instant = (time_step, *sampled_every), _INSTANT * time_step
        self._arrival = self.DeclareVectorInputPort("arrival", 2 * count)
        for group in (np.zeros(2 * count), np.array((math.inf, 0.0)), np.full(2, math.inf)):
            self.DeclareDiscreteState(BasicVector(group))
        tickets = {self._arrival.ticket(), self.xd_ticket()}
        self.DeclareVectorOutputPort(
            "now", 2 * count, self._calc_now, tickets | {self.time_ticket()}
        )
        self.DeclareVectorOutputPort("during", 2 * count, self._calc_during, tickets)
        self.DeclarePerStepDiscreteUpdateEvent(self._end_step)
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0.0, self._update)

    def _end_step(self, context: Context, discrete_state: DiscreteValues) -> None:
        last, length = context.get_discrete_state(_STEP).value().tolist()
        now = context.get_time()
        duration = now - last
        if duration > self._instant:
            is_cut = now > self._next_sample(last) - self._instant
            length = max(length, duration) if is_cut else duration
        discrete_state.set_value(_STEP, np.array((now, length)))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._end_step(context, discrete_state)
        updated, _ = context.get_discrete_state(_UPDATED).value()
        update = np.array((context.get_time(), float(math.isfinite(updated))))
        discrete_state.set_value(_BEFORE, read_array(self._arrival, context))
        discrete_state.set_value(_UPDATED, update)

    def _next_sample(self, time: float) -> float:
        """First time after this one at which something is sampled."""
        after = time + self._instant
        return min(period * (math.floor(after / period) + 1) for period in self._periods)

    def _calc_now(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._at_end_of_step(context, context.get_time()))

    def _calc_during(self, context: Context, output: BasicVector) -> None:
        last = float(context.get_discrete_state(_STEP).value()[0])
        output.SetFromVector(self._at_end_of_step(context, last))

    def _at_end_of_step(self, context: Context, start: float) -> Array:
        """Positions and velocities (2n) at the end of a step that starts then."""
        arrival = read_array(self._arrival, context)
        updated, has_before = context.get_discrete_state(_UPDATED).value().tolist()
        _, length = context.get_discrete_state(_STEP).value().tolist()
        step, n = self._time_step, self._count
        if not has_before or not math.isfinite(start):
            return arrival
        s = (min(start + length, self._next_sample(start)) - updated) / step
        if not s < 1.0 - _INSTANT:
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
