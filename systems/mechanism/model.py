"""Model files of closed-loop mechanisms, read into a plant with everything that closes them.

URDF, SDFormat, MJCF and Drake's model directives are read. Loops come from Drake's tags
(`drake:ball_constraint`, `drake:distance_constraint`, `mimic`), from MJCF's `connect`, `weld` and
`joint`, from an SDFormat whose joints themselves close loops, as Gazebo's do, and from a small
YAML file beside the model. Its keys are those of github.com/Gepetto/example-parallel-robots.
"""

import fnmatch
import logging
import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    BodyIndex,
    FixedOffsetFrame,
    Frame,
    Joint,
    JointActuator,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
    SpatialInertia,
    UniversalJoint,
    WeldJoint,
)

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import did_you_mean, quoted, quoted_path
from parapod.systems.core.scenario_file import load_scenario
from parapod.systems.core.schema import Schema
from parapod.systems.mechanism.graph import loop_joints, reversed_joints
from parapod.systems.mechanism.hinges import PLAIN_AXES, add_hinges
from parapod.systems.mechanism.meshes import Drawing, adapt_sdf, adapt_urdf
from parapod.systems.mechanism.mjcf import add_mjcf
from parapod.systems.mechanism.parts import Model, frames_by_name, joints_by_name, named
from parapod.systems.physics.loops import Ball, Loop, Weld, add_loop
from parapod.systems.physics.model_files import ROUNDED

_SUFFIXES = (".urdf", ".sdf", ".xml", ".mjcf", ".dmd.yaml")
# Kinds of elements that an SDFormat may have which are not of it, and what is said of one.
_FOREIGN = 20
_NUMBER = re.compile(r"\s*[0-9.]+([eE][-+]?[0-9]+)?\s*")
_NOT_DEFINED = re.compile(r"XML Element\[(\w+)\], child of element\[(\w+)\], not defined")
_KINDS = {"3d": "ball", "6d": "weld"}
_AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
# Distance along its axis of the two ball joints in place of a hinge that closes a loop [m].
_SPREAD = 0.05
# Angle by which a range of a whole turn may be smaller [rad].
_TURN = 0.02
# Limit of a joint or motor from which on there is none: the largest number stands in formats that
# cannot leave one out [N, m, s].
_ENDLESS = 1e300
# Axes of the frames of a universal joint that is turned round: about y, then x, both back.
_REVERSED = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# Inertia of the body between a joint that closes a loop and the link that it is welded to
# [kg, m]: what is too light to be felt, and heavy enough for a simulation.
_LIGHT, _SMALL = 1e-3, 1e-2


@dataclass
class LoopsFile(Schema):
    """Loops and motors of a model, where its own file does not have them.

    Attributes:
        closed_loop: pairs of frames or links that are held together.
        type: kind of each pair: 3d holds their origins together, 6d both as a whole.
        points: for each pair the points, in both frames, that are held together [m], such as
            [[0.3, 0, 0], [0, 0.1, 0]]; empty: their origins.
        name_mot: joints with motors; * and ? stand for any characters.
        joint_name: joints that are of another kind than in the model.
        joint_type: kind of each of these: SPHERICAL, FIXED, or UJOINT_ and two axes, as UJOINT_XY.
    """

    closed_loop: list[list[str]] = field(default_factory=list)
    type: list[str] = field(default_factory=list)
    points: list[list[list[float]]] = field(default_factory=list)
    name_mot: list[str] = field(default_factory=list)
    joint_name: list[str] = field(default_factory=list)
    joint_type: list[str] = field(default_factory=list)


def add_model(
    plant: MultibodyPlant,
    path: Path,
    loops_file: Path | None = None,
    motors: Sequence[str] = (),
    is_free: bool | None = None,
    is_plain: bool = False,
    least_mass: float = 0.0,
) -> Model:
    """Adds a model and its loops to a plant.

    Args:
        plant: not finalized, and empty.
        path: the model's file.
        loops_file: file of a `LoopsFile`; None: beside the model, where there is one, the file of
            its name with .yaml behind it or in place of the suffix. An MJCF needs none.
        motors: joints with motors, in place of those that the files name; * and ? stand for any
            characters.
        is_free: false welds the first link that hangs on nothing to the world, true takes such a
            weld away; None: what an MJCF says, and false for other files.
        is_plain: true if its joints are to be hinges and slides alone, see `Model`.
        least_mass: mass of links that are lighter, but not massless [kg].

    Raises:
        ScenarioError: a file that cannot be read, or names what the model does not have.
    """
    if not path.is_file():
        raise ScenarioError(f"cannot read {quoted_path(path)}: no such file")
    if not path.name.lower().endswith(_SUFFIXES):
        suffixes = ", ".join(_SUFFIXES)
        raise ScenarioError(f"{quoted_path(path)}: the suffix of a model is one of {suffixes}")
    settings, source = _settings(path, loops_file)
    model = Model(path, plant, is_plain=is_plain)
    if _is_mjcf(path):
        add_mjcf(model)
    else:
        _add_by_drake(model)
        _free_endless(plant)
        _change_joints(model, settings, source)
        _cut_loops(model)
    if is_free:
        _free_base(plant)
    elif is_free is not None or not _is_mjcf(path):
        _weld_base(plant)
    _weigh_light(plant, least_mass)
    _turn_round(model)
    if is_plain and not _is_mjcf(path):
        for joint in [plant.get_joint(index) for index in plant.GetJointIndices()]:
            _make_plain(model, joint)
    _close(model, settings, source)
    _name_motors(model, tuple(motors) or tuple(settings.name_mot), source)
    _turn_freely(model)
    return model


def _turn_freely(model: Model) -> None:
    """Takes limits of a whole turn, as CAD exports have them, from hinges without a motor."""
    plant, names = model.plant, []
    for joint in [plant.get_joint(index) for index in plant.GetJointIndices()]:
        if joint.type_name() != "revolute" or joint.index() in model.motors:
            continue
        (low,), (high,) = joint.position_lower_limits(), joint.position_upper_limits()
        if math.isfinite(high - low) and high - low > 2.0 * math.pi - _TURN:
            joint.set_position_limits(np.array((-np.inf,)), np.array((np.inf,)))
            names.append(joint.name())
    if names:
        model.notes.append(f"limits of a whole turn count as none: {', '.join(names)}")


def _is_mjcf(path: Path) -> bool:
    return path.suffix.lower() in (".xml", ".mjcf")


def loops_beside(path: Path) -> Path | None:
    """File of the loops of a model, where there is one beside it."""
    name = path.name.removesuffix(".dmd.yaml").removesuffix(path.suffix)
    # An MJCF has all that it needs, and may be beside a URDF that has not.
    usual = [] if _is_mjcf(path) else [f"{path.name}.yaml", f"{name}.yaml"]
    return next((file for file in map(path.with_name, usual) if file.is_file()), None)


def _settings(path: Path, loops_file: Path | None) -> tuple[LoopsFile, str]:
    """Loops of a model, and the name of their file."""
    file = loops_file if loops_file is not None else loops_beside(path)
    if file is None:
        return LoopsFile(), quoted_path(path)
    settings = load_scenario(LoopsFile, file=file)
    source = quoted_path(file)
    for names, kinds in (("closed_loop", "type"), ("joint_name", "joint_type")):
        count, others = (len(getattr(settings, key)) for key in (names, kinds))
        if count != others:
            raise ScenarioError(f"{source}: {names} has {count} entries and {kinds} {others}")
    return settings, source


def _add_by_drake(model: Model) -> None:
    """Adds a URDF, SDFormat or directives; what Drake warns about becomes notes."""
    parser = Parser(model.plant)
    parser.SetAutoRenaming(True)
    parser.package_map().PopulateFromFolder(str(model.path.resolve().parent))
    text, drawings = _readable(model)
    form = model.path.suffix[1:].lower()
    for _ in range(_FOREIGN):
        try:
            with _warnings(model.notes):
                if text is None:
                    parser.AddModels(model.path)
                else:
                    parser.AddModelsFromString(text, form)
                for number, drawing in enumerate(drawings):
                    drawing.add_to(model, number)
            return
        except (RuntimeError, ValueError) as error:
            reason = " ".join(str(error).split())
            less = _without_foreign(text, reason, model.notes) if text and form == "sdf" else None
            if less is None:
                raise ScenarioError(f"cannot read {quoted_path(model.path)}: {reason}") from None
            text = less


def _without_foreign(text: str, reason: str, notes: list[str]) -> str | None:
    """An SDFormat without elements that are not of it, which Drake has refused; None: other."""
    foreign = _NOT_DEFINED.search(reason)
    if foreign is None:
        return None
    name, owner = foreign.groups()
    root, count = ElementTree.fromstring(text), 0
    for parent in root.iter(owner):
        for element in parent.findall(name):
            parent.remove(element)
            count += 1
    notes.append(f"not read: <{name}> of <{owner}>, which is not of SDFormat")
    return ElementTree.tostring(root, encoding="unicode") if count else None


def _readable(model: Model) -> tuple[str | None, list[Drawing]]:
    """A file as Drake reads it, None: as it is; and STLs that are to be drawn beside it."""
    form = model.path.suffix.lower()
    if form not in (".urdf", ".sdf"):
        return None, []
    try:
        root = ElementTree.parse(model.path).getroot()
    except ElementTree.ParseError:
        return None, []  # Drake says what is wrong, and where
    ElementTree.register_namespace("drake", "http://drake.mit.edu")
    is_drawn, notes = model.plant.geometry_source_is_registered(), list[str]()
    drawings = []
    if form == ".urdf":
        drawings = adapt_urdf(root, model.path.parent, notes)
        model.efforts = _efforts(root)
    else:
        adapt_sdf(root, model.path.parent, notes)
    model.notes += notes if is_drawn else []
    if form == ".sdf":
        _adapt_joints(root, model.notes)
    return ElementTree.tostring(root, encoding="unicode"), drawings if is_drawn else []


def _efforts(root: ElementTree.Element) -> dict[str, float]:
    """Largest forces of a URDF's joints, by their names; an effort of zero is left out."""
    limits = ((joint.get("name", ""), joint.find("limit")) for joint in root.iter("joint"))
    efforts = ((name, limit.get("effort", "")) for name, limit in limits if limit is not None)
    numbers = {name: float(effort) for name, effort in efforts if _NUMBER.fullmatch(effort)}
    return {name: effort for name, effort in numbers.items() if 0.0 < effort < _ENDLESS}


def _free_endless(plant: MultibodyPlant) -> None:
    """Takes limits away that are numbers for none."""
    for joint in (plant.get_joint(index) for index in plant.GetJointIndices()):
        if joint.num_velocities() > 0:
            for what in ("position", "velocity"):
                limits = [
                    np.array(getattr(joint, f"{what}_{side}_limits")())
                    for side in ("lower", "upper")
                ]
                ends = [
                    np.where(np.abs(limit) < _ENDLESS, limit, np.copysign(np.inf, limit))
                    for limit in limits
                ]
                getattr(joint, f"set_{what}_limits")(*ends)
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        if actuator.effort_limit() >= _ENDLESS:
            actuator.set_effort_limit(np.inf)


def _adapt_joints(root: ElementTree.Element, notes: list[str]) -> None:
    """Makes `revolute2` of an SDFormat, which Drake does not have, the universal joint it is."""
    doubles = [joint for joint in root.iter("joint") if joint.get("type") == "revolute2"]
    for joint in doubles:
        joint.set("type", "universal")
    if doubles:
        notes.append(f"{len(doubles)} joints revolute2 are read as universal")


@contextmanager
def _warnings(notes: list[str]) -> Iterator[None]:
    """Collects Drake's warnings, each once, in place of printing them."""

    def keep(record: logging.LogRecord) -> bool:
        text = " ".join(record.getMessage().partition(": warning: ")[2].split())
        text = text or record.getMessage()
        if record.levelno >= logging.WARNING and text not in notes:
            notes.append(text)
        return False

    log = logging.getLogger("drake")
    log.addFilter(keep)
    try:
        yield
    finally:
        log.removeFilter(keep)


def _change_joints(model: Model, settings: LoopsFile, source: str) -> None:
    """Gives joints the kinds that a file beside the model says."""
    for name, kind in zip(settings.joint_name, settings.joint_type, strict=True):
        if kind == "FIXED":
            continue  # as it is: the convention has the joint taken out of its list
        joint = named(name, joints_by_name(model.plant), "joint", source)
        first, second = (_AXES.get(axis) for axis in kind.removeprefix("UJOINT_").ljust(2)[:2])
        is_universal = kind.startswith("UJOINT_") and None not in (first, second)
        if kind != "SPHERICAL" and not (is_universal and first != second):
            raise ScenarioError(
                f"{source}: {quoted(kind)} of {quoted(name)} is not one of SPHERICAL, FIXED, "
                "UJOINT_XY and further two axes"
            )
        parent, child = joint.frame_on_parent(), joint.frame_on_child()
        _remove_joint(model.plant, joint)
        if kind == "SPHERICAL":
            model.plant.AddJoint(BallRpyJoint(name, parent, child))
            continue
        # Drake's universal joint turns about x, then y: its frames have the axes asked for there.
        axes = np.array([first, second, np.cross(np.array(first), np.array(second))]).T
        ends = _turned_frames(model.plant, name, (parent, child), axes)
        model.plant.AddJoint(UniversalJoint(name, *ends))


@dataclass(frozen=True)
class _Motor:
    """Parts of an actuator that are kept while its joint is replaced."""

    effort: float
    rotor_inertia: float
    gear_ratio: float
    gains: PdControllerGains | None

    @classmethod
    def of(cls, actuator: JointActuator) -> Self:
        """The motor of an actuator."""
        gains = actuator.get_controller_gains() if actuator.has_controller() else None
        return cls(
            actuator.effort_limit(),
            actuator.default_rotor_inertia(),
            actuator.default_gear_ratio(),
            PdControllerGains(p=gains.p, d=gains.d) if gains else None,
        )

    def add_to(self, plant: MultibodyPlant, joint: Joint) -> None:
        """Adds it to a joint."""
        added = plant.AddJointActuator(joint.name(), joint, self.effort)
        added.set_default_rotor_inertia(self.rotor_inertia)
        added.set_default_gear_ratio(self.gear_ratio)
        if self.gains is not None:
            added.set_controller_gains(self.gains)


def _remove_joint(plant: MultibodyPlant, joint: Joint) -> _Motor | None:
    """Removes a joint and its actuator; returns the motor, None where it had none."""
    motor = None
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if actuator.joint().index() == joint.index():
            motor = _Motor.of(actuator)
            plant.RemoveJointActuator(actuator)
    try:
        plant.RemoveJoint(joint)
    except RuntimeError as error:
        raise ScenarioError(
            f"the joint {joint.name()} cannot be cut or changed in a model that has constraints "
            f"of its own: {' '.join(str(error).split())}"
        ) from None
    return motor


def _cut_loops(model: Model) -> None:
    """Puts constraints in place of joints that close loops, which Drake's trees cannot hold."""
    plant = model.plant
    for joint in loop_joints(plant):
        turn: Any = joint
        ends: list[Any] = [joint.frame_on_parent(), joint.frame_on_child()]
        name, kind = joint.name(), joint.type_name()
        poses = [frame.GetFixedPoseInBodyFrame() for frame in ends]
        bodies = [frame.body() for frame in ends]
        if kind in ("ball_rpy", "weld"):
            _remove_joint(plant, joint)
            closed = Ball if kind == "ball_rpy" else Weld
            places = [pose.translation() for pose in poses] if closed is Ball else poses
            model.loops.append(closed(bodies[0], places[0], bodies[1], places[1], name=name))
        elif kind == "revolute":
            axis = np.asarray(turn.revolute_axis())
            _remove_joint(plant, joint)
            for side, end in ((-0.5, "near"), (0.5, "far")):
                places = [pose.multiply(side * _SPREAD * axis) for pose in poses]
                ball = Ball(bodies[0], places[0], bodies[1], places[1], name=f"{name} ({end})")
                model.loops.append(ball)
        else:
            _split(model, joint)
        model.notes.append(f"the {kind} joint {name} closes a loop, and is held by constraints")


def _split(model: Model, joint: Any) -> None:
    """Hangs a light body on a joint that closes a loop, and welds it to the joint's link."""
    plant, link, name = model.plant, joint.child_body(), joint.name()
    light = SpatialInertia.SolidSphereWithMass(_LIGHT, _SMALL)
    body = plant.AddRigidBody(f"{name}_half", link.model_instance(), light)
    X_BM = joint.frame_on_child().GetFixedPoseInBodyFrame()
    end: Any = plant.AddFrame(FixedOffsetFrame(f"{name}_half_child", body.body_frame(), X_BM))
    parent, kind = joint.frame_on_parent(), type(joint)
    axes = [
        getattr(joint, read)()
        for read in ("revolute_axis", "translation_axis", "screw_axis", "screw_pitch")
        if hasattr(joint, read)
    ]
    if joint.type_name() == "screw":
        axes.append(0.0)  # damping
    limits = _Limits.of(joint)
    _remove_joint(plant, joint)
    limits.put(plant.AddJoint(kind(name, parent, end, *axes)))
    model.loops.append(Weld(body, RigidTransform(), link, RigidTransform(), name=name))


def _weld_base(plant: MultibodyPlant) -> None:
    """Welds the first link that hangs on nothing, unless a link hangs on the world already."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    world = plant.world_body().index()
    if any(joint.parent_body().index() == world for joint in joints):
        return
    children = {int(joint.child_body().index()) for joint in joints}
    for i in range(1, plant.num_bodies()):
        if i not in children:
            body = plant.get_body(BodyIndex(i))
            pose = plant.GetDefaultFloatingBaseBodyPose(body)
            plant.WeldFrames(plant.world_frame(), body.body_frame(), pose)
            return


def _free_base(plant: MultibodyPlant) -> None:
    """Takes the weld away with which a link hangs on the world, which stays where it is."""
    for joint in [plant.get_joint(index) for index in plant.GetJointIndices()]:
        if joint.type_name() == "weld" and int(joint.parent_body().index()) == 0:
            weld: Any = joint
            X_WF, X_BM = (
                frame.GetFixedPoseInBodyFrame()
                for frame in (weld.frame_on_parent(), weld.frame_on_child())
            )
            pose = X_WF.multiply(weld.X_FM()).multiply(X_BM.inverse())
            body = joint.child_body()
            _remove_joint(plant, joint)
            plant.SetDefaultFloatingBaseBodyPose(body, pose)


def _weigh_light(plant: MultibodyPlant, least: float) -> None:
    """Welds bodies to links that are lighter than a mass [kg], which make them as heavy."""
    for i in range(1, plant.num_bodies()):
        link = plant.get_body(BodyIndex(i))
        mass = link.default_mass()
        if 0.0 < mass < least:
            own = link.default_spatial_inertia()
            rest = SpatialInertia(least - mass, own.get_com(), own.get_unit_inertia())
            body = plant.AddRigidBody(f"{link.name()}_ballast", link.model_instance(), rest)
            plant.WeldFrames(link.body_frame(), body.body_frame())


def _turn_round(model: Model) -> None:
    """Turns joints round whose parents are farther from the world.

    Drake has hinges, slides and welds that are, but formats have none.
    """
    plant = model.plant
    for joint in reversed_joints(plant):
        name, kind, turn = joint.name(), joint.type_name(), joint
        parent, child = joint.frame_on_child(), joint.frame_on_parent()
        if kind in ("universal", "ball_rpy"):
            _remove_joint(plant, joint)
            if kind == "ball_rpy":
                plant.AddJoint(BallRpyJoint(name, parent, child))
            else:
                ends = _turned_frames(plant, name, (parent, child), _REVERSED)
                plant.AddJoint(UniversalJoint(name, *ends))
            model.notes.append(f"the {kind} joint {name} is turned round: its angles are others")
        elif model.is_plain and kind in ("revolute", "prismatic", "weld"):
            _replace_by_reversed(plant, turn, parent, child)


def _replace_by_reversed(plant: MultibodyPlant, joint: Any, parent: Frame, child: Frame) -> None:
    """Puts a hinge, slide or weld between its links the other way round, positions as they are."""
    name, kind = joint.name(), joint.type_name()
    if kind == "weld":
        X_FM = RigidTransform(joint.X_FM())
        _remove_joint(plant, joint)
        plant.AddJoint(WeldJoint(name, parent, child, X_FM.inverse()))
        return
    is_hinge = kind == "revolute"
    axis = -np.array(joint.revolute_axis() if is_hinge else joint.translation_axis())
    limits, damping = _Limits.of(joint), float(joint.default_damping_vector()[0])
    motor = _remove_joint(plant, joint)
    turned_kind = RevoluteJoint if is_hinge else PrismaticJoint
    added: Any = plant.AddJoint(turned_kind(name, parent, child, axis))
    added.set_default_damping(damping)
    limits.put(added)
    if motor is not None:
        motor.add_to(plant, added)


def _make_plain(model: Model, joint: Any) -> None:
    """Puts hinges at origins of links in place of a joint that not every format has."""
    plant, kind, name = model.plant, joint.type_name(), joint.name()
    parent, child = joint.frame_on_parent(), joint.frame_on_child()
    is_beside = np.abs(child.GetFixedPoseInBodyFrame().translation()).max() > ROUNDED
    if kind not in PLAIN_AXES and not (kind == "revolute" and is_beside):
        return
    axes = PLAIN_AXES.get(kind) or {"": tuple(joint.revolute_axis())}
    limits = _Limits.of(joint)
    damping = joint.default_damping_vector().tolist()  # a copy: the joint goes
    motor = _remove_joint(plant, joint)
    for k, hinge in enumerate(add_hinges(plant, name, parent, child, axes)):
        hinge.set_default_damping(damping[min(k, len(damping) - 1)])
        if len(axes) == 1:
            limits.put(hinge)
            if motor is not None:
                motor.add_to(plant, hinge)


@dataclass(frozen=True)
class _Limits:
    """Copies of a joint's limits, which stay when the joint goes."""

    positions: tuple[NDArray[np.float64], NDArray[np.float64]]
    velocities: tuple[NDArray[np.float64], NDArray[np.float64]]

    @classmethod
    def of(cls, joint: Joint) -> Self:
        """Those of a joint."""
        return cls(
            (np.array(joint.position_lower_limits()), np.array(joint.position_upper_limits())),
            (np.array(joint.velocity_lower_limits()), np.array(joint.velocity_upper_limits())),
        )

    def put(self, joint: Joint) -> None:
        """Gives them to a joint."""
        joint.set_position_limits(*self.positions)
        joint.set_velocity_limits(*self.velocities)


def _turned_frames(
    plant: MultibodyPlant, name: str, ends: tuple[Frame, Frame], axes: NDArray[np.float64]
) -> list[Any]:
    """Frames at the ends of a joint, turned within those (axes are the columns)."""
    turn = RigidTransform(RotationMatrix(axes), np.zeros(3))
    return [
        plant.AddFrame(FixedOffsetFrame(f"{name}_turned_{i}", frame, turn))
        for i, frame in enumerate(ends)
    ]


def _close(model: Model, settings: LoopsFile, source: str) -> None:
    """Adds the loops of the file beside the model, and those that the model has as joints."""
    plant, every_frame = model.plant, frames_by_name(model.plant)
    points = _points(settings, source)
    pairs = zip(_pairs(settings, source), settings.type, points, strict=True)
    for (one, other), kind, places in pairs:
        frames = [named(name, every_frame, "frame", source) for name in (one, other)]
        if kind.lower() not in _KINDS:
            raise ScenarioError(f"{source}: type {quoted(kind)} is not one of 3d, 6d")
        poses = [
            frame.GetFixedPoseInBodyFrame().multiply(RigidTransform(np.array(place)))
            for frame, place in zip(frames, places, strict=True)
        ]
        bodies = [frame.body() for frame in frames]
        name = f"{one} - {other}"
        if _KINDS[kind.lower()] == "ball":
            points = [pose.translation() for pose in poses]
            loop: Loop = Ball(bodies[0], points[0], bodies[1], points[1], name=name)
        else:
            loop = Weld(bodies[0], poses[0], bodies[1], poses[1], name=name)
        model.loops.append(loop)
    for loop in model.loops:
        add_loop(plant, loop)


def _pairs(settings: LoopsFile, source: str) -> list[list[str]]:
    for pair in settings.closed_loop:
        if len(pair) != 2:
            raise ScenarioError(f"{source}: closed_loop has {len(pair)} frames in place of two")
    return settings.closed_loop


def _points(settings: LoopsFile, source: str) -> list[list[list[float]]]:
    """Points of each pair, in their frames [m]."""
    count = len(settings.closed_loop)
    if not settings.points:
        return [[[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]] * count
    if len(settings.points) != count:
        raise ScenarioError(
            f"{source}: closed_loop has {count} entries and points {len(settings.points)}"
        )
    for pair in settings.points:
        if [len(point) for point in pair] != [3, 3]:
            raise ScenarioError(f"{source}: {pair} of points is not two points of three numbers")
    return settings.points


def _name_motors(model: Model, patterns: Sequence[str], source: str) -> None:
    """Names the joints with motors: by patterns, or those that the model has actuators for."""
    plant = model.plant
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    movable = [joint for joint in joints if joint.num_velocities() > 0]
    if not patterns:
        actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
        model.motors = model.motors or [actuator.joint().index() for actuator in actuators]
        return
    model.motors = []
    names = [joint.name() for joint in movable]
    for pattern in patterns:
        matches = [joint for joint in movable if fnmatch.fnmatchcase(joint.name(), pattern)]
        if not matches:
            raise ScenarioError(
                f"{source}: the model has no joint {quoted(pattern)}{did_you_mean(pattern, names)}"
            )
        for joint in matches:
            if joint.num_velocities() != 1:
                raise ScenarioError(
                    f"{source}: the {joint.type_name()} joint {joint.name()} cannot have a motor: "
                    "it has more than one freedom"
                )
            if joint.index() not in model.motors:
                model.motors.append(joint.index())
    _fit_actuators(model)


def _fit_actuators(model: Model) -> None:
    """Gives each motor an actuator, and takes those of other joints away."""
    plant = model.plant
    for index in plant.GetJointActuatorIndices():
        actuator = plant.get_joint_actuator(index)
        if actuator.joint().index() not in model.motors:
            plant.RemoveJointActuator(actuator)
    actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    driven = {actuator.joint().index() for actuator in actuators}
    for motor in model.motors:
        if motor not in driven:
            joint = plant.get_joint(motor)
            effort = model.efforts.get(joint.name(), np.inf)
            plant.AddJointActuator(joint.name(), joint, effort)
