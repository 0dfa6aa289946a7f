"""Kinematics of the 3-RPS platform: three legs that lift and tilt a platform.

K.-M. Lee and D. K. Shah, Kinematic analysis of a three-degrees-of-freedom in-parallel actuated
manipulator, IEEE Journal of Robotics and Automation 4 (1988) 354-360. A leg turns about a revolute
joint on the base, in the vertical plane through the base's centre, and carries the platform by a
spherical joint: the platform does not twist, and its centre wanders as it tilts (I. A. Bonev's
tilt and torsion angles). A pose is the rotation vector's x and y [rad] and the height [m].
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
_SPOKES = np.radians([0.0, 120.0, 240.0])
_RADIAL = np.column_stack([np.cos(_SPOKES), np.sin(_SPOKES), np.zeros(3)])
_STEP = 1e-6  # step of the differences that make a Jacobian; their error is 1e-10


@dataclass(frozen=True)
class Geometry:
    """Radii of the joints' circles on base and platform [m], and mass of the platform [kg]."""

    base: float = 0.30
    platform: float = 0.18
    mass: float = 40.0


def platform_joints(geometry: Geometry, pose: ArrayLike) -> Floats:
    """Spherical joints (..., 3, 3) in the base's frame [m] at poses (..., 3)."""
    a, b, height = np.moveaxis(np.asarray(pose, dtype=float), -1, 0)
    tilt, zero = np.hypot(a, b), np.zeros_like(a)
    s = np.sinc(tilt / np.pi)  # sin(tilt) / tilt
    c = 0.5 * np.sinc(0.5 * tilt / np.pi) ** 2  # (1 - cos(tilt)) / tilt^2
    rotation = np.array(
        [
            [1.0 - c * b * b, c * a * b, s * b],
            [c * a * b, 1.0 - c * a * a, -s * a],
            [-s * b, s * a, np.cos(tilt)],
        ]
    )
    # Each joint stays in its leg's plane: that moves the centre.
    centre = np.array([0.5 * c * (a * a - b * b), -c * a * b, zero]) * geometry.platform
    centre[2] = height
    turned = np.moveaxis(rotation, (0, 1), (-2, -1)) @ (geometry.platform * _RADIAL).T
    return turned + np.moveaxis(centre, 0, -1)[..., None]


def inverse(geometry: Geometry, pose: ArrayLike) -> Floats:
    """Lengths of the legs (..., 3) [m] at poses (..., 3)."""
    feet = (geometry.base * _RADIAL).T
    return np.linalg.norm(platform_joints(geometry, pose) - feet, axis=-2)


def jacobian(geometry: Geometry, pose: ArrayLike) -> Floats:
    """Rates of the lengths (3) by rates of the pose (3), by central differences."""
    steps = _STEP * np.eye(3)
    ahead, back = np.asarray(pose) + steps, np.asarray(pose) - steps
    return (inverse(geometry, ahead) - inverse(geometry, back)).T / (2.0 * _STEP)


def forward(geometry: Geometry, lengths: ArrayLike) -> Floats:
    """Pose (3) at lengths (3) [m] by Newton's method from the level pose; NaN where none is."""
    goal = np.asarray(lengths, dtype=float)
    reach = geometry.base - geometry.platform
    pose = np.array([0.0, 0.0, np.sqrt(max(np.mean(goal) ** 2 - reach**2, 1e-4))])
    for _ in range(20):
        missing = goal - inverse(geometry, pose)
        if np.abs(missing).max() < 1e-12:
            return pose
        pose = pose + np.linalg.solve(jacobian(geometry, pose), missing)
    return np.full(3, np.nan)


def leg_forces(geometry: Geometry, pose: ArrayLike) -> Floats:
    """Forces (3) with which the legs hold the platform's weight [N], by virtual work."""
    return np.linalg.solve(jacobian(geometry, pose).T, [0.0, 0.0, 9.81 * geometry.mass])
