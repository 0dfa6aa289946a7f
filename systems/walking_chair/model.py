"""The walking chair as bodies and joints: names, closed-form pose, drawing, truth.

The truth, which no drive measures: the chair's pose, feet, contacts, loops.
"""

import functools
import math
import weakref
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import (
    ModelInstanceIndex,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import declare_cached, read_array, read_or_zeros
from parapod.systems.physics.loops import Ball
from parapod.systems.physics.poses import Gaps, poses_at
from parapod.systems.walking_chair.geometry import (
    BRANCHES,
    LEG_COUNT,
    ChairGeometry,
    LegGeometry,
)
from parapod.systems.walking_chair.leg import up_of_lengths, ups_vectors
from parapod.systems.walking_chair.masses import Passenger

_BRANCHES = ("up", "ups_2", "ups_3")


def moment_of_inertia(passenger: Passenger) -> float:
    """Moment of inertia of a passenger about any axis through the centre of mass [kg m^2]."""
    sphere = UnitInertia.SolidSphere(math.sqrt(2.5) * passenger.gyration)
    return float(passenger.mass * sphere.get_moments()[0])


def inertia_of(passenger: Passenger) -> SpatialInertia:
    """Inertia of a passenger about the centre of mass, as a parser has it from the moment."""
    if passenger.mass == 0.0:
        return SpatialInertia(0.0, np.zeros(3), UnitInertia.SolidSphere(passenger.gyration))
    moment = moment_of_inertia(passenger)
    central = RotationalInertia(moment, moment, moment)
    return SpatialInertia.MakeFromCentralInertia(passenger.mass, np.zeros(3), central)


def leg_joints(geometry: LegGeometry, lengths: ArrayLike) -> dict[str, float]:
    """Positions of a leg's joints [m, rad], by their names, its loops closed.

    Args:
        geometry: the leg.
        lengths: (3) of its branches [m].
    """
    up = up_of_lengths(geometry, lengths)
    joints = {"up_length": float(up[0]), "up_swing": float(up[1]), "up_tilt": float(up[2])}
    for name, vector in zip(_BRANCHES[1:], ups_vectors(geometry, up), strict=True):
        x, y, z = vector / np.linalg.norm(vector)
        joints[f"{name}_swing"] = math.atan2(-x, -z)
        joints[f"{name}_tilt"] = math.asin(y)
        joints[f"{name}_length"] = float(np.linalg.norm(vector))
    return joints


@dataclass(frozen=True)
class ChairModel:
    """A finalized plant that holds the chair of `parapod.urdf.walking_chair`.

    Attributes:
        plant: the plant.
        geometry: dimensions of the chair.
    """

    plant: MultibodyPlant
    geometry: ChairGeometry

    @cached_property
    def body(self) -> RigidBody:
        """The chair's body; its origin is the centre S."""
        return self.plant.GetBodyByName("body")

    @cached_property
    def passenger(self) -> RigidBody:
        """Body of the passenger; its origin is the centre of mass."""
        return self.plant.GetBodyByName("passenger")

    @cached_property
    def legs(self) -> tuple[ModelInstanceIndex, ...]:
        """The legs' model instances, 1..4."""
        return tuple(self.plant.GetModelInstanceByName(f"leg_{i + 1}") for i in range(LEG_COUNT))

    @cached_property
    def feet(self) -> tuple[RigidBody, ...]:
        """The feet; their origins are the corners E_1."""
        return tuple(self.plant.GetBodyByName("foot", leg) for leg in self.legs)

    def rods(self, leg: int) -> tuple[RigidBody, RigidBody]:
        """A leg's (0..3) rods of the UPS branches; their origins are the ball joints."""
        instance = self.legs[leg]
        second, third = (self.plant.GetBodyByName(f"ups_{k}_rod", instance) for k in (2, 3))
        return second, third

    @cached_property
    def balls(self) -> tuple[Ball, ...]:
        """The ball joints that close the legs' loops, two a leg, between rod and foot."""
        places = self.geometry.leg.lower_joints[1:]
        return tuple(
            Ball(rod, np.zeros(3), foot, place)
            for leg, foot in enumerate(self.feet)
            for rod, place in zip(self.rods(leg), places, strict=True)
        )

    def stand(
        self, context: Context, lengths: ArrayLike, body_position: ArrayLike, passenger: Passenger
    ) -> None:
        """Puts the chair at rest, loops closed, level and looking ahead.

        Args:
            context: the plant's context.
            lengths: (4, 3) of the branches [m].
            body_position: (3) of S in the world [m].
            passenger: person on the seat.
        """
        self.plant.SetPositions(context, self.standing_positions(lengths, body_position))
        self.plant.SetVelocities(context, np.zeros(self.plant.num_velocities()))
        self.seat(context, passenger)

    def standing_positions(
        self, lengths: ArrayLike, body_position: ArrayLike
    ) -> NDArray[np.float64]:
        """All positions of the plant, loops closed, level and looking ahead.

        Args:
            lengths: (4, 3) lengths of the branches [m].
            body_position: (3) of S in the world [m].
        """
        pose = (1.0, 0.0, 0.0, 0.0, *np.asarray(body_position).tolist())
        return self.positions(lengths, pose)

    def positions(self, lengths: ArrayLike, body_pose: ArrayLike) -> NDArray[np.float64]:
        """All positions of the plant, loops closed.

        Args:
            lengths: (4, 3) of the branches [m].
            body_pose: (7) quaternion (w, x, y, z) and position [m] of the body.
        """
        q = np.zeros(self.plant.num_positions())
        for starts, row in zip(self._starts, np.asarray(lengths), strict=True):
            for name, value in leg_joints(self.geometry.leg, row).items():
                q[starts[name]] = value
        start = self.body.floating_positions_start()
        q[start : start + 7] = body_pose
        return q

    @cached_property
    def _starts(self) -> list[dict[str, int]]:
        """Index of each leg's joint positions among the plant's, by the joints' names."""
        starts: list[dict[str, int]] = []
        for leg in self.legs:
            joints = [self.plant.get_joint(i) for i in self.plant.GetJointIndices(leg)]
            starts.append({joint.name(): joint.position_start() for joint in joints})
        return starts

    def seat(self, context: Context, passenger: Passenger) -> None:
        """Puts the passenger's centre of mass where it is, as heavy as it is.

        Args:
            context: the plant's context.
            passenger: person on the seat from here on.
        """
        seat: Any = self.plant.GetFrameByName("seat")
        seat.SetPoseInParentFrame(context, RigidTransform(passenger.place))
        self.passenger.SetSpatialInertiaInBodyFrame(context, inertia_of(passenger))


class ChairPose(LeafSystem):
    """Positions of the model's joints, all loops closed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | 12 | m | lengths of the branches |
    | in `body_pose` | 7 | -, m | quaternion (w, x, y, z) and position of the body |
    | out `positions` | n | - | positions of the model's plant |

    State: none.

    Bad input: NaN for the joints of a leg that cannot be assembled.
    """

    def __init__(self, model: ChairModel):
        super().__init__()
        self.set_name("chair_pose")
        self._model = model
        self._position = self.DeclareVectorInputPort("position", len(BRANCHES))
        self._pose = self.DeclareVectorInputPort("body_pose", 7)
        self.DeclareVectorOutputPort(
            "positions",
            model.plant.num_positions(),
            self._calc_positions,
            {self._position.ticket(), self._pose.ticket()},
        )

    def _calc_positions(self, context: Context, output: BasicVector) -> None:
        lengths = read_array(self._position, context).reshape(LEG_COUNT, 3)
        q = self._model.positions(lengths, read_array(self._pose, context))
        output.SetFromVector(q)


class ChairTruth(LeafSystem):
    """True pose of the body, contact of the feet, and how well the legs' loops are closed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `contact_results` | abstract | - | contact results of the plant |
    | in `body_poses` | abstract | - | poses of the plant's bodies |
    | in `rising` | 8 | m, m/s | how far the ground under each foot has risen; unconnected: 0 |
    | out `body_position` | 3 | m | of S in the world |
    | out `body_attitude` | 3 | rad | roll, pitch, yaw |
    | out `foot_height` | 12 | m | corners E_1, E_2, E_3 of each foot above the ground |
    | out `loop_error` | 8 | m | distance of rod end and foot at each ball joint |
    | out `contact_force` | 4 | N | of the ground on the feet, upwards |

    State: none.

    Bad input: a rise that is not finite is passed on.
    """

    def __init__(self, model: ChairModel):
        super().__init__()
        self.set_name("chair_truth")
        self._body = int(model.body.index())
        self._feet = [int(foot.index()) for foot in model.feet]
        self._gaps = Gaps(model.balls)
        self._corners = model.geometry.leg.corners.tolist()
        self._contact = self.DeclareAbstractInputPort("contact_results", Value[ContactResults]())
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]([]))
        self._rising = self.DeclareVectorInputPort("rising", 2 * LEG_COUNT)
        tickets = {self._poses.ticket(), self._rising.ticket()}
        self._shown = declare_cached(self, "shown", self._calc_shown, tickets)
        for i, (name, size) in enumerate(
            (("body_position", 3), ("body_attitude", 3), ("foot_height", 12), ("loop_error", 8))
        ):
            calc = functools.partial(_copy_shown, weakref.ref(self), i)
            self.DeclareVectorOutputPort(name, size, calc, {self._shown.ticket})
        self.DeclareVectorOutputPort(
            "contact_force", LEG_COUNT, self._calc_force, {self._contact.ticket()}
        )

    def shown(self, context: Context, index: int) -> NDArray[np.float64]:
        """Position, attitude, heights of corners and gaps of loops, from the poses."""
        part: NDArray[np.float64] = self._shown.value(self, context)[index]
        return part

    def _calc_shown(self, context: Context) -> tuple[NDArray[np.float64], ...]:
        poses, rising = poses_at(self._poses, context), read_or_zeros(self._rising, context)
        feet = zip(self._feet, rising[:LEG_COUNT], strict=True)
        return (
            np.array([*poses.origin(self._body)]),
            np.array([*poses.axes(self._body).roll_pitch_yaw()]),
            np.array([poses.point(i, at)[2] - by for i, by in feet for at in self._corners]),
            np.array(self._gaps.of(poses)),
        )

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        results: Any = self._contact.Eval(context)
        force = [0.0] * LEG_COUNT
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            for sign, body in ((-1.0, info.bodyA_index()), (1.0, info.bodyB_index())):
                if body in self._feet:
                    force[self._feet.index(body)] += sign * info.contact_force()[2]
        output.SetFromVector(np.array(force))


def _copy_shown(
    truth: weakref.ref[ChairTruth], index: int, context: Context, output: BasicVector
) -> None:
    """Calculates one output port; knows the system weakly, as a port must not keep it alive."""
    system = truth()
    assert system is not None
    output.SetFromVector(system.shown(context, index))
