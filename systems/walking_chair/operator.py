"""Commands that a person gives to the walking chair in the browser."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem


class HeldControls(Protocol):
    """Buttons that count while they are held."""

    # fmt: off
    def AddHold(self, name: str, key: str = "") -> Any: ...  # noqa: D102
    def DeleteHold(self, name: str, strict: bool = True) -> Any: ...  # noqa: D102
    def GetHoldNames(self) -> list[str]: ...  # noqa: D102
    def IsHeld(self, name: str) -> bool: ...  # noqa: D102
    # fmt: on


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

    def __init__(self, controls: HeldControls, period: float = 0.02):
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

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Shows the button, and takes it away at the end."""
        self._controls.AddHold(self.WALK, self.KEY)
        try:
            yield
        finally:
            self._controls.DeleteHold(self.WALK, strict=False)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        is_there = self.WALK in self._controls.GetHoldNames()
        walks = is_there and self._controls.IsHeld(self.WALK)
        discrete_state.set_value(np.array([float(not walks)]))
