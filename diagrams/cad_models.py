"""Models of a user's own: files of a CAD program, their frames and joints checked by name."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, Joint, ModelInstanceIndex

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import quoted, quoted_path
from parapod.urdf import MODELS_DIR, configure_parser

# Meshes whose convex hull Drake takes as a collision shape.
_MESHES = (".obj", ".vtk", ".gltf")
# Link that stands for the world in a URDF.
_WORLD = "world"


@dataclass(frozen=True)
class OwnModel:
    """A file with a part of a machine.

    Attributes:
        key: key of the file in the scenario; those of its frames and joints are beside it.
        urdf: URDF or SDFormat file, or a `package://` URL; empty: the drawn part.
        frame: link or frame by which it is fixed.
        joints: joints of an arm that are driven, from its frame to its tip; empty: all that move
            between these; every other one is fixed.
        tip: link or frame that is the tip of an arm.
    """

    key: str
    urdf: str = ""
    frame: str = ""
    joints: tuple[str, ...] = ()
    tip: str = ""

    def add(self, plant: MultibodyPlant, name: str) -> Frame:
        """Adds a part without joints to a plant that is not finalized; returns its frame.

        Args:
            plant: the plant.
            name: name of the model instance.

        Raises:
            ScenarioError: the file cannot be read, has no mass, a joint that moves, or no link of
                the frame's name; names those that it has.
        """
        instance, group = self._parse(plant, name), self.key.rpartition(".")[0]
        frame = find_frame(plant, instance, self.frame, f"{group}.frame", self.urdf)
        find_joints(plant, instance, (), f"{group}.joints", self.urdf)
        return frame

    def add_arm(self, plant: MultibodyPlant, name: str) -> tuple[Frame, tuple[Joint, ...], Frame]:
        """Adds an arm to a plant that is not finalized; returns its mount, joints and tip.

        Args:
            plant: the plant.
            name: name of the model instance.

        Raises:
            ScenarioError: as `add`; or joints that are not those that move the tip.
        """
        instance, group = self._parse(plant, name, False), self.key.rpartition(".")[0]
        mount = find_frame(plant, instance, self.frame, f"{group}.mount", self.urdf)
        tip = find_frame(plant, instance, self.tip, f"{group}.tip", self.urdf)
        way = _joints_between(plant, mount, tip, f"{group}.tip", self.urdf)
        names, key = tuple(joint.name() for joint in way), f"{group}.joints"
        joints = find_joints(plant, instance, self.joints or names, key, self.urdf)
        if joints != way:
            order = ", ".join(names) or "none"
            raise ScenarioError(
                f"{key}: from {quoted(self.frame)} to {quoted(self.tip)} of {quoted(self.urdf)} "
                f"the joints that move are: {order}",
                key,
            )
        return mount, joints, tip

    def _parse(
        self, plant: MultibodyPlant, name: str, collides: bool = True
    ) -> ModelInstanceIndex:
        instance = parse_model(plant, self.urdf, self.key, collides)
        plant.RenameModelInstance(instance, name)
        bodies = map(plant.get_body, plant.GetBodyIndices(instance))
        mass = sum(body.default_mass() for body in bodies)
        if not mass > 0.0:
            raise ScenarioError(f"{self.key} = {quoted(self.urdf)} has no mass", self.key)
        return instance


def parse_model(
    plant: MultibodyPlant, urdf: str, key: str, collides: bool = True
) -> ModelInstanceIndex:
    """Adds the one model of a file to a plant.

    Args:
        plant: not finalized.
        urdf: URDF or SDFormat file, or a `package://` URL.
        key: key of the file in the scenario.
        collides: true if it keeps those of its collision shapes that Drake can read.

    Raises:
        ScenarioError: the file, or one that it refers to, is missing or cannot be read.
    """
    parser = Parser(plant)
    configure_parser(parser)
    parser.SetAutoRenaming(True)
    add = _reader(parser, urdf, key, collides)
    warnings: list[str] = []
    listening = _Listening(warnings)
    try:
        with listening:
            models = add()
    except RuntimeError as error:
        words = " ".join(str(error).split())
        raise ScenarioError(f"{key} = {quoted(urdf)} cannot be read: {words}", key) from None
    # Drake warns, and goes on with a body of 1 kg.
    if wrong := next((line for line in warnings if "inertia" in line), ""):
        place = wrong.partition(" warning:")[0].rstrip(":")
        raise ScenarioError(
            f"{key} = {quoted(urdf)} has an inertia of no body, at {quoted_path(place)}: mass "
            "must be above 0, and no principal moment larger than the sum of the others",
            key,
        )
    if len(models) != 1:
        raise ScenarioError(f"{key} = {quoted(urdf)} must have one model, not {len(models)}", key)
    return models[0]


class _Listening(logging.Handler):
    """Takes Drake's warnings while it reads a file, instead of the terminal."""

    def __init__(self, lines: list[str]):
        super().__init__(logging.WARNING)
        self._lines, self._log = lines, logging.getLogger("drake")

    def emit(self, record: logging.LogRecord) -> None:
        self._lines.append(record.getMessage())

    def __enter__(self) -> None:
        self._log.addHandler(self)

    def __exit__(self, *error: object) -> None:
        self._log.removeHandler(self)


def _reader(
    parser: Parser, urdf: str, key: str, collides: bool
) -> Callable[[], Sequence[ModelInstanceIndex]]:
    if urdf.startswith("package://"):
        return lambda: parser.AddModels(url=urdf)
    path = Path(urdf)
    if not path.is_file():
        raise ScenarioError(f"{key} = {quoted(urdf)}: there is no such file", key)
    _add_packages(parser.package_map(), path)
    text = _as_part(path, collides)
    if text is None:
        return lambda: parser.AddModels(path)
    return lambda: parser.AddModelsFromString(text, "urdf")


def _as_part(path: Path, collides: bool) -> str | None:
    """A URDF without what keeps it from being a part of a machine; None: it is one as it is.

    That is a link "world" to which it is fixed, and meshes of collision shapes that Drake cannot
    read: most public robots have STL files there, and only feet and wheels touch anything.

    Args:
        path: the file.
        collides: false for a part that loses all collision shapes, as an arm does.
    """
    if path.suffix.lower() != ".urdf":
        return None
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError:
        return None  # Drake says what is wrong, and where
    # Elements that go, and their parents.
    surplus = [(root, link) for link in root.findall("link") if link.get("name") == _WORLD]
    for joint in root.findall("joint"):
        parent = joint.find("parent")
        if parent is not None and parent.get("link") == _WORLD and joint.get("type") == "fixed":
            surplus.append((root, joint))
    for link in root.findall("link"):
        for shape in link.findall("collision"):
            mesh = shape.find("geometry/mesh")
            name = "" if mesh is None else mesh.get("filename", "")
            is_foreign = bool(name) and Path(name).suffix.lower() not in _MESHES
            if is_foreign or not collides:
                surplus.append((link, shape))
    if not surplus:
        return None
    for owner, element in surplus:
        owner.remove(element)
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if "://" not in name:
            mesh.set("filename", (path.parent / name).resolve().as_uri())
    return ElementTree.tostring(root, encoding="unicode")


def _add_packages(packages: PackageMap, path: Path) -> None:
    """Adds the ROS packages that a file may refer to: its own, and those of the environment."""
    files = (folder / "package.xml" for folder in path.resolve().parents)
    if (own := next(filter(Path.is_file, files), None)) and own.parent != MODELS_DIR.resolve():
        packages.AddPackageXml(str(own))
    packages.PopulateFromRosPackagePath()


def find_frame(
    plant: MultibodyPlant, instance: ModelInstanceIndex, name: str, key: str, urdf: str
) -> Frame:
    """A link or frame of a model.

    Args:
        plant: the plant.
        instance: the model.
        name: name of the link or frame.
        key: key of the name in the scenario.
        urdf: file of the model.

    Raises:
        ScenarioError: there is none; names those that there are.
    """
    if not plant.HasFrameNamed(name, instance):
        frames = map(plant.get_frame, plant.GetFrameIndices(instance))
        names = ", ".join(sorted(frame.name() for frame in frames))
        raise ScenarioError(
            f"{key} = {quoted(name)} is not a link of {quoted(urdf)}; there are: {names}", key
        )
    return plant.GetFrameByName(name, instance)


def _joints_between(
    plant: MultibodyPlant, mount: Frame, tip: Frame, key: str, urdf: str
) -> tuple[Joint, ...]:
    """Joints that move a tip against a mount, from the mount on.

    Raises:
        ScenarioError: the tip hangs on another link than the mount.
    """
    above = {
        joint.child_body().index(): joint
        for joint in map(plant.get_joint, plant.GetJointIndices(tip.model_instance()))
    }
    body, joints = tip.body(), []
    while body.index() != mount.body().index():
        joint = above.get(body.index())
        if joint is None:
            raise ScenarioError(
                f"{key} = {quoted(tip.name())} of {quoted(urdf)} does not hang on "
                f"{quoted(mount.name())}",
                key,
            )
        joints.append(joint)
        body = joint.parent_body()
    return tuple(joint for joint in reversed(joints) if joint.num_velocities() > 0)


def find_joints(
    plant: MultibodyPlant,
    instance: ModelInstanceIndex,
    names: Sequence[str],
    key: str,
    urdf: str,
) -> tuple[Joint, ...]:
    """All joints of a model that move, in an order.

    Args:
        plant: the plant.
        instance: the model.
        names: their names.
        key: key of the names in the scenario.
        urdf: file of the model.

    Raises:
        ScenarioError: other joints move than these; names those that do.
    """
    there = {
        joint.name(): joint
        for joint in map(plant.get_joint, plant.GetJointIndices(instance))
        if joint.num_velocities() > 0
    }
    for name in names:
        if name not in there:
            others = ", ".join(there) or "none"
            raise ScenarioError(
                f"{key}: {quoted(name)} is not a moving joint of {quoted(urdf)}; "
                f"there are: {others}",
                key,
            )
        if there[name].num_velocities() != 1:
            raise ScenarioError(
                f"{key}: {quoted(name)} must turn about or slide along one axis", key
            )
    for name in there:
        if name not in names:
            raise ScenarioError(
                f"{key}: {quoted(name)} moves, so it must be among them, or be fixed in "
                f"{quoted(urdf)}",
                key,
            )
    if len(set(names)) != len(names):
        raise ScenarioError(f"{key} names a joint twice", key)
    return tuple(there[name] for name in names)
