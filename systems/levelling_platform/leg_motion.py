"""Desired states of the legs: ramps up and down, and feet kept on the ground by their switches."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.elementwise import all_finite, clamp
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, is_on, read
from parapod.systems.levelling_platform.geometry import LEG_COUNT

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
            acceleration: acceleration of a change of the rates [m/s^2] (design choice).
            period: period of the updates [s].
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
            posture = read(self._posture, context)
            for i in range(LEG_COUNT):
                if np.isfinite(posture[i]) and np.isfinite(posture[LEG_COUNT + i]):
                    state[i], state[LEG_COUNT + i] = posture[i], posture[LEG_COUNT + i]
        else:
            for i, leg_rate in enumerate(read(self._leg_rate, context)):
                rate = state[LEG_COUNT + i]
                goal = leg_rate if np.isfinite(leg_rate) else 0.0
                faster = rate + clamp(goal - rate, -self._step, self._step)
                state[i] += 0.5 * self._period * (rate + faster)
                state[LEG_COUNT + i] = faster
        state[_STARTED] = float(all_finite(state[_EXTENSION]))
        discrete_state.set_value(np.array(state))


_PASSIVE = 3


class ContactKeeper(LeafSystem):
    """Trims the passive leg until all four contact switches are closed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension_desired_state` | 8 | m, m/s | what the kinematics asks for, Eq. (31) |
    | in `limits` | 12 | 0/1 | switches: extended, retracted, ground contact of each leg |
    | in `enable` | 1 | - | above 0.5: trim; otherwise the trim is zero |
    | out `extension_trimmed_state` | 8 | m, m/s | the same with the passive leg trimmed |
    | out `standing` | 4 | 0/1 | feet that stand, or have lifted a moment ago only |

    A platform whose fourth leg has the wrong length stands on one diagonal and rocks about it. If
    foot 2 or 4 is in the air, leg 4 is too short, and going down with it lowers both; if foot 1
    or 3 is, it is too long. So one leg brings back any of the four. It goes on for a little after
    the switch has closed, so that the foot carries something.

    A foot whose switch opens is not lost yet: the trim brings it back within moments, before it
    is further from the ground than that.

    State: discrete, the trim, its rate and what is left of the pressing (3) [m, m/s, m]; how long
    each switch has been open (4) [s]; updated every period. Rate and size of the trim are limited.

    Bad input: a switch that is NaN is open; a desired state that is not finite is passed on.
    """

    def __init__(
        self,
        rate: float = 5e-4,
        limit: float = 3e-3,
        press: float = 2e-5,
        patience: float = 0.5,
        period: float = 0.01,
    ):
        """Creates the keeper (all settings are design choices).

        Args:
            rate: rate of the trim [m/s]; 3 mm/s at the foot.
            limit: limit of the trim, either way [m].
            press: way beyond the closing of the switches [m]; a tenth of a millimetre at the foot.
            patience: time for which a switch may be open before its foot counts as lifted [s].
            period: period of the updates [s].
        """
        super().__init__()
        self.set_name("contact_keeper")
        self._rate, self._limit, self._press = rate, limit, press
        self._patience, self._period = patience, period
        self._desired = self.DeclareVectorInputPort("extension_desired_state", 2 * LEG_COUNT)
        self._limits = self.DeclareVectorInputPort("limits", 3 * LEG_COUNT)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        self._trim: Any = self.DeclareDiscreteState(3)
        self._open: Any = self.DeclareDiscreteState(LEG_COUNT)
        self.DeclareVectorOutputPort(
            "extension_trimmed_state",
            2 * LEG_COUNT,
            self._calc_trimmed_state,
            {self._desired.ticket(), self.discrete_state_ticket(self._trim)},
        )
        self.DeclareVectorOutputPort(
            "standing",
            LEG_COUNT,
            self._calc_standing,
            {self._limits.ticket(), self._enable.ticket(), self.discrete_state_ticket(self._open)},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_trim)

    def _contact(self, context: Context) -> list[bool]:
        return [switch > 0.5 for switch in read(self._limits, context)[2 * LEG_COUNT :]]

    def _calc_trimmed_state(self, context: Context, output: BasicVector) -> None:
        desired = read(self._desired, context)
        trim, rate, _ = elements(context.get_discrete_state(self._trim))
        desired[_PASSIVE] += trim
        desired[LEG_COUNT + _PASSIVE] += rate
        output.SetFromVector(np.array(desired))

    def _calc_standing(self, context: Context, output: BasicVector) -> None:
        patience = self._patience if is_on(self._enable, context) else 0.0
        times = elements(context.get_discrete_state(self._open))
        standing = [
            float(closed or since + self._period <= patience)
            for closed, since in zip(self._contact(context), times, strict=True)
        ]
        output.SetFromVector(np.array(standing))

    def _update_trim(self, context: Context, discrete_state: Any) -> None:
        if not is_on(self._enable, context):
            discrete_state.set_value(self._trim, np.zeros(3))
            discrete_state.set_value(self._open, np.full(LEG_COUNT, self._patience))
            return
        contact = self._contact(context)
        times = elements(context.get_discrete_state(self._open))
        times = [
            0.0 if closed else min(since + self._period, self._patience)
            for closed, since in zip(contact, times, strict=True)
        ]
        discrete_state.set_value(self._open, np.array(times))
        trim, _, time_left = elements(context.get_discrete_state(self._trim))
        # A shorter actuator is a longer leg.
        is_short, is_long = not (contact[1] and contact[3]), not (contact[0] and contact[2])
        if is_short or is_long:
            sign = float(is_long) - float(is_short)
            step, time_left = sign * self._rate * self._period, sign * self._press
        else:
            fastest = self._rate * self._period
            step = clamp(time_left, -fastest, fastest)
            time_left -= step
        trim_next = clamp(trim + step, -self._limit, self._limit)
        rate = (trim_next - trim) / self._period
        discrete_state.set_value(self._trim, np.array([trim_next, rate, time_left]))
