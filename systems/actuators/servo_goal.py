"""What a velocity-controlled drive aims at: its command within all that limits it."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.ports import is_on, read_array


@dataclass(frozen=True)
class VelocityServoParams:
    """Closed velocity loop of a motor on its controller.

    Attributes:
        resolution: one count of the encoder [m or rad]; 0 for a perfect one.
        time_constant: of the velocity loop [s].
        max_velocity: largest velocity [m/s or rad/s].
        acceleration: largest acceleration [m/s^2 or rad/s^2].
        stop_min: lower end of the stroke of each drive, or of all of them [m or rad].
        stop_max: upper end, likewise.
    """

    resolution: float
    time_constant: float
    max_velocity: float
    acceleration: float = math.inf
    stop_min: float | tuple[float, ...] = -math.inf
    stop_max: float | tuple[float, ...] = math.inf


class ServoGoal(LeafSystem):
    """Velocities that drives tend to: commands, as far as speed, acceleration and stroke allow.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `velocity_command` | n | m/s or rad/s | what the drives follow |
    | in `brake` | 1 | - | above 0.5: stop and hold |
    | in `state` | 2n | m or rad, and per s | positions and velocities of the drives |
    | out `goal` | n | m/s or rad/s | gain u + offset, limited; 0 when braked |

    With a goal g over a period T and none after it, a drive with the lag tau comes to rest
    T g + tau v further on: that must be within its stroke. In a period the lag changes the
    velocity by (1 - exp(-T / tau)) (g - v): that must be within the acceleration.

    State: none; the goal is to be sampled every period.

    Parameters (Context): gains (n) [-] and offsets (n) [m/s or rad/s], see `set_imperfection`.

    Bad input: a command that is not finite counts as zero.

    Args:
        params: of each drive.
        channels: number of drives n.
        period: for which a goal's limits hold [s].
    """

    def __init__(self, params: VelocityServoParams, channels: int, period: float = 0.01):
        super().__init__()
        self.set_name("servo_goal")
        self._params, self._channels, self._period = params, channels, period
        self._share = -math.expm1(-period / params.time_constant)
        self._low = np.broadcast_to(np.asarray(params.stop_min, dtype=float), channels)
        self._high = np.broadcast_to(np.asarray(params.stop_max, dtype=float), channels)
        self._command = self.DeclareVectorInputPort("velocity_command", channels)
        self._brake = self.DeclareVectorInputPort("brake", 1)
        self._state = self.DeclareVectorInputPort("state", 2 * channels)
        self._gain = self.DeclareNumericParameter(BasicVector(np.ones(channels)))
        self._offset = self.DeclareNumericParameter(BasicVector(np.zeros(channels)))
        inputs = {port.ticket() for port in (self._command, self._brake, self._state)}
        self.DeclareVectorOutputPort(
            "goal", channels, self._calc_goal, inputs | {self.all_parameters_ticket()}
        )

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

    def _calc_goal(self, context: Context, output: BasicVector) -> None:
        braked = is_on(self._brake, context)
        state = read_array(self._state, context)
        position, velocity = state[: self._channels], state[self._channels :]
        if braked and not velocity.any():
            output.SetZero()
            return
        resting = position + self._params.time_constant * velocity
        low, high = (self._low - resting) / self._period, (self._high - resting) / self._period
        if math.isfinite(self._params.acceleration):
            change = self._params.acceleration * self._period / self._share
            low, high = np.maximum(low, velocity - change), np.minimum(high, velocity + change)
        # A drive that is beyond an end, or too fast for it, does what it can.
        output.SetFromVector(np.minimum(np.maximum(self._wanted(context, braked), low), high))

    def _wanted(self, context: Context, braked: bool) -> NDArray[np.float64]:
        if braked:
            return np.zeros(self._channels)
        command, fastest = read_array(self._command, context), self._params.max_velocity
        if not np.isfinite(command).all():
            command = np.where(np.isfinite(command), command, 0.0)
        wanted = np.minimum(np.maximum(command, -fastest), fastest)
        gain: Any = context.get_numeric_parameter(self._gain)
        offset: Any = context.get_numeric_parameter(self._offset)
        return gain.value() * wanted + offset.value()
