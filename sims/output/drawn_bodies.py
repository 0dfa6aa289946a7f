"""Bodies of a machine as its drawing has them: poses in the world, and a URDF that shows them.

RViz, Foxglove and others show the machine by both: each body is a link of the URDF, and a frame of
the same name. Bodies of the measured drawing are named as `measured/leg_1/foot`, those of what is
asked for, which are pale, as `desired/leg_1/foot`.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    FrameId,
    Mesh,
    Rgba,
    Role,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import Context

from parapod.diagrams.twin import MEASURED, PALE, Twin
from parapod.systems.core.errors import ParapodError

# Frame in which the poses are.
WORLD = "world"
_GREY = Rgba(0.8, 0.8, 0.8, 1.0)


class Visual(NamedTuple):
    """One solid by which a body is seen.

    Attributes:
        shape: a box, sphere, cylinder, ellipsoid or mesh of Drake's.
        pose: its pose in the body's frame.
        colour: (4,) red, green, blue and opacity, from 0 to 1.
    """

    shape: Shape
    pose: RigidTransform
    colour: tuple[float, float, float, float]


class _Body(NamedTuple):
    """A body that is seen: its name, its drawing, and its frame in the drawing's scene."""

    name: str
    drawing: str
    graph: SceneGraph
    context: Context
    frame: FrameId


def frames(twin: Twin) -> dict[str, RigidTransform]:
    """Poses of the bodies in the world, by name, as they were shown last.

    Args:
        twin: drawing of the machine, such as `machine.view.twin(None, scenario)`, whose `show`
            takes signals.
    """
    poses, queries = {}, {}
    for body in _bodies(twin):
        if body.drawing not in queries:
            port: Any = body.graph.get_query_output_port()
            queries[body.drawing] = port.Eval(body.context)
        poses[body.name] = queries[body.drawing].GetPoseInWorld(body.frame)
    return poses


def visuals(twin: Twin) -> dict[str, list[Visual]]:
    """Solids of the bodies, by name; the names are those of `frames`.

    Args:
        twin: drawing of the machine.

    Raises:
        ParapodError: a shape that has no solid here.
    """
    return {body.name: list(_visuals(body)) for body in _bodies(twin)}


def robot_description(twin: Twin, name: str) -> str:
    """Text of a URDF whose links are the bodies of `frames`, each free in the world.

    Closed loops need no joints here, because each link has its own frame. Meshes are files of this
    computer. An ellipsoid, which URDF does not have, becomes the sphere with its volume.

    Args:
        twin: drawing of the machine.
        name: name of the robot.

    Raises:
        ParapodError: a shape that has no solid here.
    """
    urdf = ET.Element("robot", name=name)
    ET.SubElement(urdf, "link", name=WORLD)
    for body, solids in visuals(twin).items():
        link = ET.SubElement(urdf, "link", name=body)
        for number, solid in enumerate(solids):
            visual = ET.SubElement(link, "visual")
            rpy = RollPitchYaw(solid.pose.rotation()).vector()
            ET.SubElement(visual, "origin", xyz=_text(solid.pose.translation()), rpy=_text(rpy))
            geometry = ET.SubElement(visual, "geometry")
            kind, attributes = _as_urdf(solid.shape)
            ET.SubElement(geometry, kind, attributes)
            material = ET.SubElement(visual, "material", name=f"{body}/{number}")
            ET.SubElement(material, "color", rgba=_text(solid.colour))
        joint = ET.SubElement(urdf, "joint", name=f"{WORLD}_to_{body}", type="floating")
        ET.SubElement(joint, "parent", link=WORLD)
        ET.SubElement(joint, "child", link=body)
    ET.indent(urdf)
    return ET.tostring(urdf, encoding="unicode")


def _bodies(twin: Twin) -> Iterator[_Body]:
    names: set[str] = set()
    for drawing, (graph, context) in twin.scene_graphs().items():
        inspector = graph.model_inspector()
        for frame in inspector.GetAllFrameIds():
            if frame == graph.world_frame_id() or not inspector.NumGeometriesForFrameWithRole(
                frame, Role.kIllustration
            ):
                continue
            name = f"{drawing}/{inspector.GetName(frame)}".replace("::", "/")
            while name in names:
                name += "_"
            names.add(name)
            yield _Body(name, drawing, graph, context, frame)


def _visuals(body: _Body) -> Iterator[Visual]:
    inspector = body.graph.model_inspector()
    opacity = 1.0 if body.drawing == MEASURED else PALE
    for geometry in inspector.GetGeometries(body.frame, Role.kIllustration):
        shape, pose = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry)
        properties = inspector.GetIllustrationProperties(geometry)
        rgba: Any = properties.GetPropertyOrDefault("phong", "diffuse", _GREY)
        colour = rgba.r(), rgba.g(), rgba.b(), opacity * rgba.a()
        match shape:
            case Capsule():
                yield Visual(Cylinder(shape.radius(), shape.length()), pose, colour)
                for end in (-0.5, 0.5):
                    offset = RigidTransform(np.array([0.0, 0.0, end * shape.length()]))
                    yield Visual(Sphere(shape.radius()), pose @ offset, colour)
            case Box() | Sphere() | Cylinder() | Ellipsoid():
                yield Visual(shape, pose, colour)
            case Mesh() if shape.source().is_path():
                yield Visual(shape, pose, colour)
            case _:
                raise ParapodError(f"no message draws a {type(shape).__name__}")


def _as_urdf(shape: Shape) -> tuple[str, dict[str, str]]:
    """Kind of a solid in a URDF, and its attributes."""
    match shape:
        case Box():
            return "box", {"size": _text(shape.size())}
        case Sphere():
            return "sphere", {"radius": _text([shape.radius()])}
        case Ellipsoid():
            radius = np.cbrt(shape.a() * shape.b() * shape.c())
            return "sphere", {"radius": _text([radius])}
        case Cylinder():
            radius, length = _text([shape.radius()]), _text([shape.length()])
            return "cylinder", {"radius": radius, "length": length}
        case Mesh():
            file = Path(shape.source().path()).absolute().as_uri()
            return "mesh", {"filename": file, "scale": _text(shape.scale3())}
        case _:
            raise ParapodError(f"a URDF has no {type(shape).__name__}")


def _text(numbers: ArrayLike) -> str:
    return " ".join(f"{number:.9g}" for number in np.ravel(numbers))
