"""Forces of foot and tread by the balance of momentum, for a plant that reports none.

Of a continuous plant Drake 1.58 reports contacts and reactions by a model of its own, not those
with which CENIC has integrated it: friction is another one where feet stick (normal forces are
right), and reactions at joints are refused where constraints close loops. What bodies do is right
all the same, and the forces follow from it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array

_LEAST = 1e-9  # normal force below which nothing touches [N]
_NEAR = 1e-4  # distance from an end of the slide's way at which that may bear it [m]


def normal_forces(results: ContactResults, bodies: Sequence[int]) -> tuple[Array, Array]:
    """Normal forces (n, 2) on bodies, x and z [N], and where they act (n, 2) [m].

    Args:
        results: contact results of a plant.
        bodies: indices of the bodies.
    """
    forces, points = [], []
    for i in range(results.num_point_pair_contacts()):
        info = results.point_pair_contact_info(i)
        sign = int(info.bodyB_index() in bodies) - int(info.bodyA_index() in bodies)
        normal = info.point_pair().nhat_BA_W
        along = float(np.dot(info.contact_force(), normal))
        if sign and abs(along) > _LEAST:
            forces.append(sign * along * normal[[0, 2]])
            points.append(info.contact_point()[[0, 2]])
    return np.reshape(forces, (-1, 2)), np.reshape(points, (-1, 2))


class FootBalance(LeafSystem):
    """Force of the ground on a leg that a driven column and its slide carry.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `state` | n | - | state of the plant |
    | in `contact_results` | abstract | - | contact results of the plant |
    | in `column_force` | 1 | N | mean force of the column's drive, along x |
    | in `slide_force` | 1 | N | force of the slide's drive, upwards |
    | out `foot_force` | 2 | N | of the ground on the leg, x and z; to be sampled |

    It is the mean since the last sample: the drives and the ground alone move the leg with slide
    and column. Of a slide that is locked or at an end of its way, where something else bears it,
    the normal forces are those that the plant reports, and friction is what is missing along x.

    State: discrete, the momentum along x and z at the last sample [N s], zero at first.

    Bad input: NaN for a state that is not finite, and forces that are not are passed on.

    Args:
        plant: finalized.
        slide: joint of the slide on the column.
        leg: model instance of the leg, which is on the slide.
        period: period of the samples [s].
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        slide: Joint,
        leg: ModelInstanceIndex,
        period: float = 1e-3,
    ):
        super().__init__()
        self.set_name("foot_balance")
        self._plant, self._slide, self._period = plant, slide, period
        # The column moves along x alone, and slide and leg in both directions.
        self._rising = [slide.child_body().model_instance(), leg]
        self._moved = [slide.parent_body().model_instance(), *self._rising]
        self._bodies = [int(index) for index in plant.GetBodyIndices(leg)]
        self._private = plant.CreateDefaultContext()
        self._weight = GRAVITY * plant.CalcTotalMass(self._private, self._rising)
        (self._low,), (self._high,) = slide.position_lower_limits(), slide.position_upper_limits()
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self._contact = self.DeclareAbstractInputPort("contact_results", Value[ContactResults]())
        self._drives = [
            self.DeclareVectorInputPort(f"{name}_force", 1) for name in ("column", "slide")
        ]
        self.DeclareDiscreteState(2)
        self.DeclareVectorOutputPort(
            "foot_force", 2, self._calc_force, {self.all_input_ports_ticket(), self.xd_ticket()}
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        momentum = self._momentum(context)
        if np.isfinite(momentum).all():
            discrete_state.set_value(0, momentum)

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        last = context.get_discrete_state(0).value()
        driven = np.concatenate([read_array(port, context) for port in self._drives])
        momentum = self._momentum(context)
        force = (momentum - last) / self._period - driven
        force[1] += self._weight
        if np.isfinite(momentum).all() and self._is_borne():
            results: Any = self._contact.Eval(context)
            normal = normal_forces(results, self._bodies)[0].sum(axis=0)
            # Friction is at right angles to the normal forces, in proportion to each.
            share = (force[0] - normal[0]) / normal[1] if normal[1] > _LEAST else 0.0
            force = normal + share * np.array((normal[1], -normal[0]))
        output.SetFromVector(force)

    def _is_borne(self) -> bool:
        """Whether something else than its drive bears the slide of the private context."""
        place = self._slide.GetOnePosition(self._private)
        is_locked = self._slide.GetOneVelocity(self._private) == 0.0
        return is_locked or not self._low + _NEAR < place < self._high - _NEAR

    def _momentum(self, context: Context) -> Array:
        """Momentum (2) along x and z [N s]."""
        plant, private = self._plant, self._private
        state = read_array(self._state, context)
        if not np.isfinite(state).all():
            return np.full(2, np.nan)
        plant.SetPositionsAndVelocities(private, state)
        along, upwards = (
            plant.CalcSpatialMomentumInWorldAboutPoint(private, bodies, np.zeros(3))
            for bodies in (self._moved, self._rising)
        )
        return np.array((along.translational()[0], upwards.translational()[2]))


class TreadBalance(LeafSystem):
    """Reaction at the joint by which a tread is fixed to its plate.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `state` | n | - | state of the plant |
    | in `contact_results` | abstract | - | contact results of the plant |
    | in `foot_force` | 2 | N | of the ground on the leg, x and z |
    | out `reaction_forces` | abstract | - | that one, as a plant reports it; to be sampled |

    The tread is moved by the reaction, its weight and the foot, which acts where the plant
    reports contacts. Forces are in the plane of x and z.

    State: discrete, the momentum along x and z [N s] and about the world's origin [N m s] at the
    last sample, zero at first.

    Bad input: NaN for a state that is not finite, and forces that are not are passed on.

    Args:
        plant: finalized.
        joint: the joint, whose child is the tread.
        period: period of the samples [s].
    """

    def __init__(self, plant: MultibodyPlant, joint: Joint, period: float = 1e-3):
        super().__init__()
        self.set_name("tread_balance")
        self._plant, self._joint, self._period = plant, joint, period
        self._tread = joint.child_body()
        self._private = plant.CreateDefaultContext()
        inertia = self._tread.CalcSpatialInertiaInBodyFrame(self._private)
        self._mass, self._p_BC = inertia.get_mass(), inertia.get_com()
        self._turning = float(
            inertia.Shift(self._p_BC).CalcRotationalInertia().CopyToFullMatrix3()[1, 1]
        )
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self._contact = self.DeclareAbstractInputPort("contact_results", Value[ContactResults]())
        self._force = self.DeclareVectorInputPort("foot_force", 2)
        self.DeclareDiscreteState(3)
        self.DeclareAbstractOutputPort(
            "reaction_forces",
            lambda: Value[list[SpatialForce]]([SpatialForce(np.zeros(3), np.zeros(3))]),
            self._calc_reaction,
            {self.all_input_ports_ticket(), self.xd_ticket()},
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        if self._put(context):
            discrete_state.set_value(0, self._momentum())

    def _calc_reaction(self, context: Context, output: Any) -> None:
        if not self._put(context):
            output.set_value([SpatialForce(np.full(3, np.nan), np.full(3, np.nan))])
            return
        last = context.get_discrete_state(0).value()
        f_x, f_z, m_y = ((self._momentum() - last) / self._period).tolist()
        centre = self._centre()
        weight, foot = np.array((0.0, -self._mass * GRAVITY)), -read_array(self._force, context)
        results: Any = self._contact.Eval(context)
        normal, points = normal_forces(results, [int(self._tread.index())])
        sizes = np.linalg.norm(normal, axis=1)
        point = sizes @ points / sizes.sum() if sizes.size else centre
        force = np.array((f_x, f_z)) - weight - foot
        X_WJ = self._joint.frame_on_child().CalcPoseInWorld(self._private)
        place = X_WJ.translation()[[0, 2]]
        moment = m_y - _about_y(centre, weight) - _about_y(point, foot) - _about_y(place, force)
        turned = X_WJ.rotation().matrix().T
        reaction = SpatialForce(
            turned @ np.array((0.0, moment, 0.0)), turned @ np.array((force[0], 0.0, force[1]))
        )
        output.set_value([reaction])

    def _put(self, context: Context) -> bool:
        """Puts the private context into the state, if that is finite."""
        state = read_array(self._state, context)
        is_usable = bool(np.isfinite(state).all())
        if is_usable:
            self._plant.SetPositionsAndVelocities(self._private, state)
        return is_usable

    def _centre(self) -> Array:
        """Centre of mass of the tread, x and z [m]."""
        X_WB = self._plant.EvalBodyPoseInWorld(self._private, self._tread)
        centre: Array = X_WB.translation() + X_WB.rotation().matrix() @ self._p_BC
        return centre[[0, 2]]

    def _momentum(self) -> Array:
        """Momentum (3) of the tread, along x and z, and about the world's origin."""
        X_WB = self._plant.EvalBodyPoseInWorld(self._private, self._tread)
        V_WB = self._plant.EvalBodySpatialVelocityInWorld(self._private, self._tread)
        arm = X_WB.rotation().matrix() @ self._p_BC
        velocity = V_WB.translational() + np.cross(V_WB.rotational(), arm)
        linear = self._mass * velocity[[0, 2]]
        spin = self._turning * float(V_WB.rotational()[1])
        return np.array((*linear, spin + _about_y(self._centre(), linear)))


def _about_y(place: Array, force: Array) -> float:
    """Moment about the world's y of a force at a place, both of them x and z [N m]."""
    return float(place[1] * force[0] - place[0] * force[1])
