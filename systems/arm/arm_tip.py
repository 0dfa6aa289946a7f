"""Tip of a rigid arm on a platform that moves."""

from operator import mul

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.core import quaternions
from parapod.systems.core.elementwise import total
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read, read_or_zeros
from parapod.systems.core.triples import cross, plus
from parapod.systems.core.vectors import Axes


class ArmTip(LeafSystem):
    """Pose and velocity of an arm's tip in the world.

    Without a tool the tip is where a `FlexibleArm` is clamped.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `platform_pose` | 7 | -, m | quaternion (w, x, y, z) and place of the centre F |
    | in `platform_velocity` | 6 | rad/s, m/s | angular and linear velocity; unconnected: 0 |
    | in `arm_state` | 2n | rad or m, and per s | positions of the arm's joints, and their rates |
    | out `pose` | 7 | -, m | quaternion and place of the tip |
    | out `velocity` | 6 | rad/s, m/s | its angular and linear velocity |

    Poses and velocities are in the world.

    State: none.

    Bad input: outputs are not finite where an input is not.
    """

    def __init__(self, arm: SerialArm):
        """Creates the system.

        Args:
            arm: the arm.
        """
        super().__init__()
        self.set_name("arm_tip")
        self._arm = arm
        self._pose = self.DeclareVectorInputPort("platform_pose", 7)
        self._velocity = self.DeclareVectorInputPort("platform_velocity", 6)
        self._state = self.DeclareVectorInputPort("arm_state", 2 * arm.count)
        place = {self._pose.ticket(), self._state.ticket()}
        motion = place | {self._velocity.ticket()}
        self.DeclareVectorOutputPort("pose", 7, self._calc_pose, place)
        self.DeclareVectorOutputPort("velocity", 6, self._calc_velocity, motion)

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        *quaternion, x, y, z = read(self._pose, context)
        axes = Axes.from_quaternion(quaternion)
        tip = self._arm.tip_pose(read(self._state, context)[: self._arm.count])
        turned = quaternions.of_axes(list(zip(*tip.rotation, strict=True)))
        place = plus((x, y, z), axes.in_world(tip.place))
        output.SetFromVector(np.array([*quaternions.product(quaternion, turned), *place]))

    def _calc_velocity(self, context: Context, output: BasicVector) -> None:
        axes = Axes.from_quaternion(read(self._pose, context)[:4])
        state, count = read(self._state, context), self._arm.count
        position, rate = state[:count], state[count:]
        w_x, w_y, w_z, v_x, v_y, v_z = read_or_zeros(self._velocity, context)
        turning, place = (w_x, w_y, w_z), axes.in_world(self._arm.tip_pose(position).place)
        rows = self._arm.tip_jacobian(position)
        own = [total(map(mul, row, rate)) for row in rows]
        angular = plus(turning, axes.in_world(own[:3]))
        linear = plus(plus((v_x, v_y, v_z), cross(turning, place)), axes.in_world(own[3:]))
        output.SetFromVector(np.array([*angular, *linear]))
