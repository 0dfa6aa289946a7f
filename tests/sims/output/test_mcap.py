import numpy as np
import pytest

from parapod.sims.output.logs.files import read_log
from parapod.sims.output.logs.mcap import write_mcap
from parapod.systems.core.errors import OutputError

pytest.importorskip("mcap")
UNITS = {"legs.extension": "m", "status.age": "s"}


def test_a_log_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "log.mcap"
    times = 0.01 * np.arange(100)
    extension = np.random.default_rng(0).normal(size=(100, 4))
    signals = {"legs.extension": extension, "status.age": np.full((100, 1), np.nan)}
    write_mcap(path, times, signals, UNITS, {"scenario": "seed: 1\n"})
    shown = read_log(path)
    np.testing.assert_array_equal(shown.time, times)
    np.testing.assert_array_equal(shown.signals["legs.extension"], extension)
    assert np.isnan(shown.signals["status.age"]).all()
    assert shown.metadata["scenario"] == "seed: 1\n"
    assert shown.metadata["units"] == UNITS
    assert shown.metadata["wall_time"] == 0.0


def test_other_readers_of_mcap_see_the_topics(tmp_path):
    from mcap.reader import make_reader

    path = tmp_path / "log.mcap"
    write_mcap(path, [0.0], {"legs.extension": np.zeros((1, 4)), "status.age": [0.0]}, UNITS, {})
    with open(path, "rb") as stream:
        topics = {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}
    assert topics == set(UNITS)


def test_a_log_that_was_written_anew_in_chunks_is_the_same(tmp_path):
    from mcap.stream_reader import StreamReader
    from mcap.writer import Writer

    path, anew = tmp_path / "log.mcap", tmp_path / "anew.mcap"
    write_mcap(path, np.arange(20), {"a": np.arange(20)}, {"a": "m"}, {"scenario": ""})
    with open(path, "rb") as stream, open(anew, "wb") as sink:
        writer = Writer(sink, chunk_size=300)
        writer.start()
        for record in StreamReader(stream).records:
            match type(record).__name__:
                case "Metadata":
                    writer.add_metadata(record.name, record.metadata)
                case "Schema":
                    writer.register_schema(record.name, record.encoding, record.data)
                case "Channel" if record.id == 1 and not record.topic.startswith("/"):
                    writer.register_channel("a", "json", 1, record.metadata)
                case "Message":
                    writer.add_message(1, record.log_time, record.data, record.publish_time)
                case "DataEnd":
                    break
        writer.finish()
    shown = read_log(anew)
    np.testing.assert_array_equal(shown.time, np.arange(20))
    np.testing.assert_array_equal(shown.signals["a"][:, 0], np.arange(20))
    assert shown.metadata["units"] == {"a": "m"}


def test_a_log_cut_anywhere_is_readable_up_to_there(tmp_path):
    path = tmp_path / "log.mcap"
    write_mcap(path, np.arange(20), {"a": np.arange(20)}, {"a": "m"}, {})
    whole = path.read_bytes()
    counts = []
    for size in range(200, len(whole), 97):
        path.write_bytes(whole[:size])
        shown = read_log(path)
        np.testing.assert_array_equal(shown.time, np.arange(len(shown.time)))
        counts.append(len(shown.time))
    assert counts == sorted(counts)
    assert counts[-1] == 20


@pytest.mark.parametrize("content", [b"", b"nothing of the kind", b"\x89MCAP0\r\nwrong"])
def test_what_is_no_log_is_refused(tmp_path, content):
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(OutputError, match=r"log\.mcap"):
        read_log(path)


def test_a_log_that_is_not_there_is_named(tmp_path):
    with pytest.raises(OutputError, match="No such file"):
        read_log(tmp_path / "nowhere.mcap")
