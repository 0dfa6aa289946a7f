from pathlib import Path

import numpy as np
import pytest

from parapod.sims.output.logs.files import read_log
from parapod.sims.output.logs.mcap import write_mcap
from parapod.sims.output.logs.stored import open_log
from parapod.systems.core.errors import OutputError

pytest.importorskip("mcap")
pytest.importorskip("rosbags")
COUNT = 7
# Units and sizes; names that ROS 2 does not admit, that collide when they are changed, or that
# fields and topics have already.
SIGNALS = {
    "legs.extension": ("m", 4),
    "Legs.extension": ("m", 2),
    "legs.left.foot": ("N, N m", 6),
    "legs.left_foot": ("°", 1),
    "status.age": ("s", 1),
    "legs.0": ("µm # of nothing", 3),
    "tf.t": ("V", 2),
    "scene.header": ("", 1),
    "f0": ("1", 1),
    "t.": ("rad", 1),
    "phase": ("", 1),
    "loop.phase": ("", 2),
    "legs.nothing": ("A", 0),
}
UNITS = {name: unit for name, (unit, _) in SIGNALS.items()}
TIMES = 0.1 + 0.25 * np.arange(COUNT)  # a chunk each


def samples(seed):
    """Random numbers of every size, and some that JSON has not."""
    random = np.random.default_rng(seed)
    signals = {
        name: random.normal(size=(COUNT, size)) * 10.0 ** random.integers(-300, 300)
        for name, (_, size) in SIGNALS.items()
    }
    signals["legs.extension"][2] = np.nan, np.inf, -np.inf, -0.0
    return signals


@pytest.fixture
def path(tmp_path):
    """A log of all signals."""
    path = tmp_path / "log.mcap"
    write_mcap(path, TIMES, samples(0), UNITS, {"scenario": "seed: 1\n"})
    return path


@pytest.mark.parametrize("seed", range(3))
def test_a_log_is_read_as_it_was_written(tmp_path, seed):
    path, signals = tmp_path / "log.mcap", samples(seed)
    write_mcap(path, TIMES, signals, UNITS, {"scenario": "seed: 1\n"})
    log = read_log(path)
    np.testing.assert_array_equal(log.time, TIMES)
    assert [*log.signals] == [*SIGNALS]
    for name, values in signals.items():
        np.testing.assert_array_equal(log.signals[name], values)
    assert [*log.metadata["units"].items()] == [*UNITS.items()]
    assert log.metadata["scenario"] == "seed: 1\n"
    assert log.metadata["wall_time"] == pytest.approx(TIMES[0])


def test_other_readers_have_the_same_numbers_from_the_file_alone(path):
    from rosbags.highlevel import AnyReader

    expected = samples(0)
    fields = {
        each.name: (f"/{part}", each.field)
        for part, channel in channels(path)
        for each in channel.signals
        if each.size
    }
    assert fields["legs.extension"] == ("/legs", "extension")
    assert fields["f0"] == ("/loop", "f0")
    assert len(set(fields.values())) == len(fields) == len(SIGNALS) - 1
    read = {}
    with AnyReader([path]) as reader:
        for connection, stamp, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
            assert stamp == round(1e9 * message.t)
            read.setdefault(connection.topic, []).append(message)
    for name, (topic, field) in fields.items():
        values = np.array([getattr(each, field) for each in read[topic]])
        np.testing.assert_array_equal(values.reshape(COUNT, -1), expected[name])
        np.testing.assert_array_equal([each.t for each in read[topic]], TIMES)


def channels(path):
    """Part and description of each channel of a log."""
    return [
        (channel.topic.removeprefix("/"), channel) for channel in open_log(path)._channels.values()
    ]


def test_definitions_have_names_and_units(path):
    from mcap.reader import make_reader

    with open(path, "rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    by_topic = {each.topic: each for each in summary.channels.values()}
    assert {each.message_encoding for each in by_topic.values()} == {"cdr"}
    schema = summary.schemas[by_topic["/legs"].schema_id]
    assert (schema.name, schema.encoding) == ("parapod_msgs/msg/Legs", "ros2msg")
    own, header, time = schema.data.decode().split("=" * 80 + "\n")
    assert "float64[4] extension  # legs.extension [m]\n" in own
    assert "float64 left_foot_2  # legs.left_foot [°]\n" in own
    assert header.startswith("MSG: std_msgs/Header\n")
    assert time.startswith("MSG: builtin_interfaces/Time\n")


@pytest.mark.parametrize("in_chunks", [True, False])
def test_a_log_that_was_written_anew_is_the_same(path, tmp_path, in_chunks):
    from mcap.stream_reader import StreamReader
    from mcap.writer import Writer

    anew = tmp_path / "anew.mcap"
    with open(path, "rb") as stream, open(anew, "wb") as sink:
        writer = Writer(sink, chunk_size=300, use_chunking=in_chunks)
        writer.start()
        numbers = {}
        for record in StreamReader(stream).records:
            match type(record).__name__:
                case "Metadata":
                    writer.add_metadata(record.name, record.metadata)
                case "Schema":
                    numbers[record.id] = writer.register_schema(
                        record.name, record.encoding, record.data
                    )
                case "Channel":
                    schema = numbers[record.schema_id]
                    writer.register_channel(record.topic, "cdr", schema, record.metadata)
                case "Message":
                    writer.add_message(
                        record.channel_id, record.log_time, record.data, record.publish_time
                    )
                case "DataEnd":
                    break
        writer.finish()
    one, other = read_log(path), read_log(anew)
    assert one.metadata == other.metadata
    np.testing.assert_array_equal(one.time, other.time)
    assert [*one.signals] == [*other.signals]
    for name, values in one.signals.items():
        np.testing.assert_array_equal(values, other.signals[name])


def test_a_log_cut_anywhere_is_readable_up_to_its_last_whole_chunk(path):
    whole, expected, counts = path.read_bytes(), samples(0), []
    for size in range(60, len(whole), 10):
        path.write_bytes(whole[:size])
        log = read_log(path)
        count = len(log.time)
        np.testing.assert_array_equal(log.time, TIMES[:count])
        for name, values in log.signals.items():
            np.testing.assert_array_equal(values, expected[name][:count])
        counts.append(count)
    assert counts == sorted(counts)
    assert set(counts) == {*range(COUNT + 1)}


def test_logs_with_json_messages_of_each_port_are_read_as_ever():
    log = read_log(Path(__file__).with_name("json.mcap"))
    time = 0.25 * np.arange(12)
    ones = np.ones(12)
    np.testing.assert_array_equal(log.time, time)
    assert [*log.signals] == ["legs.extension", "status.age", "phase"]
    np.testing.assert_array_equal(
        log.signals["legs.extension"],
        np.column_stack((time, -time, 1.0 / (1.0 + np.arange(12)), 1e-300 * ones)),
    )
    age = np.where(np.arange(12) % 3, np.nan, np.arange(12) + 0.5)
    np.testing.assert_array_equal(log.signals["status.age"], age[:, None])
    np.testing.assert_array_equal(log.signals["phase"], (np.arange(12) // 4)[:, None])
    assert log.metadata["units"] == {"legs.extension": "m", "status.age": "s", "phase": ""}
    assert log.metadata["scenario"] == "seed: 1\n"
    assert log.metadata["wall_time"] == 1_790_000_000.0
    assert open_log(Path(__file__).with_name("json.mcap")).clock == 1_790_000_000.0


@pytest.mark.parametrize("content", [b"", b"nothing of the kind", b"\x89MCAP0\r\nwrong"])
def test_what_is_no_log_is_refused(tmp_path, content):
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(OutputError, match=r"log\.mcap"):
        read_log(path)


def test_a_log_that_is_not_there_is_named(tmp_path):
    with pytest.raises(OutputError, match="No such file"):
        read_log(tmp_path / "nowhere.mcap")
