"""Support polygons of the walking chair, and the monitor that holds a gait near tipping."""

import math
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context
from scipy.spatial import ConvexHull, QhullError  # type: ignore[import-untyped]

from parapod.systems.core.batching import first_of_largest
from parapod.systems.core.elementwise import (
    Elementwise,
    both,
    greatest,
    is_finite,
    least,
    where,
)
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import declare_cached, read
from parapod.systems.core.rows import answer_of, batch_of, number_of, shared
from parapod.systems.core.vectors import product
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.geometry import (
    ChairGeometry,
)
from parapod.systems.walking_chair.masses import (
    ChairMasses,
    Passenger,
    centre_of_mass,
)


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

    def margin(self, point: Any) -> Elementwise:
        """Distance of a point (2) from the nearest edge's line [m]; negative outside.

        Minus infinity without a polygon, and for a point that is not finite.
        """
        place = batch_of(point)
        if not (self.offsets.size and answer_of(np.isfinite(place).all(axis=-1))):
            return -np.inf
        inside = self.offsets - product(self.normals, place)
        return number_of(inside.min(axis=-1))


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


# Corners this close to the ground touch it [m].
_TOUCHING = 1e-6
_SAME_MARGIN = 1e-9  # difference of two phases' margins that is rounding [m]


class SupportLost(ParapodError):
    """A gait in which the chair would come too close to tipping over.

    Attributes:
        margin: distance of the centre of mass from the edge of the support polygon [m]; negative
            outside.
        required: smallest admissible [m].
        phase: name of the phase.
        time: beginning of the phase, in the gait's time [s].
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
        polygon: polygon of the corners that touch the ground throughout.
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
        masses: masses of the chair.
    """

    def __init__(self, geometry: ChairGeometry, walk: Walk, masses: ChairMasses = ChairMasses()):
        self._geometry, self._walk, self._masses = geometry, walk, masses

    def margins(self, passenger: Passenger) -> NDArray[np.float64]:
        """(phases,) smallest distance of the centre of mass from the polygon's edge [m]."""
        return np.array([self.margin(i, passenger) for i in range(len(self._phases))])

    def margin(self, phase: int, passenger: Passenger) -> Elementwise:
        """Smallest distance of the centre of mass from the polygon's edge in a phase [m]."""
        polygon, bodies, feet = self._phases[phase]
        _, places = centre_of_mass(self._masses, passenger, feet)
        beginning, end = (bodies + places)[:, :2]
        return least(polygon.margin(beginning), polygon.margin(end))

    def polygon(self, phase: int) -> SupportPolygon:
        """The support polygon of a phase, in the world."""
        return self._phases[phase].polygon

    def check(self, passenger: Passenger, required: float) -> None:
        """Refuses a gait before its first step.

        Raises:
            SupportLost: a phase in which the margin is smaller than required; the worst one, and
                of those that are alike the first.
        """
        margins = self.margins(passenger)
        (worst,) = first_of_largest(-margins, _SAME_MARGIN)
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
        phases = []
        for i, stands in enumerate(self._walk.standing):
            always = touching[i] & touching[i + 1] & np.array(stands)[:, None]
            polygon = support_polygon(corners[i][always][:, :2])
            phases.append(_Phase(polygon, body[i : i + 2], centroids[i : i + 2]))
        return phases


@dataclass(frozen=True)
class SupportMonitorParams:
    """Margin that the centre of mass must keep inside the support polygon.

    Attributes:
        required: smallest margin with which a step is begun [m]. Feet and branches give way: of a
            margin computed rigidly some 4 mm are lost under 57 kg.
        regained: increase of the margin after which the gait goes on [m].
    """

    required: float = 0.010
    regained: float = 0.005


class SupportMonitor(LeafSystem):
    """The support margin of this phase of the gait and of the next, and whether to hold.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `gait_time` | 1 | s | the gait's clock |
    | in `payload` | 3 | kg, m, m | mass of the payload, and x and y of its centre from S |
    | out `margin` | 1 | m | smallest distance of the centre of mass from the polygon's edge |
    | out `hold` | 1 | 0/1 | whether no further step may be made |

    State: discrete, whether the gait is held, updated every period.

    Bad input: with a payload or a time that is not finite the margin is minus infinity, and the
    gait held.

    Args:
        walk: the gaits.
        params: see `SupportMonitorParams`.
        geometry: the chair.
        masses: masses of the chair without payload.
        period: period of the state [s].
    """

    def __init__(
        self,
        walk: Walk = Walk(),
        params: SupportMonitorParams = SupportMonitorParams(),
        geometry: ChairGeometry = ChairGeometry(),
        masses: ChairMasses = ChairMasses(),
        period: float = 0.2,
    ):
        super().__init__()
        self.set_name("support_monitor")
        self._params, self._walk = params, walk
        self._support = GaitSupport(geometry, walk, masses)
        self._time = self.DeclareVectorInputPort("gait_time", 1)
        self._payload = self.DeclareVectorInputPort("payload", 3)
        index = self.DeclareDiscreteState(1)
        inputs = {self._time.ticket(), self._payload.ticket()}
        self._margin = declare_cached(self, "smallest_margin", self._smallest_margin, inputs)
        self.DeclareVectorOutputPort("margin", 1, self._calc_margin, {self._margin.ticket})
        self.DeclareStateOutputPort("hold", index)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_hold)

    def _smallest_margin(self, context: Context) -> Elementwise:
        (time,), payload = read(self._time, context), read(self._payload, context)
        if not reduce(both, map(is_finite, (time, *payload))):
            return -math.inf
        mass, x, y = payload
        passenger = Passenger(greatest(0.0, mass), x, y)
        now = shared(self._walk.phase_at, time)
        coming = range(now, min(now + 2, len(self._walk.phases)))
        return reduce(least, (self._support.margin(phase, passenger) for phase in coming))

    def _calc_margin(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([self._margin.value(self, context)]))

    def _update_hold(self, context: Context, discrete_state: Any) -> None:
        hold: Any = context.get_discrete_state_vector()
        params = self._params
        required = params.required + where(hold[0] > 0.5, params.regained, 0.0)
        holds = where(self._margin.value(self, context) >= required, 0.0, 1.0)
        discrete_state.set_value(np.array([holds]))
