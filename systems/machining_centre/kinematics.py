"""Kinematics of the machining centres: batched, exact, free of Drake.

Conventions:

* limbs are counted from 1; the legs of all limbs are arrays (..., 2n): left, right of limb 1, ...
* pose = x, y, z, roll, pitch, yaw of the platform's frame {P} in the world, rotations about fixed
  axes: R = R_z(yaw) R_y(pitch) R_x(roll), as Drake's RollPitchYaw [m, rad].
* footholds = poses (..., n, 6) of the feet's frames {A}, third axis off the ground.
* twists [angular; linear] and wrenches [moment; force] at the platform's origin P_O, in the world.

Leading dimensions are batch dimensions and broadcast.

This module is the front door for users; inside the package what it offers is imported from where
it is defined.
"""

from parapod.systems.machining_centre.branch import (
    branch_forward,
    branch_joints,
    branch_joints_and_rates,
)
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import (
    AssembledPose,
    check_strokes,
    forward_kinematics,
    inverse_kinematics,
    jacobian,
    leg_lengths,
)
from parapod.systems.machining_centre.swing import (
    LockConditions,
    Locks,
    LockSet,
    SingularSwing,
    SwingPose,
    SwungPose,
    close_locks,
    lock_conditions,
    swing_forward,
    swing_inverse,
)
from parapod.systems.machining_centre.wrench import WrenchIndices, wrench_indices

__all__ = [
    "AssembledPose",
    "CentreGeometry",
    "LockConditions",
    "LockSet",
    "Locks",
    "SingularSwing",
    "SwingPose",
    "SwungPose",
    "WrenchIndices",
    "branch_forward",
    "branch_joints",
    "branch_joints_and_rates",
    "check_strokes",
    "close_locks",
    "forward_kinematics",
    "inverse_kinematics",
    "jacobian",
    "leg_lengths",
    "lock_conditions",
    "swing_forward",
    "swing_inverse",
    "wrench_indices",
]
