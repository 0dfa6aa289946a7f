"""Poses of a plant's bodies, in plain numbers for a run of Drake's, and in those of rows."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, InputPort

from parapod.systems.core.elementwise import length_of
from parapod.systems.core.leaf_system import RowsContext
from parapod.systems.core.ports import read_object
from parapod.systems.core.rows import Index, OfRows, number_of
from parapod.systems.core.triples import minus, plus
from parapod.systems.core.vectors import Axes, Vector3
from parapod.systems.physics.loops import Ball


class Poses(OfRows):
    """Poses of bodies in the world, by the indices of the bodies."""

    @abstractmethod
    def origin(self, body: int) -> Vector3:
        """Origin of a body [m]."""

    @abstractmethod
    def axes(self, body: int) -> Axes:
        """Axes of a body."""

    def point(self, body: int, place: Sequence[float]) -> Vector3:
        """A point of a body in the world [m].

        Args:
            body: index of the body.
            place: (3) place of the point in the body's frame [m].
        """
        return plus(self.axes(body).in_world(place), self.origin(body))


def poses_at(port: InputPort, context: Context | RowsContext) -> Poses:
    """Poses at an input port to which a list of `RigidTransform` comes."""
    poses: Any = read_object(port, context)
    return poses if isinstance(poses, Poses) else _PosesOfOne(poses)


class _PosesOfOne(Poses):
    """Poses of Drake's."""

    def __init__(self, poses: Sequence[Any]):
        self._poses = poses

    def origin(self, body: int) -> Vector3:
        x, y, z = self._poses[body].translation().tolist()
        return x, y, z

    def axes(self, body: int) -> Axes:
        return Axes(*map(tuple, self._poses[body].rotation().matrix().T.tolist()))

    def taken(self, index: Index | int) -> "Poses":
        raise TypeError("poses of one run are not those of rows")


class PosesOfRows(Poses):
    """Poses of many runs."""

    def __init__(self, places: NDArray[np.float64], turns: NDArray[np.float64]):
        """Takes the poses.

        Args:
            places: (rows, bodies, 3) origins [m].
            turns: (rows, bodies, 9) rotation matrices, row by row.
        """
        self._places, self._turns = places, turns

    def origin(self, body: int) -> Vector3:
        """Origin of a body [m]."""
        x, y, z = (number_of(self._places[..., body, k].copy()) for k in range(3))
        return x, y, z

    def axes(self, body: int) -> Axes:
        """Axes of a body."""
        r = [number_of(self._turns[..., body, k].copy()) for k in range(9)]
        return Axes((r[0], r[3], r[6]), (r[1], r[4], r[7]), (r[2], r[5], r[8]))

    def taken(self, index: Index | int) -> "Poses":
        """Poses of some rows, or those of one."""
        return self if index is None else PosesOfRows(self._places[index], self._turns[index])


class Gaps:
    """Distances of the points that ball joints hold together; the origin of `body` is one."""

    def __init__(self, balls: Sequence[Ball]):
        self._places: list[tuple[int, int, list[float]]] = [
            (int(ball.body.index()), int(ball.other.index()), np.array(ball.other_point).tolist())
            for ball in balls
        ]

    def of(self, poses: Poses) -> list[Any]:
        """Distance at each joint [m]."""
        return [
            length_of(*minus(poses.origin(body), poses.point(other, place)))
            for body, other, place in self._places
        ]
