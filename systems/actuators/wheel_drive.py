"""Velocity-controlled wheel drives: DC motor, gear, encoder and positioning controller."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.elementwise import clamp
from parapod.systems.ports import elements, is_on, read


@dataclass(frozen=True)
class WheelDriveParams:
    """Closed velocity loop of a Maxon motor on an EPOS2 24/5.

    Attributes:
        gear: reduction n between motor and wheel [-] (section 2.1).
        counts_per_turn: encoder counts per turn of the motor (assumption: 500 lines, four edges).
        time_constant: of the velocity loop [s] (assumption).
        acceleration: largest acceleration of the wheel [rad/s^2] (assumption).
        max_velocity: largest velocity of the wheel [rad/s] (assumption: 8000 rpm at the motor).
    """

    gear: float = 26.0
    counts_per_turn: float = 2000.0
    time_constant: float = 0.05
    acceleration: float = 20.0
    max_velocity: float = 8000.0 * 2.0 * math.pi / 60.0 / 26.0

    @property
    def resolution(self) -> float:
        """One encoder count at the wheel [rad]."""
        return 2.0 * math.pi / (self.counts_per_turn * self.gear)


class WheelDrive(LeafSystem):
    """Wheel drives that follow a velocity command, or brake.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `velocity_command` | n | rad/s | of the wheels |
    | in `brake` | 1 | - | above 0.5: stop and hold |
    | out `position_measured` | n | rad | encoder: whole counts |
    | out `velocity_measured` | n | rad/s | counts per period |
    | out `state` | 2n | rad, rad/s | angles and velocities that the wheels are held to |

    State: discrete, angles and velocities (2n), updated every period: an acceleration-limited
    first-order lag, without overshoot.

    Bad input: a command that is not finite counts as zero.
    """

    def __init__(
        self,
        params: WheelDriveParams = WheelDriveParams(),
        channels: int = 4,
        period: float = 0.01,
    ):
        super().__init__()
        self.set_name("wheel_drive")
        self._params, self._channels, self._period = params, channels, period
        self._command = self.DeclareVectorInputPort("velocity_command", channels)
        self._brake = self.DeclareVectorInputPort("brake", 1)
        index = self.DeclareDiscreteState(2 * channels)
        state = {self.discrete_state_ticket(index)}
        self.DeclareVectorOutputPort("position_measured", channels, self._calc_position, state)
        self.DeclareVectorOutputPort("velocity_measured", channels, self._calc_velocity, state)
        self.DeclareStateOutputPort("state", index)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_state)

    def _calc_position(self, context: Context, output: BasicVector) -> None:
        angle = context.get_discrete_state_vector().value()[: self._channels]
        resolution = self._params.resolution
        output.SetFromVector(np.round(angle / resolution) * resolution)

    def _calc_velocity(self, context: Context, output: BasicVector) -> None:
        velocity = context.get_discrete_state_vector().value()[self._channels :]
        resolution = self._params.resolution / self._period
        output.SetFromVector(np.round(velocity / resolution) * resolution)

    def _update_state(self, context: Context, discrete_state: Any) -> None:
        params, n, h = self._params, self._channels, self._period
        state = elements(context.get_discrete_state_vector())
        braked = is_on(self._brake, context)
        if braked and not any(state[n:]):
            return
        targets = [0.0] * n if braked else read(self._command, context)
        share = 1.0 - math.exp(-h / params.time_constant)
        step, limit = params.acceleration * h, params.max_velocity
        for i, target in enumerate(targets):
            goal = clamp(target if math.isfinite(target) else 0.0, -limit, limit)
            change = clamp(share * (goal - state[n + i]), -step, step)
            velocity = state[n + i] + change
            state[i] += 0.5 * h * (state[n + i] + velocity)
            state[n + i] = velocity
        discrete_state.set_value(np.array(state))
