"""Reach of an upright platform, and what it resists there: Section VI-D."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import (
    leg_lengths,
    legs_at,
    within_stroke,
)
from parapod.systems.machining_centre.wrench import WrenchIndices, wrench_indices

# Points that are looked at at once: between them progress is reported.
_CHUNK = 1 << 16


class Survey(NamedTuple):
    """Reachable points of a box.

    Attributes:
        points: number of points that were tested.
        reachable: (k, 3) those at which every leg is within its stroke [m].
        indices: wrench indices there, (k) each.
        push: (k) force that all legs together exert when each pushes with its largest, in units
            of their sum: no way to weigh moments changes it, and w_max is no less.
    """

    points: int
    reachable: Array
    indices: WrenchIndices
    push: Array

    def percent(self, threshold: float) -> float:
        """Points at which w_minmax exceeds a threshold, of all that were tested [%]."""
        return 100.0 * float((self.indices.w_minmax > threshold).sum()) / self.points

    def means(self, threshold: float) -> tuple[float, float, float]:
        """Means of w_minmax, w_max and their ratio where w_minmax exceeds a threshold."""
        is_kept = self.indices.w_minmax > threshold
        w_minmax, w_max, ratio = (float(index[is_kept].mean()) for index in self.indices)
        return w_minmax, w_max, ratio


def cell_centres(size: tuple[float, float, float], height: float, cell: float) -> Array:
    """Centres (k, 3) of the cells of a box above the world's origin [m].

    Args:
        size: size of the box [m].
        height: height of its middle [m].
        cell: largest edge of a cell [m].
    """
    counts = [max(1, round(edge / cell)) for edge in size]
    return _grid(size, height, [(np.arange(n) + 0.5) / n - 0.5 for n in counts])


def nodes(size: tuple[float, float, float], height: float, count: int) -> Array:
    """Nodes (k, 3) of a grid that includes the faces of a box above the world's origin [m].

    Args:
        size: size of the box [m].
        height: height of its middle [m].
        count: number of nodes along each edge.
    """
    return _grid(size, height, [np.linspace(-0.5, 0.5, count)] * 3)


def survey(
    geometry: CentreGeometry, points: Array, tell: Callable[[int], None] = lambda points_done: None
) -> Survey:
    """Tests points, the platform upright.

    Args:
        geometry: the centre.
        points: (k, 3) places of P_O [m].
        tell: called with the number of points that are done.
    """
    is_kept, indices, pushes = [], [], []
    for begin in range(0, len(points), _CHUNK):
        part = points[begin : begin + _CHUNK]
        poses = np.hstack((part, np.zeros_like(part)))
        poses = poses[is_reachable(geometry, poses)]
        is_kept.append(poses[:, :3])
        indices.append(wrench_indices(geometry, poses))
        pushes.append(_push(geometry, poses))
        tell(begin + len(part))
    joined = WrenchIndices(*(np.concatenate(each) for each in zip(*indices, strict=True)))
    return Survey(len(points), np.concatenate(is_kept), joined, np.concatenate(pushes))


def is_reachable(geometry: CentreGeometry, poses: Array) -> NDArray[np.bool_]:
    """True where all legs are within their stroke, at poses (..., 6), feet at home."""
    return np.asarray(within_stroke(geometry, leg_lengths(geometry, poses)).all(axis=-1))


def _push(geometry: CentreGeometry, poses: Array) -> Array:
    directions = legs_at(geometry, poses).directions
    force: Array = np.linalg.norm(directions.sum(axis=0), axis=0) / geometry.legs
    return force


def _grid(size: tuple[float, float, float], height: float, shares: list[Array]) -> Array:
    axes = [edge * share for edge, share in zip(size, shares, strict=True)]
    axes[2] = axes[2] + height
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
