"""Load on the plate by the currents of the sliders: a check on the force cells."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from parapod.systems.core.batching import columns, of_width, stack
from parapod.systems.core.elementwise import Elementwise, sin_cos
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.geometry import CONFIGURATIONS, BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    UnreachablePlate,
    forward_kinematics,
    inverse_jacobian,
    slider_accelerations,
    slider_places,
)

_LEVEL = (0.0, 0.0, 0.0)  # change of a slider's height by the pose
_LARGEST = 1e9  # number at an input that can be a measurement [any SI unit]
_ROD = 1.0 / 12.0  # moment of inertia of a bar by its mass and the square of its length


@dataclass(frozen=True)
class BenchMasses:
    """Masses of the bench; all are assumptions, as the paper names none.

    Attributes:
        slider: mass of a slider [kg].
        link: mass of each of the three links, bars with their centres in the middle [kg].
        plate: mass of the plate with its tread [kg].
        inertia: moment of inertia of these about their centre of mass [kg m^2].
        below: depth of that below the plate's middle [m].
    """

    slider: float
    link: float
    plate: float
    inertia: float
    below: float


# Masses of the bodies in `parapod.urdf.terrain_simulator`.
MASSES = {
    "pedal": BenchMasses(2.0, 0.5, 1.0, 0.00123333, 0.01),
    "treadmill": BenchMasses(2.0, 0.5, 8.0, 0.241667, 0.025),
}


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
    parts = [_carried(bodies.plate, _point((0.0, -bodies.below), pose_columns))]
    parts.append([0.0, 0.0, bodies.inertia * pose_columns[8]])
    ends = ((at_p, geometry.link), (at_p, geometry.link), (at_t, geometry.strut))
    for i, (end, length) in enumerate(ends):
        rail = _Point((places[i], 0.0), (slopes[3 * i : 3 * i + 3], _LEVEL), (speeding[i], 0.0))
        parts.append(_carried(bodies.slider, rail))
        parts.append(_carried(bodies.link, _middle(rail, end)))
        parts.append(_turned(_ROD * bodies.link * length**2, rail, end, length))
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
        geometry: BenchGeometry = CONFIGURATIONS["pedal"],
        masses: BenchMasses = MASSES["pedal"],
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


class _Point(NamedTuple):
    """A point: place, its derivative by the plate's pose, acceleration, each along x and z."""

    place: tuple[Elementwise, Elementwise]
    by_pose: tuple[Sequence[Elementwise], Sequence[Elementwise]]
    acceleration: tuple[Elementwise, Elementwise]


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


def _middle(one: _Point, other: _Point) -> _Point:
    """The point between two points of a bar."""
    (x, z), rows, (ddx, ddz) = one
    (x_2, z_2), rows_2, (ddx_2, ddz_2) = other
    row_x, row_z = (
        [0.5 * (a + b) for a, b in zip(row, row_2, strict=True)]
        for row, row_2 in zip(rows, rows_2, strict=True)
    )
    return _Point(
        (0.5 * (x + x_2), 0.5 * (z + z_2)),
        (row_x, row_z),
        (0.5 * (ddx + ddx_2), 0.5 * (ddz + ddz_2)),
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
