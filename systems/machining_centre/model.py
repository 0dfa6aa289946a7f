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
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    JointActuator,
    ModelInstanceIndex,
    MultibodyConstraintId,
    RigidBody,
)
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import declare_cached, read_array
from parapod.systems.machining_centre.branch import branch_joints
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import feet_of, leg_lengths
from parapod.systems.machining_centre.swing import LOCKABLE

# Names of a limb's joints that carry locks, by the number of the chain's joint.
LOCK_JOINTS = {1: "ankle_1", 2: "ankle_2", 3: "ankle_3", 6: "hinge"}
_CHAIN = ("ankle_1", "ankle_2", "ankle_3", "left_length", "left_swing", "hinge")


@dataclass(frozen=True)
class CentreModel:
    """A finalized plant that holds a centre of `parapod.urdf.machining_centre`.

    Attributes:
        plant: the plant.
        geometry: geometry to which the files are drawn.
        clamps: constraints between clamps and feet, one a limb.
    """

    plant: MultibodyPlant
    geometry: CentreGeometry
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
            self.clamp(context, limb, transform_of(foot))
        self.plant.SetPositions(context, self.positions(pose, feet))
        self.plant.SetVelocities(context, np.zeros(self.plant.num_velocities()))

    def positions(self, pose: ArrayLike, footholds: ArrayLike | None = None) -> NDArray[Any]:
        """All positions of the plant, loops closed.

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
        start = self.plant.GetJointByName("platform").position_start()
        transform = transform_of(place)
        quaternion = transform.rotation().ToQuaternion().wxyz()
        q[start : start + 7] = (*quaternion, *transform.translation())
        return q

    def _right_swing(self, values: dict[str, float]) -> float:
        """Angle of the right leg: both legs end in the ankle."""
        apart = float(np.linalg.norm(self.geometry.pivots[1] - self.geometry.pivots[0]))
        across = values["left_length"] * np.sin(values["left_swing"]) + apart
        return float(np.arctan2(across, values["left_length"] * np.cos(values["left_swing"])))

    def lock(self, context: Context, joints: Collection[tuple[int, int]]) -> None:
        """Locks joints where they are, and unlocks all others; a locked joint stands.

        Args:
            context: the plant's context.
            joints: (limb, joint) each.
        """
        for limb in range(1, self.geometry.limbs + 1):
            for joint in LOCK_JOINTS:
                lock_joint = self.lock_joint(limb, joint)
                if (limb, joint) in joints:
                    lock_joint.Lock(context)
                else:
                    lock_joint.Unlock(context)

    def clamp(self, context: Context, limb: int, at: RigidTransform | None = None) -> None:
        """Clamps a foot where it is.

        Args:
            context: the plant's context.
            limb: counted from 1.
            at: pose of the clamp, where the foot is not there yet.
        """
        pose = self.foot_pose(context, limb) if at is None else at
        if self.plant.HasJointNamed(name := f"pad_{limb}"):
            # The ground under it may have given way before.
            pad: Any = self.plant.GetJointByName(name)
            pose = pose @ RigidTransform(np.array((0.0, 0.0, -pad.get_translation(context))))
        frame: Any = self.plant.GetFrameByName(f"clamp_{limb}")
        frame.SetPoseInParentFrame(context, pose)
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


class CentrePositions(LeafSystem):
    """Positions of the plant's joints for a drawing, loops closed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pose` | 6 | m, rad | of the platform |
    | in `feet` | 6n | m, rad | of the feet's frames |
    | out `positions` | n | - | positions of the plant's joints |

    No state.

    Bad input: a posture that is not finite gives positions that are not finite.

    Args:
        model: the bodies.
    """

    def __init__(self, model: CentreModel):
        super().__init__()
        self.set_name("centre_positions")
        self._model = model
        self._pose = self.DeclareVectorInputPort("pose", 6)
        self._feet = self.DeclareVectorInputPort("feet", 6 * model.geometry.limbs)
        self.DeclareVectorOutputPort(
            "positions",
            model.plant.num_positions(),
            self._calc,
            {self._pose.ticket(), self._feet.ticket()},
        )

    def _calc(self, context: Context, output: BasicVector) -> None:
        feet, pose = read_array(self._feet, context), read_array(self._pose, context)
        if np.isfinite(feet).all() and np.isfinite(pose).all():
            output.SetFromVector(self._model.positions(pose, feet.reshape(-1, 6)))
        else:
            output.SetFromVector(np.full(self._model.plant.num_positions(), np.nan))


class CentreTruth(LeafSystem):
    """True platform, feet, joints, and gaps of loops and clamps.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `body_poses` | abstract | - | poses of the plant's bodies |
    | in `state` | n | - | positions and velocities of the plant |
    | out `pose` | 6 | m, rad | of the platform |
    | out `feet` | 6n | m, rad | of the feet's frames |
    | out `joints` | 4n | rad | q_1, q_2, q_3, q_6 of each limb |
    | out `clamp_gap` | n | m | distance of each foot from its clamp |
    | out `loop_error` | n | m | distance of both rods' tips of each limb |

    State: none.

    Bad input: what is not finite is shown as it is.

    Args:
        model: the bodies.
    """

    def __init__(self, model: CentreModel):
        super().__init__()
        self.set_name("centre_truth")
        n = model.geometry.limbs
        self._platform = model.platform.index()
        self._feet = [foot.index() for foot in model.feet]
        self._clamps = [clamp.index() for clamp in model.clamp_bodies]
        self._tips = [
            [model.plant.GetBodyByName(f"{side}_rod", limb).index() for limb in model.limbs]
            for side in ("left", "right")
        ]
        self._joints = [
            model.lock_joint(limb, joint).position_start()
            for limb in range(1, n + 1)
            for joint in LOCKABLE
        ]
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]([]))
        self._state = self.DeclareVectorInputPort("state", model.plant.num_multibody_states())
        poses = {self._poses.ticket()}
        self._all_feet = declare_cached(self, "feet", self._calc_all_feet, poses)
        for name, size, calc, tickets in (
            ("pose", 6, self._calc_pose, poses),
            ("feet", 6 * n, self._calc_feet, {self._all_feet.ticket}),
            ("joints", len(self._joints), self._calc_joints, {self._state.ticket()}),
            ("clamp_gap", n, self._calc_clamp_gap, poses),
            ("loop_error", n, self._calc_loop_error, poses),
        ):
            self.DeclareVectorOutputPort(name, size, calc, tickets)

    def _calc_all_feet(self, context: Context) -> NDArray[np.float64]:
        poses: Any = self._poses.Eval(context)
        return np.concatenate([pose_of(poses[foot]) for foot in self._feet])

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        poses: Any = self._poses.Eval(context)
        output.SetFromVector(pose_of(poses[self._platform]))

    def _calc_feet(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._all_feet.value(self, context))

    def _calc_joints(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(read_array(self._state, context)[self._joints])

    def _calc_clamp_gap(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._gaps(context, self._feet, self._clamps))

    def _calc_loop_error(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._gaps(context, *self._tips))

    def _gaps(self, context: Context, one: list[Any], other: list[Any]) -> NDArray[np.float64]:
        poses: Any = self._poses.Eval(context)
        spans = [
            poses[i].translation() - poses[j].translation()
            for i, j in zip(one, other, strict=True)
        ]
        return np.linalg.norm(spans, axis=-1)


def transform_of(pose: NDArray[np.float64]) -> RigidTransform:
    """Transform of x, y, z, roll, pitch, yaw (6) [m, rad]."""
    return RigidTransform(RollPitchYaw(pose[3:]), pose[:3])


def pose_of(transform: RigidTransform) -> NDArray[np.float64]:
    """x, y, z, roll, pitch, yaw (6) of a transform [m, rad]."""
    angles = RollPitchYaw(transform.rotation()).vector()
    return np.concatenate((transform.translation(), angles))
