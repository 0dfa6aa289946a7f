"""Ranges of the walking chair in closed form: heights, ground, places of a foot, steps."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.vectors import cross
from parapod.systems.walking_chair.checks import Stances, stroke_excess
from parapod.systems.walking_chair.gait import TrotGait, gait_branches
from parapod.systems.walking_chair.geometry import ChairGeometry, LegGeometry
from parapod.systems.walking_chair.leg import (
    branch_lengths,
    carried,
    carried_jacobian,
    leg_corners,
    up_of_lengths,
)
from parapod.systems.walking_chair.rates import corner_jacobians
from parapod.systems.walking_chair.statics import force_map

# A length that was computed for an actuator at its stroke's end is admissible, by the stroke [-].
_ROUNDING = 1e-9
# Instants of a phase that are looked at, in each of the parts of a swing too, and those about the
# one with the largest value.
_INSTANTS, _CLOSELY = 60, 41
_HALVINGS = 24
# Cells along each coordinate in which a foot's places are looked for first.
_LOOKS = 13
# Coordinates of a UP branch that differ by less are the same [m, rad].
_SAME = 1e-6


def straight_lengths(geometry: LegGeometry, height: ArrayLike) -> NDArray[np.float64]:
    """Lengths (..., 3) of the branches of a leg that hangs straight [m].

    Args:
        geometry: the leg.
        height: (...) of the upper platform's face above the foot's corners [m].
    """
    up = np.zeros((*np.shape(height), 3))
    up[..., 0] = np.asarray(height) - geometry.x1 - geometry.x2
    return branch_lengths(geometry, up)


def straight_ends(leg: LegGeometry) -> tuple[float, float]:
    """Lengths of the UP branch beside UPS branches at the ends of their stroke, leg straight [m].

    An end is 0 if the UPS branches are too short to meet the UP branch.
    """
    aside = leg.a - leg.b  # the corners of the UP branch are above each other
    squares = (ups * ups - aside * aside for ups in leg.ups_stroke)
    low, high = (leg.x3 - leg.x2 + math.sqrt(max(0.0, square)) for square in squares)
    return low, high


def standing_heights(leg: LegGeometry) -> tuple[float, float]:
    """Smallest and largest height of the upper platform above a foot below it [m].

    Both are NaN if no length of the UP branch lets the UPS branches be within their stroke.
    """
    ends = straight_ends(leg)
    low, high = max(leg.up_stroke[0], ends[0]), min(leg.up_stroke[1], ends[1])
    if not low < high:
        return math.nan, math.nan
    return low + leg.x1 + leg.x2, high + leg.x1 + leg.x2


def straight_corners(
    geometry: ChairGeometry, corners: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Corners (4, 3, 2) of the legs' platforms from S, from above, legs straight [m].

    Args:
        geometry: the chair.
        corners: (3, 3) of a platform in the leg's frame {A1} [m]; None: those of a foot.
    """
    of_leg = geometry.leg.corners if corners is None else corners
    places = geometry.p_SA[:, None, :] + np.einsum("lij,kj->lki", geometry.R_SA, of_leg)
    return np.asarray(places[..., :2])


def straight_stance(geometry: ChairGeometry) -> Stances:
    """Stance of a chair whose legs hang straight, their UP branches retracted."""
    height = geometry.leg.retracted_height
    lengths = straight_lengths(geometry.leg, np.full(len(geometry.placements), height))
    corners = np.concatenate(
        (straight_corners(geometry), np.full((len(lengths), 3, 1), -height)), axis=-1
    )
    by_vertical = force_map(geometry, lengths)[..., 2]
    return Stances(np.zeros(1), corners[np.newaxis], by_vertical[np.newaxis])


def overlap(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Depth by which two convex polygons (n, 2) overlap [m]; negative: they are apart."""
    depths = []
    for polygon in (one, other):
        edges = np.roll(polygon, -1, axis=0) - polygon
        normals = np.column_stack((edges[:, 1], -edges[:, 0]))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        a, b = one @ normals.T, other @ normals.T
        depths.append(np.minimum(a.max(axis=0) - b.min(axis=0), b.max(axis=0) - a.min(axis=0)))
    return float(np.min(depths))


def level_range(geometry: ChairGeometry, azimuth: ArrayLike) -> NDArray[np.float64]:
    """Largest inclination (...) of ground on which the chair stands level, legs straight [rad].

    Soles stay level, so that each foot stands on its highest corner.

    Args:
        geometry: the chair.
        azimuth: (...) direction in which the ground rises, from x against the clock [rad].
    """
    low, high = standing_heights(geometry.leg)
    along = np.asarray(azimuth, dtype=float)
    uphill = np.stack((np.cos(along), np.sin(along)), axis=-1)
    ways = np.einsum("lki,...i->...lk", straight_corners(geometry), uphill).max(axis=-1)
    return np.asarray(np.arctan2(high - low, np.ptp(ways, axis=-1)))


class FootPlaces(NamedTuple):
    """Cells of the places that the middle of a foot takes.

    Attributes:
        up: (n, 3) coordinates of the UP branch [m, rad, rad].
        place: (n, 3) in the leg's frame {A1} [m].
        volume: (n) of the cells [m^3].
    """

    up: NDArray[np.float64]
    place: NDArray[np.float64]
    volume: NDArray[np.float64]


def foot_places(leg: LegGeometry, cells: int, lean: float) -> FootPlaces:
    """Places of a foot's middle at which all branches are within their strokes.

    Its branches take them as they are assembled while the leg hangs straight.

    Args:
        leg: the leg.
        cells: number along each coordinate of the UP branch.
        lean: largest angle of the UP branch about each of its axes [rad].
    """
    ends = np.array((leg.up_stroke, (-lean, lean), (-lean, lean)))
    # First where any are at all, then there.
    for count in (_LOOKS, cells):
        widths = (ends[:, 1] - ends[:, 0]) / count
        shares = (np.indices((count,) * 3).reshape(3, -1).T + 0.5) / count
        up = ends[:, 0] + shares * (ends[:, 1] - ends[:, 0])
        up = up[(stroke_excess(leg, branch_lengths(leg, up)) <= 0.0).all(axis=-1)]
        if not len(up):
            break
        low, high = up.min(axis=0) - widths, up.max(axis=0) + widths
        ends = np.stack((np.maximum(low, ends[:, 0]), np.minimum(high, ends[:, 1])), axis=-1)
    own = up_of_lengths(leg, branch_lengths(leg, up))
    up = up[np.abs(own - up).max(axis=-1) < _SAME]
    middle = leg.corners.mean(axis=0)
    from_joint = carried(leg, up, np.broadcast_to(middle, up.shape))
    volume = np.abs(np.linalg.det(carried_jacobian(up, from_joint))) * float(widths.prod())
    return FootPlaces(up, from_joint + leg.upper_joints[0], volume)


def foot_jacobian(geometry: LegGeometry, up: ArrayLike) -> NDArray[np.float64]:
    """Derivative (..., 3, 3) of the place of a foot's middle by the branches' lengths [-].

    Args:
        geometry: the leg.
        up: (..., 3) coordinates of the UP branch [m, rad, rad].
    """
    return np.asarray(corner_jacobians(geometry, up).mean(axis=-3))


def body_stiffness(
    geometry: ChairGeometry, lengths: ArrayLike, stiffness: float
) -> NDArray[np.float64]:
    """Stiffness (6, 6) of the body on feet that stay where they are, about S.

    The middles of the feet hold like ball joints. Rows are forces and moments, columns
    translations and turns, along the body's axes [N/m, N, N m].

    Args:
        geometry: the chair.
        lengths: (4, 3) of the branches [m].
        stiffness: axial stiffness of a branch [N/m].
    """
    up = up_of_lengths(geometry.leg, lengths)
    by_lengths = geometry.R_SA @ foot_jacobian(geometry.leg, up)
    of_foot = stiffness * np.linalg.inv(by_lengths @ np.swapaxes(by_lengths, -1, -2))
    middles = leg_corners(geometry.leg, up).mean(axis=-2)
    arms = geometry.p_SA + np.einsum("lij,lj->li", geometry.R_SA, middles)
    # Motion of a place of the body above each foot by the body's.
    turns = [cross(np.broadcast_to(axis, arms.shape), arms) for axis in np.eye(3)]
    by_body = np.concatenate(
        (np.broadcast_to(np.eye(3), (len(arms), 3, 3)), np.stack(turns, axis=-1)), axis=-1
    )
    return np.asarray(np.einsum("lai,lab,lbj->ij", by_body, of_foot, by_body))


def gait_excess(geometry: ChairGeometry, gait: TrotGait) -> float:
    """Largest excess of a branch over its stroke in a gait [m]; infinite out of reach."""

    def excess(times: NDArray[np.float64]) -> NDArray[np.float64]:
        return stroke_excess(geometry.leg, gait_branches(geometry, one, times).length)

    one = replace(gait, cycles=1)
    return _peak(one, excess)


def gait_speed(geometry: ChairGeometry, gait: TrotGait) -> float:
    """Largest speed of a branch in a gait [m/s]; infinite out of reach."""

    def speed(times: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.abs(gait_branches(geometry, one, times).velocity)

    one = replace(gait, cycles=1)
    return _peak(one, speed)


def _peak(
    gait: TrotGait, values_at: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> float:
    """Largest value (k, 4, 3) in a gait, looked at closely where it is; infinite for NaN."""
    times = np.linspace(0.0, gait.duration, len(gait.phases) * _INSTANTS + 1)
    values = values_at(times).max(axis=(1, 2))
    if np.isnan(values).any():
        return math.inf
    place = int(values.argmax())
    low, high = times[max(0, place - 1)], times[min(place + 1, len(times) - 1)]
    return max(float(values[place]), float(values_at(np.linspace(low, high, _CLOSELY)).max()))


def largest_size(geometry: ChairGeometry, gait_of: Callable[[float], TrotGait]) -> float:
    """Largest size with which a gait is within the strokes [m]; 0 if none will do.

    Args:
        geometry: the chair.
        gait_of: gait with a size [m], such as that of its steps.
    """
    stroke = geometry.leg.stroke
    low, high = 0.0, 2.0 * stroke
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        fits = gait_excess(geometry, gait_of(middle)) <= _ROUNDING * stroke
        low, high = (middle, high) if fits else (low, middle)
    return low
