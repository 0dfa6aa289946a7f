"""Desired states of the legs while they go up or down by themselves, or follow a posture."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.elementwise import clamp
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.ports import elements, is_on, read

_EXTENSION, _RATE = slice(0, LEG_COUNT), slice(LEG_COUNT, 2 * LEG_COUNT)
_STARTED = 2 * LEG_COUNT


class LegRamp(LeafSystem):
    """Legs at a rate of their own, or legs that follow a posture; never a jump between the two.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `leg_rate` | 4 | m/s | wanted rates of the extensions |
    | in `extension` | 4 | m | measured extensions, where the ramp starts |
    | in `posture_extension_state` | 8 | m, m/s | extensions and rates that a posture asks for |
    | in `posture_control` | 1 | - | above 0.5: follow the posture |
    | in `enable` | 1 | - | above 0.5: on; otherwise the ramp stays where the legs are |
    | out `extension_desired_state` | 8 | m, m/s | what the legs are asked for |

    The rates approach the wanted ones with a limited acceleration. While the legs follow a
    posture, the ramp follows too, and goes on from there.

    State: discrete, extensions and rates (8) and whether started (1), updated every period.

    Bad input: a posture's extension that is not finite is passed on, for `PiController` to answer
    with zero volts; the ramp keeps that leg where it was. A wanted rate that is not finite counts
    as zero.
    """

    def __init__(self, acceleration: float = 0.1, period: float = 0.01):
        """Creates the ramp.

        Args:
            acceleration: with which the rates change [m/s^2] (design choice).
            period: of the updates [s].
        """
        super().__init__()
        self.set_name("leg_ramp")
        self._step, self._period = acceleration * period, period
        self._leg_rate = self.DeclareVectorInputPort("leg_rate", LEG_COUNT)
        self._measured = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._posture = self.DeclareVectorInputPort("posture_extension_state", 2 * LEG_COUNT)
        self._control = self.DeclareVectorInputPort("posture_control", 1)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        state = self.DeclareDiscreteState(2 * LEG_COUNT + 1)
        self.DeclareVectorOutputPort(
            "extension_desired_state",
            2 * LEG_COUNT,
            self._calc_desired_state,
            {
                self.discrete_state_ticket(state),
                self._measured.ticket(),
                self._posture.ticket(),
                self._control.ticket(),
            },
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_ramp)

    def _calc_desired_state(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state_vector())
        if is_on(self._control, context):
            desired = read(self._posture, context)
        elif state[_STARTED] > 0.5:
            desired = state[:_STARTED]
        else:
            desired = read(self._measured, context) + [0.0] * LEG_COUNT
        output.SetFromVector(np.array(desired))

    def _update_ramp(self, context: Context, discrete_state: Any) -> None:
        state = elements(context.get_discrete_state_vector())
        if not is_on(self._enable, context) or not state[_STARTED] > 0.5:
            state[_EXTENSION], state[_RATE] = read(self._measured, context), [0.0] * LEG_COUNT
        elif is_on(self._control, context):
            asked = read(self._posture, context)
            for i in range(LEG_COUNT):
                if np.isfinite(asked[i]) and np.isfinite(asked[LEG_COUNT + i]):
                    state[i], state[LEG_COUNT + i] = asked[i], asked[LEG_COUNT + i]
        else:
            for i, wanted in enumerate(read(self._leg_rate, context)):
                rate = state[LEG_COUNT + i]
                goal = wanted if np.isfinite(wanted) else 0.0
                faster = rate + clamp(goal - rate, -self._step, self._step)
                state[i] += 0.5 * self._period * (rate + faster)
                state[LEG_COUNT + i] = faster
        state[_STARTED] = float(np.isfinite(state[_EXTENSION]).all())
        discrete_state.set_value(np.array(state))
