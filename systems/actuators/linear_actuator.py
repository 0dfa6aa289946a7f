"""Electric linear actuator: a DC motor behind a high reduction and a self-locking screw."""

import math
import sys
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import (  # type: ignore[attr-defined]
    BasicVector_,
    Context,
)
from pydrake.systems.scalar_conversion import TemplateSystem

from parapod.systems.core.elementwise import (
    Elementwise,
    both,
    clamp,
    either,
    exp,
    greatest,
    least,
    log,
    negated,
    where,
)
from parapod.systems.core.leaf_system import LeafSystem_
from parapod.systems.core.ports import elements, has_value, is_safe, read, read_array
from parapod.systems.core.rows import each
from parapod.systems.core.templates import for_floats


@dataclass(frozen=True)
class LinearActuatorParams:
    """Constants of one actuator, all referred to the rod's linear motion.

    The paper gives K = K_m / nu = 0.01 (m/s)/V (Eq. 18) and finds it within 15 % for ten voltage
    steps with and without load (section 5.2). The split into the constants below is an
    assumption that has both, with a load of 0.74 kN on each actuator.

    Attributes:
        model: "dynamic" for Eq. (15); "integrator" for the pure K/s of Eq. (17), which ignores
            inertia, friction and load.
        motor_constant: K_m, force per voltage [N/V].
        viscous_friction: nu_l, force per speed, mostly the motor's back-EMF [N s/m].
        inertia: J_l, equivalent mass of rotor and gear [kg]; J_l / nu_l = 10 ms.
        coulomb_friction: Gamma^nlc without load [N].
        screw_efficiency: eta of the screw when it lifts a load [-]. A load against the motion
            counts load / eta, one along it load (2 - 1 / eta), the rule for screws; at 0.5 and
            below the screw is self-locking: no load drives it back, and none helps.
        supply_voltage: largest voltage either way [V].
        stop_min: mechanical end stop, rod retracted [m].
        stop_max: mechanical end stop, rod extended [m].
    """

    model: Literal["dynamic", "integrator"] = "dynamic"
    motor_constant: float = 2.0e4
    viscous_friction: float = 2.0e6
    inertia: float = 2.0e4
    coulomb_friction: float = 1.0e3
    screw_efficiency: float = 0.5
    supply_voltage: float = 12.0
    stop_min: float = 0.380
    stop_max: float = 0.460

    @property
    def gain(self) -> float:
        """K of Eq. (17), speed per voltage [(m/s)/V]."""
        return self.motor_constant / self.viscous_friction

    @property
    def time_constant(self) -> float:
        """J_l / nu_l of Eq. (15) [s]."""
        return self.inertia / self.viscous_friction


# Larger loads than any actuator bears, which would overflow, count as zero [N].
_LARGEST_LOAD = 1e12


class Stepper:
    """Steps one actuator: Eq. (15) solved exactly for constant voltage and load.

    Between changes of direction the equation is linear; the instant at which the rod stops is
    found in closed form, and from there it sticks or leaves in the other direction. What depends
    on the parameters and the duration alone is computed once.

    Args:
        params: the actuator.
        duration: duration of a step [s].
    """

    def __init__(self, params: LinearActuatorParams, duration: float):
        self._params, self._duration = params, duration
        self._constants = (
            params.model == "integrator",
            params.supply_voltage,
            params.viscous_friction,
            params.coulomb_friction,
            params.stop_min,
            params.stop_max,
        )
        self._tau = params.inertia / params.viscous_friction
        self._decay = math.exp(-duration / self._tau) if self._tau > 0.0 else 0.0
        # What a newton of load takes from the motor when the rod moves against it, and along it.
        self._against = 1.0 / params.screw_efficiency
        self._along = max(0.0, 2.0 - 1.0 / params.screw_efficiency)

    def step(
        self,
        motor_constant: Elementwise,
        position: Elementwise,
        velocity: Elementwise,
        voltage: Elementwise,
        load_force: Elementwise,
    ) -> tuple[Elementwise, Elementwise]:
        """Position and velocity after a step that begins with these.

        Args:
            motor_constant: K_m [N/V].
            position: [m].
            velocity: [m/s].
            voltage: saturated at the supply here [V].
            load_force: force that the rod must exert to extend [N].
        """
        is_integrator, supply, nu, coulomb, low, high = self._constants
        voltage = clamp(voltage, -supply, supply)
        force = motor_constant * voltage
        if is_integrator:
            velocity = force / nu
            position = position + velocity * self._duration
        else:
            lifts = load_force > 0.0
            extending = coulomb + where(lifts, self._against, self._along) * load_force
            retracting = coulomb - where(lifts, self._along, self._against) * load_force
            sticks = both(-retracting <= force, force <= extending)
            if both(velocity == 0.0, sticks):
                return position, velocity
            position, velocity = self._slide(position, velocity, force, extending, retracting)
        if both(low < position, position < high):
            return position, velocity
        stop = where(position <= low, low, high)
        return stop + 0.0 * position, 0.0 * velocity

    def _slide(
        self,
        position: Elementwise,
        velocity: Elementwise,
        force: Elementwise,
        extending: Elementwise,
        retracting: Elementwise,
    ) -> tuple[Elementwise, Elementwise]:
        """Motion under a constant motor force and constant resistances to either direction."""
        nu, tau = self._params.viscous_friction, self._tau
        duration, decay = self._duration, self._decay
        if tau == 0.0:
            # Without inertia the limit speed is taken at once, or the rod does not move.
            excess = greatest(0.0, force - extending) + least(0.0, force + retracting)
            return position + excess / nu * duration, excess / nu
        for _ in range(2):  # at most one change of direction
            extends = either(velocity > 0.0, both(velocity == 0.0, force > extending))
            limit = where(extends, force - extending, force + retracting) / nu
            end = limit + (velocity - limit) * decay
            if either(both(extends, end >= 0.0), both(negated(extends), end <= 0.0)):
                return position + limit * duration + (velocity - limit) * tau * (1.0 - decay), end
            time_to_stop = tau * log((limit - velocity) / limit)
            position = position + limit * time_to_stop + velocity * tau
            velocity = 0.0 * velocity
            if both(-retracting <= force, force <= extending):
                break
            duration = duration - time_to_stop
            decay = exp(-duration / tau)
        return position, velocity


@TemplateSystem.define("LinearActuator_", scope=sys.modules[__name__])
def LinearActuator_(T: Any) -> Any:
    """Scalar-convertible form of `LinearActuator` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """Linear actuators with inertia, friction, supply and end stops, Eqs. (15)-(18).

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `voltage` | n | V | motor voltage, saturated at the supply |
        | in `load_force` | n | N | force the rod must exert to extend; unconnected: no load |
        | in `stop` | 1 | - | above 0.5: the supply is cut; unconnected: never |
        | out `extension` | n | m | position of the rod |
        | out `velocity` | n | m/s | its rate |
        | out `next_state` | 2n | m, m/s | extensions and velocities one step ahead |

        State: discrete, extensions (n) and velocities (n), stepped exactly for inputs that are
        constant over the step. `next_state` lets an implicit plant arrive where the actuator
        will be, instead of trailing it by a step.

        Parameters (Context): motor constants K_m (n) [N/V], see `set_gain_scale`.

        Bad input: a NaN voltage counts as zero volts; a load that is not finite, or beyond 1e12
        N, counts as no load. A stop that is near neither 0 nor 1 cuts the supply.
        Positions never leave the end stops.
        """

        def _construct(  # noqa: D417 (`for_floats` hides the converter)
            self,
            params: LinearActuatorParams = LinearActuatorParams(),
            channels: int = 4,
            time_step: float = 1e-3,
            extension: ArrayLike | None = None,
            gain_scale: ArrayLike = 1.0,
            converter: Any = None,
        ) -> None:
            """Creates the actuators.

            Args:
                params: each actuator.
                channels: number of actuators n.
                time_step: step [s].
                extension: extensions (n or scalar) in a default context, where the rods are at
                    rest [m]; None for the middle of the stroke.
                gain_scale: factor (n or scalar) of the nominal motor constants in a default
                    context [-].
            """
            LeafSystem_[T].__init__(self, converter)
            self.set_name("linear_actuator")
            self.params, self.channels = params, channels
            self.time_step = time_step
            self._stepper = Stepper(params, time_step)
            n = channels
            self._voltage = self.DeclareVectorInputPort("voltage", n)
            self._load = self.DeclareVectorInputPort("load_force", n)
            self._stop = self.DeclareVectorInputPort("stop", 1)
            middle = 0.5 * (params.stop_min + params.stop_max)
            self._begins_at = self._each(middle if extension is None else extension)
            self._gain_scale = self._each(gain_scale)
            self._gains = self.DeclareNumericParameter(
                BasicVector_[T](self._scaled_gains(self._gain_scale))
            )
            position = self.DeclareDiscreteState(BasicVector_[T](self._begins_at))
            velocity = self.DeclareDiscreteState(BasicVector_[T](np.zeros(n)))
            self.DeclareStateOutputPort("extension", position)
            self.DeclareStateOutputPort("velocity", velocity)
            self._next = self.DeclareVectorOutputPort(
                "next_state",
                2 * n,
                self._calc_next_state,
                {
                    self.xd_ticket(),
                    self._voltage.ticket(),
                    self._load.ticket(),
                    self._stop.ticket(),
                    self.all_parameters_ticket(),
                },
            )
            self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0.0, self._update_state)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(
                self,
                other.params,
                other.channels,
                other.time_step,
                other._begins_at,
                other._gain_scale,
                converter=converter,
            )

        def set_extension(self, context: Context, extension: ArrayLike) -> None:
            """Puts the rods at rest at the given extensions (n) [m]."""
            context.SetDiscreteState(0, self._each(extension))
            context.SetDiscreteState(1, np.zeros(self.channels))

        def set_gain_scale(self, context: Context, scale: ArrayLike) -> None:
            """Multiplies the nominal motor constants by `scale` (n or scalar) [-]."""
            gains = self._scaled_gains(self._each(scale))
            context.get_mutable_numeric_parameter(self._gains).SetFromVector(gains)

        def _each(self, value: ArrayLike) -> NDArray[np.float64]:
            return np.broadcast_to(np.asarray(value, dtype=float), self.channels).copy()

        def _scaled_gains(self, scale: NDArray[np.float64]) -> NDArray[np.float64]:
            return self.params.motor_constant * scale

        def _calc_next_state(self, context: Context, output: Any) -> None:
            positions = elements(context.get_discrete_state(0))
            velocities = elements(context.get_discrete_state(1))
            gains = elements(context.get_numeric_parameter(self._gains))
            voltages = read(self._voltage, context)
            if has_value(self._stop, context) and is_safe(self._stop, context):
                voltages = [0.0] * self.channels
            loaded = has_value(self._load, context)
            loads = read(self._load, context) if loaded else [0.0] * self.channels
            ahead = each(self._stepped, gains, positions, velocities, voltages, loads)
            positions, velocities = map(list, zip(*ahead, strict=True))
            output.SetFromVector(np.array(positions + velocities))

        def _stepped(
            self,
            gain: Elementwise,
            position: Elementwise,
            velocity: Elementwise,
            voltage: Elementwise,
            load: Elementwise,
        ) -> tuple[Elementwise, Elementwise]:
            """An actuator a step ahead."""
            voltage = where(voltage != voltage, 0.0, voltage)
            is_load = both(load > -_LARGEST_LOAD, load < _LARGEST_LOAD)
            load = where(is_load, load, 0.0)
            return self._stepper.step(gain, position, velocity, voltage, load)

        def _update_state(self, context: Context, discrete_state: Any) -> None:
            ahead = read_array(self._next, context)
            discrete_state.set_value(0, ahead[: self.channels])
            discrete_state.set_value(1, ahead[self.channels :])

    return Impl


LinearActuator = for_floats(LinearActuator_)
