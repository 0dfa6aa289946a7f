"""Way of the walking chair, counted by the feet that stand: what its encoders know of its place.

Feet that stand do not slip. From one instant to another the chair therefore has moved by as much
as the corners of these feet have gone the other way, seen from the body: a turn and a way that fit
them best, each corner counted by how near it is to the ground at both instants. Ways add up.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.vectors import Array
from parapod.systems.walking_chair.chair import foot_corners
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT, ChairGeometry

_LEVEL = np.eye(3)
# Height above the lowest corner from which on a corner counts no more [m]: by so much a chair that
# is not quite level, and a foot that is late, are off.
_TOUCHES = 4e-3
_HIGH = 1e3  # height of a corner whose place is unknown [m]
# Time after which a way is counted even though the same feet stand [s]: seldom, where it is known
# which these are, and often, where their heights tell it.
_LONGEST, _LONGEST_UNTOLD = 2.0, 0.05


class Footing(NamedTuple):
    """An instant from which on the way is counted.

    Attributes:
        place: (..., 3) x, y of the body [m] and its heading [rad] in the world.
        lengths: (..., 4, 3) lengths of the branches [m].
        stands: (..., 4) 1 for feet that stand from then on, 0 for those that swing.
    """

    place: Array
    lengths: Array
    stands: Array

    def at(self, geometry: ChairGeometry, lengths: ArrayLike) -> NDArray[np.float64]:
        """Place of the chair with other lengths, while the same feet stand.

        Args:
            geometry: the chair.
            lengths: (..., 4, 3) lengths of the branches then [m].

        Returns:
            (..., 3) x, y [m] and heading [rad]; the place of the footing where lengths are not
            finite or cannot be assembled.
        """
        before, after = _seen(geometry, self.lengths), _seen(geometry, lengths)
        return _added(self.place, _way(before, after, self.stands))


class FeetOdometer:
    """Counts the way over a recording, piece by piece, however long it is.

    Corners are worked out where feet come to stand or leave the ground, and once in a while
    between; what lies between these instants is asked of the newest `Footing`.
    """

    def __init__(self, geometry: ChairGeometry, place: ArrayLike):
        """Begins to count.

        Args:
            geometry: the chair.
            place: (2) x and y of the body at the first sample, where it looks ahead [m].
        """
        self._geometry = geometry
        self._place: Array = np.append(np.asarray(place, dtype=np.float64), 0.0)
        self._last: tuple[float, Array, Array] | None = None  # time, lengths, feet that stand

    def add(self, time: Array, lengths: ArrayLike, stands: ArrayLike | None = None) -> Footing:
        """Counts on.

        Args:
            time: (k) of further samples [s], in order.
            lengths: (k, 12) or (k, 4, 3) lengths of the branches [m]; where they are not finite
                the chair counts as standing still.
            stands: (k, 4) 1 for feet that stand, 0 for those that swing; None: those whose
                corners are the lowest.

        Returns:
            For each sample the newest footing, arrays (k, ...).

        Raises:
            ValueError: wrong shapes.
        """
        count = len(time)
        rows = np.reshape(np.asarray(lengths, dtype=np.float64), (count, LEG_COUNT, 3))
        longest = _LONGEST_UNTOLD if stands is None else _LONGEST
        feet: Array = np.ones((count, LEG_COUNT))
        if stands is not None:
            feet = (np.reshape(np.asarray(stands), (count, LEG_COUNT)) > 0.5).astype(np.float64)
        is_finite = np.isfinite(rows).all(axis=(1, 2))
        chosen = is_finite & self._is_counted(time, feet, is_finite, longest)
        places = np.flatnonzero(chosen)
        if self._last is None:
            if not places.size:
                return _unknown(self._place, count)
            first = places[0]
            self._last = float(time[first]), rows[first], feet[first]
        _, before, stood = self._last
        stops = np.concatenate((before[np.newaxis], rows[places]))
        begins = np.concatenate((stood[np.newaxis], feet[places]))
        footprints = _seen(self._geometry, stops)
        # A foot that comes down at a stop stands from it on: until then the others carry.
        ways = _way(footprints[:-1], footprints[1:], begins[:-1])
        way = _sum(self._place, ways)
        newest = np.searchsorted(places, np.arange(count), side="right")
        self._place = way[-1]
        if places.size:
            last = places[-1]
            self._last = float(time[last]), rows[last], feet[last]
        return Footing(way[newest], stops[newest], begins[newest])

    def _is_counted(
        self, time: Array, feet: Array, is_finite: NDArray[np.bool_], longest: float
    ) -> NDArray[np.bool_]:
        """(k) samples from which on the way is counted anew."""
        begin, last = (-np.inf, feet[0]) if self._last is None else (self._last[0], self._last[2])
        changes = (feet != np.concatenate((last[np.newaxis], feet[:-1]))).any(axis=1)
        # Beginnings of equal spans of time, which do not depend on the pieces.
        spans = np.floor(time / longest)
        previous = np.concatenate(([np.floor(begin / longest)], spans[:-1]))
        is_missing = np.concatenate(([False], ~is_finite[:-1]))  # what was to be counted there
        return changes | (spans != previous) | is_missing


def _seen(geometry: ChairGeometry, lengths: ArrayLike) -> Array:
    """(..., 12, 3) corners of all feet from the body [m]."""
    array = np.asarray(lengths, dtype=np.float64)
    corners = foot_corners(geometry, np.zeros(3), _LEVEL, array)
    return corners.reshape(*array.shape[:-2], len(BRANCHES), 3)


def _way(before: Array, after: Array, stands: Array) -> Array:
    """Way (..., 2) [m] and turn (..., 1) [rad] of the body, along its axes before."""
    feet = np.repeat(stands, 3, axis=-1)
    weights = feet * _near(before, feet) * _near(after, feet)
    # A chair of which nothing is known, or whose feet have all been changed, has not moved.
    is_finite = np.isfinite(before).all(axis=(-1, -2)) & np.isfinite(after).all(axis=(-1, -2))
    total = np.where(is_finite, weights.sum(axis=-1), 0.0)
    is_carried = total > 0.0
    share = (
        np.where(is_carried[..., None], weights, 0.0) / np.where(is_carried, total, 1.0)[..., None]
    )
    was, now = (np.nan_to_num(each[..., :2]) for each in (before, after))
    middle_was, middle_now = (np.einsum("...c,...ci->...i", share, each) for each in (was, now))
    was, now = was - middle_was[..., None, :], now - middle_now[..., None, :]
    along = np.einsum("...c,...ci,...ci->...", share, was, now)
    across = np.einsum(
        "...c,...c->...", share, now[..., 0] * was[..., 1] - now[..., 1] * was[..., 0]
    )
    turn = np.where(is_carried, np.arctan2(across, along), 0.0)
    way = middle_was - _turned(turn, middle_now)
    return np.concatenate((way, turn[..., None]), axis=-1)


def _near(corners: Array, feet: Array) -> Array:
    """(..., 12) 1 for corners as low as the lowest of the standing feet, 0 for higher ones."""
    heights = np.nan_to_num(corners[..., 2], nan=_HIGH)
    lowest = np.where(feet > 0.5, heights, _HIGH).min(axis=-1, keepdims=True)
    near: Array = np.clip(1.0 - (heights - lowest) / _TOUCHES, 0.0, 1.0)
    return near


def _turned(angle: Array, vectors: Array) -> Array:
    """Vectors (..., 2) turned by angles (...)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack((cosine * x - sine * y, sine * x + cosine * y), axis=-1)


def _added(place: Array, way: Array) -> Array:
    ahead = place[..., :2] + _turned(place[..., 2], way[..., :2])
    return np.concatenate((ahead, (place[..., 2] + way[..., 2])[..., None]), axis=-1)


def _sum(place: Array, ways: Array) -> Array:
    """(n + 1, 3) places of which the first is given, by n ways from each to the next."""
    headings = place[2] + np.concatenate(([0.0], np.cumsum(ways[:, 2])))
    steps = _turned(headings[:-1], ways[:, :2])
    there = place[:2] + np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
    return np.concatenate((there, headings[:, None]), axis=1)


def _unknown(place: Array, count: int) -> Footing:
    return Footing(
        np.tile(place, (count, 1)),
        np.full((count, LEG_COUNT, 3), np.nan),
        np.ones((count, LEG_COUNT)),
    )
