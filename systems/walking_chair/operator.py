"""Commands that a person gives to the walking chair in the browser."""

from contextlib import AbstractContextManager

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues

from parapod.systems.core.controls import Controls, is_held, shown
from parapod.systems.core.leaf_system import LeafSystem


class ChairControls(LeafSystem):
    """The operator of the chair, who has one button: it walks while that is held.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `halt` | 1 | 0/1 | whether the chair is to stand still |

    The button exists while `shown` is entered.

    State: discrete, the output (1), updated every period.

    Bad input: without the button the chair stands still.
    """

    WALK, KEY = "walk", "ArrowUp"

    def __init__(self, controls: Controls, period: float = 0.02):
        """Creates the operator; shows nothing yet.

        Args:
            controls: owner of the button.
            period: period of reading it [s].
        """
        super().__init__()
        self.set_name("chair_controls")
        self._controls = controls
        self.DeclareStateOutputPort("halt", self.DeclareDiscreteState(np.ones(1)))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def shown(self) -> AbstractContextManager[None]:
        """Shows the button, and takes it away at the end."""
        return shown(self._controls, holds=[(self.WALK, self.KEY)])

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        discrete_state.set_value(np.array([float(not is_held(self._controls, self.WALK))]))
