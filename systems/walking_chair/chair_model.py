"""The walking chair as bodies and joints: names in the plant, and its closed-form pose."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import ModelInstanceIndex, RigidBody, SpatialInertia, UnitInertia
from pydrake.systems.framework import Context

from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.leg import ups_vectors
from parapod.systems.walking_chair.leg_forward import up_of_lengths
from parapod.systems.walking_chair.masses import Passenger

# What the files in `parapod.urdf.walking_chair` are drawn to.
CHAIR_GEOMETRY = ChairGeometry()
# Radius of gyration of a sitting person [m] (assumption).
_GYRATION = 0.26
_BRANCHES = ("up", "ups_2", "ups_3")


@dataclass(frozen=True)
class ChairModel:
    """A finalized plant that holds the chair of `parapod.urdf.walking_chair`.

    Attributes:
        plant: the plant.
        geometry: what the files are drawn to.
    """

    plant: MultibodyPlant
    geometry: ChairGeometry = CHAIR_GEOMETRY

    @cached_property
    def body(self) -> RigidBody:
        """The chair's body; its origin is the centre S."""
        return self.plant.GetBodyByName("body")

    @cached_property
    def passenger(self) -> RigidBody:
        """Who sits on it; the body's origin is the centre of mass."""
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

    def stand(
        self, context: Context, lengths: ArrayLike, body_position: ArrayLike, passenger: Passenger
    ) -> None:
        """Puts the chair at rest, loops closed, level and looking ahead.

        Args:
            context: the plant's context.
            lengths: (4, 3) of the branches [m].
            body_position: (3) of S in the world [m].
            passenger: who sits on it.
        """
        pose = (1.0, 0.0, 0.0, 0.0, *np.asarray(body_position).tolist())
        self.plant.SetPositions(context, self.positions(lengths, pose))
        self.plant.SetVelocities(context, np.zeros(self.plant.num_velocities()))
        self.seat(context, passenger)

    def positions(self, lengths: ArrayLike, body_pose: ArrayLike) -> NDArray[np.float64]:
        """All positions of the plant, loops closed.

        Args:
            lengths: (4, 3) of the branches [m].
            body_pose: (7) quaternion (w, x, y, z) and position [m] of the body.
        """
        q = np.zeros(self.plant.num_positions())
        for starts, joints in zip(self._starts, self._joints(np.asarray(lengths)), strict=True):
            for name, value in joints.items():
                q[starts[name]] = value
        start = self.body.floating_positions_start()
        q[start : start + 7] = body_pose
        return q

    @cached_property
    def _starts(self) -> list[dict[str, int]]:
        """Index of each leg's joint positions among the plant's, by the joints' names."""
        found: list[dict[str, int]] = []
        for leg in self.legs:
            joints = [self.plant.get_joint(i) for i in self.plant.GetJointIndices(leg)]
            found.append({joint.name(): joint.position_start() for joint in joints})
        return found

    def seat(self, context: Context, passenger: Passenger) -> None:
        """Puts the passenger's centre of mass where it is, as heavy as it is.

        Args:
            context: the plant's context.
            passenger: who sits on the chair from here on.
        """
        seat: Any = self.plant.GetFrameByName("seat")
        seat.SetPoseInParentFrame(context, RigidTransform(passenger.place))
        inertia = SpatialInertia(
            passenger.mass, np.zeros(3), UnitInertia.SolidSphere(math.sqrt(2.5) * _GYRATION)
        )
        self.passenger.SetSpatialInertiaInBodyFrame(context, inertia)

    def _joints(self, lengths: NDArray[np.float64]) -> list[dict[str, float]]:
        """Positions of each leg's joints, by their names."""
        found = []
        leg = self.geometry.leg
        for row, up in zip(lengths, up_of_lengths(leg, lengths), strict=True):
            joints = {"up_length": row[0], "up_swing": up[1], "up_tilt": up[2]}
            for name, vector in zip(_BRANCHES[1:], ups_vectors(leg, up), strict=True):
                x, y, z = vector / np.linalg.norm(vector)
                joints[f"{name}_swing"] = math.atan2(-x, -z)
                joints[f"{name}_tilt"] = math.asin(y)
                joints[f"{name}_length"] = float(np.linalg.norm(vector))
            found.append(joints)
        return found
