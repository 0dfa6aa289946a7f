"""Commands that a person gives to a mechanism in the browser: sliders move its frame."""

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, DiscreteValues

from parapod.systems.core.controls import Controls, PoseSliders, shown
from parapod.systems.core.leaf_system import LeafSystem

_LAG = 0.15  # time constant with which the frame goes where the sliders are [s]


class MechanismControls(LeafSystem):
    """The operator of a mechanism: a slider for each coordinate of its frame.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `pose_desired_state` | 2k | m, rad and rates | coordinates a period later, their rates |

    The frame goes where the sliders are within some tenths of a second, as fast as it may.
    Sliders exist while `shown` is entered.

    State: discrete, the coordinates and their rates (2k), updated every period.

    Bad input: without the sliders the coordinates are those at first.

    Args:
        controls: owner of the sliders.
        elements: for each coordinate (k) name, largest distance from the first one, step, and SI
            unit of one of them, as `PoseSliders` has them.
        first: (k) coordinates at first [m, rad].
        speeds: (k) largest rates [m/s, rad/s].
        period: time between two readings of the sliders [s].
    """

    def __init__(
        self,
        controls: Controls,
        elements: Sequence[tuple[str, float, float, float]],
        first: ArrayLike,
        speeds: ArrayLike,
        period: float = 0.01,
    ):
        super().__init__()
        self.set_name("mechanism_controls")
        begin = np.array(first, dtype=float)
        self._controls, self._period = controls, period
        self._sliders = PoseSliders(controls, elements, begin)
        self._share = -math.expm1(-period / _LAG)
        self._most = period * np.asarray(speeds, dtype=float)
        state = self.DeclareDiscreteState(np.concatenate((begin, np.zeros_like(begin))))
        self.DeclareStateOutputPort("pose_desired_state", state)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def shown(self) -> AbstractContextManager[None]:
        """Shows the sliders, and takes them away at the end."""
        return shown(self._controls, self._sliders.rows())

    def _update(self, context: Context, state: DiscreteValues) -> None:
        now, _ = np.split(context.get_discrete_state(0).value(), 2)
        step = np.clip(self._share * (self._sliders.read() - now), -self._most, self._most)
        state.set_value(0, np.concatenate((now + step, step / self._period)))
