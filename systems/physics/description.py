"""A plant as files describe machines: one tree of links, with names that no other thing has."""

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Rgba, Role, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    FrameIndex,
    Joint,
    JointActuator,
    JointIndex,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
    WeldJoint,
    default_model_instance,
)
from pydrake.systems.framework import Context

from parapod.systems.core.errors import WiringError
from parapod.systems.physics.loops import Coupling, Distance, Loop, find_constraints, held_body

KINDS: dict[type, str] = {
    RevoluteJoint: "revolute",
    PrismaticJoint: "prismatic",
    WeldJoint: "fixed",
    QuaternionFloatingJoint: "floating",
}
# Share by which the moments of inertia of a flat body or a rod are larger than they must be [-].
_FLAT = 1e-12
_CONTACT = ("point_contact_stiffness", "hunt_crossley_dissipation", "relaxation_time")


@dataclass(frozen=True)
class Shape:
    """A shape of a link.

    Attributes:
        name: its name, unique among those of its role on the link.
        pose: pose in the frame of the link.
        shape: Drake's shape.
        colour: colour of a shape to be seen; None: none is known.
        contact: properties of a shape that collides, by their names in Drake's tags.
    """

    name: str
    pose: RigidTransform
    shape: Any
    colour: Rgba | None = None
    contact: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Closure:
    """Two frames that a constraint holds together.

    Attributes:
        kind: "ball" for their origins, "weld" for both as a whole, "rod" for a distance of their
            origins.
        names: names of the frames.
        links: names of their links.
        poses: their poses in the frames of the links.
        length: distance of a rod [m].
    """

    kind: str
    names: tuple[str, str]
    links: tuple[str, str]
    poses: tuple[RigidTransform, RigidTransform]
    length: float = 0.0

    def __str__(self) -> str:
        ends = []
        for name, link, pose in zip(self.names, self.links, self.poses, strict=True):
            x, y, z = pose.translation().round(9) + 0.0
            ends.append(f"{name} at ({x:.6g}, {y:.6g}, {z:.6g}) m on {link}")
        return " and ".join(ends)


@dataclass(frozen=True)
class Servo:
    """Actuator of a joint as MuJoCo has it, with a force of its own before its gear.

    The force is `gain` times the control, and `bias` times one, length and speed; these are the
    joint's position and velocity times the gear, as the joint's force is the force times that.

    Attributes:
        name: its name.
        joint: its joint.
        gain: force by the control.
        bias: forces at zero, by the length, and by the speed.
        gear: length by the joint's position.
        forces: smallest and largest force [N, N m]; None: there are no limits.
        controls: smallest and largest control; None: there are no limits.
    """

    name: str
    joint: JointIndex
    gain: float
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gear: float = 1.0
    forces: tuple[float, float] | None = None
    controls: tuple[float, float] | None = None

    @classmethod
    def of(cls, actuator: JointActuator, name: str) -> Self:
        """The actuator of a plant, whose control is a force unless it has gains."""
        servo = actuator.get_controller_gains() if actuator.has_controller() else None
        p, d = (servo.p, servo.d) if servo else (0.0, 0.0)
        effort = actuator.effort_limit()
        forces = (-effort, effort) if 0.0 < effort < np.inf else None
        bias = (0.0, -p, -d) if p or d else (0.0, 0.0, 0.0)
        return cls(name, actuator.joint().index(), p or d or 1.0, bias, forces=forces)

    @property
    def controlled(self) -> str:
        """Kind of its control: a position, a speed, a force, or another number."""
        at_zero, by_length, by_speed = self.bias
        if not any(self.bias):
            return "force"
        if at_zero == 0.0 and by_length == -self.gain:
            return "position"
        return "speed" if (at_zero, by_length, by_speed) == (0.0, 0.0, -self.gain) else "number"

    @property
    def stiffness(self) -> float:
        """Stiffness with which it holds its joint [N/m, N m/rad]."""
        return -self.bias[1] * self.gear**2

    @property
    def damping(self) -> float:
        """Damping of its joint by it [N s/m, N m s/rad]."""
        return -self.bias[2] * self.gear**2

    def holding(self, position: float) -> float:
        """Control with which it exerts nothing while its joint rests at a position."""
        at_zero, by_length, _ = self.bias
        force = at_zero + by_length * self.gear * position
        control = -force / self.gain + 0.0 if self.gain else 0.0
        return float(np.clip(control, *self.controls)) if self.controls else control


@dataclass
class Drives:
    """Parts of joints and motors that an MJCF has, and a plant does not hold.

    Attributes:
        servos: actuators of single joints, in their order.
        forces: smallest and largest force of all motors of a joint [N, N m].
        armatures: inertia that joints have of their own [kg, kg m^2].
        springs: stiffness and position at rest of joints [N/m, N m/rad; m, rad].
    """

    servos: list[Servo] = field(default_factory=list)
    forces: dict[JointIndex, tuple[float, float]] = field(default_factory=dict)
    armatures: dict[JointIndex, float] = field(default_factory=dict)
    springs: dict[JointIndex, tuple[float, float]] = field(default_factory=dict)


class Description:
    """A plant with names for all that a file holds.

    Attributes:
        plant: the plant.
        context: context in which the machine stands.
        scene_graph: holds the geometry of the plant.
        name: name of the model in the file.
        bodies: its bodies, of which the first is the world.
        joints: its joints.
        links: name of each body's link.
        joint_names: name of each joint.
        frames: further frames: name, link and pose in the frame of that.
        closures: constraints that close loops.
        constraints: all constraints, as `find_constraints` returns them.
        actuators: actuator of each joint that has one, by the joint's name.
        couplings: coupling of each joint that follows another one, by the joint's name.
        drives: drives of all actuators, with what the plant does not hold of them.
        other_names: names of joints that a link has too, by those that they have in its place.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        context: Context,
        scene_graph: SceneGraph,
        name: str,
        loops: Sequence[Loop] = (),
        shares_names: bool = True,
        drives: Drives | None = None,
    ):
        """Names what a plant has.

        Args:
            plant: finalized, registered with `scene_graph`.
            context: context in which the machine stands; its parameters are used_names.
            scene_graph: holds the geometry of the plant.
            name: name of the model in the file.
            loops: those that were added by `add_loop`; they need not be searched for.
            shares_names: false if a joint may have the name of a link, as in all but SDFormat.
            drives: parts of its drives that an MJCF has, and the plant does not hold.

        Raises:
            WiringError: joints of a kind, or a body on two joints, that files do not know.
        """
        self.plant, self.context, self.scene_graph, self.name = plant, context, scene_graph, name
        self.bodies, self.joints = bodies_of(plant), joints_of(plant)
        for joint in self.joints:
            if type(joint) not in KINDS:
                raise WiringError(f"{joint.name()} is a joint of a kind that files do not know")
        if len({int(joint.child_body().index()) for joint in self.joints}) < len(self.joints):
            raise WiringError("a body hangs on two joints, which files do not know")
        used_names = {"world"}
        self.links = ["world", *unique_names(self.bodies[1:], "link", used_names)]
        names_of_joints = used_names if shares_names else set()
        self.joint_names = unique_names(self.joints, "joint", names_of_joints)
        self.other_names = {
            name: joint.name()
            for name, joint in zip(self.joint_names, self.joints, strict=True)
            if joint.num_velocities() == 1 and name != joint.name() and joint.name() in self.links
        }
        sides = ("parent", "child")
        automatic = {f"{joint.name()}_{side}" for joint in self.joints for side in sides}
        frames = [
            frame
            for frame in map(plant.get_frame, map(FrameIndex, range(plant.num_frames())))
            if not (frame.is_body_frame() or frame.is_ephemeral() or frame.name() in automatic)
            and not frame.name().startswith("__")  # reserved in SDFormat
        ]
        names = unique_names(frames, "frame", used_names)
        self.frames = [
            (name, self.link(frame.body()), frame.CalcPoseInBodyFrame(context))
            for name, frame in zip(names, frames, strict=True)
        ]
        self.constraints = find_constraints(plant, loops)
        ends: list[tuple[str, RigidBody, Any, RigidBody, Any]] = [
            ("ball", ball.body, ball.point, ball.other, ball.other_point)
            for ball in self.constraints.balls
        ]
        ends += [
            ("weld", weld.body, weld.frame, weld.other, weld.other_frame)
            for weld in self.constraints.welds
        ]
        rods = self.constraints.of(Distance)
        ends += [("rod", rod.body, rod.point, rod.other, rod.other_point) for rod in rods]
        lengths = [0.0] * (len(ends) - len(rods)) + [rod.distance for rod in rods]
        self.closures = [
            Closure(
                kind,
                (f"loop_{i}_a", f"loop_{i}_b"),
                (self.link(held_body(plant, one)), self.link(held_body(plant, other))),
                (RigidTransform(of_one), RigidTransform(of_other)),
                length,
            )
            for i, ((kind, one, of_one, other, of_other), length) in enumerate(
                zip(ends, lengths, strict=True), start=1
            )
        ]
        indices = plant.GetJointActuatorIndices()
        self.actuators: dict[str, JointActuator] = {
            self.joint_name(actuator.joint()): actuator
            for actuator in map(plant.get_joint_actuator, indices)
        }
        self.drives = self._drives(drives or Drives())
        self.couplings: dict[str, Coupling] = {
            self.joint_name(coupling.joint): coupling for coupling in self.constraints.couplings
        }

    def _drives(self, beside: Drives) -> Drives:
        """Drives of all actuators, and of none that the plant has not."""
        driven = {actuator.joint().index() for actuator in self.actuators.values()}
        servos = [servo for servo in beside.servos if servo.joint in driven]
        names = {servo.name for servo in servos}
        for name, actuator in self.actuators.items():
            if actuator.joint().index() not in {servo.joint for servo in servos}:
                names.add(own := f"{name}_motor" if name in names else name)
                servos.append(Servo.of(actuator, own))
        inertias = {
            actuator.joint().index(): actuator.calc_reflected_inertia(self.context)
            for actuator in self.actuators.values()
        }
        armatures = {joint: inertia for joint, inertia in inertias.items() if inertia}
        forces = {joint: limits for joint, limits in beside.forces.items() if joint in driven}
        return Drives(servos, forces, armatures | beside.armatures, beside.springs)

    def link(self, body: RigidBody) -> str:
        """Name of a body's link."""
        return self.links[int(body.index())]

    def joint_name(self, joint: Joint) -> str:
        """Name of a joint."""
        return next(
            name
            for name, one in zip(self.joint_names, self.joints, strict=True)
            if one.index() == joint.index()
        )

    def inertia(self, body: RigidBody) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        """Mass [kg], centre of mass (3) [m] and inertia about it (3, 3) [kg m^2]."""
        if body.get_mass(self.context) == 0.0:
            return 0.0, np.zeros(3), np.zeros((3, 3))
        mass, centre, inertia = inertia_of(body, self.context)
        least, middle, most = np.linalg.eigvalsh(inertia)
        if least + middle < (1.0 + _FLAT) * most:  # which rounding lets other programs refuse
            inertia += _FLAT * most * np.eye(3)
        return mass, centre, inertia

    def home(self, joint: Joint) -> RigidTransform:
        """Pose of a joint's child in the frame of its parent, with the joint at zero."""
        return pose_at_zero(joint, self.context)

    def axis(self, joint: Any) -> NDArray[np.float64]:
        """Axis (3) of a joint in the frame of its child."""
        R_BM = joint.frame_on_child().CalcPoseInBodyFrame(self.context).rotation().matrix()
        turns = isinstance(joint, RevoluteJoint)
        axis = joint.revolute_axis() if turns else joint.translation_axis()
        return np.asarray(R_BM @ axis)

    def belt(self, body: RigidBody) -> NDArray[np.float64] | None:
        """Axis (3), in a body's frame, about which its surface turns as a belt; None: it rests."""
        return self.plant.GetSurfaceVelocityAxis(body)

    def homes(self) -> list[RigidTransform]:
        """Poses of the bodies with all joints at zero, and what floats where it stands."""
        q, context = self.plant.GetPositions(self.context), self.plant.CreateDefaultContext()
        context.SetTimeStateAndParametersFrom(self.context)
        for joint in self.joints:
            if joint.num_positions() == 1:
                q[joint.position_start()] = 0.0
        self.plant.SetPositions(context, q)
        return [self.plant.EvalBodyPoseInWorld(context, body) for body in self.bodies]

    def standing(self) -> dict[str, float]:
        """Positions in which the machine stands, by the names of its joints [m, rad]."""
        return {
            name: float(joint.GetOnePosition(self.context))
            for name, joint in zip(self.joint_names, self.joints, strict=True)
            if joint.num_positions() == 1
        }

    def shapes(self, body: RigidBody, role: Role) -> Iterator[Shape]:
        """Shapes of a body that are seen (`Role.kIllustration`) or collide (`kProximity`)."""
        inspector, used_names = self.scene_graph.model_inspector(), Counter[str]()
        frame = self.plant.GetBodyFrameIdOrThrow(body.index())
        for geometry in sorted(inspector.GetGeometries(frame, role), key=lambda g: g.get_value()):
            name = inspector.GetName(geometry).rpartition("::")[2].replace(" ", "_")
            used_names[name] += 1
            name = f"{name}_{used_names[name]}" if used_names[name] > 1 else name
            colour, contact = None, {}
            properties: Any = inspector.GetIllustrationProperties(geometry)
            if role == Role.kProximity:
                properties = inspector.GetProximityProperties(geometry)
                contact = _contact(properties)
            elif properties.HasProperty("phong", "diffuse"):
                colour = properties.GetProperty("phong", "diffuse")
            pose = inspector.GetPoseInFrame(geometry)
            yield Shape(name, pose, inspector.GetShape(geometry), colour, contact)


def unique_names(parts: Sequence[Any], kind: str, used_names: set[str]) -> list[str]:
    """Names of parts; with their instances where another one has the same, and numbers.

    Args:
        parts: bodies, joints or frames of one plant.
        kind: word that is added to a name that other things have.
        used_names: names of other things; these are added.
    """
    counts, names = Counter(part.name() for part in parts), []
    for part in parts:
        name, instance = part.name(), part.GetParentPlant().GetModelInstanceName
        is_only = counts[name] == 1 and part.model_instance() == default_model_instance()
        if (counts[name] > 1 or name in used_names) and not is_only:
            name = f"{instance(part.model_instance())}_{name}"
        numbered = (f"{name}_{i}" for i in range(2, len(parts) + 3))
        tries = itertools.chain((name, f"{name}_{kind}"), numbered)
        names.append(next(each for each in tries if each not in used_names))
        used_names.add(names[-1])
    return names


def _contact(properties: Any) -> dict[str, str]:
    """Properties of a contact, by their names in Drake's tags."""

    def read(name: str) -> Any:
        has = properties.HasProperty("material", name)
        return properties.GetProperty("material", name) if has else None

    contact = {name: read(name) for name in _CONTACT}
    if friction := read("coulomb_friction"):
        contact["mu_dynamic"] = friction.dynamic_friction()
        contact["mu_static"] = friction.static_friction()
    return {name: repr(float(value)) for name, value in contact.items() if value is not None}


def bodies_of(plant: MultibodyPlant) -> list[RigidBody]:
    """The bodies of a plant in the order of their indices."""
    return [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]


def joints_of(plant: MultibodyPlant) -> list[Joint]:
    """The joints of a plant, floating ones included."""
    return [plant.get_joint(i) for i in plant.GetJointIndices()]


def inertia_of(
    body: RigidBody, plant_context: Context
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Mass [kg], centre of mass (3) [m] and inertia about it (3, 3) [kg m^2] of a body."""
    return parts_of(body.CalcSpatialInertiaInBodyFrame(plant_context))


def parts_of(inertia: SpatialInertia) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Mass [kg], centre of mass (3) [m] and inertia about it (3, 3) [kg m^2]."""
    mass, centre = inertia.get_mass(), np.asarray(inertia.get_com())
    about_origin = inertia.CalcRotationalInertia().CopyToFullMatrix3()
    shift = centre @ centre * np.eye(3) - np.outer(centre, centre)
    return mass, centre, about_origin - mass * shift


def pose_at_zero(joint: Joint, plant_context: Context) -> RigidTransform:
    """X_PB: pose of a joint's child in its parent, with the joint at zero."""
    X_PF = joint.frame_on_parent().CalcPoseInBodyFrame(plant_context)
    X_BM = joint.frame_on_child().CalcPoseInBodyFrame(plant_context)
    X_FM = joint.X_FM() if isinstance(joint, WeldJoint) else RigidTransform()
    return X_PF.multiply(X_FM).multiply(X_BM.inverse())
