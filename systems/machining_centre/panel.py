"""The panel that a centre stands on and machines: part of a cylinder, or a plane.

Its highest line is the world's second axis; the world's third axis leads out of it there. Places
on it are given by the way along its circumference and the way across, from the world's origin.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry


@dataclass(frozen=True)
class Panel:
    """The panel.

    Attributes:
        radius: radius of curvature [m]; infinite for a plane.
        foot_height: height of the frame of a foot that stands on it [m], see `CentreGeometry`.
    """

    radius: float = 3.0
    foot_height: float = CentreGeometry.foot_height

    def __post_init__(self) -> None:
        if not self.radius > 0.0:
            raise ValueError(f"radius must be positive or infinite, not {self.radius!r}")

    def frame(self, along: float, across: float, yaw: float = 0.0, height: float = 0.0) -> Array:
        """Pose (6) of a frame whose third axis leads out of the panel [m, rad].

        Args:
            along: way along the circumference [m].
            across: way across it [m].
            yaw: turn about the third axis; at 0 the first one looks along the circumference [rad].
            height: height of the frame's origin above the panel [m].
        """
        turn = 0.0 if math.isinf(self.radius) else along / self.radius
        rotation = Rotation.from_euler("YZ", (turn, yaw))
        if turn == 0.0:
            place = np.array((along, across, height))
        else:
            out = self.radius + height
            place = np.array((out * math.sin(turn), across, out * math.cos(turn) - self.radius))
        return np.concatenate((place, rotation.as_euler("xyz")))

    def foothold(self, along: float, across: float, yaw: float = 0.0) -> Array:
        """Pose (6) of the frame of a foot that stands on the panel; arguments as of `frame`."""
        return self.frame(along, across, yaw, self.foot_height)

    def place(self, points: Array) -> Array:
        """Ways along and across, and heights (..., 3) [m] of points (..., 3) in the world."""
        x, y, z = np.moveaxis(np.asarray(points, dtype=np.float64), -1, 0)
        if math.isinf(self.radius):
            return np.stack((x, y, z), axis=-1)
        out = self.radius + z
        along = self.radius * np.arctan2(x, out)
        # Exact near the surface too, where the radius is much larger than a height.
        height = (x**2 + z * (2.0 * self.radius + z)) / (np.hypot(x, out) + self.radius)
        return np.stack((along, y, height), axis=-1)

    def tilt(self, frame: NDArray[np.float64]) -> float:
        """Angle between a frame's third axis and that of the panel below it [rad]."""
        along, across, _ = self.place(frame[:3])
        here = Rotation.from_euler("xyz", self.frame(along, across)[3:])
        own = Rotation.from_euler("xyz", frame[3:])
        third = (here.inv() * own).as_matrix()[:, 2]
        return float(math.atan2(math.hypot(third[0], third[1]), third[2]))

    def heading(self, frame: NDArray[np.float64]) -> float:
        """Turn of a frame about the panel's normal below it, see `frame` [rad]."""
        along, across, _ = self.place(frame[:3])
        here = Rotation.from_euler("xyz", self.frame(along, across)[3:])
        first = (here.inv() * Rotation.from_euler("xyz", frame[3:])).as_matrix()[:, 0]
        return float(math.atan2(first[1], first[0]))
