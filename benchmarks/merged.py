"""Copies of plants in which everything that is welded or braked is one body."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometryId, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    Joint,
    ModelInstanceIndex,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
    WeldJoint,
)

from parapod.systems.levelling_platform.model import PlatformModel
from parapod.systems.physics.loops import Ball, Coupling
from parapod.systems.physics.mujoco.translation import joints_of, pose_at_zero

type Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Machine:
    """The platform in a plant, with everything that is welded or braked in one body.

    Attributes:
        plant: the plant.
        legs: the legs' model instances.
        balls: its ball joints.
        couplings: its coupled joints.
        pose: place of the platform's quaternion and position among the positions.
    """

    plant: MultibodyPlant
    legs: tuple[ModelInstanceIndex, ...]
    balls: tuple[Ball, ...]
    couplings: tuple[Coupling, ...]
    pose: slice


# Joints that are braked: turntable and arm.
_BRAKED = ("turntable", "arm")


class Merger:
    """Copies a plant, with its welded and braked bodies in one.

    Args:
        whole: the plant to copy.
        plant: the copy.
        scene_graph: holds the geometry of the plant to copy.
    """

    def __init__(self, whole: MultibodyPlant, plant: MultibodyPlant, scene_graph: SceneGraph):
        self._whole, self._plant = whole, plant
        self._inspector = scene_graph.model_inspector()
        self._context = whole.CreateDefaultContext()
        # By the index of a body: the body that it is part of, and its pose in that.
        self._parts: dict[int, tuple[RigidBody, RigidTransform]] = {
            0: (plant.world_body(), RigidTransform())
        }

    def merge(
        self, model: PlatformModel, touching: Sequence[GeometryId], positions: Floats
    ) -> Machine:
        """Copies all, but of the geometry only what touches, and puts it at positions."""
        joints = self._outwards()
        moving = [joint for joint in joints if not self._is_stiff(joint)]
        inertias = self._inertias(joints)
        for joint in joints:
            child = joint.child_body()
            if self._is_stiff(joint):
                owner, X_GP = self._parts[int(joint.parent_body().index())]
                self._parts[int(child.index())] = (
                    owner,
                    X_GP.multiply(pose_at_zero(joint, self._context)),
                )
            else:
                instance = self._instance(child)
                inertia = inertias[int(child.index())]
                body = self._plant.AddRigidBody(child.name(), instance, inertia)
                self._parts[int(child.index())] = (body, RigidTransform())
        copies = {int(joint.index()): self._add(joint) for joint in moving}
        balls = tuple(self._ball(ball) for ball in model.balls)
        couplings = tuple(
            Coupling(copies[int(c.joint.index())], copies[int(c.leader.index())], c.ratio)
            for c in model.couplings
        )
        for ball in balls:
            self._plant.AddBallConstraint(
                ball.body, np.asarray(ball.point), ball.other, np.asarray(ball.other_point)
            )
        for coupling in couplings:
            self._plant.AddCouplerConstraint(coupling.joint, coupling.leader, coupling.ratio)
        for geometry in touching:
            self._touch(geometry)
        self._plant.Finalize()
        q = np.zeros(self._plant.num_positions())
        base = self._plant.GetBodyByName("base")
        pose = slice(base.floating_positions_start(), base.floating_positions_start() + 7)
        start = model.base.floating_positions_start()
        q[pose] = positions[start : start + 7]
        for joint in moving:
            if joint.num_positions() == 1:
                q[copies[int(joint.index())].position_start()] = positions[joint.position_start()]
        self._plant.SetDefaultPositions(q)
        names = [self._whole.GetModelInstanceName(leg) for leg in model.legs]
        legs = tuple(map(self._plant.GetModelInstanceByName, names))
        return Machine(self._plant, legs, balls, couplings, pose)

    def _outwards(self) -> list[Joint]:
        """All joints, those nearer to the world first."""
        joints = joints_of(self._whole)
        joined_bodies, ordered = {0}, list[Joint]()
        while len(ordered) < len(joints):
            for joint in joints:
                child = int(joint.child_body().index())
                if (
                    child not in joined_bodies
                    and int(joint.parent_body().index()) in joined_bodies
                ):
                    joined_bodies.add(child)
                    ordered.append(joint)
        return ordered

    def _is_stiff(self, joint: Joint) -> bool:
        return isinstance(joint, WeldJoint) or joint.name() in _BRAKED

    def _inertias(self, joints: Sequence[Joint]) -> dict[int, SpatialInertia]:
        """By the index of the innermost body of what moves together, the sum of its inertias."""
        owners: dict[int, tuple[int, RigidTransform]] = {0: (0, RigidTransform())}
        sums: dict[int, SpatialInertia] = {}
        for joint in joints:
            child = joint.child_body()
            index = int(child.index())
            owners[index] = (index, RigidTransform())
            if self._is_stiff(joint):
                owner, X_GP = owners[int(joint.parent_body().index())]
                owners[index] = (owner, X_GP.multiply(pose_at_zero(joint, self._context)))
            owner, X_GB = owners[index]
            own = child.CalcSpatialInertiaInBodyFrame(self._context)
            shifted = own.ReExpress(X_GB.rotation()).Shift(-X_GB.translation())
            if owner in sums:
                sums[owner] += shifted
            else:
                sums[owner] = shifted
        return sums

    def _instance(self, body: RigidBody) -> ModelInstanceIndex:
        name = self._whole.GetModelInstanceName(body.model_instance())
        if self._plant.HasModelInstanceNamed(name):
            return self._plant.GetModelInstanceByName(name)
        return self._plant.AddModelInstance(name)

    def _frame(self, frame: Any) -> Any:
        """The same frame on the copy's body."""
        owner, X_GB = self._parts[int(frame.body().index())]
        X_GF = X_GB.multiply(frame.CalcPoseInBodyFrame(self._context))
        name = f"frame_{self._plant.num_frames()}"
        return self._plant.AddFrame(FixedOffsetFrame(name, owner, X_GF))

    def _add(self, joint: Joint) -> Any:
        """Adds a joint and its drive; a floating body needs none."""
        if isinstance(joint, QuaternionFloatingJoint):
            return joint
        frames = (self._frame(joint.frame_on_parent()), self._frame(joint.frame_on_child()))
        damping = float(joint.GetDampingVector(self._context)[0])
        if isinstance(joint, RevoluteJoint):
            axis = joint.revolute_axis()
            revolute: Any = RevoluteJoint(joint.name(), *frames, axis, damping)
        else:
            assert isinstance(joint, PrismaticJoint)
            axis = joint.translation_axis()
            revolute = PrismaticJoint(joint.name(), *frames, axis, damping=damping)
        copy = self._plant.AddJoint(revolute)
        for i in self._whole.GetJointActuatorIndices():
            drive = self._whole.get_joint_actuator(i)
            if drive.joint().index() == joint.index():
                copied = self._plant.AddJointActuator(drive.name(), copy)
                copied.set_controller_gains(drive.get_controller_gains())
        return copy

    def _ball(self, ball: Ball) -> Ball:
        (one, X_GA), (other, X_HB) = (
            self._parts[int(body.index())] for body in (ball.body, ball.other)
        )
        points = X_GA @ np.asarray(ball.point), X_HB @ np.asarray(ball.other_point)
        return Ball(one, points[0], other, points[1])

    def _touch(self, geometry: GeometryId) -> None:
        body = self._whole.GetBodyFromFrameId(self._inspector.GetFrameId(geometry))
        assert body is not None
        owner, X_GB = self._parts[int(body.index())]
        X_GC = X_GB.multiply(self._inspector.GetPoseInFrame(geometry))
        shape: Any = self._inspector.GetShape(geometry)
        properties = self._inspector.GetProximityProperties(geometry)
        name = f"{self._inspector.GetName(geometry)} {geometry.get_value()}"
        self._plant.RegisterCollisionGeometry(owner, X_GC, shape, name, properties)
