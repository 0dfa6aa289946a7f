"""Support polygons of the walking chair, and how far a point is from their edges."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError  # type: ignore[import-untyped]


class SupportPolygon(NamedTuple):
    """Convex hull of the contacts as half planes: normals . point <= offsets inside.

    Attributes:
        normals: (n, 2) outward unit normals of the edges.
        offsets: (n) [m].
        corners: (n, 2) of the polygon, anticlockwise [m].
    """

    normals: NDArray[np.float64]
    offsets: NDArray[np.float64]
    corners: NDArray[np.float64]

    def margin(self, point: ArrayLike) -> float:
        """Distance of a point (2) from the nearest edge's line [m]; negative outside.

        Minus infinity without a polygon, and for a point that is not finite.
        """
        place = np.asarray(point, dtype=np.float64)
        if not (self.offsets.size and np.isfinite(place).all()):
            return -np.inf
        return float((self.offsets - self.normals @ place).min())


NO_SUPPORT = SupportPolygon(np.empty((0, 2)), np.empty(0), np.empty((0, 2)))


def support_polygon(contacts: ArrayLike) -> SupportPolygon:
    """The polygon that contacts (n, 2) [m] span; empty if they lie on a line."""
    points = np.asarray(contacts, dtype=np.float64).reshape(-1, 2)
    if len(points) < 3 or not np.isfinite(points).all():
        return NO_SUPPORT
    try:
        hull = ConvexHull(points)
    except QhullError:
        return NO_SUPPORT
    return SupportPolygon(hull.equations[:, :2], -hull.equations[:, 2], hull.points[hull.vertices])
