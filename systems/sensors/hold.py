"""Zero-order hold with a value to begin with."""

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array


class Hold(LeafSystem):
    """Samples a vector once a period and shows the last sample.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `signal` | n | any | the vector |
    | out `held` | n | that of the signal | its last sample |

    Drake's `ZeroOrderHold` shows zeros until its first sample, which comes after initialization:
    too late for systems that sample at initialization. This one begins with a value.

    State: discrete, the last sample (n), updated every period.

    Bad input: passes as it is, and with the next sample it is gone.
    """

    def __init__(self, period: float = 0.01, initial: ArrayLike = (0.0,)) -> None:
        """Creates the hold.

        Args:
            period: time between two samples [s].
            initial: value (n) in a default context, any unit.
        """
        super().__init__()
        self.set_name("hold")
        value = np.array(initial, dtype=float)
        self._signal = self.DeclareVectorInputPort("signal", BasicVector(value))
        self.DeclareStateOutputPort("held", self.DeclareDiscreteState(value))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_sample)

    def set_value(self, context: Context, value: ArrayLike) -> None:
        """Shows a value (n) until the next sample."""
        context.SetDiscreteState(np.array(value, dtype=float))

    def _update_sample(self, context: Context, discrete_state: DiscreteValues) -> None:
        discrete_state.set_value(read_array(self._signal, context))
