"""Electric linear actuator: a DC motor behind a high reduction and a self-locking screw."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector_, Context, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from parapod.systems.elementwise import Elementwise, clamp, exp, log


@dataclass(frozen=True)
class LinearActuatorParams:
    """Constants of one actuator, all referred to the rod's linear motion.

    The paper gives K = K_m / nu = 0.01 (m/s)/V (Eq. 18) and that the load changes it by no more
    than 15 % (section 5.2); the split into the constants below is an assumption that has both.

    Attributes:
        model: "dynamic" for Eq. (15); "integrator" for the pure K/s of Eq. (17), which ignores
            inertia, friction and load.
        motor_constant: K_m, force per voltage [N/V].
        viscous_friction: nu_l, force per speed [N s/m].
        inertia: J_l, equivalent mass of rotor and gear [kg]; J_l / nu_l = 10 ms.
        coulomb_friction: Gamma^nlc without load [N].
        load_friction: additional Coulomb friction per newton of load [-]; 1 or more makes the
            screw self-locking, so that no load can drive it back.
        supply_voltage: largest voltage either way [V].
        stop_min: mechanical end stop, rod retracted [m].
        stop_max: mechanical end stop, rod extended [m].
    """

    model: Literal["dynamic", "integrator"] = "dynamic"
    motor_constant: float = 1.0e3
    viscous_friction: float = 1.0e5
    inertia: float = 1.0e3
    coulomb_friction: float = 200.0
    load_friction: float = 1.0
    supply_voltage: float = 12.0
    stop_min: float = 0.380
    stop_max: float = 0.460

    @property
    def gain(self) -> float:
        """K of Eq. (17), speed per voltage [(m/s)/V]."""
        return self.motor_constant / self.viscous_friction


def step(
    params: LinearActuatorParams,
    motor_constant: Elementwise,
    position: Elementwise,
    velocity: Elementwise,
    voltage: Elementwise,
    load_force: Elementwise,
    duration: float,
) -> tuple[Elementwise, Elementwise]:
    """Position and velocity after `duration` of constant voltage and load: Eq. (15) solved exactly.

    Between changes of direction the equation is linear; the instant at which the rod stops is
    found in closed form, and from there it sticks or leaves in the other direction.
    """
    voltage = clamp(voltage, -params.supply_voltage, params.supply_voltage)
    if params.model == "integrator":
        velocity = motor_constant / params.viscous_friction * voltage
        position = position + velocity * duration
    else:
        drive = motor_constant * voltage - load_force
        friction = params.coulomb_friction + params.load_friction * abs(load_force)
        position, velocity = _slide(params, position, velocity, drive, friction, duration)
    if position <= params.stop_min:
        return params.stop_min + 0.0 * position, 0.0 * velocity
    if position >= params.stop_max:
        return params.stop_max + 0.0 * position, 0.0 * velocity
    return position, velocity


def _slide(
    params: LinearActuatorParams,
    position: Elementwise,
    velocity: Elementwise,
    drive: Elementwise,
    friction: Elementwise,
    duration: float,
) -> tuple[Elementwise, Elementwise]:
    """Motion under a constant drive force and Coulomb friction, from one stop to the next."""
    nu, tau = params.viscous_friction, params.inertia / params.viscous_friction
    for _ in range(2):  # at most one change of direction
        if velocity == 0.0 and abs(drive) <= friction:
            break
        forwards = velocity > 0.0 or (velocity == 0.0 and drive > 0.0)
        limit = (drive - friction if forwards else drive + friction) / nu
        if tau == 0.0:
            # Without inertia the limit speed is taken at once, or the rod does not move.
            moves = limit > 0.0 if forwards else limit < 0.0
            return (position + limit * duration, limit) if moves else (position, 0.0 * limit)
        decay = exp(-duration / tau)
        end = limit + (velocity - limit) * decay
        if end >= 0.0 if forwards else end <= 0.0:
            return position + limit * duration + (velocity - limit) * tau * (1.0 - decay), end
        time_to_stop = tau * log((limit - velocity) / limit)
        position = position + limit * time_to_stop + velocity * tau
        duration = duration - time_to_stop
        velocity = 0.0 * velocity
    return position, velocity


@TemplateSystem.define("LinearActuator_")
def LinearActuator_(T: Any) -> Any:
    """Scalar-convertible form of `LinearActuator` (float, AutoDiffXd)."""

    class Impl(LeafSystem_[T]):
        """Linear actuators with inertia, friction, supply and end stops, Eqs. (15)-(18).

        | port | size | unit | meaning |
        |---|---|---|---|
        | in `voltage` | n | V | motor voltage, saturated at the supply |
        | in `load_force` | n | N | force the rod must exert to extend; unconnected: no load |
        | out `extension` | n | m | position of the rod |
        | out `velocity` | n | m/s | its rate |
        | out `next_state` | 2n | m, m/s | extensions and velocities one step ahead |

        State: discrete, extensions and velocities (2n), stepped exactly for inputs that are
        constant over the step. `next_state` lets an implicit plant arrive where the actuator
        will be, instead of trailing it by a step.

        Parameters (Context): motor constants K_m (n) [N/V], see `set_gain_scale`.

        Bad input: a NaN voltage counts as zero volts, a NaN load as no load. Positions never
        leave the end stops.
        """

        def _construct(
            self,
            params: LinearActuatorParams = LinearActuatorParams(),
            channels: int = 4,
            time_step: float = 1e-3,
            converter: Any = None,
        ) -> None:
            LeafSystem_[T].__init__(self, converter)
            self.set_name("linear_actuator")
            self.params, self.channels, self.time_step = params, channels, time_step
            n = channels
            self._voltage = self.DeclareVectorInputPort("voltage", n)
            self._load = self.DeclareVectorInputPort("load_force", n)
            self._gains = self.DeclareNumericParameter(
                BasicVector_[T](np.full(n, params.motor_constant))
            )
            middle = 0.5 * (params.stop_min + params.stop_max)
            state = self.DeclareDiscreteState(
                BasicVector_[T](np.concatenate((np.full(n, middle), np.zeros(n))))
            )
            ticket = {self.discrete_state_ticket(state)}
            self.DeclareVectorOutputPort("extension", n, self._calc_extension, ticket)
            self.DeclareVectorOutputPort("velocity", n, self._calc_velocity, ticket)
            self._next = self.DeclareVectorOutputPort(
                "next_state",
                2 * n,
                self._calc_next_state,
                ticket
                | {
                    self._voltage.ticket(),
                    self._load.ticket(),
                    self.all_parameters_ticket(),
                },
            )
            self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0.0, self._update_state)

        def _construct_copy(self, other: Any, converter: Any = None) -> None:
            Impl._construct(
                self, other.params, other.channels, other.time_step, converter=converter
            )

        def set_extension(self, context: Context, extension: ArrayLike) -> None:
            """Puts the rods at rest at the given extensions (n) [m]."""
            rest = np.concatenate((np.asarray(extension), np.zeros(self.channels)))
            context.SetDiscreteState(rest)

        def set_gain_scale(self, context: Context, scale: ArrayLike) -> None:
            """Multiplies the nominal motor constants by `scale` (n or scalar) [-]."""
            gains = self.params.motor_constant * np.broadcast_to(scale, self.channels)
            context.get_mutable_numeric_parameter(self._gains).SetFromVector(gains)

        def _calc_extension(self, context: Context, output: Any) -> None:
            output.SetFromVector(
                context.get_discrete_state_vector().CopyToVector()[: self.channels]
            )

        def _calc_velocity(self, context: Context, output: Any) -> None:
            output.SetFromVector(
                context.get_discrete_state_vector().CopyToVector()[self.channels :]
            )

        def _calc_next_state(self, context: Context, output: Any) -> None:
            n = self.channels
            state = context.get_discrete_state_vector().CopyToVector().tolist()
            voltages = self._voltage.Eval(context).tolist()
            loads = (
                self._load.Eval(context).tolist() if self._load.HasValue(context) else [0.0] * n
            )
            gains = context.get_numeric_parameter(self._gains).CopyToVector().tolist()
            result: list[Any] = [0.0] * (2 * n)
            for i in range(n):
                voltage, load = voltages[i], loads[i]
                result[i], result[n + i] = step(
                    self.params,
                    gains[i],
                    state[i],
                    state[n + i],
                    voltage if voltage == voltage else 0.0,
                    load if load == load else 0.0,
                    self.time_step,
                )
            output.SetFromVector(result)

        def _update_state(self, context: Context, discrete_state: Any) -> None:
            discrete_state.set_value(self._next.Eval(context))

    return Impl


LinearActuator = LinearActuator_[None]
