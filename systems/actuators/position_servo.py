"""Drives that go to a position by the next command: a position loop around `VelocityServo`."""

import math

from numpy.typing import ArrayLike
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from pydrake.systems.primitives import Adder, Demultiplexer, Gain

from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams


def make_position_loop(time_constant: float, channels: int, arrival: float) -> Diagram:
    """Velocities with which drives arrive at a position some time from now.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position_command` | n | m or rad | where the drives are to be then |
    | in `state` | 2n | m or rad, and per s | positions and velocities of the drives |
    | out `velocity_command` | n | m/s or rad/s | to be sampled every period |

    With a velocity u for a time T, a drive with the lag tau goes on by
    T u - tau (1 - exp(-T / tau)) (u - v): that is made what is missing. Sampled as often, the
    drives are there when the next command comes; sampled more often, they come after it.

    Of a command that is not finite the velocity is not either, which `ServoGoal` takes as zero.

    Args:
        time_constant: tau of the drives' velocity loop [s].
        channels: number of drives n.
        arrival: T [s].
    """
    late = -time_constant * math.expm1(-arrival / time_constant)
    per_way = 1.0 / (arrival - late)
    builder = DiagramBuilder()
    parts = builder.AddSystem(Demultiplexer(2 * channels, channels))
    missing = builder.AddSystem(Adder(3, channels))
    # Element-wise: a matrix product would spread NaN to every drive.
    gains = [builder.AddSystem(Gain(k * per_way, channels)) for k in (1.0, -1.0, -late)]
    for i, gain in enumerate(gains):
        builder.Connect(gain.get_output_port(), missing.get_input_port(i))
    builder.ExportInput(gains[0].get_input_port(), "position_command")
    builder.ExportInput(parts.get_input_port(), "state")
    for i in range(2):
        builder.Connect(parts.get_output_port(i), gains[1 + i].get_input_port())
    builder.ExportOutput(missing.get_output_port(), "velocity_command")
    loop: Diagram = builder.Build()
    loop.set_name("position_loop")
    return loop


class PositionServo(Diagram):
    """Drives that are at their commands one period later, or brake.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position_command` | n | m or rad | where the drives are to be |
    | in `brake` | 1 | - | above 0.5: stop and hold |
    | out `position_measured` | n | m or rad | encoder: whole counts |
    | out `velocity_measured` | n | m/s or rad/s | counts per gate time |
    | out `position` | n | m or rad | where the drives are |
    | out `state` | 2n | m or rad, and per s | positions and velocities |
    | out `next_state` | 2n | m or rad, and per s | positions and velocities one step ahead |

    Speed, acceleration and stroke limit what is followed, see `VelocityServo`.

    State: that of `VelocityServo`.

    Bad input: a command that is not finite is not followed; the drives come to rest. A brake that
    is near neither 0 nor 1 brakes.

    Args:
        params: parameters of each drive.
        channels: number of drives n.
        period: at which commands are taken [s].
        time_step: time step of the drives' lag [s]; None for the period.
        position: positions (n or scalar) in a default context, where the drives are at rest
            [m or rad].
        arrival: time in which a command is to be reached [s]; None for the period.
    """

    def __init__(
        self,
        params: VelocityServoParams,
        channels: int,
        period: float = 0.01,
        time_step: float | None = None,
        position: ArrayLike = 0.0,
        arrival: float | None = None,
    ):
        super().__init__()
        self.params = params
        builder = DiagramBuilder()
        self._servo = VelocityServo(params, channels, period, time_step, position)
        loop = make_position_loop(params.time_constant, channels, arrival or period)
        for system in (self._servo, loop):
            builder.AddSystem(system)
        builder.Connect(self._servo.GetOutputPort("state"), loop.GetInputPort("state"))
        builder.Connect(
            loop.GetOutputPort("velocity_command"), self._servo.GetInputPort("velocity_command")
        )
        builder.ExportInput(loop.GetInputPort("position_command"), "position_command")
        builder.ExportInput(self._servo.GetInputPort("brake"), "brake")
        for i in range(self._servo.num_output_ports()):
            port = self._servo.get_output_port(i)
            builder.ExportOutput(port, port.get_name())
        builder.BuildInto(self)
        self.set_name("position_servo")

    def set_position(self, context: Context, position: ArrayLike) -> None:
        """Puts the drives at rest at the given positions (n) [m or rad]."""
        self._servo.set_position(context, position)
