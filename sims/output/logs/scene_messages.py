"""Drawing of a machine in its log, as messages that RViz and Foxglove know."""

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from pydrake.geometry import (
    Box,
    Cylinder,
    Ellipsoid,
    Mesh,
    ReadObjToTriangleSurfaceMesh,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform

from parapod.sims.output.drawn import DrawnLog
from parapod.sims.output.drawn_bodies import WORLD, Visual, frames, robot_description, visuals
from parapod.sims.output.logs.mcap import Message, Picture, Schema
from parapod.sims.output.logs.part_messages import SCHEMA_ENCODING, definition_of, types
from parapod.systems.core.errors import ParapodError

FRAMES, SCENE, DESCRIPTION = "/tf", "/scene", "/robot_description"
KINDS = {
    FRAMES: "tf2_msgs/msg/TFMessage",
    SCENE: "visualization_msgs/msg/MarkerArray",
    DESCRIPTION: "std_msgs/msg/String",
}
# Kinds of markers, from visualization_msgs/msg/Marker.
_CUBE, _SPHERE, _CYLINDER, _TRIANGLES = 1, 2, 3, 11
# Somebody waits for the log: drawings whose poses take longer are made with fewer pictures [s].
_PATIENCE, _TRIED = 8.0, 10


def scene_messages(drawing: DrawnLog, pictures: Sequence[Picture]) -> Iterator[Message]:
    """The bodies, once as a URDF and once as markers, and their poses in each picture.

    Args:
        drawing: the machine and its signals.
        pictures: stamp [ns], time [s] and samples of the log's signals.

    Raises:
        MissingExtra: rosbags is not installed.
        ParapodError: the drawing is refused.
    """
    if not pictures:
        return
    twin, first = drawing.make(), pictures[0][0]
    yield _message(DESCRIPTION, first, data=robot_description(twin, "parapod"))
    yield _message(SCENE, first, markers=_markers(visuals(twin), first))
    began, step = time.monotonic(), 1
    for number, (stamp, t, row) in enumerate(pictures):
        if number == _TRIED:
            duration = (time.monotonic() - began) / _TRIED * len(pictures)
            step = max(1, round(duration / _PATIENCE + 0.5))
        if number % step == 0:
            twin.show(drawing.values(row), t)
            yield _message(FRAMES, stamp, transforms=transforms(frames(twin), stamp))


def transforms(poses: Mapping[str, RigidTransform], stamp: int) -> list[Any]:
    """Poses of bodies as `geometry_msgs/msg/TransformStamped` of rosbags.

    Args:
        poses: poses in the world, by body.
        stamp: their time [ns].

    Raises:
        MissingExtra: rosbags is not installed.
    """
    return [
        _made(
            "geometry_msgs/msg/TransformStamped",
            header=_header(WORLD, stamp),
            child_frame_id=body,
            transform=_made(
                "geometry_msgs/msg/Transform",
                translation=_vector(X.translation()),
                rotation=_quaternion(X),
            ),
        )
        for body, X in poses.items()
    ]


@cache
def _schema(topic: str) -> Schema:
    return Schema(KINDS[topic], SCHEMA_ENCODING, definition_of(KINDS[topic]).encode())


def _message(topic: str, stamp: int, **fields: Any) -> Message:
    kind = KINDS[topic]
    data = bytes(types().serialize_cdr(_made(kind, **fields), kind))
    return Message(topic, _schema(topic), stamp, data)


def _made(kind: str, **fields: Any) -> Any:
    return types().types[kind](**fields)


def _markers(bodies: Mapping[str, Sequence[Visual]], stamp: int) -> list[Any]:
    """One marker for each solid, which moves with the frame of its body.

    Raises:
        ParapodError: a shape that no marker draws.
    """
    return [
        _marker(body, number, visual, stamp)
        for body, solids in bodies.items()
        for number, visual in enumerate(solids)
    ]


def _marker(body: str, number: int, visual: Visual, stamp: int) -> Any:
    kind, scale, points = _as_marker(visual.shape)
    colour = dict(zip("rgba", map(float, visual.colour), strict=True))
    image = _made(
        "sensor_msgs/msg/CompressedImage",
        header=_header("", 0),
        format="",
        data=np.zeros(0, np.uint8),
    )
    mesh = _made("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8))
    return _made(
        "visualization_msgs/msg/Marker",
        header=_header(body, stamp),
        ns=body,
        id=number,
        type=kind,
        action=0,  # add
        pose=_made(
            "geometry_msgs/msg/Pose",
            position=_vector(visual.pose.translation(), "Point"),
            orientation=_quaternion(visual.pose),
        ),
        scale=_vector(scale),
        color=_made("std_msgs/msg/ColorRGBA", **colour),
        lifetime=_made("builtin_interfaces/msg/Duration", sec=0, nanosec=0),  # for ever
        frame_locked=True,
        points=[_vector(point, "Point") for point in points],
        colors=[],
        texture_resource="",
        texture=image,
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=mesh,
        mesh_use_embedded_materials=False,
    )


def _as_marker(shape: Shape) -> tuple[int, Any, Any]:
    """Kind of a marker, its scale, and for meshes three points for each triangle."""
    match shape:
        case Box():
            return _CUBE, shape.size(), ()
        case Sphere():
            return _SPHERE, 3 * [2.0 * shape.radius()], ()
        case Ellipsoid():
            return _SPHERE, [2.0 * shape.a(), 2.0 * shape.b(), 2.0 * shape.c()], ()
        case Cylinder():
            return _CYLINDER, [2.0 * shape.radius(), 2.0 * shape.radius(), shape.length()], ()
        case Mesh():
            mesh = ReadObjToTriangleSurfaceMesh(str(shape.source().path()))
            corners = [
                mesh.vertex(triangle.vertex(k)) for triangle in mesh.triangles() for k in range(3)
            ]
            return _TRIANGLES, shape.scale3(), corners
        case _:
            raise ParapodError(f"no marker draws a {type(shape).__name__}")


def _header(frame: str, stamp: int) -> Any:
    sec, nanosec = divmod(stamp, 10**9)
    time_of = _made("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return _made("std_msgs/msg/Header", stamp=time_of, frame_id=frame)


def _vector(numbers: Any, kind: str = "Vector3") -> Any:
    x, y, z = map(float, numbers)
    return _made(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _quaternion(X: RigidTransform) -> Any:
    q = X.rotation().ToQuaternion()
    return _made("geometry_msgs/msg/Quaternion", x=q.x(), y=q.y(), z=q.z(), w=q.w())
