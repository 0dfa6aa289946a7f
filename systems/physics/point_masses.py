"""Point masses that bodies take, and lose again, by the weights among pushes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.tree import RigidBody, SpatialInertia, UnitInertia

from parapod.systems.core.physics import GRAVITY

# Mass above which a weight is absurd [kg].
_HEAVIEST = 1e6

type Place = tuple[float, float, float]


class Points:
    """Point masses on bodies of a plant, each known by its weight among pushes."""

    def __init__(self, points: Sequence[tuple[int, RigidBody, Place]]):
        """Takes the masses.

        Args:
            points: index among the pushes, body, and place from its origin by its axes [m], each.
        """
        self._forces = [6 * i + 5 for i, *_ in points]
        self._bodies: dict[int, tuple[RigidBody, list[int], list[Place]]] = {}
        for k, (_, body, place) in enumerate(points):
            entry = self._bodies.setdefault(int(body.index()), (body, [], []))
            entry[1].append(k)
            entry[2].append(place)

    def masses(self, pushes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Masses (..., n) of which pushes (..., 6k) hold the weights [kg]; 0: absurd ones."""
        masses = pushes[..., self._forces] / -GRAVITY
        return np.where(np.abs(masses) < _HEAVIEST, masses, 0.0)

    def inertias(self, masses: ArrayLike) -> list[tuple[RigidBody, SpatialInertia]]:
        """Bodies with their inertias, about their origins by their axes, for masses (n) [kg].

        A body that has not got what it would lose loses nothing.
        """
        each, inertias = np.asarray(masses, dtype=float), []
        for body, indices, places in self._bodies.values():
            own = body.default_spatial_inertia()
            inertia = with_points(own, each[indices], places)
            inertias.append((body, inertia if inertia.IsPhysicallyValid() else own))
        return inertias

    def impossible(self, masses: ArrayLike) -> list[RigidBody]:
        """Bodies that have not got what they would lose of masses (n) below zero [kg]."""
        each = np.minimum(np.asarray(masses, dtype=float), 0.0)
        return [
            body
            for body, indices, places in self._bodies.values()
            if not with_points(
                body.default_spatial_inertia(), each[indices], places
            ).IsPhysicallyValid()
        ]


def with_points(
    own: SpatialInertia, masses: ArrayLike, places: Sequence[ArrayLike]
) -> SpatialInertia:
    """Inertia of a body and of point masses on it, about its origin and by its axes.

    It may be one that no body has, if masses are below zero: see `IsPhysicallyValid`.

    Args:
        own: inertia of the body alone.
        masses: (n) the masses [kg]; below zero those that it has lost.
        places: (n, 3) their places, from its origin by its axes [m].
    """
    each, points = np.asarray(masses, dtype=float), np.asarray(places, dtype=float)
    if not each.any():
        return own
    mass = own.get_mass() + float(each.sum())
    if mass == 0.0:
        return SpatialInertia.Zero()
    moment = own.CalcComMoment() + each @ points
    about_origin = own.CalcRotationalInertia().CopyToFullMatrix3()
    squares = (points * points).sum(axis=1)
    about_origin += each @ squares * np.eye(3) - (points * each[:, np.newaxis]).T @ points
    (xx, xy, xz), (_, yy, yz), (*_, zz) = (about_origin / mass).tolist()
    unit = UnitInertia(xx, yy, zz, xy, xz, yz)
    return SpatialInertia(mass, moment / mass, unit, skip_validity_check=True)
