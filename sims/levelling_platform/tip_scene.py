"""Points and the way of an arm's tip in a scene, also in a recording of it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform

_PATH = "/tip"
# Radius of a point by the machine's size, and width of the way [m, pixels].
_RADIUS, _WIDTH = 0.02, 3.0
_TO_COME, _PRESENT, _TRAIL = (
    Rgba(0.45, 0.50, 0.58, 0.6),
    Rgba(0.84, 0.28, 0.16),
    Rgba(0.12, 0.42, 0.78),
)
# Time between two places of the way [s], and number of them that are kept.
_PERIOD, _MOST = 0.1, 3000


class TipScene:
    """Points at which a tip is wanted, the present one in another colour, and its way so far."""

    def __init__(self, meshcat: Meshcat, points: ArrayLike = (), size: float = 1.0):
        """Draws the points.

        Args:
            meshcat: the scene.
            points: points (m, 3) that are to come; more are drawn as they come [m].
            size: size of the machine by the paper's [-].
        """
        self._meshcat, self._sphere = meshcat, Sphere(_RADIUS * size)
        meshcat.Delete(_PATH)
        for i, point in enumerate(np.reshape(points, (-1, 3))):
            path = f"{_PATH}/points/{i}"
            meshcat.SetObject(path, self._sphere, _TO_COME)
            meshcat.SetTransform(path, RigidTransform(point))
        self._goal, self._target = np.full(3, np.nan), 0
        self._last: NDArray[np.float64] | None = None
        self._next, self._count = 0.0, 0

    def show(self, goal: ArrayLike, tip: ArrayLike, time: float) -> None:
        """Shows the present point, and the tip's way up to now.

        Args:
            goal: the present point (3); NaN: none [m].
            tip: place of the tip (3) [m].
            time: [s].
        """
        place: NDArray[np.float64] = np.array(goal, dtype=float)
        if np.isfinite(place).all() and not np.array_equal(place, self._goal):
            self._visible(f"{_PATH}/goal/{self._target}", False, time)
            self._goal, self._target = place, self._target + 1
            path = f"{_PATH}/goal/{self._target}"
            self._meshcat.SetObject(path, Sphere(1.3 * self._sphere.radius()), _PRESENT)
            self._meshcat.SetTransform(path, RigidTransform(place))
            self._visible(path, False, 0.0)
            self._visible(path, True, time)
        if time < self._next or not np.isfinite(self._goal).all():
            return
        self._next = time + _PERIOD
        here: NDArray[np.float64] = np.array(tip, dtype=float)
        if self._last is not None and np.isfinite([*here, *self._last]).all():
            path = f"{_PATH}/way/{self._count % _MOST}"
            self._count += 1
            ends = np.column_stack([self._last, here])
            self._meshcat.SetLine(path, ends, _WIDTH, _TRAIL)
            self._visible(path, False, 0.0)
            self._visible(path, True, time)
        self._last = here

    def _visible(self, path: str, value: bool, time: float) -> None:
        self._meshcat.SetProperty(path, "visible", value, time_in_recording=time)
