"""The levelling platform as bodies and joints: names in the plant, and its closed-form pose."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, ModelInstanceIndex, RigidBody
from pydrake.systems.framework import Context

from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.leg import diagonal_angle, swing_angle
from parapod.systems.levelling_platform.plane import normal_of
from parapod.systems.levelling_platform.resting import resting_posture

# What the files in `parapod.urdf.levelling_platform` are drawn to: Tables 1 and 2, with rollers.
MODEL_GEOMETRY = PlatformGeometry(foot_radius=0.025)

WHEEL_COUNT = 4


def standing_pose(posture: ArrayLike, ground: ArrayLike) -> NDArray[np.float64]:
    """Quaternion (w, x, y, z) and position (7) of a platform with this posture.

    Its centre stands above the world's origin, through which the ground's plane goes.

    Args:
        posture: (3) roll, pitch, height [rad, rad, m].
        ground: (2) roll and pitch of the ground [rad].
    """
    roll, pitch, height = np.asarray(posture).tolist()
    normal = normal_of(*np.asarray(ground).tolist())
    quaternion = RollPitchYaw(roll, pitch, 0.0).ToQuaternion().wxyz()
    return np.concatenate((quaternion, height * np.array(normal)))


@dataclass(frozen=True)
class PlatformModel:
    """A finalized plant that holds the platform of `parapod.urdf.levelling_platform`.

    Attributes:
        plant: the plant.
        ground_mount: frame on the world that carries the ground and can be inclined.
        geometry: dimensions of the machine as built; the files have those of `MODEL_GEOMETRY`.
    """

    plant: MultibodyPlant
    ground_mount: FixedOffsetFrame
    geometry: PlatformGeometry = MODEL_GEOMETRY

    @cached_property
    def base(self) -> RigidBody:
        """The platform's body; its origin is the centre F."""
        return self.plant.GetBodyByName("base")

    @cached_property
    def legs(self) -> tuple[ModelInstanceIndex, ...]:
        """The legs' model instances, 1..4."""
        return tuple(self.plant.GetModelInstanceByName(f"leg_{i + 1}") for i in range(LEG_COUNT))

    @cached_property
    def arm(self) -> ModelInstanceIndex:
        """The model instance of turntable and arm."""
        return self.plant.GetModelInstanceByName("arm")

    @cached_property
    def wheels(self) -> tuple[ModelInstanceIndex, ...]:
        """The wheels' model instances, 1..4."""
        return tuple(
            self.plant.GetModelInstanceByName(f"wheel_{i + 1}") for i in range(WHEEL_COUNT)
        )

    @cached_property
    def has_rolling_wheels(self) -> bool:
        """Whether the wheels turn, instead of being part of the base."""
        return self.plant.num_actuators(self.wheels[0]) > 0

    @cached_property
    def is_full(self) -> bool:
        """Whether the legs' actuators are modelled as bodies."""
        return self.plant.HasBodyNamed("rod", self.legs[0])

    def leg_bodies(self, name: str) -> tuple[RigidBody, ...]:
        """The body of that name of each leg."""
        return tuple(self.plant.GetBodyByName(name, leg) for leg in self.legs)

    def leg_angles(self, leg: int, extension: float) -> dict[str, float]:
        """Positions of a leg's joints at an extension, in closed form."""
        dimensions = self.geometry.legs[leg]
        swing = swing_angle(dimensions, extension)
        angles = {"swing": swing}
        if self.is_full:
            angles["coupler_swing"] = -swing
            angles["cylinder_swing"] = diagonal_angle(dimensions, extension)
            angles["extension"] = extension
        return angles

    @cached_property
    def _position_starts(self) -> list[dict[str, int]]:
        """Index of each leg's joint position among the plant's positions."""
        starts: list[dict[str, int]] = []
        for leg in self.legs:
            joints = [self.plant.get_joint(i) for i in self.plant.GetJointIndices(leg)]
            starts.append({joint.name(): joint.position_start() for joint in joints})
        return starts

    def positions(
        self, extension: ArrayLike, posture: ArrayLike, ground: ArrayLike, arm: ArrayLike
    ) -> NDArray[np.float64]:
        """All positions of the plant, loops closed and feet on the ground.

        Args:
            extension: (4) extensions [m].
            posture: (3) roll, pitch, height [rad, rad, m].
            ground: (2) roll and pitch of the ground [rad].
            arm: (2) turntable and arm angle [rad].
        """
        return self.positions_at(extension, standing_pose(posture, ground), arm)

    def positions_at(
        self, extension: ArrayLike, base_pose: ArrayLike, arm: ArrayLike
    ) -> NDArray[np.float64]:
        """All positions of the plant, loops closed; wheels and rollers are at zero.

        Args:
            extension: (4) extensions [m].
            base_pose: (7) quaternion (w, x, y, z) and position [m] of the platform.
            arm: (2) turntable and arm angle [rad].
        """
        q = np.zeros(self.plant.num_positions())
        for leg, d in enumerate(np.asarray(extension).tolist()):
            for joint, value in self.leg_angles(leg, d).items():
                q[self._position_starts[leg][joint]] = value
        start = self.base.floating_positions_start()
        q[start : start + 7] = base_pose
        self.plant.SetPositionsInArray(self.arm, np.asarray(arm, dtype=float), q)
        return q

    def base_pose(self, positions: NDArray[np.float64]) -> RigidTransform:
        """X_WF: pose of the platform at these positions of the plant (or its whole state)."""
        start = self.base.floating_positions_start()
        quaternion = positions[start : start + 4]
        rotation = RotationMatrix(Quaternion(quaternion / np.linalg.norm(quaternion)))
        return RigidTransform(rotation, positions[start + 4 : start + 7])

    def swing(self, leg: int, positions: NDArray[np.float64]) -> float:
        """Angle psi of a leg's lower link at these positions of the plant [rad]."""
        return float(positions[self._position_starts[leg]["swing"]])

    def _build(self, context: Context) -> None:
        """Gives the legs in this context the dimensions that they were built with."""
        legs = zip(self.legs, self.geometry.legs, MODEL_GEOMETRY.legs, strict=True)
        for i, (instance, leg, drawn) in enumerate(legs):
            hip: Any = self.plant.GetFrameByName(f"hip_{i + 1}")
            p_FE = np.array([-leg.l_x, -leg.l_y, -leg.l_z])
            turned = RotationMatrix.MakeZRotation(leg.beta)
            hip.SetPoseInParentFrame(context, RigidTransform(turned, p_FE))
            p_MC = -leg.l_6 * _in_plane(*leg.e_a) - _in_plane(0.0, leg.l_7 - leg.foot_radius)
            along = np.array([leg.l_4, 0.0, 0.0])
            if self.is_full:
                # The coupler only translates, so what it is longer at K, the pivot may recede.
                longer = leg.l_3 * _in_plane(*leg.e_a) - drawn.l_3 * _in_plane(*drawn.e_a)
                origins = {"coupler_swing": along, "roll": p_MC, "cylinder_swing": -longer}
            else:
                origins = {"swing": p_MC, "roll": along}
            for joint, origin in origins.items():
                frame: Any = self.plant.GetJointByName(joint, instance).frame_on_parent()
                frame.SetPoseInParentFrame(context, RigidTransform(origin))

    def stand(
        self,
        context: Context,
        extension: ArrayLike,
        ground: ArrayLike,
        foot_offsets: ArrayLike = (0.0, 0.0, 0.0, 0.0),
    ) -> None:
        """Inclines the ground and puts the platform at rest on it with these extensions.

        Args:
            context: the plant's context.
            extension: (4) extensions [m].
            ground: (2) roll and pitch of the ground [rad].
            foot_offsets: (4) heights under the feet above the ground's plane, which the model
                must have been built with [m].
        """
        roll, pitch = np.asarray(ground).tolist()
        # The model's plane is the lowest part of the ground.
        lowest = min(0.0, float(np.min(np.asarray(foot_offsets))))
        X_WG = RigidTransform(
            RollPitchYaw(roll, pitch, 0.0), lowest * np.array(normal_of(roll, pitch))
        )
        self.ground_mount.SetPoseInParentFrame(context, X_WG)
        if self.geometry != MODEL_GEOMETRY:
            self._build(context)
        posture = resting_posture(self.geometry, extension, ground, foot_offsets)
        q = self.positions(extension, posture, ground, (0.0, 0.0))
        self.plant.SetPositions(context, q)
        self.plant.SetVelocities(context, np.zeros(self.plant.num_velocities()))

    def stand_on_wheels(
        self,
        context: Context,
        extension: ArrayLike,
        posture: ArrayLike,
        ground: ArrayLike,
        x: float = 0.0,
    ) -> None:
        """Inclines the ground and puts the platform at rest on its wheels, legs raised.

        Args:
            context: the plant's context.
            extension: (4) extensions [m].
            posture: (3) of a platform on its wheels [rad, rad, m].
            ground: (2) roll and pitch of the ground [rad].
            x: how far it is from the places of the feet, along its x axis [m].
        """
        roll, pitch = np.asarray(ground).tolist()
        X_WG = RigidTransform(RollPitchYaw(roll, pitch, 0.0), np.zeros(3))
        self.ground_mount.SetPoseInParentFrame(context, X_WG)
        if self.geometry != MODEL_GEOMETRY:
            self._build(context)
        pose = standing_pose(posture, ground)
        pose[4:] += X_WG.rotation().matrix() @ [x, 0.0, 0.0]
        self.plant.SetPositions(context, self.positions_at(extension, pose, (0.0, 0.0)))
        self.plant.SetVelocities(context, np.zeros(self.plant.num_velocities()))


def _in_plane(x: float, z: float) -> NDArray[np.float64]:
    """A vector of a leg's plane."""
    return np.array([x, 0.0, z])
