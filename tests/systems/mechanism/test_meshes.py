"""Meshes of models: where they are, STL of both kinds, and what is told of those that are not."""

from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import DiagramBuilder

from parapod.systems.mechanism.meshes import as_obj, find_mesh, read_stl
from parapod.systems.mechanism.model import add_model

CORNERS = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1.0]]])
URDF = """<robot name="r"><link name="a">
  <visual><origin xyz="0.1 0 0" rpy="0 0 1"/><geometry>
    <mesh filename="package://nowhere/meshes/part.stl" scale="2 2 2"/></geometry>
    <material name="red"><color rgba="1 0 0 1"/></material></visual>
  <visual><geometry><mesh filename="file:///gone/other.dae"/></geometry></visual>
  <collision><geometry><mesh filename="package://nowhere/meshes/part.stl"/></geometry></collision>
</link></robot>"""

# A link with a mesh that is seen and one that collides, in both formats.
_SHAPES = (
    "<{tag}><geometry><mesh filename='parts/a.obj'/></geometry></{tag}>",
    "<{tag} name='{tag}'><geometry><mesh><uri>parts/a.obj</uri></mesh></geometry></{tag}>",
)
_URDF_SHAPES, _SDF_SHAPES = (
    "".join(shape.format(tag=tag) for tag in ("visual", "collision")) for shape in _SHAPES
)
BESIDE = {
    "urdf": f'<robot name="r"><link name="a">{_URDF_SHAPES}</link></robot>',
    "sdf": f'<sdf version="1.9"><model name="r"><link name="a">{_SDF_SHAPES}</link></model></sdf>',
}


def binary() -> bytes:
    triangles = b"".join(
        np.zeros(3, "<f4").tobytes() + each.astype("<f4").tobytes() + b"\0\0" for each in CORNERS
    )
    return b"solid looks like text".ljust(80) + np.uint32(len(CORNERS)).tobytes() + triangles


def text() -> bytes:
    facets = "".join(
        "facet normal 0 0 0 outer loop "
        + " ".join(f"vertex {x:g} {y:g} {z:g}" for x, y, z in each)
        + " endloop endfacet\n"
        for each in CORNERS
    )
    return f"solid part\n{facets}endsolid part\n".encode()


@pytest.mark.parametrize("content", [binary, text])
def test_both_kinds_of_stl_have_their_triangles(tmp_path, content):
    path = tmp_path / "part.stl"
    path.write_bytes(content())
    np.testing.assert_allclose(read_stl(path), CORNERS)


def test_corners_that_triangles_share_are_written_once():
    lines = as_obj(CORNERS).splitlines()
    assert sum(line.startswith("v ") for line in lines) == 4
    assert sum(line.startswith("f ") for line in lines) == 2


def test_meshes_are_found_near_the_file_whatever_package_they_are_of(tmp_path):
    folder = tmp_path / "robot" / "urdf"
    (tmp_path / "robot" / "meshes").mkdir(parents=True)
    folder.mkdir()
    mesh = tmp_path / "robot" / "meshes" / "part.stl"
    mesh.write_bytes(text())
    for name in ("package://robot/meshes/part.stl", "package:///meshes/part.stl", str(mesh)):
        path = find_mesh(folder, name)
        assert path is not None
        assert path.samefile(mesh)
    assert find_mesh(folder, "package://robot/meshes/other.stl") is None
    assert find_mesh(folder, "") is None


@pytest.mark.parametrize("form", BESIDE)
def test_a_relative_name_is_that_of_a_mesh_beside_the_model(tmp_path, monkeypatch, form):
    home, elsewhere = tmp_path / "the model", tmp_path / "elsewhere"
    for folder, size in ((home, 1.0), (elsewhere, 2.0)):
        (folder / "parts").mkdir(parents=True)
        (folder / "parts" / "a.obj").write_text(as_obj(size * CORNERS))
    (home / f"r.{form}").write_text(BESIDE[form])
    for place, name in ((home, "r"), (elsewhere, "../the model/r"), (elsewhere, home / "r")):
        monkeypatch.chdir(place)
        path = Path(f"{name}.{form}")
        plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
        assert add_model(plant, path).notes == []
        inspector = scene_graph.model_inspector()
        frame = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName("a").index())
        (drawn,) = inspector.GetGeometries(frame, Role.kIllustration)
        source = inspector.GetShape(drawn).source().path()
        assert source.samefile(home / "parts" / "a.obj")
        add_model(MultibodyPlant(0.0), path)  # which is not drawn


def test_an_stl_is_drawn_where_it_is_and_others_are_named(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "part.stl").write_bytes(binary())
    (tmp_path / "r.urdf").write_text(URDF)
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 1e-3)
    model = add_model(plant, tmp_path / "r.urdf")
    assert model.notes == ["not drawn: file:///gone/other.dae"]
    inspector = scene_graph.model_inspector()
    frame = plant.GetBodyFrameIdOrThrow(plant.GetBodyByName("a").index())
    (drawn,) = inspector.GetGeometries(frame, Role.kIllustration)
    assert inspector.GetGeometries(frame, Role.kProximity) == []
    np.testing.assert_allclose(inspector.GetPoseInFrame(drawn).translation(), (0.1, 0.0, 0.0))
    colour = inspector.GetIllustrationProperties(drawn).GetProperty("phong", "diffuse")
    assert (colour.r(), colour.g(), colour.b()) == (1.0, 0.0, 0.0)
