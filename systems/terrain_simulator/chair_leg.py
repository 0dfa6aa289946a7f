"""The walking chair's leg under the bench's slide: closed form of its foot, and its control.

The leg has three degrees of freedom. In the bench's plane two of them put the foot to a place, the
third keeps it in the plane: the foot's inclination is not free, its sole is always at a right
angle to the UP branch. So the foot rolls over its edges as it does under the chair: whichever end
of the sole is the lower one keeps to its place on the plate (the rule of `lowest_corner`), the
edge of E_2 and E_3 or, once the hinge U_11 has passed E_1 along the plate, the corner E_1.
`foot_desired` is the place of the plate under the middle of the sole, whose ends stand as far
before and behind it as if the sole lay flat.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.walk import BenchWalk
from parapod.systems.walking_chair.checks import (
    SPEED_LIMIT,
    check_speeds,
    check_strokes,
    refuse_forces,
)
from parapod.systems.walking_chair.geometry import LegGeometry, branch_names
from parapod.systems.walking_chair.leg import leg_corners, leg_inverse, up_of_lengths
from parapod.systems.walking_chair.payload import FORCE_LIMIT
from parapod.systems.walking_chair.rates import leg_jacobian
from parapod.systems.walking_chair.trajectories import BranchMotion

_PLANE = [0, 2]  # x and z
_APART = 1e-3  # half of the time over which rates are taken [s]
_TIP, _EDGE = 1, 2  # corner E_1, and the one that stands for the edge of E_2 and E_3
_STEP = 2e-3  # time between the instants of a walk that are looked at [s]
# The leg under test counts as the chair's first.
_NAMES = branch_names((1,))


@dataclass(frozen=True)
class ChairLegMount:
    """Place of the leg on the slide.

    Attributes:
        turned: true if E_1 is at the rear, as with the chair's rear legs 1 and 2; otherwise it is
            ahead, as with the front legs 3 and 4.
        lean: angle by which the leg hangs inclined, as the chair does on a slope; positive uphill
            [rad].
        ahead: place from the hip, along the slope, over which the leg hangs straight and its sole
            is flat [m]: 0 for a foot that rolls from one end to the other in the middle of its
            stance.
        height: height of the upper platform's face above the sole there [m].
    """

    turned: bool = False
    lean: float = 0.0
    ahead: float = 0.0
    height: float = 0.7801


@dataclass(frozen=True)
class ChairLegModel:
    """Closed forms of the leg on the slide, in the hip's frame: x to the front, z up.

    Attributes:
        mount: its place.
        geometry: the leg.
        max_velocity: largest speed of a branch [m/s].
        max_force: largest force of a branch, both ways [N].
    """

    mount: ChairLegMount = ChairLegMount()
    geometry: LegGeometry = field(default_factory=LegGeometry)
    max_velocity: float = SPEED_LIMIT
    max_force: float = FORCE_LIMIT

    @cached_property
    def half_sole(self) -> float:
        """Distance of the sole's edges from its middle [m]."""
        return 0.25 * math.sqrt(3.0) * self.geometry.b

    @cached_property
    def R_HA(self) -> NDArray[np.float64]:
        """(3, 3) rotation of the leg's frame {A1} in the hip's."""
        s, c = math.sin(self.mount.lean), math.cos(self.mount.lean)
        inclined = np.array(((c, 0.0, -s), (0.0, 1.0, 0.0), (s, 0.0, c)))
        way = self._way
        return inclined @ np.array(((0.0, way, 0.0), (-way, 0.0, 0.0), (0.0, 0.0, 1.0)))

    @cached_property
    def p_HA(self) -> NDArray[np.float64]:
        """(3) origin A_1 of the leg's frame from the hip [m]."""
        mount, (_, to_tip, up) = self.mount, self.R_HA.T
        below = np.array((0.0, 0.0, -mount.height))
        from_middle = (self._way * mount.ahead + self.half_sole) * to_tip + mount.height * up
        position: NDArray[np.float64] = below + from_middle
        return position

    @property
    def _way(self) -> float:
        """Sign of the way to the front along the leg's y axis."""
        return -1.0 if self.mount.turned else 1.0

    def branches(self, foot: Array, phi: Array) -> BranchMotion:
        """Lengths, velocities and accelerations of the branches on a way of the foot.

        Rates are differences over 2 ms: they go over from one end of the sole to the other.

        Args:
            foot: (3, ..., 2) x, z under the sole's middle, from the hip, and their derivatives
                [m, s].
            phi: (3, ...) angle of the plate, and its derivatives [rad, s].

        Returns:
            Arrays (..., 3) [m, m/s, m/s^2]; NaN where the leg cannot reach.
        """
        near = [
            [of[0] + s * _APART * of[1] + 0.5 * (s * _APART) ** 2 * of[2] for s in (-1, 0, 1)]
            for of in (foot, phi)
        ]
        before, now, after = self.lengths(np.array(near[0]), np.array(near[1]))
        velocity = (after - before) / (2.0 * _APART)
        return BranchMotion(now, velocity, (after - 2.0 * now + before) / _APART**2)

    def lengths(self, foot: Array, phi: Array) -> NDArray[np.float64]:
        """Lengths (..., 3) of the branches [m]; NaN where the leg cannot reach.

        Args:
            foot: (..., 2) x, z under the sole's middle, from the hip [m].
            phi: (...) angle of the plate [rad].
        """
        reference, corner = self._lowest(foot, phi)
        return leg_inverse(self.geometry, corner, reference)

    def places(self, lengths: Array, phi: Array) -> NDArray[np.float64]:
        """x, z (..., 2) of the place under the sole's middle, from the hip [m].

        Args:
            lengths: (..., 3) of the branches [m].
            phi: (...) angle of the plate [rad].
        """
        corners: Array = leg_corners(self.geometry, up_of_lengths(self.geometry, lengths))
        tip, edge = (
            (corners[..., k - 1, :] @ self.R_HA.T + self.p_HA)[..., _PLANE] for k in (_TIP, _EDGE)
        )
        along = _along(phi)
        off = along[..., ::-1] * (-1.0, 1.0)
        is_edge = ((tip - edge) * off).sum(axis=-1) > 0.0
        to_tip = self._way * self.half_sole * along
        return np.where(is_edge[..., np.newaxis], edge + to_tip, tip - to_tip)

    def check(self, walk: BenchWalk) -> None:
        """Refuses a walk that the leg cannot do.

        Args:
            walk: the walk.

        Raises:
            StrokeExceeded: names the branch that would be too long or too short, and when.
            SpeedExceeded: names the fastest branch, and when.
            ForceExceeded: names the branch that bears most, and when.
        """
        times = np.linspace(0.0, walk.duration, math.ceil(walk.duration / _STEP) + 1)
        positions = walk.at(times)
        foot, phi = positions.foot, positions.pose[..., 2]
        motion = self.branches(foot, phi)
        check_strokes(self.geometry, motion.length[..., np.newaxis, :], times, (1,))
        check_speeds(motion.velocity[..., np.newaxis, :], self.max_velocity, times, (1,))
        reference, corner = self._lowest(foot[0], phi[0])
        upwards = np.multiply.outer(positions.force, self.R_HA[2])
        jacobian = leg_jacobian(self.geometry, corner, reference)
        force = -np.linalg.solve(np.swapaxes(jacobian, -1, -2), upwards[..., np.newaxis])[..., 0]
        # Both corners of the edge bear alike.
        force[..., 1:] = force[..., 1:].mean(axis=-1, keepdims=True)
        refuse_forces(force, self.max_force, times, _NAMES)

    def _lowest(self, foot: Array, phi: Array) -> tuple[NDArray[np.intp], Array]:
        """Number of the corner that stands (...), and its place (..., 3) in {A1} [m]."""
        to_leg = self.R_HA[_PLANE, 1:]
        to_tip = self._way * self.half_sole * (_along(phi) @ to_leg)
        middle = (foot - self.p_HA[_PLANE]) @ to_leg
        hinge = self.geometry.upper_joints[0, 1:]
        is_tip = ((hinge - middle - to_tip) * to_tip).sum(axis=-1) >= 0.0
        reference = np.where(is_tip, _TIP, _EDGE)
        place = np.empty((*is_tip.shape, 3))
        place[..., 0] = self.geometry.corners[reference - 1, 0]
        place[..., 1:] = middle + np.where(is_tip, 1.0, -1.0)[..., np.newaxis] * to_tip
        return reference, place


@dataclass(frozen=True)
class ChairScrewParams:
    """Screws and their position loops: those of the chair's model, or assumptions.

    Attributes:
        stiffness: force of a loop by the error of its length, the stiffness that the chair's
            screws have with their drives [N/m].
        damping: force by the error of its rate, theirs too [N s/m].
        way: way of a screw by a turn of its motor [m], the chair's lead and reduction.
        rotor_inertia: moment of inertia of a motor of some 60 W [kg m^2] (assumption).
    """

    stiffness: float = 1e6
    damping: float = 2e4
    way: float = 1e-3
    rotor_inertia: float = 3.3e-6

    @property
    def ratio(self) -> float:
        """Turn of the motor by the way of the screw [rad/m]."""
        return 2.0 * math.pi / self.way

    @property
    def inertia(self) -> float:
        """Mass as which the rotor resists the screw's way [kg]."""
        return self.rotor_inertia * self.ratio**2


class ChairLegController(LeafSystem):
    """Forces with which the screws of the chair's leg keep to the lengths of its branches.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | 3 | m | lengths of the branches UP, UPS, UPS |
    | in `velocity` | 3 | m/s | their rates |
    | in `foot_desired` | 6 | m, s | x, z of the foot from the hip, rates, accelerations |
    | in `plate_motion` | 9 | m, rad, s | pose of the plate, its rates, and theirs |
    | out `torque_command` | 3 | N | forces of the screws, within what they can give |

    The screws' drives are here, behind forces as commands, so that the ports of a leg are the same
    for all legs: a position loop about each length that the closed-form inverse kinematics has,

        force = K (l_d - l) + D (l_d' - l') + m l_d''

    with the rotor's mass m, as large as it looks through gear and screw. That mass lets a loop
    as stiff as the chair's screws be closed at 1 kHz; it is stable while its period is
    much shorter than m / D. The load is not fed forward: screws give under it as the chair's do.

    State: none.

    Bad input: with a number that is not finite, or a foot out of reach, the forces are zero.

    Args:
        model: the leg.
        screws: its screws.
    """

    def __init__(
        self,
        model: ChairLegModel = ChairLegModel(),
        screws: ChairScrewParams = ChairScrewParams(),
    ):
        super().__init__()
        self.set_name("chair_leg_controller")
        self._model, self._screws = model, screws
        self._position = self.DeclareVectorInputPort("position", 3)
        self._velocity = self.DeclareVectorInputPort("velocity", 3)
        self._foot = self.DeclareVectorInputPort("foot_desired", 6)
        self._plate = self.DeclareVectorInputPort("plate_motion", 9)
        self.DeclareVectorOutputPort(
            "torque_command", 3, self._calc_force, {self.all_input_ports_ticket()}
        )

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        length, rate = read_array(self._position, context), read_array(self._velocity, context)
        foot = read_array(self._foot, context).reshape(3, 2)
        phi = read_array(self._plate, context).reshape(3, 3)[:, 2]
        desired, screws = self._model.branches(foot, phi), self._screws
        force = screws.stiffness * (desired.length - length)
        force += screws.damping * (desired.velocity - rate)
        force += screws.inertia * desired.acceleration
        if not np.isfinite(force).all():
            output.SetZero()
            return
        largest = self._model.max_force
        output.SetFromVector(np.minimum(np.maximum(force, -largest), largest))


def _along(phi: Array) -> NDArray[np.float64]:
    """x, z (..., 2) of the unit vector along the plate, to the front."""
    return np.stack((np.cos(phi), -np.sin(phi)), axis=-1)
