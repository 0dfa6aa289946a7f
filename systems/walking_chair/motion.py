"""Motions: what a trajectory gives at the times it is asked for."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Motion(NamedTuple):
    """Motion of a point, or of several.

    Attributes:
        position: (..., 3) [m].
        velocity: (..., 3) [m/s].
        acceleration: (..., 3) [m/s2].
    """

    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]


class BodyMotion(NamedTuple):
    """Motion of the body's frame {S} in the world; by default it is level and at rest.

    Attributes:
        position: (..., 3) of S [m].
        rotation: (..., 3, 3) of {S}.
        velocity: (..., 3) of S [m/s].
        angular_velocity: (..., 3) in the world's axes [rad/s].
        acceleration: (..., 3) of S [m/s2].
        angular_acceleration: (..., 3) in the world's axes [rad/s2].
    """

    position: ArrayLike
    rotation: ArrayLike = np.eye(3)
    velocity: ArrayLike = (0.0, 0.0, 0.0)
    angular_velocity: ArrayLike = (0.0, 0.0, 0.0)
    acceleration: ArrayLike = (0.0, 0.0, 0.0)
    angular_acceleration: ArrayLike = (0.0, 0.0, 0.0)


class BranchMotion(NamedTuple):
    """Motion of a leg's three branches UP, UPS, UPS, or of all legs' (..., 4, 3).

    Attributes:
        length: (..., 3) between the joints' centres [m].
        velocity: (..., 3) of the lengths [m/s].
        acceleration: (..., 3) of the lengths [m/s2].
    """

    length: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
