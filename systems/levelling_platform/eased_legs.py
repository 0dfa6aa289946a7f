"""Legs that are led from where they are to where they are asked to be, and then follow."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.elementwise import all_finite
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, is_on, read
from parapod.systems.levelling_platform.geometry import LEG_COUNT

# Largest rate of a quintic from rest to rest, by its mean [-].
_PEAK = 1.875
_OFFSET = slice(0, LEG_COUNT)
_SINCE, _IS_LED = LEG_COUNT, LEG_COUNT + 1


def easing_time(distance: float, rate: float) -> float:
    """Duration of a quintic from rest to rest [s].

    Args:
        distance: distance to go [m].
        rate: largest rate on the way [m/s].
    """
    return _PEAK * distance / rate


class EasedLegs(LeafSystem):
    """Way of the legs from where they are to what they are asked for, without a jump.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension_request` | 8 | m, m/s | extensions and rates that are asked for |
    | in `extension` | 4 | m | measured extensions, where the way begins |
    | in `enable` | 1 | - | above 0.5: lead and follow; when it rises a way begins |
    | out `extension_desired_state` | 8 | m, m/s | what the legs are led to |
    | out `legs_arrived` | 1 | 0/1 | whether the way is over, and the request is followed |

    When it is enabled, what the legs are off their request fades by a quintic, no leg being
    faster for it than `rate`; all legs arrive together. The request should rest then. Disabled,
    the legs are commanded where they are.

    State: discrete, what the legs were off (4) [m], since when (1) [s], whether led (1).

    Bad input: a way begins once the measured extensions are finite; a request that is not finite
    is passed on, for `PiController` to answer with zero volts.
    """

    def __init__(self, rate: float = 4e-3, period: float = 0.01):
        """Creates the system.

        Args:
            rate: largest rate of a leg on its way [m/s] (design choice: a foot goes six times as
                fast).
            period: period of the updates [s].
        """
        super().__init__()
        self.set_name("eased_legs")
        self._rate = rate
        self._request = self.DeclareVectorInputPort("extension_request", 2 * LEG_COUNT)
        self._measured = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        state = self.DeclareDiscreteState(LEG_COUNT + 2)
        tickets = {self.discrete_state_ticket(state), self.time_ticket()}
        dependencies = {self._request.ticket(), self._measured.ticket()}
        self.DeclareVectorOutputPort(
            "extension_desired_state",
            2 * LEG_COUNT,
            self._calc_desired_state,
            tickets | dependencies,
        )
        self.DeclareVectorOutputPort("legs_arrived", 1, self._calc_arrived, tickets)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _calc_desired_state(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state_vector())
        if not state[_IS_LED] > 0.5:
            desired = read(self._measured, context) + [0.0] * LEG_COUNT
            output.SetFromVector(np.array(desired))
            return
        request = np.array(read(self._request, context))
        offset, duration = np.array(state[_OFFSET]), self._duration(state)
        share = self._share(context, state)
        share_left = 1.0 - share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        rate = -30.0 * share**2 * (1.0 - share) ** 2 / duration if share < 1.0 else 0.0
        output.SetFromVector(request + np.concatenate([share_left * offset, rate * offset]))

    def _calc_arrived(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state_vector())
        is_there = state[_IS_LED] > 0.5 and self._share(context, state) >= 1.0
        output.SetFromVector(np.array([float(is_there)]))

    def _duration(self, state: list[float]) -> float:
        return easing_time(max(map(abs, state[_OFFSET])), self._rate)

    def _share(self, context: Context, state: list[float]) -> float:
        """Share of the way that is over, 0..1."""
        elapsed, duration = context.get_time() - state[_SINCE], self._duration(state)
        return min(1.0, elapsed / duration) if duration > 0.0 else 1.0

    def _update(self, context: Context, discrete_state: Any) -> None:
        state = elements(context.get_discrete_state_vector())
        is_led = state[_IS_LED] > 0.5
        if not is_on(self._enable, context):
            state[_IS_LED] = 0.0
        elif not is_led:
            request = read(self._request, context)[:LEG_COUNT]
            offset = np.array(read(self._measured, context)) - request
            if all_finite(offset):
                state = [*offset.tolist(), context.get_time(), 1.0]
        discrete_state.set_value(np.array(state))
