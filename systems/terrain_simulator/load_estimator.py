"""Load on the plate by the currents of the sliders: a check on the force cells."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from parapod.systems.core.batching import of_width
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.geometry import CONFIGURATIONS, BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    UnreachablePlate,
    forward_kinematics,
    slider_accelerations,
    slider_places,
    slider_rates,
)
from parapod.systems.terrain_simulator.support import GRAVITY

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


# As `parapod.urdf.terrain_simulator` has them.
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
    pose, twist, change = q[..., :3], q[..., 3:6], q[..., 6:]
    wrench = np.zeros_like(pose)
    slides = np.moveaxis(_rates_by_twist(geometry, pose), -2, 0)
    changes = np.moveaxis(slider_accelerations(geometry, pose, twist, change), -1, 0)
    places = np.moveaxis(slider_places(geometry, pose), -1, 0)
    level = np.zeros_like(slides[0])
    at_p, at_t = (_point(p, pose, twist, change) for p in (geometry.p_OP, geometry.p_OT))
    ends = ((at_p, geometry.link), (at_p, geometry.link), (at_t, geometry.strut))
    for i, ((place, by_twist, acceleration), length) in enumerate(ends):
        rail = np.stack((slides[i], level), axis=-2)
        on_rail = np.stack((changes[i], np.zeros_like(changes[i])), axis=-1)
        wrench += bodies.slider * changes[i][..., np.newaxis] * slides[i]
        middle, lifted = 0.5 * (rail + by_twist), 0.5 * (on_rail + acceleration)
        wrench += bodies.link * _moved(middle, lifted)
        # Turn of the bar, from its ends.
        along = place - np.stack((places[i], np.zeros_like(places[i])), axis=-1)
        across = np.stack((along[..., 1], -along[..., 0]), axis=-1) / length**2
        turns = np.einsum("...i,...ij->...j", across, by_twist - rail)
        turned = np.einsum("...i,...i->...", across, acceleration - on_rail)
        inertia = _ROD * bodies.link * length**2
        wrench += inertia * turned[..., np.newaxis] * turns
    _, by_twist, acceleration = _point((0.0, -bodies.below), pose, twist, change)
    wrench += bodies.plate * _moved(by_twist, acceleration)
    wrench[..., 2] += bodies.inertia * change[..., 2]
    return wrench


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
    K = _rates_by_twist(geometry, of_width(motion, 9, "motion")[..., :3])
    needed = inertial_wrench(geometry, bodies, motion) - of_width(load, 3, "load")
    transposed = np.swapaxes(K, -1, -2)
    return np.asarray(np.linalg.solve(transposed, needed[..., np.newaxis])[..., 0])


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
    K = _rates_by_twist(geometry, of_width(motion, 9, "motion")[..., :3])
    pushed = np.einsum("...ij,...i->...j", K, of_width(force, 3, "force"))
    return inertial_wrench(geometry, bodies, motion) - pushed


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

    State: discrete, both outputs (6), updated every period.

    Bad input: sliders that no pose belongs to give the pose that is asked for; with a number that
    is none of a measurement the outputs are zero.

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
        shown = self.DeclareDiscreteState(6)
        after = {self.discrete_state_ticket(shown)}
        self.DeclareVectorOutputPort("pose_estimated", 3, self._copy_pose, after)
        self.DeclareVectorOutputPort("load_estimated", 3, self._copy_load, after)
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
        shown = np.concatenate((pose, load))
        state.set_value(0, np.where(np.isfinite(shown), shown, 0.0))


def _rates_by_twist(geometry: BenchGeometry, pose: Array) -> Array:
    """Speeds of the sliders by those of the plate, K (..., 3, 3) [-; m]."""
    each = slider_rates(geometry, pose[..., np.newaxis, :], np.eye(3))
    return np.swapaxes(each, -1, -2)


def _point(
    place: tuple[float, float], pose: Array, twist: Array, change: Array
) -> tuple[Array, Array, Array]:
    """Place (..., 2), its velocity by the plate's (..., 2, 3), and acceleration (..., 2)."""
    s, c = np.sin(pose[..., 2]), np.cos(pose[..., 2])
    r = np.stack((c * place[0] + s * place[1], c * place[1] - s * place[0]), axis=-1)
    by_phi = np.stack((r[..., 1], -r[..., 0]), axis=-1)
    by_twist = np.zeros((*pose.shape[:-1], 2, 3))
    by_twist[..., 0, 0] = by_twist[..., 1, 1] = 1.0
    by_twist[..., 2] = by_phi
    rate, speeding = twist[..., 2:], change[..., 2:]
    return pose[..., :2] + r, by_twist, change[..., :2] + speeding * by_phi - rate**2 * r


def _moved(by_twist: Array, acceleration: Array) -> Array:
    """Wrench (..., 3) by the inertia and weight of a unit mass at a point."""
    lifted = acceleration + np.array((0.0, GRAVITY))
    return np.einsum("...ij,...i->...j", by_twist, lifted)
