"""Meshes of a model file as Drake can draw them, wherever the file has them.

Files that others wrote name meshes by packages that are not installed here, and most are STL,
which Drake does not draw.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import GeometryInstance, MakePhongIllustrationProperties
from pydrake.math import RigidTransform, RollPitchYaw

from parapod.systems.mechanism.parts import Model

# Suffixes of meshes that Drake draws.
_DRAWN = (".obj", ".gltf", ".vtk")
_GREY = np.array([0.7, 0.7, 0.72, 1.0])
# Size of the header of a binary STL, and what one of its triangles is [bytes].
_HEADER = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])


@dataclass(frozen=True)
class Drawing:
    """An STL that is to be drawn on a link.

    Attributes:
        link: name of the link.
        path: its file.
        pose: pose in the frame of the link.
        scale: (3) factors along its axes.
        colour: (4) red, green, blue, opacity.
    """

    link: str
    path: Path
    pose: RigidTransform
    scale: NDArray[np.float64]
    colour: NDArray[np.float64]

    def add_to(self, model: Model, number: int) -> None:
        """Registers it as a visual of its link, with a number that no other one has."""
        plant = model.plant
        mesh = model.mesh(self.path.stem, as_obj(read_stl(self.path) * self.scale))
        instance = GeometryInstance(self.pose, mesh, f"stl_{number}_{self.path.stem}")
        instance.set_illustration_properties(MakePhongIllustrationProperties(self.colour))
        plant.RegisterVisualGeometry(plant.GetBodyByName(self.link), instance)


def adapt_urdf(root: Element, folder: Path, notes: list[str]) -> list[Drawing]:
    """Resolves the meshes of a URDF, and takes out those that Drake cannot draw.

    Collision shapes go: a mechanism touches nothing.

    Args:
        root: the file's `robot` element, changed in place.
        folder: folder of the file.
        notes: names of meshes that are missing, or of formats that are not drawn, are added.

    Returns:
        STLs that were taken out, to be drawn once the links are there.
    """
    colours = dict(_materials(root))
    drawings, missing = [], set()
    for link in root.findall("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
        for shape in link.findall("visual"):
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            name = mesh.get("filename", "")
            path = find_mesh(folder, name)
            if path is not None and path.suffix.lower() in _DRAWN:
                mesh.set("filename", f"file://{path}")
                continue
            link.remove(shape)
            if path is not None and path.suffix.lower() == ".stl":
                drawings.append(_drawing(link.get("name", ""), shape, mesh, path, colours))
            else:
                missing.add(name)
    if missing:
        notes.append(f"not drawn: {', '.join(sorted(missing))}")
    return drawings


def adapt_sdf(root: Element, folder: Path, notes: list[str]) -> None:
    """Takes collision shapes and meshes that Drake cannot draw out of an SDFormat; see above."""
    missing = set()
    for link in root.iter("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
        for shape in link.findall("visual"):
            uri = shape.find("geometry/mesh/uri")
            if uri is None:
                continue
            path = find_mesh(folder, (uri.text or "").strip())
            if path is not None and path.suffix.lower() in _DRAWN:
                uri.text = f"file://{path}"
            else:
                link.remove(shape)
                missing.add((uri.text or "").strip())
    if missing:
        notes.append(f"not drawn: {', '.join(sorted(missing))}")


def find_mesh(folder: Path, name: str) -> Path | None:
    """Absolute path of a mesh near a model's file; None: there is none.

    In the text of a model, which is in no folder, Drake takes it with file:// alone.

    Args:
        folder: folder of the model's file.
        name: its name in the file: a path, or a URI of a package.
    """
    path = Path(name.removeprefix("file://"))
    if path.is_absolute() and path.is_file():
        return path
    parts = Path(name.partition("://")[2] or name).parts
    parts = tuple(part for part in parts if part != "/")
    if not parts:
        return None
    # A package is mostly a folder above the file, or not there at all.
    folder = folder.absolute()
    for base in (folder, *folder.resolve().parents[:3]):
        for first in range(len(parts)):
            candidate = base.joinpath(*parts[first:])
            if candidate.is_file():
                return candidate
    return None


def read_stl(path: Path) -> NDArray[np.float64]:
    """Corners (triangles, 3, 3) of an STL, binary or text.

    Raises:
        ValueError: neither.
    """
    data = path.read_bytes()
    count = int.from_bytes(data[_HEADER - 4 : _HEADER], "little")
    if len(data) == _HEADER + count * _TRIANGLE.itemsize:
        triangles = np.frombuffer(data, _TRIANGLE, count, _HEADER)
        return np.asarray(triangles["corners"], dtype=float)
    words = data.decode("utf-8", "replace").split()
    numbers = [words[i + 1 : i + 4] for i, word in enumerate(words) if word == "vertex"]
    return np.array(numbers, dtype=float).reshape(-1, 3, 3)


def as_obj(corners: NDArray[np.float64]) -> str:
    """Triangles (n, 3, 3) [m] as Wavefront OBJ."""
    vertices, faces = np.unique(corners.reshape(-1, 3).round(7), axis=0, return_inverse=True)
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in vertices.tolist()]
    lines += [f"f {i + 1} {j + 1} {k + 1}" for i, j, k in faces.reshape(-1, 3).tolist()]
    return "\n".join(lines) + "\n"


def _materials(root: Element) -> Iterator[tuple[str, NDArray[np.float64]]]:
    for material in root.iter("material"):
        colour = material.find("color")
        if colour is not None:
            yield material.get("name", ""), _numbers(colour, "rgba", _GREY)


def _numbers(element: Element | None, key: str, usual: NDArray[np.float64]) -> NDArray[np.float64]:
    text = "" if element is None else element.get(key, "")
    return np.array(text.split(), dtype=float) if text else usual


def _drawing(
    link: str, shape: Element, mesh: Element, path: Path, colours: dict[str, NDArray[np.float64]]
) -> Drawing:
    origin, material = shape.find("origin"), shape.find("material")
    place, rpy = (_numbers(origin, key, np.zeros(3)) for key in ("xyz", "rpy"))
    colour = _GREY
    if material is not None:
        named = colours.get(material.get("name", ""), _GREY)
        colour = _numbers(material.find("color"), "rgba", named)
    pose = RigidTransform(RollPitchYaw(rpy), place)
    return Drawing(link, path, pose, _numbers(mesh, "scale", np.ones(3)), colour)
