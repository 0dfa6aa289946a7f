"""MJCF as MuJoCo compiles it, put into a plant: bodies, joints, motors, shapes, and loops.

Drake's own parser leaves out welds, couplings and sites of an MJCF. Compiled by MuJoCo, a model
has all defaults, classes and files resolved. What a plant has no counterpart for is named.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeometryInstance,
    HalfSpace,
    MakePhongIllustrationProperties,
    Mesh,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import (
    BallRpyJoint,
    FixedOffsetFrame,
    Frame,
    Joint,
    PdControllerGains,
    PrismaticJoint,
    PrismaticSpring,
    RevoluteJoint,
    RevoluteSpring,
    RigidBody,
    RotationalInertia,
    SpatialInertia,
)

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.extras import need
from parapod.systems.core.quoting import quoted_path
from parapod.systems.mechanism.hinges import LIGHT, PLAIN_AXES, add_hinges
from parapod.systems.mechanism.parts import Model
from parapod.systems.physics.description import Servo
from parapod.systems.physics.loops import Ball, Coupling, Distance, Weld

# Parts of an MJCF without counterpart, by the counts that MuJoCo keeps of them.
_LEFT_OUT = {
    "ntendon": "tendons",
    "nsensor": "sensors",
    "nflex": "flexible bodies",
    "nskin": "skins",
    "nhfield": "height fields",
    "nplugin": "plugins",
    "npair": "contact pairs",
    "nexclude": "contact exclusions",
    "nkey": "key frames",
    "ncam": "cameras",
    "nlight": "lights",
}

_NOTHING = SpatialInertia.Zero()


def add_mjcf(model: Model) -> None:
    """Adds an MJCF to the plant of a model.

    Args:
        model: its loops, motors and notes are filled in.

    Raises:
        MissingExtra: MuJoCo is not installed.
        ScenarioError: MuJoCo refuses the file, or it has a loop that no plant has.
    """
    mujoco: Any = need("mujoco")
    try:
        # By its path: what it includes is beside it.
        spec = mujoco.MjSpec.from_file(str(model.path.absolute()))
        compiled = spec.compile()
    except (ValueError, OSError) as error:
        reason = " ".join(str(error).split())
        raise ScenarioError(f"cannot read {quoted_path(model.path)}: {reason}") from None
    _Reader(mujoco, spec, compiled, model).read()


class _Reader:
    """A compiled model as it is put into a plant."""

    def __init__(self, mujoco: Any, spec: Any, compiled: Any, model: Model):
        self._mujoco, self._spec, self._compiled = mujoco, spec, compiled
        self._model, self._plant = model, model.plant
        self._bodies: list[RigidBody] = [self._plant.world_body()]
        self._joints: list[Joint | None] = []
        self._rods = 0

    def read(self) -> None:
        """Puts all of the model into the plant."""
        for body in range(1, self._compiled.nbody):
            self._add_body(body)
        if self._plant.geometry_source_is_registered():
            for geom in range(self._compiled.ngeom):
                self._add_shape(geom)
        for equality in range(self._compiled.neq):
            self._add_loop(equality)
        for actuator in range(self._compiled.nu):
            self._add_motor(actuator)
        self._give_gains()
        for count, what in _LEFT_OUT.items():
            number = int(getattr(self._compiled, count))
            if number := number - (self._rods if count == "ntendon" else 0):
                self._model.notes.append(f"not read: {number} {what}")
        stiff = [joint for joint, loss in self._losses() if loss]
        if stiff:
            self._model.notes.append(f"not read: the dry friction of {', '.join(stiff)}")

    def _losses(self) -> Iterator[tuple[str, float]]:
        for index, joint in enumerate(self._joints):
            if joint is not None:
                dof = int(self._compiled.jnt_dofadr[index])
                yield joint.name(), float(self._compiled.dof_frictionloss[dof])

    def _name(self, kind: str, index: int) -> str:
        name = getattr(self._compiled, kind)(index).name
        return name or f"{kind}_{index}"

    def _add_body(self, index: int) -> None:
        compiled = self._compiled
        mass = float(compiled.body_mass[index])
        name = self._name("body", index)
        body = self._plant.AddRigidBody(name, _inertia(compiled, index) if mass else _NOTHING)
        parent = self._bodies[int(compiled.body_parentid[index])]
        X_PB = _transform(compiled.body_pos[index], compiled.body_quat[index])
        self._bodies.append(body)
        first, count = int(compiled.body_jntadr[index]), int(compiled.body_jntnum[index])
        if count == 0:
            self._plant.WeldFrames(parent.body_frame(), body.body_frame(), X_PB)
        for joint in range(first, first + count):
            is_last = joint == first + count - 1
            light = LIGHT if self._model.is_plain else _NOTHING
            child = body if is_last else self._plant.AddRigidBody(f"{name}_{joint}", light)
            self._add_joint(joint, parent, child, X_PB)
            parent, X_PB = child, RigidTransform()

    def _add_joint(
        self, index: int, parent: RigidBody, child: RigidBody, X_PB: RigidTransform
    ) -> None:
        compiled, kinds = self._compiled, self._mujoco.mjtJoint
        name, kind = self._name("joint", index), kinds(int(compiled.jnt_type[index]))
        if kind == kinds.mjJNT_FREE:
            self._plant.SetDefaultFloatingBaseBodyPose(child, X_PB)
            self._joints.append(None)
            return
        anchor, axis = RigidTransform(compiled.jnt_pos[index]), compiled.jnt_axis[index]
        zero = float(compiled.qpos0[compiled.jnt_qposadr[index]])
        dof = int(compiled.jnt_dofadr[index])
        damping, spring = float(compiled.dof_damping[dof]), float(compiled.jnt_stiffness[index])
        back = RigidTransform()
        if kind == kinds.mjJNT_HINGE:
            back = RigidTransform(RotationMatrix(_turn(axis, -zero)), np.zeros(3))
        elif kind == kinds.mjJNT_SLIDE:
            back = RigidTransform(-zero * axis)
        ends = (
            self._offset(f"{name}_on_parent", parent, X_PB.multiply(anchor).multiply(back)),
            self._offset(f"{name}_on_child", child, anchor),
        )
        rest = float(compiled.qpos_spring[compiled.jnt_qposadr[index]])
        is_beside = bool(anchor.translation().any())
        if kind == kinds.mjJNT_BALL:
            if self._model.is_plain:
                hinges = add_hinges(self._plant, name, *ends, PLAIN_AXES["ball_rpy"])
                for hinge in hinges:
                    hinge.set_default_damping(damping)
                added: Any = hinges[-1]
            else:
                added = self._plant.AddJoint(BallRpyJoint(name, *ends, damping))
            if spring:
                self._model.notes.append(f"not read: the stiffness of the ball joint {name}")
        elif kind == kinds.mjJNT_HINGE:
            if self._model.is_plain and is_beside:
                (added,) = add_hinges(self._plant, name, *ends, {"": tuple(axis)})
                added.set_default_damping(damping)
            else:
                added = self._plant.AddJoint(RevoluteJoint(name, *ends, axis, damping))
            if spring:
                self._plant.AddForceElement(RevoluteSpring(added, rest, spring))
        else:
            added = self._plant.AddJoint(PrismaticJoint(name, *ends, axis, damping=damping))
            if spring:
                self._plant.AddForceElement(PrismaticSpring(added, rest, spring))
        if kind != kinds.mjJNT_BALL:
            added.set_default_positions([zero])
            if compiled.jnt_limited[index]:
                low, high = compiled.jnt_range[index]
                added.set_position_limits([low], [high])
            if armature := self._armature(index):
                self._model.drives.armatures[added.index()] = armature
            if spring:
                self._model.drives.springs[added.index()] = spring, rest
        self._joints.append(added)

    def _offset(self, name: str, body: RigidBody, pose: RigidTransform) -> Frame:
        return self._plant.AddFrame(FixedOffsetFrame(name, body.body_frame(), pose))

    def _add_loop(self, index: int) -> None:
        compiled, kinds = self._compiled, self._mujoco.mjtEq
        name, kind = self._name("equality", index), kinds(int(compiled.eq_type[index]))
        one, other = int(compiled.eq_obj1id[index]), int(compiled.eq_obj2id[index])
        data = compiled.eq_data[index]
        if not compiled.eq_active0[index]:
            self._model.notes.append(f"not read: {name}, which is not active")
        elif kind == kinds.mjEQ_JOINT:
            self._add_coupling(name, one, other, data)
        elif kind == kinds.mjEQ_TENDON and other < 0 and (ends := self._rod(one)):
            (body, X_AP), (far, X_BQ) = ends
            label = compiled.equality(index).name or f"{body.name()} - {far.name()}"
            length = float(compiled.tendon_length0[one] + data[0])
            self._model.loops.append(
                Distance(body, X_AP.translation(), far, X_BQ.translation(), length, label)
            )
        elif kind in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
            is_ball = kind == kinds.mjEQ_CONNECT
            if int(compiled.eq_objtype[index]) == int(self._mujoco.mjtObj.mjOBJ_SITE):
                ends = [self._site(site) for site in (one, other)]
            else:
                poses = (
                    (RigidTransform(data[:3]), RigidTransform(data[3:6]))
                    if is_ball
                    else (_transform(data[3:6], data[6:10]), RigidTransform(data[:3]))
                )
                bodies = self._bodies[one], self._bodies[other]
                ends = list(zip(bodies, poses, strict=True))
            (body, X_AP), (far, X_BQ) = ends
            label = compiled.equality(index).name or f"{body.name()} - {far.name()}"
            self._model.loops.append(
                Ball(body, X_AP.translation(), far, X_BQ.translation(), name=label)
                if is_ball
                else Weld(body, X_AP, far, X_BQ, name=label)
            )
        else:
            word = str(kind.name).removeprefix("mjEQ_").lower()
            raise ScenarioError(
                f"cannot read {quoted_path(self._model.path)}: {name} is an equality of the kind "
                f"{word}; connect, weld, joint and tendons as rods are read"
            )

    def _rod(self, tendon: int) -> list[tuple[RigidBody, RigidTransform]]:
        """Ends of a tendon that goes from one site straight to another; none of another one."""
        compiled = self._compiled
        first, count = int(compiled.tendon_adr[tendon]), int(compiled.tendon_num[tendon])
        is_site = compiled.wrap_type[first : first + count] == int(
            self._mujoco.mjtWrap.mjWRAP_SITE
        )
        if count != 2 or not is_site.all():
            return []
        self._rods += 1
        return [self._site(int(site)) for site in compiled.wrap_objid[first : first + 2]]

    def _site(self, index: int) -> tuple[RigidBody, RigidTransform]:
        compiled = self._compiled
        pose = _transform(compiled.site_pos[index], compiled.site_quat[index])
        return self._bodies[int(compiled.site_bodyid[index])], pose

    def _add_coupling(self, name: str, one: int, other: int, data: NDArray[np.float64]) -> None:
        joint, leader = self._joints[one], self._joints[other] if other >= 0 else None
        if joint is None or leader is None or np.abs(data[2:5]).any():
            raise ScenarioError(
                f"cannot read {quoted_path(self._model.path)}: {name} couples joints by more than "
                "a ratio and an offset"
            )
        zeros = [self._compiled.qpos0[self._compiled.jnt_qposadr[i]] for i in (one, other)]
        offset = float(zeros[0] + data[0] - data[1] * zeros[1])
        label = self._compiled.equality(name).name if not name.startswith("equality_") else ""
        self._model.loops.append(Coupling(joint, leader, float(data[1]), offset, name=label))

    def _add_motor(self, index: int) -> None:
        compiled = self._compiled
        name = self._name("actuator", index)
        kinds = self._mujoco.mjtTrn
        is_joint = kinds(int(compiled.actuator_trntype[index])) == kinds.mjTRN_JOINT
        joint = self._joints[int(compiled.actuator_trnid[index][0])] if is_joint else None
        if joint is None or joint.num_velocities() != 1:
            self._model.notes.append(f"not read: the actuator {name}, which moves no single joint")
            return
        if compiled.actuator_damping[index]:
            self._model.notes.append(f"not read: the damping of the actuator {name}")
        servo, place = self._servo(index, name, joint), int(compiled.actuator_trnid[index][0])
        if servo is not None:
            self._model.drives.servos.append(servo)
        if joint.index() not in self._model.motors:
            self._model.motors.append(joint.index())
            gear = abs(float(compiled.actuator_gear[index][0]))
            effort = np.inf
            if compiled.actuator_forcelimited[index]:
                effort = gear * float(np.abs(compiled.actuator_forcerange[index]).max())
            if compiled.jnt_actfrclimited[place]:
                low, high = compiled.jnt_actfrcrange[place].tolist()
                self._model.drives.forces[joint.index()] = low, high
                effort = min(effort or np.inf, max(-low, high))
            motor = self._plant.AddJointActuator(name, joint, effort or np.inf)
            motor.set_default_rotor_inertia(self._armature(place))

    def _armature(self, joint: int) -> float:
        """Inertia of a joint of its own, that of its actuators included [kg, kg m^2]."""
        compiled = self._compiled
        inertia = float(compiled.dof_armature[int(compiled.jnt_dofadr[joint])])
        for actuator in range(compiled.nu):
            kind = int(compiled.actuator_trntype[actuator])
            rotor = float(compiled.actuator_armature[actuator])
            is_here = int(compiled.actuator_trnid[actuator][0]) == joint
            if rotor and is_here and kind == int(self._mujoco.mjtTrn.mjTRN_JOINT):
                inertia += rotor * float(compiled.actuator_gear[actuator][0]) ** 2
        return inertia

    def _servo(self, index: int, name: str, joint: Joint) -> Servo | None:
        """An actuator; None for one that is more than a gain and a bias, which a note says."""
        compiled, mujoco = self._compiled, self._mujoco
        bias, kinds = int(compiled.actuator_biastype[index]), mujoco.mjtBias
        if (
            int(compiled.actuator_gaintype[index]) != int(mujoco.mjtGain.mjGAIN_FIXED)
            or bias not in (int(kinds.mjBIAS_NONE), int(kinds.mjBIAS_AFFINE))
            or int(compiled.actuator_dyntype[index]) != int(mujoco.mjtDyn.mjDYN_NONE)
        ):
            self._model.notes.append(
                f"not read: the force of the actuator {name}, which is more than a gain and a bias"
            )
            return None
        at_zero, by_length, by_speed = compiled.actuator_biasprm[index][:3].tolist()
        is_affine = bias == int(kinds.mjBIAS_AFFINE)
        limits = {
            what: (low, high) if limited[index] else None
            for what, limited, (low, high) in (
                (
                    "forces",
                    compiled.actuator_forcelimited,
                    compiled.actuator_forcerange[index].tolist(),
                ),
                (
                    "controls",
                    compiled.actuator_ctrllimited,
                    compiled.actuator_ctrlrange[index].tolist(),
                ),
            )
        }
        return Servo(
            name,
            joint.index(),
            float(compiled.actuator_gainprm[index][0]),
            (at_zero, by_length, by_speed) if is_affine else (0.0, 0.0, 0.0),
            float(compiled.actuator_gear[index][0]),
            **limits,
        )

    def _give_gains(self) -> None:
        """Gives actuators the stiffness and damping of their servos."""
        servos = self._model.drives.servos
        for actuator in map(self._plant.get_joint_actuator, self._plant.GetJointActuatorIndices()):
            own = [servo for servo in servos if servo.joint == actuator.joint().index()]
            p, d = sum(servo.stiffness for servo in own), sum(servo.damping for servo in own)
            if p > 0.0 or d > 0.0:
                actuator.set_controller_gains(PdControllerGains(p=max(p, 0.0), d=max(d, 0.0)))

    def _add_shape(self, index: int) -> None:
        compiled = self._compiled
        shape = self._shape(index)
        if shape is None:
            return
        body = self._bodies[int(compiled.geom_bodyid[index])]
        pose = _transform(compiled.geom_pos[index], compiled.geom_quat[index])
        material = int(compiled.geom_matid[index])
        colour = compiled.geom_rgba[index] if material < 0 else compiled.mat_rgba[material]
        instance = GeometryInstance(pose, shape, self._name("geom", index))
        instance.set_illustration_properties(MakePhongIllustrationProperties(colour))
        self._plant.RegisterVisualGeometry(body, instance)

    def _shape(self, index: int) -> Any:
        compiled, kinds = self._compiled, self._mujoco.mjtGeom
        kind, (a, b, c) = kinds(int(compiled.geom_type[index])), compiled.geom_size[index].tolist()
        if kind == kinds.mjGEOM_MESH:
            return self._mesh(int(compiled.geom_dataid[index]))
        shapes = {
            kinds.mjGEOM_PLANE: HalfSpace,
            kinds.mjGEOM_SPHERE: lambda: Sphere(a),
            kinds.mjGEOM_CAPSULE: lambda: Capsule(a, 2.0 * b),
            kinds.mjGEOM_CYLINDER: lambda: Cylinder(a, 2.0 * b),
            kinds.mjGEOM_BOX: lambda: Box(2.0 * a, 2.0 * b, 2.0 * c),
            kinds.mjGEOM_ELLIPSOID: lambda: Ellipsoid(a, b, c),
        }
        return shapes[kind]() if kind in shapes else None

    def _mesh(self, index: int) -> Mesh:
        compiled = self._compiled
        first, count = int(compiled.mesh_vertadr[index]), int(compiled.mesh_vertnum[index])
        corners = compiled.mesh_vert[first : first + count]
        first, count = int(compiled.mesh_faceadr[index]), int(compiled.mesh_facenum[index])
        faces = compiled.mesh_face[first : first + count]
        lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in corners.tolist()]
        lines += [f"f {i + 1} {j + 1} {k + 1}" for i, j, k in faces.tolist()]
        name = self._name("mesh", index)
        return self._model.mesh(name, "\n".join(lines) + "\n")


def _transform(position: NDArray[np.float64], quaternion: NDArray[np.float64]) -> RigidTransform:
    unit = quaternion / np.linalg.norm(quaternion)
    return RigidTransform(RotationMatrix(Quaternion(unit)), position)


def _turn(axis: NDArray[np.float64], angle: float) -> Quaternion:
    """Quaternion of a turn about an axis (3)."""
    unit = axis / np.linalg.norm(axis)
    w, xyz = np.cos(0.5 * angle), np.sin(0.5 * angle) * unit
    return Quaternion(np.array([w, *xyz]))


def _inertia(compiled: Any, index: int) -> SpatialInertia:
    """Spatial inertia of a body about its origin."""
    mass, centre = float(compiled.body_mass[index]), compiled.body_ipos[index]
    principal = RotationalInertia(*compiled.body_inertia[index].tolist())
    R_BI = _transform(np.zeros(3), compiled.body_iquat[index]).rotation()
    about_centre = principal.ReExpress(R_BI)
    return SpatialInertia.MakeFromCentralInertia(mass, centre, about_centre)
