"""Workspace of the bench's plate: where its middle can be, at an angle or at all of a range.

A motion along the rail moves all sliders alike and leaves the mechanism's shape as it is. So at a
height and an angle the places along the rail are one interval, known exactly, and everything else
here is its ends, counted along z.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.elementwise import nan_without_warning
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import LIMITS, margins, slider_places

# Limits of the mechanism's shape come first; those of the sliders' rails are the interval.
_SHAPE = LIMITS.index("rear end of slider 1")
_LINE = LIMITS.index("line P T A_3")
# Heights at which the workspace is looked for; its ends are then sought in parts of a step, of a
# part, ...
_LOOKS, _PARTS, _REFINEMENTS = 800, 64, 6
_HALVINGS = 40  # in the search for the tallest box


class Box(NamedTuple):
    """A rectangle of the plane of motion [m].

    Attributes:
        x_min: rear end.
        x_max: front end.
        z_min: lower end.
        z_max: upper end.
    """

    x_min: float
    x_max: float
    z_min: float
    z_max: float

    @property
    def width(self) -> float:
        """Extent along the rail [m]."""
        return self.x_max - self.x_min

    @property
    def height(self) -> float:
        """Extent upwards [m]."""
        return self.z_max - self.z_min


@nan_without_warning
def rail_interval(
    geometry: BenchGeometry, z: ArrayLike, phi: ArrayLike, least_sin_mu: float = 0.0
) -> NDArray[np.float64]:
    """Places x of O' that the sliders reach at a height and an angle: (..., 2) both ends [m].

    Args:
        geometry: the bench.
        z: (...) heights of O' [m].
        phi: (...) angles [rad].
        least_sin_mu: least sine of the transmission angle; 0 up to the singularity itself.

    Returns:
        NaN where no place can be reached.
    """
    z, phi = np.broadcast_arrays(np.asarray(z, dtype=float), np.asarray(phi, dtype=float))
    pose = np.stack((np.zeros_like(z), z, phi), axis=-1)
    places, margins_along = slider_places(geometry, pose), margins(geometry, pose)[..., :_SHAPE]
    margins_along[..., _LINE] -= least_sin_mu
    ends = np.stack(
        (geometry.slider_min - places.min(axis=-1), geometry.slider_max - places.max(axis=-1)),
        axis=-1,
    )
    has_any = (margins_along >= 0.0).all(axis=-1) & (ends[..., 1] >= ends[..., 0])
    ends[~has_any] = np.nan
    return ends


@dataclass(frozen=True)
class Workspace:
    """Places of O' that the plate can take at each of some angles.

    Attributes:
        z: (n) heights, equally far apart [m]: middles of cells that fill what can be reached.
        ends: (n, 2) ends of the places along the rail [m]; NaN where there are none.
        z_min: lowest height [m]; NaN if there is none.
        z_max: greatest height [m]; NaN if there is none.
    """

    z: NDArray[np.float64]
    ends: NDArray[np.float64]
    z_min: float
    z_max: float

    @property
    def is_empty(self) -> bool:
        """True if no place can be reached."""
        return bool(np.isnan(self.z_min))

    @property
    def area(self) -> float:
        """Area [m^2]."""
        if self.is_empty:
            return 0.0
        step = (self.z_max - self.z_min) / len(self.z)
        return float(np.nansum(self.ends[:, 1] - self.ends[:, 0]) * step)

    @property
    def extent(self) -> Box:
        """Smallest box around it; NaN if it is empty."""
        if self.is_empty:
            return Box(np.nan, np.nan, np.nan, np.nan)
        rear, front = float(np.nanmin(self.ends[:, 0])), float(np.nanmax(self.ends[:, 1]))
        return Box(rear, front, self.z_min, self.z_max)

    @property
    def width(self) -> float:
        """Longest way along the rail at one height [m]; 0 if it is empty."""
        return 0.0 if self.is_empty else float(np.nanmax(self.ends[:, 1] - self.ends[:, 0]))

    def widest_box(self, height: float) -> Box | None:
        """The widest box of a height [m] within it; None if no box is as high."""
        if self.is_empty:
            return None
        step = (self.z_max - self.z_min) / len(self.z)
        # Cells whose middles lie in a box of that height, however it lies among them.
        cells = int(np.ceil(height / step)) + 1 if height > 0.0 else 1
        if cells > len(self.z):
            return None
        windows = np.lib.stride_tricks.sliding_window_view(self.ends, cells, axis=0)
        rear, front = windows[:, 0].max(axis=-1), windows[:, 1].min(axis=-1)
        widths = front - rear
        if not (widths >= 0.0).any():
            return None
        best = int(np.nanargmax(widths))
        low = float(self.z[best]) + 0.5 * ((cells - 1) * step - height)
        return Box(float(rear[best]), float(front[best]), low, low + height)

    def largest_box(self) -> Box | None:
        """The box of the largest area within it; None if it is empty."""
        if self.is_empty:
            return None
        step, best = (self.z_max - self.z_min) / len(self.z), None
        rear, front = np.nan_to_num(self.ends, nan=np.inf).T.copy()
        front[np.isinf(front)] = -np.inf
        rears, fronts, area = rear, front, 0.0
        for cells in range(1, len(self.z) + 1):
            # From the middle of its lowest cell to that of its highest one.
            height = (cells - 1) * step
            areas = height * (fronts - rears)
            first = int(areas.argmax())
            if areas[first] > area:
                area, low = float(areas[first]), float(self.z[first])
                best = Box(float(rears[first]), float(fronts[first]), low, low + height)
            rears = np.maximum(rears[:-1], rear[cells:])
            fronts = np.minimum(fronts[:-1], front[cells:])
        return best

    def tallest_box(self, width: float) -> Box | None:
        """The tallest box of a width [m] within it; None if no box is as wide."""
        if self.width < width:
            return None
        low, high = 0.0, self.z_max - self.z_min
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            box = self.widest_box(middle)
            low, high = (middle, high) if box and box.width >= width else (low, middle)
        return self.widest_box(low)


def workspace(
    geometry: BenchGeometry,
    phi: ArrayLike,
    least_sin_mu: float = 0.0,
    cells: int = 4000,
) -> Workspace:
    """Workspace of the plate at an angle, or what it has in common at several.

    Args:
        geometry: the bench.
        phi: angle, or (k) angles that are all to be possible at each place [rad].
        least_sin_mu: least sine of the transmission angle.
        cells: number of heights.

    Raises:
        ValueError: an angle that is not finite, or none.
    """
    angles = np.atleast_1d(np.asarray(phi, dtype=float)).ravel()
    if not angles.size or not np.isfinite(angles).all():
        raise ValueError(f"phi must be finite angles, not {phi!r}")

    def ends(z: NDArray[np.float64]) -> NDArray[np.float64]:
        each = rail_interval(geometry, z[:, None], angles, least_sin_mu)
        common = np.stack((each[..., 0].max(axis=1), each[..., 1].min(axis=1)), axis=-1)
        common[~(common[:, 1] >= common[:, 0])] = np.nan
        return common

    highest = geometry.link + math.hypot(*geometry.p_OP)
    looks = np.linspace(0.0, highest, _LOOKS)
    reachable = np.flatnonzero(~np.isnan(ends(looks)[:, 0]))
    if not reachable.size:
        return Workspace(np.empty(0), np.empty((0, 2)), np.nan, np.nan)

    def edge(inside: float, outside: float) -> float:
        for _ in range(_REFINEMENTS):
            z = np.linspace(inside, outside, _PARTS + 1)
            first_out = int(np.argmax(np.isnan(ends(z)[:, 0])))
            inside, outside = z[first_out - 1], z[first_out]
        return inside

    step = looks[1]
    low = edge(looks[reachable[0]], looks[reachable[0]] - step)
    high = edge(looks[reachable[-1]], looks[reachable[-1]] + step)
    z = low + (high - low) * (np.arange(cells) + 0.5) / cells
    return Workspace(z, ends(z), float(low), float(high))
