"""Load on the plate by the currents of the sliders: a check on the force cells."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.batching import columns, of_width, stack
from parapod.systems.core.elementwise import Elementwise, sin_cos
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    UnreachablePlate,
    forward_kinematics,
    inverse_jacobian,
    slider_accelerations,
    slider_places,
)

_LEVEL = (0.0, 0.0, 0.0)  # change of a slider's height by the pose
_LARGEST = 1e9  # number at an input that can be a measurement [any SI unit]


@dataclass(frozen=True)
class PlaneBody:
    """A body that moves in the plane of the bench.

    Attributes:
        mass: [kg].
        centre: centre of mass along the body and across it, upwards [m]: of a bar from its
            slider, of the plate from its middle.
        inertia: moment of inertia about the centre of mass [kg m^2].
    """

    mass: float
    centre: tuple[float, float]
    inertia: float


_LINK = PlaneBody(0.5, (0.15, 0.0), 0.0037875)
_STRUT = PlaneBody(0.5, (0.21, 0.0), 0.0073875)
_PEDAL = PlaneBody(1.0, (0.0, -0.01), 0.00123333)


@dataclass(frozen=True)
class BenchMasses:
    """Masses of the bench; all are assumptions, as the paper names none.

    Attributes:
        slider: mass of a slider [kg].
        link: each of the two links.
        strut: link A_3 T.
        plate: plate with its tread.
    """

    slider: float = 2.0
    link: PlaneBody = _LINK
    strut: PlaneBody = _STRUT
    plate: PlaneBody = _PEDAL


def inertial_wrench(geometry: BenchGeometry, bodies: BenchMasses, motion: ArrayLike) -> Array:
    """Wrench (..., 3) at the plate that would move and carry the bench without its drives.

    It is what weight and inertia of all parts ask for in the plate's coordinates: with the drives'
    forces f and a load W on the plate, wrench = W + K^T f, K being the speeds of the sliders by
    those of the plate.

    Args:
        geometry: the bench.
        bodies: its masses.
        motion: (..., 9) pose of the plate, its rates and the rates of these [m, rad, s].
    """
    q = of_width(motion, 9, "motion")
    return _wrench(geometry, bodies, q, inverse_jacobian(geometry, q[..., :3]))


def _wrench(geometry: BenchGeometry, bodies: BenchMasses, q: Array, K: Array) -> Array:
    pose, twist, change = q[..., :3], q[..., 3:6], q[..., 6:]
    (pose_columns, slopes, speeding, places), shape = columns(
        (q, 9, "motion"),
        (K.reshape(*K.shape[:-2], 9), 9, "inverse Jacobian"),
        (slider_accelerations(geometry, pose, twist, change), 3, "accelerations"),
        (slider_places(geometry, pose), 3, "places"),
    )
    at_p, at_t = (_point(place, pose_columns) for place in (geometry.p_OP, geometry.p_OT))
    plate, link, strut = bodies.plate, bodies.link, bodies.strut
    parts = [_carried(plate.mass, _point(plate.centre, pose_columns))]
    parts.append([0.0, 0.0, plate.inertia * pose_columns[8]])
    bars = (
        (at_p, geometry.link, link),
        (at_p, geometry.link, link),
        (at_t, geometry.strut, strut),
    )
    for i, (end, length, bar) in enumerate(bars):
        rail = _Point((places[i], 0.0), (slopes[3 * i : 3 * i + 3], _LEVEL), (speeding[i], 0.0))
        parts.append(_carried(bodies.slider, rail))
        along, across = (each / length for each in bar.centre)
        parts.append(_carried(bar.mass, _on_bar(rail, end, along, across)))
        parts.append(_turned(bar.inertia, rail, end, length))
    return stack([sum(column) for column in zip(*parts, strict=True)], shape)


def drive_forces(
    geometry: BenchGeometry, bodies: BenchMasses, motion: ArrayLike, load: ArrayLike
) -> Array:
    """Forces (..., 3) of the sliders' drives for a motion under a load on the plate [N].

    Args:
        geometry: the bench.
        bodies: its masses.
        motion: (..., 9) pose of the plate, its rates and the rates of these [m, rad, s].
        load: (..., 3) F_x, F_z, M_y on the plate at its middle [N, N, N m].
    """
    q = of_width(motion, 9, "motion")
    K = inverse_jacobian(geometry, q[..., :3])
    force = _wrench(geometry, bodies, q, K) - of_width(load, 3, "load")
    transposed = np.swapaxes(K, -1, -2)
    return np.asarray(np.linalg.solve(transposed, force[..., np.newaxis])[..., 0])


def load_of_drives(
    geometry: BenchGeometry, bodies: BenchMasses, motion: ArrayLike, force: ArrayLike
) -> Array:
    """Load (..., 3) on the plate under which drives push with forces (..., 3) [N, N, N m].

    Args:
        geometry: the bench.
        bodies: its masses.
        motion: (..., 9) pose of the plate, its rates and the rates of these [m, rad, s].
        force: (..., 3) of the sliders' drives [N].
    """
    q = of_width(motion, 9, "motion")
    K = inverse_jacobian(geometry, q[..., :3])
    pushed = of_width(force, 3, "force")[..., np.newaxis, :] @ K
    return _wrench(geometry, bodies, q, K) - pushed[..., 0, :]


class LoadEstimator(LeafSystem):
    """Pose and load of the plate by the sliders' encoders and the currents of their motors.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position_measured` | 3 | m | of the sliders |
    | in `current` | 3 | A | of the sliders' motors |
    | in `plate_motion` | 9 | m, rad, s | pose that is asked for, its rates, and theirs |
    | out `pose_estimated` | 3 | m, m, rad | x, z, phi by the encoders |
    | out `load_estimated` | 3 | N, N, N m | F_x, F_z, M_y on the plate at its middle |

    Weight and inertia of the bench are taken off, for the motion that it is led through; friction
    is not.

    State: discrete, both outputs (6), updated every period, and once as a simulation begins.

    Bad input: sliders that no pose belongs to give the pose that is asked for; with a
    measurement that is not finite the outputs are zero.

    Args:
        geometry: the bench.
        masses: its masses.
        force_per_current: force of a slider's drive by the current of its motor [N/A].
        period: between two updates [s].
    """

    def __init__(
        self,
        geometry: BenchGeometry = BenchGeometry.pedal(),
        masses: BenchMasses = BenchMasses(),
        force_per_current: float = 100.0,
        period: float = 0.01,
    ):
        super().__init__()
        self.set_name("load_estimator")
        self._geometry, self._masses, self._per_ampere = geometry, masses, force_per_current
        self._position = self.DeclareVectorInputPort("position_measured", 3)
        self._current = self.DeclareVectorInputPort("current", 3)
        self._motion = self.DeclareVectorInputPort("plate_motion", 9)
        state = self.DeclareDiscreteState(6)
        after = {self.discrete_state_ticket(state)}
        self.DeclareVectorOutputPort("pose_estimated", 3, self._copy_pose, after)
        self.DeclareVectorOutputPort("load_estimated", 3, self._copy_load, after)
        self.DeclareInitializationDiscreteUpdateEvent(self._update)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _copy_pose(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(0).value()[:3])

    def _copy_load(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(0).value()[3:])

    def _update(self, context: Context, state: DiscreteValues) -> None:
        motion = read_array(self._motion, context)
        force = self._per_ampere * read_array(self._current, context)
        places = read_array(self._position, context)
        if not (np.abs(np.concatenate((motion, force, places))) < _LARGEST).all():
            state.set_value(0, np.zeros(6))
            return
        try:
            pose = forward_kinematics(self._geometry, places)
        except UnreachablePlate:
            pose = motion[:3]
        motion = np.concatenate((pose, motion[3:]))
        with np.errstate(all="ignore"):
            load = load_of_drives(self._geometry, self._masses, motion, force)
        estimate = np.concatenate((pose, load))
        state.set_value(0, np.where(np.isfinite(estimate), estimate, 0.0))


type _Pair = tuple[Elementwise, Elementwise]


class _Point(NamedTuple):
    """A point: place, its derivative by the plate's pose, acceleration, each along x and z."""

    place: _Pair
    by_pose: tuple[Sequence[Elementwise], Sequence[Elementwise]]
    acceleration: _Pair


def _point(place: tuple[float, float], motion: list[Elementwise]) -> _Point:
    """A point of the plate, in its frame, in a motion (9)."""
    x, z, phi, _, _, rate, ddx, ddz, ddphi = motion
    s, c = sin_cos(phi)
    r_x, r_z = c * place[0] + s * place[1], c * place[1] - s * place[0]
    return _Point(
        (x + r_x, z + r_z),
        ((1.0, 0.0, r_z), (0.0, 1.0, -r_x)),
        (ddx + ddphi * r_z - rate * rate * r_x, ddz - ddphi * r_x - rate * rate * r_z),
    )


def _on_bar(one: _Point, other: _Point, along: float, across: float) -> _Point:
    """A point of a bar, from one end along it and across it, in lengths of the bar."""

    def between(a: _Pair, b: _Pair) -> tuple[Elementwise, Elementwise]:
        (a_x, a_z), (b_x, b_z) = a, b
        d_x, d_z = b_x - a_x, b_z - a_z
        return a_x + along * d_x - across * d_z, a_z + along * d_z + across * d_x

    rows = zip(*one.by_pose, *other.by_pose, strict=True)
    slopes = [between((a_x, a_z), (b_x, b_z)) for a_x, a_z, b_x, b_z in rows]
    return _Point(
        between(one.place, other.place),
        ([x for x, _ in slopes], [z for _, z in slopes]),
        between(one.acceleration, other.acceleration),
    )


def _carried(mass: float, point: _Point) -> list[Elementwise]:
    """Wrench (3) by inertia and weight of a mass at a point."""
    (row_x, row_z), (ddx, ddz) = point.by_pose, point.acceleration
    f_x, f_z = mass * ddx, mass * (ddz + GRAVITY)
    return [a * f_x + b * f_z for a, b in zip(row_x, row_z, strict=True)]


def _turned(inertia: float, one: _Point, other: _Point, length: float) -> list[Elementwise]:
    """Wrench (3) by the inertia of a bar that turns, from its ends."""
    scale = inertia / length**4
    across_x = other.place[1] - one.place[1]
    across_z = one.place[0] - other.place[0]
    ddx, ddz = (b - a for a, b in zip(one.acceleration, other.acceleration, strict=True))
    acceleration = scale * (across_x * ddx + across_z * ddz)
    return [
        acceleration * (across_x * (b_x - a_x) + across_z * (b_z - a_z))
        for a_x, a_z, b_x, b_z in zip(*one.by_pose, *other.by_pose, strict=True)
    ]
