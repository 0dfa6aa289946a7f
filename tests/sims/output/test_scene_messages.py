import runpy
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from parapod.diagrams.machine import find_machine
from parapod.sims.lab.discovery import find_experiment
from parapod.sims.lab.subject import Subject, draw_log
from parapod.sims.output.logs.files import read_log
from parapod.sims.output.logs.mcap import write_mcap
from parapod.systems.core.scenario_file import dump_scenario

pytest.importorskip("mcap")
pytest.importorskip("foxglove")
POOL = pytest.importorskip("google.protobuf.descriptor_pool")

COUNT = 3
DOCS = Path(__file__).parents[3] / "docs" / "foxglove"


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
            if channel.topic in ("/tf", "/scene")
        ]


@pytest.fixture(scope="module")
def messages(log):
    """By topic, the channel's schema and times [ns] and content of its messages."""
    from google.protobuf import descriptor_pb2, message_factory
    from google.protobuf.descriptor_pool import DescriptorPool
    from mcap.reader import make_reader

    found = {}
    with open(log, "rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if schema.encoding == "protobuf":
                assert channel.message_encoding == "protobuf"
                pool = DescriptorPool()
                for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(file)
                kind = pool.FindMessageTypeByName(schema.name)
                content = message_factory.GetMessageClass(kind).FromString(message.data)
            else:
                assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
                content = message.data
            _, times, contents = found.setdefault(channel.topic, (schema, [], []))
            times.append(message.log_time)
            contents.append(content)
    return found


def test_topics_have_the_schemas_that_foxglove_publishes(messages):
    assert messages["/tf"][0].name == "foxglove.FrameTransforms"
    assert messages["/scene"][0].name == "foxglove.SceneUpdate"


def test_transforms_have_the_times_of_the_samples(messages):
    stamps = [round(1e9 * t) for t in 100.25 + np.arange(COUNT)]
    _, times, contents = messages["/tf"]
    assert times == stamps == messages["/legs"][1]
    for time, content in zip(times, contents, strict=True):
        for each in content.transforms:
            assert each.timestamp.seconds * 10**9 + each.timestamp.nanos == time


def test_each_body_that_is_seen_has_a_transform_from_the_world(messages):
    _, times, (update,) = messages["/scene"]
    assert times == messages["/tf"][1][:1]
    bodies = [entity.frame_id for entity in update.entities]
    assert len(bodies) == len(set(bodies)) == len({entity.id for entity in update.entities})
    assert all(entity.frame_locked for entity in update.entities)
    for content in messages["/tf"][2]:
        assert [each.child_frame_id for each in content.transforms] == bodies
        assert {each.parent_frame_id for each in content.transforms} == {"world"}
        for each in content.transforms:
            q = each.rotation
            assert q.x**2 + q.y**2 + q.z**2 + q.w**2 == pytest.approx(1.0)
    parts = [p for e in update.entities for p in (*e.cubes, *e.cylinders, *e.spheres, *e.models)]
    assert len(parts) >= len(bodies)
    assert all(part.color.a > 0.0 for part in parts)
    assert all(m.media_type == "model/obj" and m.data for e in update.entities for m in e.models)


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
        for each in content.transforms:
            if each.child_frame_id in poses:
                there = poses[each.child_frame_id].translation()
                at = each.translation
                np.testing.assert_allclose((at.x, at.y, at.z), there, atol=1e-9)
                if each.child_frame_id.endswith("base"):
                    heights.append(at.z)
    assert len(heights) == COUNT
    assert heights == sorted(heights)
    assert heights[-1] > heights[0] + 0.01


def test_an_experiment_draws_its_machine_into_its_log(log, tmp_path):
    read, machine = read_log(log), find_machine("levelling_platform")
    signals = {name: (each, machine.unit(name)) for name, each in read.signals.items()}
    scenario = machine.scenario(backend="kinematic")
    find_experiment("level").write_log(tmp_path / "log.mcap", scenario, read.time, signals)
    drawn = drawing(tmp_path / "log.mcap")
    assert len(drawn) == COUNT + 1
    assert drawn == drawing(log)


def test_drawings_are_no_signals(log):
    assert [*read_log(log).signals] == ["legs.extension", "attitude_estimated"]


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
    as_layout = runpy.run_path(DOCS / "layouts.py")["as_layout"]
    assert path.read_text() == as_layout(find_machine(path.stem))
