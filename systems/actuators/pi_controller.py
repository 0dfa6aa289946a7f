"""PI position controller of an actuator that integrates its voltage, Eqs. (19)-(21)."""

import math
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import (  # type: ignore[attr-defined]
    BasicVector_,
    Context,
)
from pydrake.systems.scalar_conversion import TemplateSystem

from parapod.systems.core.elementwise import Elementwise, either, where
from parapod.systems.core.leaf_system import LeafSystem_
from parapod.systems.core.ports import elements, has_value, is_on, read
from parapod.systems.core.rows import each
from parapod.systems.core.templates import for_floats


@dataclass(frozen=True)
class PiControllerParams:
    """Design of the controller R(s) = (K_p + K_v s) / s by pole placement.

    Attributes:
        gain: K of the plant K/s [(m/s)/V] (Eq. 18).
        pole: p, both closed-loop poles lie at -p [rad/s] (section 6.4).
        voltage_limit: saturation of the output [V].
        rate_feedforward: share of the desired rate that is fed forward as rate / K [-];
            0 is the paper's law, 1 removes the lag behind an accelerating reference.
        friction_feedforward: voltages that overcome friction and load when extending and when
            retracting [V]; zero in the paper's law. Added in proportion to rate /
            (|rate| + friction_rate), so that it fades in and out with the motion.
        friction_rate: rate at which half of it is added [m/s].
        error_limit: an error beyond it is a sensor's and not the actuator's [m].
        gain_share: gain of each channel's plant as a share of `gain` [-]; empty for 1.
    """

    gain: float = 0.01
    pole: float = 10.0
    voltage_limit: float = 10.0
    rate_feedforward: float = 0.0
    friction_feedforward: tuple[float, float] = (0.0, 0.0)
    friction_rate: float = 1e-5
    error_limit: float = math.inf
    gain_share: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not all(math.isfinite(share) and share > 0.0 for share in self.gain_share):
            raise ValueError(f"gain_share must be positive, not {self.gain_share}")

    @property
    def k_p(self) -> float:
        """Integral gain p^2 / K [V/(m s)]: 10 000 in Eq. (32)."""
        return self.pole**2 / self.gain

    @property
    def k_v(self) -> float:
        """Proportional gain 2 p / K [V/m]: 2 000 in Eq. (32)."""
        return 2.0 * self.pole / self.gain


@TemplateSystem.define("PiController_", scope=sys.modules[__name__])
def PiController_(T: Any) -> Any:
    """Scalar-convertible form of `PiController` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """Sampled PI controllers, one a channel, with saturation, anti-windup and bumpless start.

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `desired_state` | 2n | m, m/s | desired positions and their rates |
        | in `measured` | n | m | measured positions |
        | in `enable` | 1 | - | above 0.5: control; otherwise 0 V; unconnected: always control |
        | out `voltage` | n | V | commands, held between samples, within the limit |

        State: discrete, voltages (n) [V]; integrals (n) [V] and whether in control (n). Integrals
        are held while the output is saturated and integration would drive it further out
        (conditional integration). When control begins, the integrals are set so that the first
        voltage is the last one held: nothing jumps, however far the reference is.

        Parameters (Context): K_p, K_v, voltage limit (3); a channel whose plant has another gain
        divides K_p, K_v and the rate's feedforward by its share.

        Bad input: a channel with a NaN or infinite input, or an error beyond its limit, outputs
        0 V and keeps its integral.
        """

        def _construct(
            self,
            params: PiControllerParams = PiControllerParams(),
            channels: int = 4,
            period: float = 0.01,
            converter: Any = None,
        ) -> None:
            LeafSystem_[T].__init__(self, converter)
            self.set_name("pi_controller")
            self.params, self.channels, self.period = params, channels, period
            if len(params.gain_share) not in (0, channels):
                raise ValueError(
                    f"gain_share must have {channels} elements or none, "
                    f"not {len(params.gain_share)}"
                )
            self._share = params.gain_share or (1.0,) * channels
            self._per_rate = params.rate_feedforward / params.gain
            self._error_limit = params.error_limit
            self._friction, self._fades_at = params.friction_feedforward, params.friction_rate
            n = channels
            self._desired = self.DeclareVectorInputPort("desired_state", 2 * n)
            self._measured = self.DeclareVectorInputPort("measured", n)
            self._enable = self.DeclareVectorInputPort("enable", 1)
            self._gains = self.DeclareNumericParameter(
                BasicVector_[T]([params.k_p, params.k_v, params.voltage_limit])
            )
            voltage = self.DeclareDiscreteState(BasicVector_[T](np.zeros(n)))
            self.DeclareDiscreteState(BasicVector_[T](np.zeros(2 * n)))
            self.DeclareStateOutputPort("voltage", voltage)
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_voltage)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(self, other.params, other.channels, other.period, converter=converter)

        def _update_voltage(self, context: Context, discrete_state: Any) -> None:
            n = self.channels
            if has_value(self._enable, context) and not is_on(self._enable, context):
                discrete_state.set_value(0, np.zeros(n))
                inner = elements(context.get_discrete_state(1))
                inner[n:] = [0.0] * n
                discrete_state.set_value(1, np.array(inner))
                return
            voltages = elements(context.get_discrete_state(0))
            inner = elements(context.get_discrete_state(1))
            k_p, k_v, limit = elements(context.get_numeric_parameter(self._gains))
            desired = read(self._desired, context)
            measured = read(self._measured, context)
            gains = [k_p * self.period] * n, [k_v] * n, [limit] * n, self._share
            state = each(
                self._channel,
                *gains,
                voltages,
                inner[:n],
                inner[n:],
                desired[:n],
                desired[n:],
                measured,
            )
            commands, integrals, in_control = zip(*state, strict=True)
            discrete_state.set_value(0, np.array(commands))
            discrete_state.set_value(1, np.array(integrals + in_control))

        def _channel(
            self,
            k_i: Elementwise,
            k_v: Elementwise,
            limit: Elementwise,
            share: float,
            voltage: Elementwise,
            integral: Elementwise,
            in_control: Elementwise,
            desired: Elementwise,
            rate: Elementwise,
            measured: Elementwise,
        ) -> tuple[Elementwise, Elementwise, Elementwise]:
            """Next voltage and integral of a channel, and whether it is in control."""
            error = desired - measured
            friction = where(rate > 0.0, *self._friction)
            feedforward = rate * (self._per_rate / share + friction / (abs(rate) + self._fades_at))
            direct = k_v / share * error + feedforward
            # The difference is NaN where it is not finite.
            if either(direct - direct != 0.0, abs(error) > self._error_limit):
                return 0.0 * k_i, integral, in_control
            if not in_control > 0.5:
                integral = voltage - direct
            voltage = direct + integral
            is_within = abs(voltage) <= limit
            integrates = either(is_within, voltage * error < 0.0)
            integral = where(integrates, integral + k_i / share * error, integral)
            saturated = where(voltage > limit, limit, -limit)
            return where(is_within, voltage, saturated), integral, 1.0

    return Impl


PiController = for_floats(PiController_)
