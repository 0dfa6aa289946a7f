"""A machining centre as bodies and joints: names, closed-form positions, locks and clamps.

Locks and clamps are parameters of a plant's context, which no system can change while a simulation
steps: they are switched between two steps, and only what stands is switched.
"""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    JointActuator,
    ModelInstanceIndex,
    MultibodyConstraintId,
    QuaternionFloatingJoint,
    RigidBody,
)
from pydrake.systems.framework import Context

from parapod.systems.machining_center.branch import branch_joints
from parapod.systems.machining_center.geometry import CenterGeometry
from parapod.systems.machining_center.platform_mode import feet_of, leg_lengths

# Names of a limb's joints that carry locks, by the number of the chain's joint.
LOCK_JOINTS = {1: "ankle_1", 2: "ankle_2", 3: "ankle_3", 6: "hinge"}
_CHAIN = ("ankle_1", "ankle_2", "ankle_3", "left_length", "left_swing", "hinge")


@dataclass(frozen=True)
class CenterModel:
    """A finalized plant that holds a centre of `parapod.urdf.machining_center`.

    Attributes:
        plant: the plant.
        geometry: geometry to which the files are drawn.
        clamps: constraints between clamps and feet, one a limb.
    """

    plant: MultibodyPlant
    geometry: CenterGeometry
    clamps: tuple[MultibodyConstraintId, ...]

    @cached_property
    def platform(self) -> RigidBody:
        """The platform; its origin is P_O."""
        return self.plant.GetBodyByName("platform")

    @cached_property
    def limbs(self) -> tuple[ModelInstanceIndex, ...]:
        """Model instances of the limbs."""
        count = self.geometry.limbs
        return tuple(self.plant.GetModelInstanceByName(f"limb_{i + 1}") for i in range(count))

    @cached_property
    def feet(self) -> tuple[RigidBody, ...]:
        """The feet; their frames are {A}."""
        return tuple(self.plant.GetBodyByName("foot", limb) for limb in self.limbs)

    @cached_property
    def clamp_bodies(self) -> tuple[RigidBody, ...]:
        """The clamps; their frames coincide with those of the feet that they hold."""
        count = self.geometry.limbs
        names = (f"clamp_{i + 1}" for i in range(count))
        return tuple(
            self.plant.GetBodyByName("clamp", self.plant.GetModelInstanceByName(name))
            for name in names
        )

    @cached_property
    def actuators(self) -> tuple[JointActuator, ...]:
        """The legs' actuators, left and right of each limb."""
        return tuple(
            self.plant.GetJointActuatorByName(side, limb)
            for limb in self.limbs
            for side in ("left", "right")
        )

    def lock_joint(self, limb: int, joint: int) -> Any:
        """A joint that carries a lock.

        Args:
            limb: counted from 1.
            joint: 1, 2, 3 or 6.
        """
        return self.plant.GetJointByName(LOCK_JOINTS[joint], self.limbs[limb - 1])

    def stand(self, context: Context, pose: ArrayLike, footholds: ArrayLike | None = None) -> None:
        """Puts the centre at rest, loops closed, all feet clamped, no joint locked.

        Args:
            context: the plant's context.
            pose: (6) of the platform [m, rad].
            footholds: (n, 6) poses of the feet's frames; None for the paper's pattern.
        """
        feet = feet_of(self.geometry, footholds)
        self.lock(context, ())
        for limb, foot in enumerate(feet, start=1):
            self.clamp(context, limb, _transform(foot))
        self.plant.SetPositions(context, self.positions(pose, feet))
        self.plant.SetVelocities(context, np.zeros(self.plant.num_velocities()))

    def positions(self, pose: ArrayLike, footholds: ArrayLike | None = None) -> NDArray[Any]:
        """All positions of the plant, loops closed, clamps under the feet.

        Args:
            pose: (6) of the platform [m, rad].
            footholds: (n, 6) poses of the feet's frames; None for the paper's pattern.
        """
        geometry, place = self.geometry, np.asarray(pose, dtype=float)
        feet = feet_of(geometry, footholds)
        joints = branch_joints(geometry, place, feet, along="left")
        lengths = leg_lengths(geometry, place, feet)
        q = np.zeros(self.plant.num_positions())
        for i, limb in enumerate(self.limbs):
            values = dict(zip(_CHAIN, joints[i].tolist(), strict=True))
            values["right_length"] = float(lengths[2 * i + 1])
            values["right_swing"] = self._right_swing(values)
            for name, value in values.items():
                q[self.plant.GetJointByName(name, limb).position_start()] = value
        self._place(q, self.platform, _transform(place))
        for body, foot in zip(self.clamp_bodies, feet, strict=True):
            self._place(q, body, _transform(foot))
        return q

    def _right_swing(self, values: dict[str, float]) -> float:
        """Angle of the right leg: both legs end in the ankle."""
        apart = float(np.linalg.norm(self.geometry.pivots[1] - self.geometry.pivots[0]))
        across = values["left_length"] * np.sin(values["left_swing"]) + apart
        return float(np.arctan2(across, values["left_length"] * np.cos(values["left_swing"])))

    def _place(self, q: NDArray[Any], body: RigidBody, pose: RigidTransform) -> None:
        start = self._floating[body.index()].position_start()
        quaternion = pose.rotation().ToQuaternion().wxyz()
        q[start : start + 7] = (*quaternion, *pose.translation())

    @cached_property
    def _floating(self) -> dict[Any, Any]:
        """Floating joints, by the index of the body."""
        joints = map(self.plant.get_joint, self.plant.GetJointIndices())
        return {
            j.child_body().index(): j for j in joints if isinstance(j, QuaternionFloatingJoint)
        }

    def lock(self, context: Context, joints: Collection[tuple[int, int]]) -> None:
        """Locks joints where they are, and unlocks all others; a locked joint stands.

        Args:
            context: the plant's context.
            joints: (limb, joint) each.
        """
        for limb in range(1, self.geometry.limbs + 1):
            for joint in LOCK_JOINTS:
                found = self.lock_joint(limb, joint)
                if (limb, joint) in joints:
                    found.Lock(context)
                else:
                    found.Unlock(context)

    def clamp(self, context: Context, limb: int, at: RigidTransform | None = None) -> None:
        """Clamps a foot where it is.

        Args:
            context: the plant's context.
            limb: counted from 1.
            at: pose of the clamp, where the foot is not there yet.
        """
        body = self.clamp_bodies[limb - 1]
        pose = self.foot_pose(context, limb) if at is None else at
        joint = self._floating[body.index()]
        joint.Unlock(context)
        joint.SetPose(context, pose)
        joint.Lock(context)
        self.plant.SetConstraintActiveStatus(context, self.clamps[limb - 1], True)

    def unclamp(self, context: Context, limb: int) -> None:
        """Lets a foot go; its clamp stays.

        Args:
            context: the plant's context.
            limb: counted from 1.
        """
        self.plant.SetConstraintActiveStatus(context, self.clamps[limb - 1], False)

    def foot_pose(self, context: Context, limb: int) -> RigidTransform:
        """Pose of a foot's frame in the world."""
        return self.plant.EvalBodyPoseInWorld(context, self.feet[limb - 1])


def _transform(pose: NDArray[np.float64]) -> RigidTransform:
    return RigidTransform(RollPitchYaw(pose[3:]), pose[:3])


def pose_of(transform: RigidTransform) -> NDArray[np.float64]:
    """x, y, z, roll, pitch, yaw (6) of a transform [m, rad]."""
    angles = RollPitchYaw(transform.rotation()).vector()
    return np.concatenate((transform.translation(), angles))
