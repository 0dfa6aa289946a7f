"""Motion that an ideal inertial sensor in a simulated floating body would sense."""

from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import read_vector
from parapod.systems.core.vectors import Axes


class InertialMotion(LeafSystem):
    """Attitude, angular velocity and mean specific force at a place on a floating body.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `state` | n | - | state of the `MultibodyPlant` |
    | in `last_state` | n | - | the same at the sensor's last sample; at first at rest |
    | out `motion` | 9 | rad, rad/s, m/s^2 | roll, pitch, yaw; angular velocity; specific force |

    The angles are those of R = R_z R_y R_x, the vectors are along the body's axes.

    The specific force is the mean one since the last sample, as a decimation filter gives it: a
    difference of velocities. An acceleration taken at an instant would alias whatever happens in
    step with the controller. Evaluate the output at the instants at which the sensor samples.

    State: none; a `ZeroOrderHold` with the sensor's period carries `last_state`.

    Bad input: what is not finite is passed on; `Imu` bounds it.

    Args:
        state_size: n, positions and velocities of the plant.
        pose_start: index at which the body's quaternion and position begin in the state.
        velocity_start: index at which its angular and translational velocity begin there.
        period: period of the sensor [s].
        gravity: [m/s^2].
        place: place of the sensor, from the body's origin along its axes [m].
    """

    def __init__(
        self,
        state_size: int,
        pose_start: int,
        velocity_start: int,
        period: float,
        gravity: float = GRAVITY,
        place: Sequence[float] = (0.0, 0.0, 0.0),
    ):
        super().__init__()
        self.set_name("inertial_motion")
        self._period, self._gravity = period, gravity
        self._place = tuple(map(float, place)) if any(place) else None
        turning = range(velocity_start, velocity_start + 3)
        translation = range(velocity_start + 3, velocity_start + 6)
        # Of some fifty numbers these are taken one by one.
        self._moving = itemgetter(*range(pose_start, pose_start + 4), *turning)
        self._translation = itemgetter(*translation)
        self._state: Any = self.DeclareVectorInputPort("state", state_size)
        self._last: Any = self.DeclareVectorInputPort("last_state", state_size)
        self.DeclareVectorOutputPort(
            "motion", 9, self._calc_motion, {self._state.ticket(), self._last.ticket()}
        )

    def _calc_motion(self, context: Context, output: BasicVector) -> None:
        state = read_vector(self._state, context)
        *quaternion, w_x, w_y, w_z = self._moving(state)
        v_x, v_y, v_z = self._velocity(state)
        last = self._velocity(read_vector(self._last, context))
        axes = Axes.from_quaternion(quaternion)
        f_x, f_y = (v_x - last[0]) / self._period, (v_y - last[1]) / self._period
        f_z = (v_z - last[2]) / self._period
        output.SetFromVector(
            np.array(
                (
                    *axes.roll_pitch_yaw(),
                    *axes.components((w_x, w_y, w_z)),
                    *axes.components((f_x, f_y, f_z + self._gravity)),
                )
            )
        )

    def _velocity(self, state: BasicVector) -> Sequence[float]:
        """Velocity of the sensor in the world [m/s]."""
        velocity: tuple[float, ...] = self._translation(state)
        if self._place is None:
            return velocity
        *quaternion, w_x, w_y, w_z = self._moving(state)
        if not any(quaternion):  # held states begin at zero: at rest
            return velocity
        x, y, z = self._place
        axes = Axes.from_quaternion(quaternion)
        r_x, r_y, r_z = (a * x + b * y + c * z for a, b, c in zip(*axes, strict=True))
        return (
            velocity[0] + w_y * r_z - w_z * r_y,
            velocity[1] + w_z * r_x - w_x * r_z,
            velocity[2] + w_x * r_y - w_y * r_x,
        )
