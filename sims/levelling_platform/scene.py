"""Points and the way of an arm's tip, and its payload, in a scene and its recording."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform

from parapod.diagrams.disturbances import Disturbance
from parapod.diagrams.levelling_platform.disturbances import Payload

_PATH = "/tip"
# Radius of a point by the machine's size, and width of the way [m, pixels].
_RADIUS, _WIDTH = 0.02, 3.0
_TO_COME, _PRESENT, _TRAIL, _PAYLOAD = (
    Rgba(0.45, 0.50, 0.58, 0.6),
    Rgba(0.84, 0.28, 0.16),
    Rgba(0.12, 0.42, 0.78),
    Rgba(0.55, 0.20, 0.65),
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


class PayloadScene:
    """Payload at the tip of an arm, from the time on at which the tip takes it."""

    def __init__(self, meshcat: Meshcat, disturbances: Sequence[Disturbance], size: float = 1.0):
        """Draws it, to be seen when its time has come.

        Args:
            meshcat: the scene.
            disturbances: the disturbances, which have one payload at most.
            size: size of the machine by the paper's [-].
        """
        self._meshcat, self._path, self._at = meshcat, f"{_PATH}/payload", math.inf
        for each in disturbances:
            if isinstance(each, Payload):
                self._at = each.at
                meshcat.SetObject(self._path, Sphere(2.0 * _RADIUS * size), _PAYLOAD)
                meshcat.SetProperty(self._path, "visible", False, time_in_recording=0.0)

    def show(self, tip: ArrayLike, time: float) -> None:
        """Shows the payload where the tip is.

        Args:
            tip: place of the tip (3) [m].
            time: [s].
        """
        if time >= self._at:
            self._meshcat.SetProperty(self._path, "visible", True, time_in_recording=time)
            X_WT = RigidTransform(np.array(tip, dtype=float))
            self._meshcat.SetTransform(self._path, X_WT, time_in_recording=time)
