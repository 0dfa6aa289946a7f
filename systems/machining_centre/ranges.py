"""Ranges of the machining centre in closed form: heights, places, tilts, holes, forces."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import of_width
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import standing
from parapod.systems.machining_centre.panel import Panel
from parapod.systems.machining_centre.platform_mode import (
    jacobian,
    leg_lengths,
    length_scale,
    within_stroke,
)
from parapod.systems.machining_centre.workspace import is_reachable

# Steps in which a range is looked through for its first end, and halvings of the step with it.
_LOOKS, _HALVINGS = 60, 30
# Largest tilt that is looked at [rad].
_STEEPEST = math.radians(75.0)
# Cells along each edge in which a workspace is looked for first.
_COARSE = 24


def upright_heights(geometry: CentreGeometry) -> tuple[float, float]:
    """Smallest and largest height of the upright platform above its feet's middle [m].

    Both are those of P_O above the ankles; NaN if legs are too short to stand.
    """
    aside = math.hypot(*(geometry.pivots[0] - geometry.footholds[0, :3])[:2].tolist())
    if not aside < geometry.stroke_max:
        return math.nan, math.nan
    low, high = (
        math.sqrt(max(0.0, length**2 - aside**2))
        for length in (geometry.stroke_min, geometry.stroke_max)
    )
    return low, high


class Places(NamedTuple):
    """Cells that the upright platform reaches, feet at home on a plane.

    Attributes:
        place: (n, 3) middles of the cells, from the middle of the feet to P_O [m].
        low: (3) corner of the smallest box about them [m].
        high: (3) other corner of it [m].
        volume: volume of each cell [m^3].
    """

    place: Array
    low: Array
    high: Array
    volume: float

    @property
    def poses(self) -> Array:
        """Poses (n, 6) of the platform [m, rad]."""
        return np.hstack((self.place, np.zeros_like(self.place)))


def platform_places(geometry: CentreGeometry, cells: int) -> Places:
    """Places of the upright platform above its feet, each leg within its stroke.

    Args:
        geometry: the centre.
        cells: number along each edge of the box about them.
    """
    reach = geometry.pattern_radius + geometry.platform_radius + geometry.stroke_max
    low, high = np.array((-reach, -reach, 0.0)), np.array((reach, reach, geometry.stroke_max))
    for count in (_COARSE, _COARSE, cells):
        edges = (high - low) / count
        shares = (np.indices((count,) * 3).reshape(3, -1).T + 0.5) / count
        place = low + shares * (high - low)
        place = place[is_reachable(geometry, np.hstack((place, np.zeros_like(place))))]
        if not len(place):
            break
        bottom = np.maximum(place.min(axis=0) - edges, (-reach, -reach, 0.0))
        low, high = bottom, place.max(axis=0) + edges
    return Places(place, low + 0.5 * edges, high - 0.5 * edges, float(edges.prod()))


def drilling_poses(
    panel: Panel, along: ArrayLike, across: ArrayLike, height: float
) -> NDArray[np.float64]:
    """Poses (..., 6) of the platform upright on the panel at places of it [m, rad].

    Args:
        panel: the panel.
        along: (...) ways along its circumference [m].
        across: (...) ways across it [m].
        height: height of P_O above the panel [m].
    """
    way, side = np.broadcast_arrays(np.asarray(along, float), np.asarray(across, float))
    poses = np.zeros((*way.shape, 6))
    poses[..., 1] = side
    if math.isinf(panel.radius):
        poses[..., 0], poses[..., 2] = way, height
    else:
        turn, out = way / panel.radius, panel.radius + height
        poses[..., 0], poses[..., 4] = out * np.sin(turn), turn
        poses[..., 2] = out * np.cos(turn) - panel.radius
    return poses


def tilt_range(geometry: CentreGeometry, panel: Panel, azimuth: ArrayLike) -> NDArray[np.float64]:
    """Largest tilt (...) of the drill whose tip is on the panel amid the feet [rad].

    Args:
        geometry: the centre.
        panel: the panel on which it stands at home.
        azimuth: (...) direction in which the drill's axis leans, from the way along the panel's
            circumference against the clock [rad].
    """
    toward = np.asarray(azimuth, dtype=float)

    def poses(tilt: Array) -> Array:
        c, s = np.cos(tilt), np.sin(tilt)
        out = np.stack((s * np.cos(toward), s * np.sin(toward), c), axis=-1)
        # Roll and pitch that bring the third axis there, about fixed axes and without yaw.
        roll, pitch = -np.arcsin(out[..., 1]), np.arctan2(out[..., 0], out[..., 2])
        angles = np.stack((roll, pitch, np.zeros_like(roll)), axis=-1)
        return np.concatenate((geometry.tool_length * out, angles), axis=-1)

    return _first_end(geometry, panel, poses, np.full(toward.shape, _STEEPEST))


def drill_range(geometry: CentreGeometry, panel: Panel, azimuth: ArrayLike) -> NDArray[np.float64]:
    """Farthest places (...) that the upright drill reaches without a gap, from amid the feet [m].

    Args:
        geometry: the centre.
        panel: the panel on which it stands at home.
        azimuth: (...) directions, from the way along the panel's circumference against the clock
            [rad].
    """
    toward = np.asarray(azimuth, dtype=float)

    def poses(way: Array) -> Array:
        along, across = way * np.cos(toward), way * np.sin(toward)
        return drilling_poses(panel, along, across, geometry.tool_length)

    farthest = geometry.stroke_max + geometry.pattern_radius + geometry.platform_radius
    return _first_end(geometry, panel, poses, np.full(toward.shape, farthest))


def _first_end(
    geometry: CentreGeometry, panel: Panel, poses: Callable[[Array], Array], farthest: Array
) -> Array:
    """First value (...) from 0 on at which a leg leaves its stroke; 0 if one has before."""
    feet = standing(geometry, panel, 0.0).feet

    def is_out(value: Array) -> NDArray[np.bool_]:
        return ~within_stroke(geometry, leg_lengths(geometry, poses(value), feet)).all(axis=-1)

    shares = np.linspace(0.0, 1.0, _LOOKS + 1)
    out = np.array([is_out(share * farthest) for share in shares])
    out[-1] = True
    first = out.argmax(axis=0)
    high = shares[first] * farthest
    low = np.where(first > 0, shares[np.maximum(first - 1, 0)] * farthest, 0.0)
    for _ in range(_HALVINGS):
        between = 0.5 * (low + high)
        outside = is_out(between)
        low, high = np.where(outside, low, between), np.where(outside, between, high)
    return np.where(first > 0, low, 0.0)


def holding_forces(
    geometry: CentreGeometry, pose: ArrayLike, footholds: ArrayLike | None, wrench: ArrayLike
) -> Array:
    """Forces (..., 2n) with which clamped legs hold a wrench, positive where they push [N].

    Of more than six legs they are the smallest ones that balance it, as those of `CentreStatics`.

    Args:
        geometry: the centre.
        pose: (..., 6) of the platform [m, rad].
        footholds: (n, 6) of the feet [m, rad]; None for the paper's pattern.
        wrench: (..., 6) on the platform at P_O, in the world [N m, N].
    """
    rows = jacobian(geometry, pose, footholds)
    inverse = np.linalg.pinv(np.swapaxes(rows, -1, -2))
    load = of_width(wrench, 6, "wrench")
    return -(inverse @ load[..., np.newaxis])[..., 0]


def scaled_jacobian(
    geometry: CentreGeometry, pose: ArrayLike, footholds: ArrayLike | None = None
) -> Array:
    """Rates (..., 2n, 6) of the legs by the platform's twist, angles times r_c [-].

    Args:
        geometry: the centre.
        pose: (..., 6) of the platform [m, rad].
        footholds: (n, 6) of the feet [m, rad]; None for the paper's pattern.
    """
    return jacobian(geometry, pose, footholds) / length_scale(geometry)
