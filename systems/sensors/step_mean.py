"""Mean of a signal over the steps of an integrator, since the last sample."""

import math

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array

# Groups of the state.
_STEP, _INTEGRAL, _SAMPLED, _MEAN = range(4)


class StepMean(LeafSystem):
    """Mean of a vector since the last sample, each step with its duration.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `signal` | n | any | the vector; of a step its value at the end counts |
    | out `mean` | n | that of the signal | since the last sample; at a sample that until then |

    State: discrete, the time at the end of the last step [s]; integrals (n) since the beginning;
    these integrals (n) and the time at the last sample; and the mean (n) until then. All are zero
    at first, but the times, which are infinite.

    Bad input: numbers that are not finite are passed on; in later means they do not count.

    Args:
        size: size n of the vector.
        period: time between two samples [s].
    """

    def __init__(self, size: int, period: float = 0.01):
        super().__init__()
        self.set_name("step_mean")
        self._signal = self.DeclareVectorInputPort("signal", size)
        nothing = np.zeros(size)
        for group in ([math.inf], nothing, np.append(nothing, math.inf), nothing):
            self.DeclareDiscreteState(BasicVector(np.array(group)))
        tickets = {self._signal.ticket(), self.xd_ticket(), self.time_ticket()}
        self.DeclareVectorOutputPort("mean", size, self._calc_mean, tickets)
        self.DeclarePerStepDiscreteUpdateEvent(self._end_step)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _end_step(self, context: Context, discrete_state: DiscreteValues) -> None:
        discrete_state.set_value(_STEP, np.array((context.get_time(),)))
        discrete_state.set_value(_INTEGRAL, self._finite_integral(context))

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        self._end_step(context, discrete_state)
        sampled = np.append(self._finite_integral(context), context.get_time())
        discrete_state.set_value(_SAMPLED, sampled)
        discrete_state.set_value(_MEAN, self._mean(context))

    def _calc_mean(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._mean(context))

    def _mean(self, context: Context) -> Array:
        *before, sampled = context.get_discrete_state(_SAMPLED).value()
        elapsed = context.get_time() - sampled
        if elapsed > 0.0:
            mean: Array = (self._integral(context) - before) / elapsed
            return mean
        if elapsed == 0.0:
            until: Array = context.get_discrete_state(_MEAN).value().copy()
            return until
        return read_array(self._signal, context)

    def _integral(self, context: Context) -> Array:
        """Integrals (n) since the beginning."""
        integral: Array = context.get_discrete_state(_INTEGRAL).value().copy()
        duration = context.get_time() - context.get_discrete_state(_STEP).value()[0]
        if duration > 0.0:
            integral += duration * read_array(self._signal, context)
        return integral

    def _finite_integral(self, context: Context) -> Array:
        """The same without a step whose signal is not finite."""
        integral = self._integral(context)
        last: Array = context.get_discrete_state(_INTEGRAL).value().copy()
        return integral if np.isfinite(integral).all() else last
