"""How safely the chair stands in each phase of a gait, before a step is made."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from parapod.systems.errors import ParapodError
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.masses import ChairMasses, Passenger, centre_of_mass
from parapod.systems.walking_chair.support import SupportPolygon, support_polygon
from parapod.systems.walking_chair.walk import Walk

# Corners this close to the ground touch it [m].
_TOUCHING = 1e-6


class SupportLost(ParapodError):
    """A gait in which the chair would come too close to tipping over.

    Attributes:
        margin: distance of the centre of mass from the edge of the support polygon [m]; negative
            outside.
        required: smallest admissible [m].
        phase: name of the phase.
        time: when the phase begins, in the gait's time [s].
    """

    def __init__(self, margin: float, required: float, phase: str, time: float):
        self.margin, self.required, self.phase, self.time = margin, required, phase, time
        super().__init__(
            f"the {phase} that begins {time:g} s after the start would have a support margin of "
            f"{1e3 * margin:.1f} mm, less than the {1e3 * required:.1f} mm that are required"
        )


class _Phase(NamedTuple):
    """A phase of the gait.

    Attributes:
        polygon: of the corners that touch the ground throughout.
        bodies: (2, 3) S in the world at its beginning and its end [m].
        feet: (2, 4, 3) centroids of the feet from S then [m].
    """

    polygon: SupportPolygon
    bodies: NDArray[np.float64]
    feet: NDArray[np.float64]


class GaitSupport:
    """Support polygons of a walk's phases, and margins in them.

    Args:
        geometry: the chair.
        walk: the gaits.
        masses: of the chair.
    """

    def __init__(self, geometry: ChairGeometry, walk: Walk, masses: ChairMasses = ChairMasses()):
        self._geometry, self._walk, self._masses = geometry, walk, masses

    def margins(self, passenger: Passenger) -> NDArray[np.float64]:
        """(phases,) smallest distance of the centre of mass from the polygon's edge [m]."""
        return np.array([self.margin(i, passenger) for i in range(len(self._phases))])

    def margin(self, phase: int, passenger: Passenger) -> float:
        """Smallest distance of the centre of mass from the polygon's edge in a phase [m]."""
        polygon, bodies, feet = self._phases[phase]
        _, places = centre_of_mass(self._masses, passenger, feet)
        return min(polygon.margin(point) for point in (bodies + places)[:, :2])

    def polygon(self, phase: int) -> SupportPolygon:
        """The support polygon of a phase, in the world."""
        return self._phases[phase].polygon

    def check(self, passenger: Passenger, required: float) -> None:
        """Refuses a gait before its first step.

        Raises:
            SupportLost: a phase in which the margin is smaller than required; the worst one.
        """
        margins = self.margins(passenger)
        worst = int(np.argmin(margins))
        if not margins[worst] >= required:
            name = self._walk.phases[worst]
            time = (0.0, *self._walk.ends)[worst]
            raise SupportLost(float(margins[worst]), required, name, time)

    @cached_property
    def _phases(self) -> list[_Phase]:
        times = (0.0, *self._walk.ends)
        motions = [self._walk.motion(self._geometry, time, "left") for time in times]
        body = np.array([motion.body.position for motion in motions])
        feet = np.array([motion.feet.position for motion in motions])
        references = np.array([motion.references for motion in motions])
        lengths = chair_inverse(self._geometry, body, np.eye(3), feet, references)
        corners = foot_corners(self._geometry, body, np.eye(3), lengths)
        centroids = corners.mean(axis=-2) - body[:, None, :]
        touching = corners[..., 2] < _TOUCHING
        found = []
        for i, stands in enumerate(self._walk.standing):
            always = touching[i] & touching[i + 1] & np.array(stands)[:, None]
            polygon = support_polygon(corners[i][always][:, :2])
            found.append(_Phase(polygon, body[i : i + 2], centroids[i : i + 2]))
        return found
