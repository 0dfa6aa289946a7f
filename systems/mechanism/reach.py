"""Poses that a frame of a mechanism can take: a grid that is flooded from a pose at home.

A cell counts where the frame gets to its middle from a neighbour's pose, within all limits and
away from singular positions: so all poses of it are assembled as home is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.errors import ScenarioError
from parapod.systems.mechanism.equations import pose_vector
from parapod.systems.mechanism.mechanism import Mechanism

type Floats = NDArray[np.float64]

# Most cells of a grid.
_MOST = 2_000_000


@dataclass(frozen=True)
class Reach:
    """Cells of a grid that a frame reaches.

    Attributes:
        parts: parts of the pose along which the grid goes, by their places in x, y, z, roll,
            pitch, yaw.
        axes: middles of the cells along each [m, rad].
        is_reached: (n, m, ...) for each cell, whether the frame gets there.
        positions: (cells reached, q) a pose of each, in the order of `is_reached`.
        cut_off: true if the border of the grid is reached: there is more beyond.
    """

    parts: tuple[int, ...]
    axes: tuple[Floats, ...]
    is_reached: NDArray[np.bool_]
    positions: Floats
    cut_off: bool

    @property
    def cell(self) -> float:
        """Volume of a cell [m^i rad^j]."""
        return float(np.prod([axis[1] - axis[0] for axis in self.axes]))

    @property
    def volume(self) -> float:
        """Volume that is reached [m^i rad^j]."""
        return self.cell * int(self.is_reached.sum())

    @property
    def error(self) -> float:
        """Half the volume of the cells at the border, by which the volume may be wrong.

        It goes with the spacing of the grid.
        """
        inner = self.is_reached.copy()
        for axis in range(inner.ndim):
            for step in (1, -1):
                inner &= _shifted(self.is_reached, axis, step)
        border = self.is_reached & ~inner
        return 0.5 * self.cell * int(border.sum())


def reach(
    mechanism: Mechanism,
    frame: str,
    ranges: Mapping[int, tuple[float, float, int]],
    fixed: Mapping[int, float] | None = None,
    near: ArrayLike | None = None,
    least_held: float = 0.0,
) -> Reach:
    """Floods a grid of poses.

    Args:
        mechanism: the mechanism.
        frame: name of the frame.
        ranges: for each part of the pose along which the grid goes, by its place in x, y, z,
            roll, pitch, yaw: its least and its largest value [m, rad], and the number of cells.
        fixed: values of other parts [m, rad]; what is in neither is open.
        near: (q) positions to begin with, closed, within the grid; None: `home`.
        least_held: `Dexterity.held` below which a pose does not count; 0: all do.

    Raises:
        ScenarioError: a grid that is empty or too large, or does not hold the first pose.
    """
    parts, values = tuple(sorted(ranges)), fixed or {}
    counts = [ranges[part][2] for part in parts]
    if not parts or min(counts) < 2 or float(np.prod(counts)) > _MOST:
        raise ScenarioError(
            f"a grid must have 2 cells and more along each part, and {_MOST} at most, not "
            f"{' x '.join(map(str, counts)) or 'none'}"
        )
    axes = tuple(_middles(*ranges[part]) for part in parts)
    start = np.asarray(mechanism.home if near is None else near, dtype=float)
    begin = pose_vector(mechanism.pose(frame, start))
    first = []
    for part, axis in zip(parts, axes, strict=True):
        low, high, _ = ranges[part]
        if not low <= begin[part] <= high:
            raise ScenarioError(
                f"the grid does not hold the first pose: {begin[part]:.6g} is not within "
                f"{low:.6g}..{high:.6g}"
            )
        first.append(int(np.argmin(np.abs(axis - begin[part]))))
    flood = _Flood(mechanism, frame, parts, axes, values, least_held)
    is_reached, positions, cut_off = flood.run(tuple(first), start)
    return Reach(parts, axes, is_reached, positions, cut_off)


class _Flood:
    """A grid as it is flooded, wave by wave."""

    def __init__(
        self,
        mechanism: Mechanism,
        frame: str,
        parts: Sequence[int],
        axes: Sequence[Floats],
        fixed: Mapping[int, float],
        least_held: float,
    ):
        self._mechanism, self._frame, self._least_held = mechanism, frame, least_held
        self._parts, self._axes, self._fixed = parts, axes, fixed
        self._shape = tuple(len(axis) for axis in axes)

    def run(self, first: tuple[int, ...], start: Floats) -> tuple[NDArray[np.bool_], Floats, bool]:
        """Cells that are reached, a pose of each, and whether the grid's border is."""
        is_reached = np.zeros(self._shape, dtype=bool)
        is_tried = np.zeros(self._shape, dtype=bool)
        cells, near = np.array([first]), start[None]
        poses: list[tuple[NDArray[np.intp], Floats]] = []
        while len(cells):
            is_tried[tuple(cells.T)] = True
            q, fits = self._solve(cells, near)
            cells, q = cells[fits], q[fits]
            is_reached[tuple(cells.T)] = True
            poses.append((np.ravel_multi_index(tuple(cells.T), self._shape), q))
            cells, near = self._next(cells, q, is_tried)
        order = np.argsort(np.concatenate([index for index, _ in poses]))
        positions = np.concatenate([q for _, q in poses])[order]
        faces = (
            np.take(is_reached, side, axis).any()
            for axis in range(len(self._shape))
            for side in (0, -1)
        )
        return is_reached, positions, any(faces)

    def _solve(self, cells: NDArray[np.intp], near: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        goals = np.full((len(cells), 6), np.nan)
        for part, value in self._fixed.items():
            goals[:, part] = value
        for k, part in enumerate(self._parts):
            goals[:, part] = self._axes[k][cells[:, k]]
        q, fits = self._mechanism.inverse_rows(self._frame, goals, near)
        fits = fits & self._mechanism.is_within_limits(q)
        if self._least_held > 0.0:
            for i in np.flatnonzero(fits):
                fits[i] = self._mechanism.dexterity(q[i]).held >= self._least_held
        return q, fits

    def _next(
        self, cells: NDArray[np.intp], q: Floats, is_tried: NDArray[np.bool_]
    ) -> tuple[NDArray[np.intp], Floats]:
        """Neighbours that have not been tried, each with the pose of a cell beside it."""
        ahead, near = [], []
        for axis, count in enumerate(self._shape):
            for step in (1, -1):
                beside = cells.copy()
                beside[:, axis] += step
                is_there = (beside[:, axis] >= 0) & (beside[:, axis] < count)
                ahead.append(beside[is_there])
                near.append(q[is_there])
        candidates, poses = np.concatenate(ahead), np.concatenate(near)
        is_new = ~is_tried[tuple(candidates.T)]
        candidates, poses = candidates[is_new], poses[is_new]
        _, first = np.unique(
            np.ravel_multi_index(tuple(candidates.T), self._shape), return_index=True
        )
        return candidates[first], poses[first]


def _middles(low: float, high: float, count: int) -> Floats:
    edges = np.linspace(low, high, count + 1)
    return 0.5 * (edges[1:] + edges[:-1])


def _shifted(cells: NDArray[np.bool_], axis: int, step: int) -> NDArray[np.bool_]:
    """Cells moved by one along an axis, nothing coming in."""
    moved = np.roll(cells, step, axis)
    edge: list[slice | int] = [slice(None)] * cells.ndim
    edge[axis] = 0 if step > 0 else -1
    moved[tuple(edge)] = False
    return moved
