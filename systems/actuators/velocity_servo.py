"""Drives that follow a velocity: motor, gear, encoder and positioning controller."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import (
    BasicVector,
    Context,
    Diagram,
    DiagramBuilder,
    OutputPort,
)
from pydrake.systems.primitives import (
    Adder,
    Demultiplexer,
    LinearSystem,
    MatrixGain,
    ZeroOrderHold,
)

from parapod.systems.core.elementwise import Elementwise, greatest, is_finite, least, where
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, is_safe, read
from parapod.systems.core.rows import each
from parapod.systems.sensors.encoder import Encoder


@dataclass(frozen=True)
class VelocityServoParams:
    """Closed velocity loop of a motor on its controller.

    Attributes:
        resolution: one count of the encoder [m or rad]; 0 for a perfect one.
        time_constant: time constant of the velocity loop [s].
        max_velocity: largest velocity [m/s or rad/s].
        acceleration: largest acceleration [m/s^2 or rad/s^2].
        stop_min: lower end of the stroke of each drive, or of all of them [m or rad].
        stop_max: upper end, in the same unit.
    """

    resolution: float
    time_constant: float
    max_velocity: float
    acceleration: float = math.inf
    stop_min: float | tuple[float, ...] = -math.inf
    stop_max: float | tuple[float, ...] = math.inf

    def exact(self) -> "VelocityServoParams":
        """The same without counts, without lag and with any acceleration."""
        return replace(self, resolution=0.0, time_constant=1e-9, acceleration=math.inf)


def _each(value: ArrayLike, channels: int) -> NDArray[np.float64]:
    return np.broadcast_to(np.asarray(value, dtype=float), channels).copy()


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

    Bad input: a command that is not finite counts as zero; of a state that is not finite, the
    goal is not either. A brake that is near neither 0 nor 1 brakes.

    Args:
        params: parameters of each drive.
        channels: number of drives n.
        period: for which a goal's limits hold [s].
        gain: gains (n or scalar) in a default context [-].
        offset: offsets (n or scalar) in a default context [m/s or rad/s].
    """

    def __init__(
        self,
        params: VelocityServoParams,
        channels: int,
        period: float = 0.01,
        gain: ArrayLike = 1.0,
        offset: ArrayLike = 0.0,
    ):
        super().__init__()
        self.set_name("servo_goal")
        self._params, self._channels, self._period = params, channels, period
        self._share = -math.expm1(-period / params.time_constant)
        self._low = _each(params.stop_min, channels).tolist()
        self._high = _each(params.stop_max, channels).tolist()
        self._change = params.acceleration * period / self._share
        self._command = self.DeclareVectorInputPort("velocity_command", channels)
        self._brake = self.DeclareVectorInputPort("brake", 1)
        self._state = self.DeclareVectorInputPort("state", 2 * channels)
        self._gain = self.DeclareNumericParameter(BasicVector(_each(gain, channels)))
        self._offset = self.DeclareNumericParameter(BasicVector(_each(offset, channels)))
        inputs = {port.ticket() for port in (self._command, self._brake, self._state)}
        self.DeclareVectorOutputPort(
            "goal", channels, self._calc_goal, inputs | {self.all_parameters_ticket()}
        )

    def set_imperfection(self, context: Context, gain: ArrayLike, offset: ArrayLike) -> None:
        """Lets the drives run off their command.

        Args:
            context: context of this system.
            gain: (n) velocity by command [-].
            offset: (n) velocity at a command of zero [m/s or rad/s].
        """
        for parameter, value in ((self._gain, gain), (self._offset, offset)):
            vector: Any = context.get_mutable_numeric_parameter(parameter)
            vector.SetFromVector(_each(value, self._channels))

    def _calc_goal(self, context: Context, output: BasicVector) -> None:
        braked, n = is_safe(self._brake, context), self._channels
        state = read(self._state, context)
        position, velocity = state[:n], state[n:]
        if braked and not any(velocity):
            output.SetZero()
            return
        goal = self._wanted(context, braked)
        goals = each(self._goal, goal, position, velocity, self._low, self._high)
        output.SetFromVector(np.array(goals))

    def _goal(
        self,
        goal: Elementwise,
        position: Elementwise,
        velocity: Elementwise,
        low: float,
        high: float,
    ) -> Elementwise:
        """Goal of one drive between its stops."""
        resting = position + self._params.time_constant * velocity
        low = greatest((low - resting) / self._period, velocity - self._change)
        high = least((high - resting) / self._period, velocity + self._change)
        # A drive that is beyond an end, or too fast for it, does what it can.
        return where(is_finite(resting), least(greatest(goal, low), high), math.nan)

    def _wanted(self, context: Context, braked: bool) -> list[Elementwise]:
        if braked:
            return [0.0] * self._channels
        command = read(self._command, context)
        gain: Any = context.get_numeric_parameter(self._gain)
        offset: Any = context.get_numeric_parameter(self._offset)
        return each(self._driven, command, elements(gain), elements(offset))

    def _driven(self, command: Elementwise, gain: Elementwise, offset: Elementwise) -> Elementwise:
        """Velocity to which a command leads."""
        fastest = self._params.max_velocity
        within = least(greatest(command, -fastest), fastest)
        return gain * where(is_finite(command), within, 0.0) + offset


class VelocityServo(Diagram):
    """Drives that follow a velocity command, or brake.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `velocity_command` | n | m/s or rad/s | what the drives follow |
    | in `brake` | 1 | - | above 0.5: stop and hold |
    | out `position_measured` | n | m or rad | encoder: whole counts |
    | out `velocity_measured` | n | m/s or rad/s | counts per gate time |
    | out `position` | n | m or rad | where the drives are |
    | out `state` | 2n | m or rad, and per s | positions and velocities |
    | out `next_state` | 2n | m or rad, and per s | positions and velocities one step ahead |

    The drives are a lag of first order, dv/dt = (g - v) / time_constant, exact for the goals g
    (`ServoGoal`) that are sampled every period. `next_state` lets an implicit plant arrive where
    the drive will be, instead of trailing it by a step.

    Where the lag has a shorter step than the period, goals are held in between. Any discrete
    update makes everything that depends on discrete state be evaluated anew, so that without the
    hold a controller would be evaluated at every step of the lag; with it, nothing is computed
    in Python between two samples.

    State: of the lag and of the hold.

    Bad input: a command that is not finite counts as zero; a brake that is near neither 0 nor 1
    brakes.
    """

    def __init__(
        self,
        params: VelocityServoParams,
        channels: int,
        period: float = 0.01,
        time_step: float | None = None,
        position: ArrayLike = 0.0,
        gain: ArrayLike = 1.0,
        offset: ArrayLike = 0.0,
    ):
        """Builds the diagram.

        Args:
            params: parameters of each drive.
            channels: number of drives n.
            period: at which commands are taken, and over which the encoder's counts make a
                velocity [s].
            time_step: time step of the lag [s]; None for the period.
            position: positions (n or scalar) in a default context, where the drives are at rest
                [m or rad].
            gain: gains (n or scalar) in a default context, see `set_imperfection` [-].
            offset: offsets (n or scalar) in a default context [m/s or rad/s].
        """
        super().__init__()
        self.params, self._channels = params, channels
        builder = DiagramBuilder()
        self._goal = ServoGoal(params, channels, period, gain, offset)
        builder.AddSystem(self._goal)
        goal = self._goal.get_output_port()
        if time_step is not None and time_step < period:
            hold = builder.AddSystem(ZeroOrderHold(period, channels))
            builder.Connect(goal, hold.get_input_port())
            goal = hold.get_output_port()
        self._lag, ahead = self._add_lag(builder, goal, time_step or period)
        self._lag.configure_default_state(self._at_rest(position))
        builder.Connect(self._lag.get_output_port(), self._goal.GetInputPort("state"))
        parts = builder.AddSystem(Demultiplexer(2 * channels, channels))
        builder.Connect(self._lag.get_output_port(), parts.get_input_port(0))
        encoder = builder.AddSystem(Encoder(channels, params.resolution, period))
        for i, name in enumerate(("position", "velocity")):
            builder.Connect(parts.get_output_port(i), encoder.GetInputPort(name))
        for name in ("velocity_command", "brake"):
            builder.ExportInput(self._goal.GetInputPort(name), name)
        for name in ("position_measured", "velocity_measured"):
            builder.ExportOutput(encoder.GetOutputPort(name), name)
        builder.ExportOutput(parts.get_output_port(0), "position")
        builder.ExportOutput(self._lag.get_output_port(), "state")
        builder.ExportOutput(ahead, "next_state")
        builder.BuildInto(self)
        self.set_name("velocity_servo")

    def set_position(self, context: Context, position: ArrayLike) -> None:
        """Puts the drives at rest at the given positions (n) [m or rad]."""
        lag = self._lag.GetMyMutableContextFromRoot(context)
        lag.SetDiscreteState(self._at_rest(position))

    def set_imperfection(self, context: Context, gain: ArrayLike, offset: ArrayLike) -> None:
        """Lets the drives run off their command, see `ServoGoal.set_imperfection`."""
        self._goal.set_imperfection(self._goal.GetMyMutableContextFromRoot(context), gain, offset)

    def _at_rest(self, position: ArrayLike) -> NDArray[np.float64]:
        return np.concatenate((_each(position, self._channels), np.zeros(self._channels)))

    def _add_lag(
        self, builder: DiagramBuilder, goal: OutputPort, time_step: float
    ) -> tuple[LinearSystem, OutputPort]:
        """The lag, and its state one step ahead."""
        tau, each = self.params.time_constant, np.eye(self._channels)
        share = -math.expm1(-time_step / tau)
        by_state: Any = np.kron([[1.0, tau * share], [0.0, 1.0 - share]], each)
        by_goal: Any = np.kron([[time_step - tau * share], [share]], each)
        both, none = np.eye(2 * self._channels), np.zeros_like(by_goal)
        lag = LinearSystem(by_state, by_goal, both, none, time_step)
        builder.AddSystem(lag)
        lag.set_name("lag")
        builder.Connect(goal, lag.get_input_port())
        ahead = builder.AddSystem(Adder(2, 2 * self._channels))
        terms = ((by_state, lag.get_output_port()), (by_goal, goal))
        for i, (matrix, source) in enumerate(terms):
            part = builder.AddSystem(MatrixGain(matrix))
            builder.Connect(source, part.get_input_port())
            builder.Connect(part.get_output_port(), ahead.get_input_port(i))
        return lag, ahead.get_output_port()
