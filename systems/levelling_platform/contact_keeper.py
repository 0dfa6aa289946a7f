"""Keeps four feet on the ground by their switches, and not by calculation alone."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.elementwise import clamp
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.ports import elements, is_on, read

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

    Bad input: a switch that is NaN is open.
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
            rate: of the trim [m/s]; 3 mm/s at the foot.
            limit: of the trim, either way [m].
            press: how far it goes on when the switches are closed again [m]; a tenth of a
                millimetre at the foot.
            patience: how long a switch may be open before its foot counts as lifted [s].
            period: of the updates [s].
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
        trim, _, left = elements(context.get_discrete_state(self._trim))
        # A shorter actuator is a longer leg.
        is_short, is_long = not (contact[1] and contact[3]), not (contact[0] and contact[2])
        if is_short or is_long:
            sign = float(is_long) - float(is_short)
            step, left = sign * self._rate * self._period, sign * self._press
        else:
            fastest = self._rate * self._period
            step = clamp(left, -fastest, fastest)
            left -= step
        moved = clamp(trim + step, -self._limit, self._limit)
        rate = (moved - trim) / self._period
        discrete_state.set_value(self._trim, np.array([moved, rate, left]))
