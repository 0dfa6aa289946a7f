import runpy
import xml.etree.ElementTree as ET
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from parapod.diagrams.machine import find_machine, list_machines
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.lab.subject import Subject, draw_log
from parapod.sims.output.drawn_bodies import DrawnBodies
from parapod.sims.output.logs.files import read_log
from parapod.sims.output.logs.mcap import write_mcap
from parapod.systems.core.scenario_file import dump_scenario
from parapod.systems.hardware.buses.ros2.scene import markers

pytest.importorskip("mcap")
pytest.importorskip("rosbags")

COUNT = 3
DOCS = Path(__file__).parents[3] / "docs" / "foxglove"
MACHINES = [machine.name for machine in list_machines()]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """An MCAP log of a platform that rises and tilts."""
    path = tmp_path_factory.mktemp("scene") / "log.mcap"
    signals = {
        "legs.extension": np.linspace(0.42, 0.40, COUNT)[:, None] * np.ones(4),
        "attitude_estimated": np.linspace(0.0, 0.05, COUNT)[:, None] * np.array([1.0, 0.0]),
    }
    machine = find_machine("levelling_platform")
    metadata = {
        "experiment": "level",
        "parapod": "0.1.0",
        "scenario": dump_scenario(machine.scenario(backend="kinematic")),
    }
    units = {name: machine.unit(name) for name in signals}
    write_mcap(
        path, 100.25 + np.arange(COUNT), signals, units, metadata, partial(draw_log, metadata)
    )
    return path


def drawing(path):
    """Topic, time and content of each message that draws."""
    from mcap.reader import make_reader

    with open(path, "rb") as stream:
        return [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages()
            if channel.topic in ("/tf", "/scene", "/robot_description")
        ]


@pytest.fixture(scope="module")
def messages(log):
    """By topic, the type and times [ns] and content of its messages, in the order of the file."""
    from rosbags.highlevel import AnyReader

    by_topic = {}
    with AnyReader([log]) as reader:
        for connection, stamp, data in reader.messages():
            kind = connection.msgtype
            _, times, contents = by_topic.setdefault(connection.topic, (kind, [], []))
            times.append(stamp)
            contents.append(reader.deserialize(data, kind))
    return by_topic


def test_the_messages_are_of_types_that_rviz_and_foxglove_know(messages):
    assert messages["/tf"][0] == "tf2_msgs/msg/TFMessage"
    assert messages["/scene"][0] == "visualization_msgs/msg/MarkerArray"
    assert messages["/robot_description"][0] == "std_msgs/msg/String"


def test_readers_have_the_messages_in_the_order_of_time(log):
    from rosbags.highlevel import AnyReader

    with AnyReader([log]) as reader:
        times = [stamp for _, stamp, _ in reader.messages()]
    assert times == sorted(times)
    assert len(times) == 3 * COUNT + 2


def test_transforms_have_the_times_of_the_samples(messages):
    stamps = [round(1e9 * t) for t in 100.25 + np.arange(COUNT)]
    _, times, contents = messages["/tf"]
    assert times == stamps == messages["/legs"][1]
    for time, content in zip(times, contents, strict=True):
        for each in content.transforms:
            stamp = each.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == time


def test_each_body_that_is_seen_has_a_transform_from_the_world(messages):
    _, times, (scene,) = messages["/scene"]
    assert times == messages["/tf"][1][:1]
    bodies = list(dict.fromkeys(marker.header.frame_id for marker in scene.markers))
    assert len({(marker.ns, marker.id) for marker in scene.markers}) == len(scene.markers)
    assert all(marker.frame_locked and marker.color.a > 0.0 for marker in scene.markers)
    for content in messages["/tf"][2]:
        assert [each.child_frame_id for each in content.transforms] == bodies
        assert {each.header.frame_id for each in content.transforms} == {"world"}
        for each in content.transforms:
            q = each.transform.rotation
            assert q.x**2 + q.y**2 + q.z**2 + q.w**2 == pytest.approx(1.0)
    (description,) = messages["/robot_description"][2]
    links = [link.get("name") for link in ET.fromstring(description.data).iter("link")]
    assert links == ["world", *bodies]


def test_the_bodies_are_where_the_drawing_has_them(messages, log):
    read = read_log(log)
    shapes = {name: each.shape[1:] for name, each in read.signals.items()}
    subject = Subject.from_metadata("log", shapes, read.metadata)
    twin = subject.drawn.make()
    heights = []
    for k, content in enumerate(messages["/tf"][2]):
        twin.show({name: each[k] for name, each in read.signals.items()})
        graph, context = twin.scene_graphs()["measured"]
        query = graph.get_query_output_port().Eval(context)
        poses = {
            f"measured/{graph.model_inspector().GetName(frame).replace('::', '/')}": (
                query.GetPoseInWorld(frame)
            )
            for frame in graph.model_inspector().GetAllFrameIds()
        }
        assert len(DrawnBodies(twin).poses()) == len(content.transforms)
        for each in content.transforms:
            if each.child_frame_id in poses:
                pose, at = poses[each.child_frame_id], each.transform.translation
                np.testing.assert_allclose((at.x, at.y, at.z), pose.translation(), atol=1e-9)
                q, there = each.transform.rotation, pose.rotation().ToQuaternion().wxyz()
                np.testing.assert_allclose((q.w, q.x, q.y, q.z), there, atol=1e-9)
                if each.child_frame_id.endswith("base"):
                    heights.append(at.z)
    assert len(heights) == COUNT
    assert heights == sorted(heights)
    assert heights[-1] > heights[0] + 0.01


@pytest.mark.parametrize("name", MACHINES)
def test_the_urdf_has_the_solids_of_the_drawing_in_their_places(name):
    from pydrake.geometry import Box, Cylinder, Ellipsoid, Mesh, Role, SceneGraph, Sphere
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import BodyIndex

    def sizes(shape):
        match shape:
            case Box():
                return [*shape.size()]
            case Sphere():
                return 3 * [shape.radius()]
            case Ellipsoid():
                return 3 * [np.cbrt(shape.a() * shape.b() * shape.c())]
            case Cylinder():
                return [shape.radius(), shape.length()]
            case Mesh():
                return [*shape.scale3()]

    machine = find_machine(name)
    drawn = DrawnBodies(machine.view.twin(None, machine.scenario()))
    expected = drawn.visuals()
    plant, graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(graph)
    Parser(plant).AddModelsFromString(drawn.description(name), "urdf")
    inspector, bodies = graph.model_inspector(), set()
    for index in range(1, plant.num_bodies()):
        body = plant.get_body(BodyIndex(index))
        bodies.add(body.name())
        frame = plant.GetBodyFrameIdIfExists(body.index())
        geometries = inspector.GetGeometries(frame, Role.kIllustration)
        solids = expected[body.name()]
        assert len(geometries) == len(solids)
        order = sorted(geometries, key=lambda each: each.get_value())
        for geometry, solid in zip(order, solids, strict=True):
            pose = inspector.GetPoseInFrame(geometry)
            assert pose.IsNearlyEqualTo(solid.pose, 1e-6)
            shape = inspector.GetShape(geometry)
            np.testing.assert_allclose(sizes(shape), sizes(solid.shape), rtol=1e-6)
    assert bodies - {"world"} == {*expected}


def test_an_experiment_draws_its_machine_into_its_log(log, tmp_path):
    read, machine = read_log(log), find_machine("levelling_platform")
    signals = {name: (each, machine.unit(name)) for name, each in read.signals.items()}
    scenario = machine.scenario(backend="kinematic")
    find_experiment("level").write_log(tmp_path / "log.mcap", scenario, read.time, signals)
    drawn = drawing(tmp_path / "log.mcap")
    assert len(drawn) == COUNT + 2
    assert drawn == drawing(log)


def test_drawings_are_no_signals(log):
    assert [*read_log(log).signals] == ["legs.extension", "attitude_estimated"]


def test_meshes_of_a_log_are_drawn_without_their_files():
    from parapod.sims.output.logs.scene_messages import _made

    machine = find_machine("walking_chair")
    solids = DrawnBodies(machine.view.twin(None, machine.scenario())).visuals()
    meshes = [
        solid.shape
        for each in solids.values()
        for solid in each
        if type(solid.shape).__name__ == "Mesh"
    ]
    drawn = [marker for marker in markers(_made, solids, 0) if marker.type == 11]
    assert len(drawn) == len(meshes) > 0
    for marker, shape in zip(drawn, meshes, strict=True):
        text = Path(shape.source().path()).read_text()
        vertices = {
            tuple(map(float, line.split()[1:4]))
            for line in text.splitlines()
            if line.startswith("v ")
        }
        assert len(marker.points) % 3 == 0
        assert {(each.x, each.y, each.z) for each in marker.points} <= vertices


def test_a_log_of_which_nothing_can_be_drawn_says_why(tmp_path):
    from mcap.reader import make_reader

    path = tmp_path / "log.mcap"
    made = {"experiment": "nothing"}
    write_mcap(path, [0.0], {"a": [1.0]}, {"a": "m"}, made, partial(draw_log, made))
    with open(path, "rb") as stream:
        told = {each.name: each.metadata for each in make_reader(stream).iter_metadata()}
    assert "there is no experiment 'nothing'" in told["drawing"]["left_out"]


def test_signals_that_fit_no_drawing_do_not_cost_the_log(tmp_path):
    from mcap.reader import make_reader

    path = tmp_path / "log.mcap"
    machine = find_machine("levelling_platform")
    signals = {"legs.extension": np.full((5, 4), 0.42), "attitude_estimated": np.zeros((5, 1))}
    made = {"experiment": "level", "scenario": dump_scenario(machine.scenario())}
    write_mcap(
        path, np.arange(5), signals, dict.fromkeys(signals, "m"), made, partial(draw_log, made)
    )
    assert len(read_log(path).time) == 5
    with open(path, "rb") as stream:
        told = {each.name: each.metadata for each in make_reader(stream).iter_metadata()}
    assert told["drawing"]["left_out"]


@pytest.mark.parametrize("path", sorted(DOCS.glob("*.json")), ids=lambda path: path.stem)
def test_layouts_in_the_docs_are_those_of_the_machines(path):
    pytest.importorskip("foxglove")
    as_layout = runpy.run_path(DOCS / "layouts.py")["as_layout"]
    assert path.read_text() == as_layout(find_machine(path.stem))
