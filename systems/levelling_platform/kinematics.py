"""Kinematics of the levelling platform: batched, in closed form, free of iteration.

Conventions, everywhere in parapod:

* posture = [roll, pitch, height]: roll and pitch of the platform against gravity [rad]; height
  of the platform's centre F above the ground's plane, measured perpendicular to it [m].
* ground = attitude = [roll, pitch] against gravity [rad], of the ground and of the platform.
* extension = the four actuators' lengths [m], legs in the paper's order 1..4.
* foot_offsets = how far each foot stands above the ground's plane [m].

Yaw is zero: R = R_y(pitch) R_x(roll), Eq. (1). A leg stands on the ground when
g . P_i = height, Eqs. (9)-(12), where g is the ground's normal in the platform's frame and P_i
the vector from the foot to F. Leading dimensions are batch dimensions and broadcast.

This module is the front door for users; inside the package what it offers is imported from where
it is defined.
"""

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.legs_to_posture import (
    estimate_ground,
    forward_kinematics,
    unevenness,
)
from parapod.systems.levelling_platform.posture_to_legs import (
    height_range,
    inverse_kinematics,
    passive_extension,
    posture_jacobian,
)

__all__ = [
    "PlatformGeometry",
    "estimate_ground",
    "forward_kinematics",
    "height_range",
    "inverse_kinematics",
    "passive_extension",
    "posture_jacobian",
    "unevenness",
]
