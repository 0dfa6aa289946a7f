"""URDF and SDFormat of a described plant, with Drake's tags for what the formats do not know.

Numbers are written with all their digits. Loops are `drake:ball_constraint`; a frame on either
side lets other programs close them.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    Mesh,
    Role,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import Joint, RevoluteJoint, RigidBody

from parapod.systems.core.errors import WiringError
from parapod.systems.physics.description import KINDS, Description, Shape

# Number that other programs read where there is no limit, which they cannot leave out.
ENDLESS = sys.float_info.max
# Distance of a hinge from the origin of its link that rounding leaves [m].
ROUNDED = 1e-12
# Stiffness of a rod [N/m]: Drake reads none from a file that is infinite.
_STIFF = 1e9
# Side of the box in the place of a half space, where the format has none [m].
_GROUND = 100.0
_MOMENTS = {
    "ixx": (0, 0),
    "iyy": (1, 1),
    "izz": (2, 2),
    "ixy": (0, 1),
    "ixz": (0, 2),
    "iyz": (1, 2),
}
_ROLES = {"visual": Role.kIllustration, "collision": Role.kProximity}


class _Writer:
    """Parts that both formats have: values are attributes in URDF, and nested in SDFormat.

    Attributes:
        root: the file.
        tree: the machine, described.
    """

    def __init__(self, root: Element, tree: Description, notes: Iterable[str]):
        root.set("xmlns:drake", "http://drake.mit.edu")
        self.root, self.tree, self._is_nested = root, tree, root.tag == "sdf"
        standing = (f"{name} {value!r}" for name, value in tree.standing().items())
        for note in (*notes, "stands, with its loops closed, at: " + ", ".join(standing)):
            root.append(Comment(f" {note.replace('--', '- -')} "))

    def put(self, parent: Element, tag: str, values: Mapping[str, str]) -> Element:
        """Adds an element with several values."""
        if not self._is_nested:
            return SubElement(parent, tag, dict(values))
        element = SubElement(parent, tag)
        for name, value in values.items():
            SubElement(element, name).text = value
        return element

    def leaf(self, parent: Element, tag: str, value: str, attribute: str = "value") -> None:
        """Adds an element with one value."""
        if self._is_nested:
            SubElement(parent, tag).text = value
        else:
            SubElement(parent, tag, {attribute: value})

    def inertia(self, parent: Element, inertia: Any) -> None:
        """Adds moments and products of inertia."""
        moments = {name: _text(inertia[place]) for name, place in _MOMENTS.items()}
        self.put(parent, "inertia", moments)

    def shape(self, parent: Element, shape: Shape, mesh: Callable[[Path], str]) -> None:
        """Adds form and contact of a visual or a collision.

        Raises:
            WiringError: a form that files do not know.
        """
        form, geometry = shape.shape, SubElement(parent, "geometry")
        if isinstance(form, Mesh | Convex):
            key = "uri" if self._is_nested else "filename"
            source = form.source()
            if source.is_in_memory():
                raise WiringError(f"the mesh {source.description()} is not a file")
            values = {key: mesh(Path(source.path())), "scale": _text(form.scale3())}
            element = self.put(geometry, "mesh", values)
            if isinstance(form, Convex):
                SubElement(element, "drake:declare_convex")
        else:
            self.put(geometry, *self._form(form))
        if shape.contact:
            contact = SubElement(parent, "drake:proximity_properties")
            for name, value in shape.contact.items():
                self.leaf(contact, f"drake:{name}", value)

    def _form(self, form: Any) -> tuple[str, dict[str, str]]:
        if isinstance(form, Box):
            return "box", {"size": _text(form.size())}
        if isinstance(form, Sphere):
            return "sphere", {"radius": _text(form.radius())}
        if isinstance(form, Cylinder | Capsule):
            tag = "cylinder" if isinstance(form, Cylinder) else "capsule"
            return tag, {"radius": _text(form.radius()), "length": _text(form.length())}
        if isinstance(form, Ellipsoid):
            a, b, c = form.a(), form.b(), form.c()
            if self._is_nested:
                return "ellipsoid", {"radii": _text((a, b, c))}
            return "drake:ellipsoid", {"a": _text(a), "b": _text(b), "c": _text(c)}
        if isinstance(form, HalfSpace):
            if self._is_nested:
                return "plane", {"normal": "0 0 1", "size": _text((_GROUND, _GROUND))}
            return "box", {"size": _text((_GROUND, _GROUND, _GROUND))}
        raise WiringError(f"{type(form).__name__} is a form that files do not know")

    def belt(self, link: Element, body: RigidBody) -> None:
        """Adds the axis about which the surface of a link turns."""
        if (axis := self.tree.belt(body)) is not None:
            self.leaf(link, "drake:surface_velocity_axis", _text(axis), "axis")

    def loops(self, parent: Element) -> None:
        """Adds the ball joints and rods that close loops."""
        for closure in self.tree.closures:
            tag = {"ball": "drake:ball_constraint", "rod": "drake:distance_constraint"}.get(
                closure.kind
            )
            if tag is None:
                continue
            loop = SubElement(parent, tag)
            for letter, link in zip("AB", closure.links, strict=True):
                self.leaf(loop, f"{tag}_body_{letter}", link, "name")
            for point, pose in zip(("AP", "BQ"), closure.poses, strict=True):
                self.leaf(loop, f"{tag}_p_{point}", _text(pose.translation()))
            if closure.kind == "rod":
                self.leaf(loop, f"{tag}_distance", _text(closure.length))
                self.leaf(loop, f"{tag}_stiffness", _text(_STIFF))
                self.leaf(loop, f"{tag}_damping", _text(0.0))

    def drive(self, parent: Element, name: str) -> None:
        """Adds servo and rotor of a joint's actuator."""
        actuator = self.tree.actuators[name]
        for tag, number in (
            ("drake:rotor_inertia", actuator.rotor_inertia(self.tree.context)),
            ("drake:gear_ratio", actuator.gear_ratio(self.tree.context)),
        ):
            self.leaf(parent, tag, _text(number))
        if actuator.has_controller():
            gains = actuator.get_controller_gains()
            values = {"p": _text(gains.p), "d": _text(gains.d)}
            SubElement(parent, "drake:controller_gains", values)

    def limits(self, name: str, joint: Joint) -> dict[str, str]:
        """Limits of a joint and its drive."""
        actuator = self.tree.actuators.get(name)
        limits = {
            "lower": joint.position_lower_limits()[0],
            "upper": joint.position_upper_limits()[0],
            # Without an effort a joint of SDFormat is not driven in Drake.
            "effort": actuator.effort_limit() if actuator else 0.0 if self._is_nested else ENDLESS,
            "velocity": joint.velocity_upper_limits()[0],
        }
        ends = np.clip(list(limits.values()), -ENDLESS, ENDLESS)
        return dict(zip(limits, map(_text, ends), strict=True))

    def mimic(self, parent: Element, tag: str, name: str) -> None:
        """Adds the joint that a joint follows."""
        if coupling := self.tree.couplings.get(name):
            ratio, offset = _text(coupling.ratio), _text(coupling.offset)
            leader = self.tree.joint_name(coupling.leader)
            SubElement(parent, tag, joint=leader, multiplier=ratio, offset=offset)

    def text(self) -> str:
        """The file."""
        indent(self.root)
        return '<?xml version="1.0"?>\n' + tostring(self.root, encoding="unicode") + "\n"


def urdf(tree: Description, mesh: Callable[[Path], str], notes: Iterable[str]) -> str:
    """A machine as URDF.

    Args:
        tree: the machine, described.
        mesh: name of a mesh in the file, by its path.
        notes: lines of the comment at its beginning.

    Raises:
        WiringError: a form that files do not know, or a hinge beside its link's origin.
    """
    root = Element("robot", name=tree.name)
    writer, colours = _Writer(root, tree, notes), dict[str, str]()
    for body, name in zip(tree.bodies, tree.links, strict=True):
        link = SubElement(root, "link", name=name)
        if name != "world":
            _urdf_inertia(writer, link, *tree.inertia(body))
        for tag, role in _ROLES.items():
            for shape in _known(tree.shapes(body, role), tag):
                element, X_BG = SubElement(link, tag, name=shape.name), shape.pose
                if isinstance(shape.shape, HalfSpace):
                    X_BG = X_BG.multiply(RigidTransform(np.array((0.0, 0.0, -0.5 * _GROUND))))
                SubElement(element, "origin", _origin(X_BG))
                writer.shape(element, shape, mesh)
                if shape.colour is not None:
                    rgba = _text(shape.colour.rgba)
                    colour = colours.setdefault(rgba, f"colour_{len(colours) + 1}")
                    material = SubElement(element, "material", name=colour)
                    SubElement(material, "color", rgba=rgba)
        writer.belt(link, body)
    for name, joint in zip(tree.joint_names, tree.joints, strict=True):
        _urdf_joint(writer, name, joint)
    for closure in tree.closures:
        for end, on, pose in zip(closure.names, closure.links, closure.poses, strict=True):
            massless = 0.0, np.zeros(3), np.zeros((3, 3))
            _urdf_inertia(writer, SubElement(root, "link", name=end), *massless)
            fixed = SubElement(root, "joint", name=f"{end}_fixed", type="fixed")
            _urdf_tree(fixed, on, end, pose)
    for frame, on, pose in tree.frames:
        SubElement(root, "frame", {"name": frame, "link": on} | _origin(pose))
    writer.loops(root)
    return writer.text()


def _known(shapes: Iterable[Shape], tag: str) -> Iterator[Shape]:
    """Shapes to be seen that all readers of URDF know, in the place of capsules and ellipsoids."""
    for shape in shapes:
        form = shape.shape
        if tag == "visual" and isinstance(form, Capsule):
            yield replace(shape, shape=Cylinder(form.radius(), form.length()))
            for name, end in (("top", 0.5 * form.length()), ("bottom", -0.5 * form.length())):
                pose = shape.pose.multiply(RigidTransform(np.array((0.0, 0.0, end))))
                ball = Sphere(form.radius())
                yield replace(shape, name=f"{shape.name}_{name}", pose=pose, shape=ball)
        elif tag == "visual" and isinstance(form, Ellipsoid):
            yield replace(shape, shape=Sphere(float(np.cbrt(form.a() * form.b() * form.c()))))
        else:
            yield shape


def _urdf_inertia(writer: _Writer, link: Element, mass: float, centre: Any, inertia: Any) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_text(centre))
    SubElement(inertial, "mass", value=_text(mass))
    writer.inertia(inertial, inertia)


def _urdf_tree(joint: Element, parent: str, child: str, X_PC: RigidTransform) -> None:
    SubElement(joint, "origin", _origin(X_PC))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)


def _urdf_joint(writer: _Writer, name: str, joint: Joint) -> None:
    tree, kind = writer.tree, KINDS[type(joint)]
    has_ends = joint.num_positions() == 1 and bool(np.isfinite(joint.position_lower_limits()[0]))
    if kind == "revolute" and not has_ends:
        kind = "continuous"
    element = SubElement(writer.root, "joint", name=name, type=kind)
    links = tree.link(joint.parent_body()), tree.link(joint.child_body())
    _urdf_tree(element, *links, tree.home(joint))
    if joint.num_velocities() != 1:
        return
    axis = tree.axis(joint)
    place = joint.frame_on_child().CalcPoseInBodyFrame(tree.context).translation()
    if isinstance(joint, RevoluteJoint) and np.abs(np.cross(axis, place)).max() > ROUNDED:
        raise WiringError(
            f"the hinge {name} is beside the origin of {links[1]}, which URDF cannot hold; "
            "SDFormat and MJCF can"
        )
    SubElement(element, "axis", xyz=_text(axis))
    limits = writer.limits(name, joint)
    if kind == "continuous":
        limits = {key: limits[key] for key in ("effort", "velocity")}
    SubElement(element, "limit", limits)
    SubElement(element, "dynamics", damping=_text(joint.GetDampingVector(tree.context)[0]))
    writer.mimic(element, "mimic", name)
    if name in tree.actuators:
        transmission = SubElement(writer.root, "transmission")
        SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
        SubElement(transmission, "joint", name=name)
        writer.drive(SubElement(transmission, "actuator", name=f"{name}_drive"), name)


def sdf(tree: Description, mesh: Callable[[Path], str], notes: Iterable[str]) -> str:
    """A machine as SDFormat.

    Args:
        tree: the machine, described.
        mesh: name of a mesh in the file, by its path.
        notes: lines of the comment at its beginning.

    Raises:
        WiringError: a form that files do not know.
    """
    root = Element("sdf", version="1.9")
    writer = _Writer(root, tree, notes)
    model = SubElement(root, "model", name=tree.name)
    for body, name, X_WB in zip(tree.bodies, tree.links, tree.homes(), strict=True):
        if name != "world":
            _sdf_link(writer, SubElement(model, "link", name=name), body, X_WB, mesh)
    for name, joint in zip(tree.joint_names, tree.joints, strict=True):
        if (kind := KINDS[type(joint)]) != "floating":
            _sdf_joint(writer, SubElement(model, "joint", name=name, type=kind), name, joint)
    closed = (zip(c.names, c.links, c.poses, strict=True) for c in tree.closures)
    for name, link, pose in (*tree.frames, *(end for ends in closed for end in ends)):
        if link != "world":
            frame = SubElement(model, "frame", name=name, attached_to=link)
            SubElement(frame, "pose").text = _pose(pose)
    writer.loops(model)
    return writer.text()


def _sdf_link(
    writer: _Writer,
    link: Element,
    body: RigidBody,
    X_WB: RigidTransform,
    mesh: Callable[[Path], str],
) -> None:
    SubElement(link, "pose").text = _pose(X_WB)
    mass, centre, inertia = writer.tree.inertia(body)
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "pose").text = _pose(RigidTransform(centre))
    SubElement(inertial, "mass").text = _text(mass)
    writer.inertia(inertial, inertia)
    for tag, role in _ROLES.items():
        for shape in writer.tree.shapes(body, role):
            element = SubElement(link, tag, name=shape.name)
            SubElement(element, "pose").text = _pose(shape.pose)
            writer.shape(element, shape, mesh)
            if shape.colour is not None:
                material = SubElement(element, "material")
                for part in ("ambient", "diffuse"):
                    SubElement(material, part).text = _text(shape.colour.rgba)
    writer.belt(link, body)


def _sdf_joint(writer: _Writer, element: Element, name: str, joint: Any) -> None:
    tree = writer.tree
    X_BM = joint.frame_on_child().CalcPoseInBodyFrame(tree.context)
    SubElement(element, "pose").text = _pose(X_BM)
    SubElement(element, "parent").text = tree.link(joint.parent_body())
    SubElement(element, "child").text = tree.link(joint.child_body())
    if joint.num_velocities() != 1:
        return
    axis = SubElement(element, "axis")
    SubElement(axis, "xyz").text = _text(X_BM.rotation().inverse().multiply(tree.axis(joint)))
    writer.put(axis, "limit", writer.limits(name, joint))
    damping = _text(joint.GetDampingVector(tree.context)[0])
    writer.put(axis, "dynamics", {"damping": damping})
    writer.mimic(element, "drake:mimic", name)
    if name in tree.actuators:
        writer.drive(element, name)


def _text(values: ArrayLike) -> str:
    """Numbers with all their digits."""
    return " ".join(repr(float(value) + 0.0) for value in np.atleast_1d(values))


def _origin(pose: RigidTransform) -> dict[str, str]:
    angles = RollPitchYaw(pose.rotation()).vector()
    return {"xyz": _text(pose.translation()), "rpy": _text(angles)}


def _pose(pose: RigidTransform) -> str:
    return " ".join(_origin(pose).values())
