"""Points and the way of an arm's tip, and what disturbs it, in a scene and its recording."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from parapod.diagrams.disturbances import Disturbance, Push
from parapod.diagrams.levelling_platform.disturbances import Payload

_PATH = "/tip"
# Radius of a point by the machine's size, and width of the way [m, pixels].
_RADIUS, _WIDTH = 0.02, 3.0
_TO_COME, _PRESENT, _TRAIL, _PUSH = (
    Rgba(0.45, 0.50, 0.58, 0.6),
    Rgba(0.84, 0.28, 0.16),
    Rgba(0.12, 0.42, 0.78),
    Rgba(0.55, 0.20, 0.65),
)
# Height and half axes of an arrow's head by the machine's size [m], and what turns it round.
_HEAD, _BACKWARDS = np.array([0.1, 0.035, 0.035]), RotationMatrix.MakeXRotation(np.pi)
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


class DisturbanceScene:
    """Arrows where the platform is pushed, and the payload at the tip."""

    def __init__(self, meshcat: Meshcat, disturbances: Sequence[Disturbance], size: float = 1.0):
        """Draws them, to be seen when their time has come.

        Args:
            meshcat: the scene.
            disturbances: the disturbances.
            size: size of the machine by the paper's [-].
        """
        self._meshcat, self._shown = meshcat, set[str]()
        self._arrows: list[tuple[str, Push]] = []
        self._payload: tuple[str, Payload] | None = None
        for i, each in enumerate(disturbances):
            path = f"{_PATH}/disturbances/{i}"
            if isinstance(each, Push) and any(each.force_N) and not each.body:
                # Its point is where the force acts; a cone grows from its point along z.
                shaft, head = Cylinder(0.012 * size, 0.6 * size), MeshcatCone(*_HEAD * size)
                behind = RigidTransform(np.array([0.0, 0.0, -0.3 * size]))
                meshcat.SetObject(f"{path}/shaft", shaft, _PUSH)
                meshcat.SetTransform(f"{path}/shaft", behind)
                meshcat.SetObject(f"{path}/head", head, _PUSH)
                meshcat.SetTransform(f"{path}/head", RigidTransform(_BACKWARDS))
                self._arrows.append((path, each))
            elif isinstance(each, Payload):
                meshcat.SetObject(path, Sphere(2.0 * _RADIUS * size), _PUSH)
                self._payload = path, each
            else:
                continue
            meshcat.SetProperty(path, "visible", False, time_in_recording=0.0)

    def show(self, X_WF: RigidTransform, tip: ArrayLike, time: float) -> None:
        """Shows what disturbs the machine now.

        Args:
            X_WF: pose of the platform.
            tip: place of the tip (3) [m].
            time: [s].
        """
        for path, push in self._arrows:
            is_on = push.at <= time <= push.at + push.duration
            if is_on and path not in self._shown:
                R_WA = RotationMatrix.MakeFromOneVector(np.array(push.force_N), 2)
                X_FA = RigidTransform(1e-3 * np.array(push.place_mm))
                X_WA = RigidTransform(R_WA, (X_WF @ X_FA).translation())
                self._meshcat.SetTransform(path, X_WA)
            self._toggle(path, is_on, time)
        if self._payload is not None:
            path, payload = self._payload
            self._toggle(path, time >= payload.at, time)
            if time >= payload.at:
                X_WT = RigidTransform(np.array(tip, dtype=float))
                self._meshcat.SetTransform(path, X_WT, time_in_recording=time)

    def _toggle(self, path: str, is_on: bool, time: float) -> None:
        if is_on != (path in self._shown):
            self._meshcat.SetProperty(path, "visible", is_on, time_in_recording=time)
            self._shown ^= {path}
