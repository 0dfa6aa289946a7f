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

from parapod.diagrams.twin import MEASURED, PALE, Twin
from parapod.systems.core.errors import ParapodError
from parapod.systems.hardware.buses.bus import Poses, Visual
from parapod.systems.hardware.buses.ros2.scene import WORLD

_GREY = Rgba(0.8, 0.8, 0.8, 1.0)


class _Body(NamedTuple):
    """A body that is seen: the drawing that has it, and its frame in the drawing's scene."""

    drawing: str
    graph: SceneGraph
    frame: FrameId


class DrawnBodies:
    """Bodies of a machine that are seen, as its drawing shows them."""

    def __init__(self, twin: Twin):
        """Finds the bodies.

        Args:
            twin: drawing of the machine, such as `machine.view.twin(None, scenario)`, whose `show`
                takes signals.
        """
        self._scenes = twin.scene_graphs()
        self._bodies: dict[str, _Body] = {}
        for drawing, (graph, _) in self._scenes.items():
            inspector = graph.model_inspector()
            for frame in inspector.GetAllFrameIds():
                if frame == graph.world_frame_id() or not inspector.NumGeometriesForFrameWithRole(
                    frame, Role.kIllustration
                ):
                    continue
                name = f"{drawing}/{inspector.GetName(frame)}".replace("::", "/")
                while name in self._bodies:
                    name += "_"
                self._bodies[name] = _Body(drawing, graph, frame)

    def poses(self) -> Poses:
        """Poses in the world, by name, as they were shown last."""
        queries: dict[str, Any] = {}
        for drawing, (graph, context) in self._scenes.items():
            port: Any = graph.get_query_output_port()
            queries[drawing] = port.Eval(context)
        poses = {}
        for name, body in self._bodies.items():
            pose = queries[body.drawing].GetPoseInWorld(body.frame)
            poses[name] = pose.translation(), pose.rotation().ToQuaternion().wxyz()
        return poses

    def visuals(self) -> dict[str, list[Visual]]:
        """Solids by which they are seen, by the names of `poses`.

        Raises:
            ParapodError: a shape that has no solid here.
        """
        return {name: list(_visuals(body)) for name, body in self._bodies.items()}

    def description(self, name: str) -> str:
        """Text of a URDF whose links are the bodies, each free in the world.

        Closed loops need no joints here, because each link has its own frame. Meshes are files of
        this computer. An ellipsoid, which URDF does not have, becomes the sphere with its volume.

        Args:
            name: name of the robot.

        Raises:
            ParapodError: a shape that has no solid here.
        """
        urdf = ET.Element("robot", name=name)
        ET.SubElement(urdf, "link", name=WORLD)
        for body, solids in self.visuals().items():
            link = ET.SubElement(urdf, "link", name=body)
            for number, solid in enumerate(solids):
                visual = ET.SubElement(link, "visual")
                rpy = RollPitchYaw(solid.pose.rotation()).vector()
                ET.SubElement(
                    visual, "origin", xyz=_text(solid.pose.translation()), rpy=_text(rpy)
                )
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
