"""Joints of an arm behind drives that give way under its weight."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import read, read_or_zeros
from parapod.systems.core.remembered import Remembered
from parapod.systems.core.vectors import Axes


class YieldingDrives(LeafSystem):
    """Positions of an arm's joints at rest, from those of its drives' encoders.

    Use it with a plant that has no springs in the joints: it gives their static equilibrium, by
    `ArmJoint.compliance`.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `base_pose` | 7 | -, m | quaternion (w, x, y, z) and place of the arm's base |
    | in `drive_state` | 2n | rad or m, and per s | positions and rates of the drives |
    | in `payload` | 1 | kg | mass whose weight the tip bears; unconnected: 0 |
    | out `joint_state` | 2n | rad or m, and per s | positions of the joints, rates of the drives |

    State: none.

    Bad input: numbers that are not finite are passed on.
    """

    def __init__(self, arm: SerialArm):
        """Creates the system.

        Args:
            arm: the arm.
        """
        super().__init__()
        self.set_name("yielding_drives")
        self._yielded = Remembered(partial(yielded_on, arm))
        self._pose = self.DeclareVectorInputPort("base_pose", 7)
        self._drives = self.DeclareVectorInputPort("drive_state", 2 * arm.count)
        self._payload = self.DeclareVectorInputPort("payload", 1)
        self.DeclareVectorOutputPort(
            "joint_state", 2 * arm.count, self._calc_state, {self.all_input_ports_ticket()}
        )

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        *quaternion, _, _, _ = read(self._pose, context)
        drives = read(self._drives, context)
        count = len(drives) // 2
        (payload,) = read_or_zeros(self._payload, context)
        behind = self._yielded(drives[:count], quaternion, payload)
        output.SetFromVector(np.array([*behind, *drives[count:]]))


def yielded_on(
    arm: SerialArm, position: Sequence[float], quaternion: Sequence[float], payload: float = 0.0
) -> tuple[float, ...]:
    """Positions (n) of the joints at rest behind the drives, on a base in the world.

    Args:
        arm: the arm.
        position: positions (n) of the drives [rad or m].
        quaternion: quaternion (w, x, y, z) of the base; zeros where it is unknown.
        payload: mass whose weight the tip bears [kg].
    """
    if not any(quaternion):
        return tuple(position)
    gravity = Axes.from_quaternion(quaternion).components((0.0, 0.0, -GRAVITY))
    return arm.bearing(payload).yielded(position, gravity)
