"""Drives that follow a velocity: motor, gear, encoder and positioning controller."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.caching import declare_cached
from parapod.systems.ports import is_on


@dataclass(frozen=True)
class VelocityServoParams:
    """Closed velocity loop of a motor on its controller.

    Attributes:
        resolution: one count of the encoder [m or rad]; 0 for a perfect one.
        time_constant: of the velocity loop [s].
        max_velocity: largest velocity [m/s or rad/s].
        acceleration: largest acceleration [m/s^2 or rad/s^2].
        stop_min: lower end stop of each drive, or of all of them [m or rad].
        stop_max: upper end stop, likewise.
    """

    resolution: float
    time_constant: float
    max_velocity: float
    acceleration: float = math.inf
    stop_min: float | tuple[float, ...] = -math.inf
    stop_max: float | tuple[float, ...] = math.inf


class VelocityServo(LeafSystem):
    """Drives that follow a velocity command, or brake.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `velocity_command` | n | m/s or rad/s | what the drives follow |
    | in `brake` | 1 | - | above 0.5: stop and hold |
    | out `position_measured` | n | m or rad | encoder: whole counts |
    | out `velocity_measured` | n | m/s or rad/s | counts per gate time |
    | out `position` | n | m or rad | where the drives are |
    | out `velocity` | n | m/s or rad/s | its rate |
    | out `state` | 2n | m or rad, and per s | positions and velocities |
    | out `next_state` | 2n | m or rad, and per s | positions and velocities one step ahead |

    State: discrete, positions and velocities (2n), updated every period: a first-order lag,
    dv/dt = (gain u + offset - v) / time_constant, exact for a command that is constant over the
    period, unless the acceleration is at its limit. A drive rests at its end stops. `next_state`
    lets an implicit plant arrive where the drive will be, instead of trailing it by a step.

    Parameters (Context): gains (n) [-] and offsets (n) [m/s or rad/s], see `set_imperfection`.

    Bad input: a command that is not finite counts as zero.
    """

    def __init__(
        self,
        params: VelocityServoParams,
        channels: int,
        period: float = 0.01,
        gate_time: float | None = None,
    ):
        """Declares the ports.

        Args:
            params: of each drive.
            channels: number of drives n.
            period: of the model [s].
            gate_time: over which the encoder's counts make a velocity [s]; None for the period.
        """
        super().__init__()
        self.set_name("velocity_servo")
        self.params, self._channels, self._period = params, channels, period
        self._gate_time = gate_time or period
        self._low = np.broadcast_to(np.asarray(params.stop_min, dtype=float), channels)
        self._high = np.broadcast_to(np.asarray(params.stop_max, dtype=float), channels)
        self._command = self.DeclareVectorInputPort("velocity_command", channels)
        self._brake = self.DeclareVectorInputPort("brake", 1)
        self._gain = self.DeclareNumericParameter(BasicVector(np.ones(channels)))
        self._offset = self.DeclareNumericParameter(BasicVector(np.zeros(channels)))
        start = np.concatenate((np.clip(0.0, self._low, self._high), np.zeros(channels)))
        index = self.DeclareDiscreteState(BasicVector(start))
        state = {self.discrete_state_ticket(index)}
        for name, calc in (
            ("position_measured", self._calc_position_measured),
            ("velocity_measured", self._calc_velocity_measured),
            ("position", self._calc_position),
            ("velocity", self._calc_velocity),
        ):
            self.DeclareVectorOutputPort(name, channels, calc, state)
        self.DeclareStateOutputPort("state", index)
        inputs = {self._command.ticket(), self._brake.ticket(), self.all_parameters_ticket()}
        self._next = declare_cached(self, "next", self._step, state | inputs)
        self.DeclareVectorOutputPort(
            "next_state", 2 * channels, self._calc_next_state, {self._next.ticket}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_state)

    def set_position(self, context: Context, position: ArrayLike) -> None:
        """Puts the drives at rest at the given positions (n) [m or rad]."""
        at = np.broadcast_to(np.asarray(position, dtype=float), self._channels)
        context.SetDiscreteState(0, np.concatenate((at, np.zeros(self._channels))))

    def set_imperfection(self, context: Context, gain: ArrayLike, offset: ArrayLike) -> None:
        """Lets the drives run off their command.

        Args:
            context: of this system.
            gain: (n) velocity by command [-].
            offset: (n) velocity at a command of zero [m/s or rad/s].
        """
        for parameter, value in ((self._gain, gain), (self._offset, offset)):
            vector: Any = context.get_mutable_numeric_parameter(parameter)
            vector.SetFromVector(np.broadcast_to(np.asarray(value, dtype=float), self._channels))

    def _halves(self, context: Context) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        state: Any = context.get_discrete_state_vector()
        values = state.value()
        return values[: self._channels], values[self._channels :]

    def _calc_position_measured(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(_counted(self._halves(context)[0], self.params.resolution))

    def _calc_velocity_measured(self, context: Context, output: BasicVector) -> None:
        resolution = self.params.resolution / self._gate_time
        output.SetFromVector(_counted(self._halves(context)[1], resolution))

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._halves(context)[0])

    def _calc_velocity(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._halves(context)[1])

    def _calc_next_state(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._next.of(self, context))

    def _update_state(self, context: Context, discrete_state: Any) -> None:
        discrete_state.set_value(self._next.of(self, context))

    def _step(self, context: Context) -> NDArray[np.float64]:
        """Positions and velocities after a period."""
        position, velocity = self._halves(context)
        braked = is_on(self._brake, context)
        if braked and not velocity.any():
            return np.concatenate((position, velocity))
        params, h = self.params, self._period
        change = -math.expm1(-h / params.time_constant) * (
            (0.0 if braked else self._goal(context)) - velocity
        )
        step = params.acceleration * h
        limited = np.clip(change, -step, step)
        # The lag's own integral where it is not limited, and a ramp's where it is.
        lag = velocity + change / -math.expm1(-h / params.time_constant)
        travel = np.where(
            limited == change,
            lag * h - params.time_constant * change,
            (velocity + 0.5 * limited) * h,
        )
        ahead = position + travel
        stopped = np.clip(ahead, self._low, self._high)
        return np.concatenate((stopped, np.where(stopped == ahead, velocity + limited, 0.0)))

    def _goal(self, context: Context) -> NDArray[np.float64]:
        """Velocities that the drives would reach in the end."""
        command: Any = self._command.Eval(context)
        limit = self.params.max_velocity
        wanted = np.clip(np.where(np.isfinite(command), command, 0.0), -limit, limit)
        gain: Any = context.get_numeric_parameter(self._gain)
        offset: Any = context.get_numeric_parameter(self._offset)
        return gain.value() * wanted + offset.value()


def _counted(values: NDArray[np.float64], count: float) -> NDArray[np.float64]:
    return np.round(values / count) * count if count else values
