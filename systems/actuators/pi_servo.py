"""Positions by linear actuators behind PI controllers: `LinearActuator` in a closed loop."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import (
    Adder,
    AffineSystem,
    DiscreteDerivative,
    Gain,
    Multiplexer,
)

from parapod.systems.actuators.linear_actuator import LinearActuator, LinearActuatorParams
from parapod.systems.actuators.pi_controller import PiController, PiControllerParams
from parapod.systems.sensors.encoder import Encoder


class PiServo(Diagram):
    """Linear actuators that PI controllers lead to positions, each until the next command comes.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position_command` | n | m or rad | where the actuators are to be |
    | in `brake` | 1 | - | above 0.5: the supply is cut, screws hold |
    | in `load_force` | n | N or N m | force that each must exert; unconnected: no load |
    | out `position_measured` | n | m or rad | encoder: whole counts |
    | out `velocity_measured` | n | m/s or rad/s | counts per gate time |
    | out `position` | n | m or rad | where the actuators are |
    | out `state` | 2n | m or rad, and per s | positions and velocities |
    | out `next_state` | 2n | m or rad, and per s | positions and velocities one step ahead |

    Rates of the commands, by their differences, are fed forward.

    State: that of `LinearActuator` and `PiController`, and the last command.

    Bad input: with a command that is not finite an actuator gets no voltage. A brake that is near
    neither 0 nor 1 brakes.

    Args:
        actuator: constants of each actuator.
        control: gains of each controller.
        channels: number of actuators n.
        period: at which commands are taken [s].
        time_step: time step of the actuators [s]; None for the period.
        resolution: one count of the encoder [m or rad]; 0 for a perfect one.
        position: positions (n or scalar) in a default context [m or rad].
    """

    def __init__(
        self,
        actuator: LinearActuatorParams,
        control: PiControllerParams,
        channels: int,
        period: float = 0.01,
        time_step: float | None = None,
        resolution: float = 1e-5,
        position: ArrayLike = 0.0,
    ):
        super().__init__()
        builder, n = DiagramBuilder(), channels
        self._rods = LinearActuator(actuator, n, time_step or period, position)
        rods: Any = builder.AddSystem(self._rods)
        controller = builder.AddSystem(PiController(control, channels=n, period=period))
        encoder = builder.AddSystem(Encoder(n, resolution, period))
        rate = builder.AddSystem(DiscreteDerivative(n, period, suppress_initial_transient=True))
        # A command is for the end of the period: at its beginning the one before is due.
        back, due = builder.AddSystem(Gain(-period, n)), builder.AddSystem(Adder(2, n))
        desired, state = (builder.AddSystem(Multiplexer([n, n])) for _ in range(2))
        enable = builder.AddSystem(AffineSystem(D=np.array([[-1.0]]), y0=np.ones(1)))
        extension, velocity = rods.GetOutputPort("extension"), rods.GetOutputPort("velocity")
        for source, sink in (
            (rate.get_output_port(), back.get_input_port()),
            (back.get_output_port(), due.get_input_port(1)),
            (due.get_output_port(), desired.get_input_port(0)),
            (rate.get_output_port(), desired.get_input_port(1)),
            (desired.get_output_port(), controller.GetInputPort("desired_state")),
            (encoder.GetOutputPort("position_measured"), controller.GetInputPort("measured")),
            (enable.get_output_port(), controller.GetInputPort("enable")),
            (controller.GetOutputPort("voltage"), rods.GetInputPort("voltage")),
            (extension, encoder.GetInputPort("position")),
            (velocity, encoder.GetInputPort("velocity")),
            (extension, state.get_input_port(0)),
            (velocity, state.get_input_port(1)),
        ):
            builder.Connect(source, sink)
        for name, sinks in (
            ("position_command", (rate.get_input_port(), due.get_input_port(0))),
            ("brake", (enable.get_input_port(), rods.GetInputPort("stop"))),
        ):
            builder.ExportInput(sinks[0], name)
            builder.ConnectInput(name, sinks[1])
        builder.ExportInput(rods.GetInputPort("load_force"), "load_force")
        for port, name in (
            (encoder.GetOutputPort("position_measured"), "position_measured"),
            (encoder.GetOutputPort("velocity_measured"), "velocity_measured"),
            (extension, "position"),
            (state.get_output_port(), "state"),
            (rods.GetOutputPort("next_state"), "next_state"),
        ):
            builder.ExportOutput(port, name)
        builder.BuildInto(self)
        self.set_name("pi_servo")

    def set_position(self, context: Context, position: ArrayLike) -> None:
        """Puts the actuators at rest at the given positions (n) [m or rad]."""
        self._rods.set_extension(self._rods.GetMyMutableContextFromRoot(context), position)
