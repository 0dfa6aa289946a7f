"""A machine as RViz and Foxglove draw it: its solids as markers, and transforms of its bodies.

Functions here make messages by a function that makes one of a type with given fields, such as
`make("std_msgs/msg/Header", frame_id="world")`, so that they serve several libraries of ROS 2.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import (
    Box,
    Cylinder,
    Ellipsoid,
    Mesh,
    ReadObjToTriangleSurfaceMesh,
    Shape,
    Sphere,
)
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from parapod.systems.core.errors import ParapodError
from parapod.systems.hardware.buses.bus import Poses, Visual

type Make = Callable[..., Any]

WORLD = "world"
"""Frame in which the bodies are."""
MARKERS, TRANSFORMS = "visualization_msgs/msg/MarkerArray", "tf2_msgs/msg/TFMessage"

# Kinds of markers [ROS 2, visualization_msgs/msg/Marker].
_CUBE, _SPHERE, _CYLINDER, _FILE, _TRIANGLES = 1, 2, 3, 10, 11
_SECOND = 10**9
# Time [ns] in the place of one that is not known yet; no other number of a message is like it.
_SOME_TIME = 1_592_663_789_123_456_789
_TIME, _POSE = struct.Struct("=iI"), struct.Struct("=7d")


def markers(
    make: Make, visuals: Mapping[str, Sequence[Visual]], nanoseconds: int, has_files: bool = False
) -> list[Any]:
    """Markers of all solids, each of which moves with the frame of its body.

    Args:
        make: makes a message.
        visuals: solids of each body.
        nanoseconds: time [ns].
        has_files: true if meshes are files of this computer, in place of triangles.

    Raises:
        ParapodError: a shape that no marker draws.
    """
    return [
        make(
            "visualization_msgs/msg/Marker",
            header=_header(make, body, nanoseconds),
            ns=body,
            id=number,
            pose=make(
                "geometry_msgs/msg/Pose",
                position=_vector(make, solid.pose.translation(), "Point"),
                orientation=_quaternion(make, solid.pose.rotation().ToQuaternion().wxyz()),
            ),
            color=make("std_msgs/msg/ColorRGBA", **dict(zip("rgba", solid.colour, strict=True))),
            frame_locked=True,
            **_as_marker(make, solid.shape, has_files),
        )
        for body, solids in visuals.items()
        for number, solid in enumerate(solids)
    ]


def transforms(make: Make, poses: Poses, nanoseconds: int) -> list[Any]:
    """Transforms of bodies in the world.

    Args:
        make: makes a message.
        poses: pose of each body.
        nanoseconds: their time [ns].
    """
    return [
        make(
            "geometry_msgs/msg/TransformStamped",
            header=_header(make, WORLD, nanoseconds),
            child_frame_id=body,
            transform=make(
                "geometry_msgs/msg/Transform",
                translation=_vector(make, position),
                rotation=_quaternion(make, turn),
            ),
        )
        for body, (position, turn) in poses.items()
    ]


def _as_marker(make: Make, shape: Shape, has_files: bool) -> dict[str, Any]:
    """Fields of a marker by which it has a shape; triangles have three points each."""
    fields: dict[str, Any] = {}
    match shape:
        case Box():
            kind, scale = _CUBE, shape.size()
        case Sphere():
            kind, scale = _SPHERE, 2.0 * shape.radius() * np.ones(3)
        case Ellipsoid():
            kind, scale = _SPHERE, 2.0 * np.array([shape.a(), shape.b(), shape.c()])
        case Cylinder():
            kind, scale = _CYLINDER, 2.0 * np.array([shape.radius()] * 2 + [shape.length() / 2])
        case Mesh() if has_files:
            kind, scale = _FILE, shape.scale3()
            fields["mesh_resource"] = Path(shape.source().path()).absolute().as_uri()
        case Mesh():
            kind, scale = _TRIANGLES, shape.scale3()
            mesh = ReadObjToTriangleSurfaceMesh(str(shape.source().path()))
            corners = [mesh.vertex(each.vertex(k)) for each in mesh.triangles() for k in range(3)]
            fields["points"] = [_vector(make, corner, "Point") for corner in corners]
        case _:
            raise ParapodError(f"no marker draws a {type(shape).__name__}")
    return {"type": kind, "scale": _vector(make, scale), **fields}


def _header(make: Make, frame: str, nanoseconds: int) -> Any:
    sec, nanosec = divmod(nanoseconds, _SECOND)
    stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _vector(make: Make, numbers: ArrayLike, kind: str = "Vector3") -> Any:
    x, y, z = np.asarray(numbers, dtype=float).tolist()
    return make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)


def _quaternion(make: Make, wxyz: ArrayLike) -> Any:
    w, x, y, z = np.asarray(wxyz, dtype=float).tolist()
    return make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


class Scene:
    """Messages that draw a machine in motion, as bytes: its solids and its bodies in the world.

    Of each only the time and the poses are written anew, because making a hundred markers takes
    longer than a tick.
    """

    def __init__(
        self,
        make: Make,
        serialize: Callable[[Any], bytes],
        visuals: Mapping[str, Sequence[Visual]],
        has_transforms: bool,
    ):
        """Makes the messages.

        Args:
            make: makes a message; its fields can be set.
            serialize: bytes of a message.
            visuals: solids of each body.
            has_transforms: true if there is to be a message of the bodies too.

        Raises:
            MissingExtra: the markers' type is not installed.
            ParapodError: a shape that no marker draws.
        """
        self._bodies = list(visuals)
        solids = [solid for body in visuals.values() for solid in body]
        self._of = np.repeat(np.arange(len(visuals)), [len(body) for body in visuals.values()])
        self._offsets = np.array([solid.pose.translation() for solid in solids])
        self._turns = Rotation.from_matrix([solid.pose.rotation().matrix() for solid in solids])
        array = make(MARKERS, markers=markers(make, visuals, _SOME_TIME, has_files=True))
        for marker, place in zip(array.markers, map(_some_pose, range(len(solids))), strict=True):
            marker.header.frame_id, marker.frame_locked = WORLD, False
            marker.pose.position = _vector(make, place[:3], "Point")
            marker.pose.orientation = _quaternion(make, place[3:])
        self._messages = {MARKERS: _Posed(serialize(array), len(solids))}
        if has_transforms:
            poses = {
                body: (place[:3], place[3:])
                for body, place in zip(visuals, map(_some_pose, range(len(visuals))), strict=True)
            }
            message = make(TRANSFORMS, transforms=transforms(make, poses, _SOME_TIME))
            self._messages[TRANSFORMS] = _Posed(serialize(message), len(visuals))

    def at(self, poses: Poses, nanoseconds: int) -> dict[str, bytes]:
        """Bytes of each type's message.

        Args:
            poses: pose of each body in the world.
            nanoseconds: their time [ns].
        """
        positions = np.array([poses[body][0] for body in self._bodies])
        turns = Rotation.from_quat([poses[body][1] for body in self._bodies], scalar_first=True)
        of = turns[self._of]
        where = {
            MARKERS: (positions[self._of] + of.apply(self._offsets), of * self._turns),
            TRANSFORMS: (positions, turns),
        }
        return {
            kind: message.at(*where[kind], nanoseconds) for kind, message in self._messages.items()
        }


class _Posed:
    """Bytes of a message with times and poses, made with some and written anew with others."""

    def __init__(self, data: bytes, count: int):
        self._bytes = np.frombuffer(bytearray(data), np.uint8)
        time = _TIME.pack(*divmod(_SOME_TIME, _SECOND))
        starts, poses = [data.find(time)], [_POSE.pack(*_some_pose(k)) for k in range(count)]
        while (start := data.find(time, starts[-1] + 1)) > 0:
            starts.append(start)
        self._times = np.add.outer(starts, np.arange(_TIME.size))
        self._poses = np.add.outer([data.index(pose) for pose in poses], np.arange(_POSE.size))

    def at(self, positions: NDArray[np.float64], turns: Rotation, nanoseconds: int) -> bytes:
        """Its bytes with poses in the order of the message, and a time [ns]."""
        numbers = np.column_stack([positions, turns.as_quat()])  # x, y, z, w, as on the wire
        self._bytes[self._poses] = numbers.view(np.uint8)
        time = _TIME.pack(*divmod(nanoseconds, _SECOND))
        self._bytes[self._times] = np.frombuffer(time, np.uint8)
        return self._bytes.tobytes()


def _some_pose(number: int) -> NDArray[np.float64]:
    """Numbers in the place of a pose that is not known yet, as no other pose has them."""
    return np.full(7, 1e9 + number)
