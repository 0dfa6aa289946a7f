"""Specific force as an accelerometer with a decimation filter sees it: averaged over a sample."""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from parapod.systems.elementwise import sin_cos
from parapod.systems.ports import read, read_array


class AveragingAccelerometer(LeafSystem):
    """Mean specific force of a body since the last sample, in the body's axes, without errors.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `velocity` | 3 | m/s | of the sensor in the world |
    | in `attitude` | 3 | rad | roll, pitch, yaw, R = R_z R_y R_x |
    | out `specific_force` | 3 | m/s^2 | mean acceleration since the last sample, minus gravity |

    An acceleration taken at an instant aliases whatever happens in step with the controller; a
    real sensor's filter averages it, and the average is a difference of velocities. Evaluate the
    output at the instants at which this system samples.

    State: discrete, the velocity at the last sample (3), updated every period.

    Bad input: what is not finite is passed on; `Imu` bounds it.
    """

    def __init__(self, period: float = 8.0 / 819.2, gravity: float = 9.81):
        super().__init__()
        self.set_name("averaging_accelerometer")
        self._period, self._gravity = period, gravity
        self._velocity = self.DeclareVectorInputPort("velocity", 3)
        self._attitude = self.DeclareVectorInputPort("attitude", 3)
        state = self.discrete_state_ticket(self.DeclareDiscreteState(3))
        self.DeclareVectorOutputPort(
            "specific_force",
            3,
            self._calc_specific_force,
            {state, self._velocity.ticket(), self._attitude.ticket()},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_velocity)

    def _calc_specific_force(self, context: Context, output: BasicVector) -> None:
        last = context.get_discrete_state_vector().value().tolist()
        x, y, z = (
            (now - before) / self._period
            for now, before in zip(read(self._velocity, context), last, strict=True)
        )
        output.SetFromVector(
            np.array(in_body((x, y, z + self._gravity), *read(self._attitude, context)))
        )

    def _update_velocity(self, context: Context, discrete_state: DiscreteValues) -> None:
        discrete_state.set_value(read_array(self._velocity, context))


def in_body(vector: Any, roll: float, pitch: float, yaw: float) -> tuple[float, float, float]:
    """A vector of the world in the axes of a body with R = R_z(yaw) R_y(pitch) R_x(roll)."""
    (s_r, c_r), (s_p, c_p), (s_y, c_y) = sin_cos(roll), sin_cos(pitch), sin_cos(yaw)
    x, y, z = vector
    x, y = c_y * x + s_y * y, c_y * y - s_y * x
    x, z = c_p * x - s_p * z, s_p * x + c_p * z
    return x, c_r * y + s_r * z, c_r * z - s_r * y
