"""Meshcat that remembers its content, so that Drake's renderer can film it without a browser."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh, Meshcat, Rgba, Shape
from pydrake.math import RigidTransform

_ROOT = "/drake/"  # root of paths that do not begin with a slash


def absolute(path: str) -> str:
    """A path of Meshcat from the root on."""
    return path if path.startswith("/") else _ROOT + path


@dataclass(frozen=True)
class Prop:
    """An object of the scene.

    Attributes:
        shape: its shape.
        colour: its colour.
    """

    shape: Shape
    colour: Rgba


class Stage(Meshcat):
    """Meshcat that remembers solid objects, their poses and the camera.

    Only what Python puts into the scene is remembered. Bodies, which Drake's visualizer draws, are
    in the scene graph of their diagram; lines and points are not filmed.

    Attributes:
        props: objects by absolute path.
        poses: poses relative to the path above, by absolute path.
        hidden: absolute paths under which nothing is visible.
        camera: position of the camera (3) [m].
        target: point at which it looks (3) [m].
    """

    def __init__(self, params: Any):
        super().__init__(params)
        self.props: dict[str, Prop] = {}
        self.poses: dict[str, RigidTransform] = {}
        self.hidden: set[str] = set()
        self.camera: NDArray[np.float64] = np.array((3.0, 3.0, 1.5))
        self.target: NDArray[np.float64] = np.zeros(3)

    # Drake's stubs name each overload; here one takes them all.
    def SetObject(  # type: ignore[override]
        self, path: str, shape: Any, rgba: Any = None, **options: Any
    ) -> None:
        """See `Meshcat`."""
        colour = Rgba(0.9, 0.9, 0.9) if rgba is None else rgba
        super().SetObject(path, shape, colour, **options)
        if isinstance(shape, Shape):
            self.props[absolute(path)] = Prop(shape, colour)

    def SetTriangleMesh(  # type: ignore[override]
        self, path: str, vertices: Any, faces: Any, rgba: Any = None, **options: Any
    ) -> None:
        """See `Meshcat`."""
        colour = Rgba(0.1, 0.1, 0.1) if rgba is None else rgba
        super().SetTriangleMesh(path, vertices, faces, colour, **options)
        self.props[absolute(path)] = Prop(_mesh(path, vertices, faces), colour)

    def SetTransform(  # type: ignore[override]
        self, path: str, pose: Any, *time: Any, **options: Any
    ) -> None:
        """See `Meshcat`."""
        super().SetTransform(path, pose, *time, **options)
        is_matrix = isinstance(pose, np.ndarray)
        self.poses[absolute(path)] = RigidTransform(pose) if is_matrix else pose

    def SetProperty(
        self,
        path: str,
        property: str,  # noqa: A002
        value: Any,
        *time: Any,
        **options: Any,
    ) -> None:
        """See `Meshcat`."""
        super().SetProperty(path, property, value, *time, **options)
        if property == "visible":
            (self.hidden.discard if value else self.hidden.add)(absolute(path))

    def SetCameraPose(self, camera: ArrayLike, target: ArrayLike) -> None:
        """See `Meshcat`."""
        self.camera, self.target = np.asarray(camera, float), np.asarray(target, float)
        super().SetCameraPose(self.camera, self.target)

    def Delete(self, path: str = "") -> None:
        """See `Meshcat`."""
        super().Delete(path)
        deleted = absolute(path).rstrip("/")
        for each in [p for p in self.props if f"{p}/".startswith(f"{deleted}/")]:
            del self.props[each]


def _mesh(name: str, vertices: Any, faces: Any) -> Mesh:
    """A mesh of vertices (3, n) [m] and triangles (3, m), flat and lit on both sides."""
    points, triangles = np.asarray(vertices, dtype=float).T, np.asarray(faces).T
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points]
    lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in (*normals, *-normals)]
    for n, corners in enumerate(1 + triangles, start=1):
        for order, normal in ((corners, n), (corners[::-1], n + len(triangles))):
            lines.append("f " + " ".join(f"{corner}//{normal}" for corner in order))
    content = MemoryFile(contents="\n".join(lines), extension=".obj", filename_hint=name)
    return Mesh(InMemoryMesh(mesh_file=content), 1.0)
