"""Drawing of a machine for Foxglove's 3D panel, as messages of its own kinds."""

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
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
    SceneGraphInspector,
    Sphere,
)
from pydrake.math import RigidTransform

from parapod.diagrams.twin import MEASURED, PALE
from parapod.sims.output.drawn import DrawnLog
from parapod.sims.output.logs.mcap import Message, Picture, Schema
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.extras import need

FRAMES, SCENE = "/tf", "/scene"
WORLD = "world"
_GREY = Rgba(0.8, 0.8, 0.8, 1.0)
# Somebody waits for the log: drawings whose poses take longer are made with fewer pictures [s].
_PATIENCE, _TRIED = 8.0, 10


def schema_of(topic: str) -> Schema:
    """The schema of a topic, as Foxglove publishes it.

    Raises:
        MissingExtra: Foxglove's package is not installed.
    """
    kinds = need("foxglove.messages")
    kind = {FRAMES: kinds.FrameTransforms, SCENE: kinds.SceneUpdate}[topic]
    schema = kind.get_schema()
    return Schema(schema.name, schema.encoding, bytes(schema.data))


def scene_messages(drawing: DrawnLog, pictures: Sequence[Picture]) -> Iterator[Message]:
    """The bodies, once, and where they are in each picture.

    Args:
        drawing: the machine and its signals.
        pictures: stamp [ns], time [s] and samples of the log's signals.

    Raises:
        MissingExtra: Foxglove's package is not installed.
        ParapodError: the drawing is refused.
    """
    if not pictures:
        return
    need("foxglove.messages")
    twin = drawing.make()
    schemas = {topic: schema_of(topic) for topic in (SCENE, FRAMES)}
    yield Message(
        SCENE, schemas[SCENE], pictures[0][0], _bodies(twin.scene_graphs(), pictures[0][0])
    )
    began, step = time.monotonic(), 1
    for number, (stamp, t, row) in enumerate(pictures):
        if number == _TRIED:
            duration = (time.monotonic() - began) / _TRIED * len(pictures)
            step = max(1, round(duration / _PATIENCE + 0.5))
        if number % step == 0:
            twin.show(drawing.values(row), t)
            yield Message(FRAMES, schemas[FRAMES], stamp, _poses(twin.scene_graphs(), stamp))


def _frames(graph: SceneGraph) -> Iterator[tuple[FrameId, str]]:
    """Frames of the bodies that are seen, and their names."""
    inspector = graph.model_inspector()
    for frame in inspector.GetAllFrameIds():
        if frame != graph.world_frame_id() and inspector.NumGeometriesForFrameWithRole(
            frame, Role.kIllustration
        ):
            yield frame, inspector.GetName(frame).replace("::", "/")


def _poses(graphs: Mapping[str, Any], stamp: int) -> bytes:
    m = need("foxglove.messages")
    transforms = []
    for drawing, (graph, context) in graphs.items():
        query: Any = graph.get_query_output_port().Eval(context)
        for frame, name in _frames(graph):
            X_WF = query.GetPoseInWorld(frame)
            transforms.append(
                m.FrameTransform(
                    timestamp=_at(stamp),
                    parent_frame_id=WORLD,
                    child_frame_id=f"{drawing}/{name}",
                    translation=_vector(X_WF.translation()),
                    rotation=_quaternion(X_WF),
                )
            )
    data: bytes = m.FrameTransforms(transforms=transforms).encode()
    return data


def _bodies(graphs: Mapping[str, Any], stamp: int) -> bytes:
    m = need("foxglove.messages")
    entities = []
    for drawing, (graph, _) in graphs.items():
        inspector = graph.model_inspector()
        for frame, name in _frames(graph):
            parts: dict[str, list[Any]] = {}
            for geometry in inspector.GetGeometries(frame, Role.kIllustration):
                for kind, part in _parts(
                    inspector, geometry, 1.0 if drawing == MEASURED else PALE
                ):
                    parts.setdefault(kind, []).append(part)
            entities.append(
                m.SceneEntity(
                    timestamp=_at(stamp),
                    frame_id=f"{drawing}/{name}",
                    id=f"{drawing}/{name}",
                    frame_locked=True,
                    **parts,
                )
            )
    data: bytes = m.SceneUpdate(entities=entities).encode()
    return data


def _parts(
    inspector: SceneGraphInspector, geometry: Any, opacity: float
) -> Iterator[tuple[str, Any]]:
    """Kind of primitive, as an entity calls them, and the primitive."""
    m = need("foxglove.messages")
    shape, X_FG = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry)
    properties = inspector.GetIllustrationProperties(geometry)
    colour: Any = properties.GetPropertyOrDefault("phong", "diffuse", _GREY)
    links = {
        "pose": _pose(X_FG),
        "color": m.Color(r=colour.r(), g=colour.g(), b=colour.b(), a=opacity * colour.a()),
    }
    match shape:
        case Box():
            yield "cubes", m.CubePrimitive(size=_vector(shape.size()), **links)
        case Sphere():
            yield "spheres", m.SpherePrimitive(size=_vector(3 * [2 * shape.radius()]), **links)
        case Ellipsoid():
            size = [2.0 * shape.a(), 2.0 * shape.b(), 2.0 * shape.c()]
            yield "spheres", m.SpherePrimitive(size=_vector(size), **links)
        case Cylinder() | Capsule():
            width, length = 2.0 * shape.radius(), shape.length()
            yield (
                "cylinders",
                m.CylinderPrimitive(
                    size=_vector([width, width, length]), bottom_scale=1.0, top_scale=1.0, **links
                ),
            )
            for end in (-0.5, 0.5) if isinstance(shape, Capsule) else ():
                X_FE = X_FG @ RigidTransform(np.array([0.0, 0.0, end * length]))
                ball = {**links, "pose": _pose(X_FE)}
                yield "spheres", m.SpherePrimitive(size=_vector(3 * [width]), **ball)
        case Mesh() if (path := shape.source()).is_path():
            yield (
                "models",
                m.ModelPrimitive(
                    scale=_vector(shape.scale3()),
                    override_color=True,
                    media_type="model/obj",
                    data=Path(path.path()).read_bytes(),
                    **links,
                ),
            )
        case _:
            raise ParapodError(f"no message of Foxglove draws a {type(shape).__name__}")


def _at(stamp: int) -> Any:
    m = need("foxglove.messages")
    return m.Timestamp(sec=stamp // 10**9, nsec=stamp % 10**9)


def _pose(X: RigidTransform) -> Any:
    pose = need("foxglove.messages").Pose
    return pose(position=_vector(X.translation()), orientation=_quaternion(X))


def _vector(numbers: Any) -> Any:
    x, y, z = map(float, numbers)
    return need("foxglove.messages").Vector3(x=x, y=y, z=z)


def _quaternion(X: RigidTransform) -> Any:
    q = X.rotation().ToQuaternion()
    return need("foxglove.messages").Quaternion(x=q.x(), y=q.y(), z=q.z(), w=q.w())
