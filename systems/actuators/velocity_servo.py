"""Drives that follow a velocity: motor, gear, encoder and positioning controller."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, OutputPort
from pydrake.systems.primitives import (
    Adder,
    Demultiplexer,
    LinearSystem,
    MatrixGain,
    ZeroOrderHold,
)

from parapod.systems.actuators.servo_goal import ServoGoal, VelocityServoParams
from parapod.systems.sensors.encoder import Encoder


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

    Bad input: a command that is not finite counts as zero.
    """

    def __init__(
        self,
        params: VelocityServoParams,
        channels: int,
        period: float = 0.01,
        time_step: float | None = None,
    ):
        """Builds the diagram.

        Args:
            params: of each drive.
            channels: number of drives n.
            period: at which commands are taken, and over which the encoder's counts make a
                velocity [s].
            time_step: of the lag [s]; None for the period.
        """
        super().__init__()
        self.params, self._channels = params, channels
        builder = DiagramBuilder()
        self._goal = ServoGoal(params, channels, period)
        builder.AddSystem(self._goal)
        goal = self._goal.get_output_port()
        if time_step is not None and time_step < period:
            hold = builder.AddSystem(ZeroOrderHold(period, channels))
            builder.Connect(goal, hold.get_input_port())
            goal = hold.get_output_port()
        self._lag, ahead = self._add_lag(builder, goal, time_step or period)
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
        at = np.broadcast_to(np.asarray(position, dtype=float), self._channels)
        lag = self._lag.GetMyMutableContextFromRoot(context)
        lag.SetDiscreteState(np.concatenate((at, np.zeros(self._channels))))

    def set_imperfection(self, context: Context, gain: ArrayLike, offset: ArrayLike) -> None:
        """Lets the drives run off their command, see `ServoGoal.set_imperfection`."""
        self._goal.set_imperfection(self._goal.GetMyMutableContextFromRoot(context), gain, offset)

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
