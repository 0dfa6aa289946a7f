import subprocess
import sys
import time

import numpy as np
import pytest

from parapod.sims.lab.mcap import McapLog, read_mcap
from parapod.systems.core.errors import OutputError

pytest.importorskip("mcap")
UNITS = {"legs.extension": "m", "status.age": "s"}


def test_a_log_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "log.mcap"
    times = 0.01 * np.arange(100)
    extension = np.random.default_rng(0).normal(size=(100, 4))
    age = np.full((100, 1), np.nan)
    with McapLog(path, UNITS, {"scenario": "seed: 1\n"}) as log:
        for k, t in enumerate(times):
            log.write(t, [extension[k], age[k]])
    shown = read_mcap(path)
    np.testing.assert_array_equal(shown.time, times)
    np.testing.assert_array_equal(shown.signals["legs.extension"], extension)
    assert np.isnan(shown.signals["status.age"]).all()
    assert shown.metadata["scenario"] == "seed: 1\n"
    assert shown.metadata["units"] == UNITS
    assert abs(shown.metadata["wall_time"] - time.time()) < 60.0


def test_other_readers_of_mcap_see_the_topics(tmp_path):
    from mcap.reader import make_reader

    path = tmp_path / "log.mcap"
    with McapLog(path, UNITS, {}) as log:
        log.write(0.0, [np.zeros(4), np.zeros(1)])
    with open(path, "rb") as stream:
        topics = {channel.topic for _, channel, _ in make_reader(stream).iter_messages()}
    assert topics == set(UNITS)


WRITER = """
import sys, time
import numpy as np
from pathlib import Path
from parapod.sims.lab.mcap import McapLog
with McapLog(Path(sys.argv[1]), {"a": "m", "b": "V"}, {}) as log:
    for k in range(100000):
        log.write(time.time(), [np.zeros(4), np.zeros(12)])
        if k == 0:
            print("begun", flush=True)
        time.sleep(0.005)
"""


def test_the_log_of_a_killed_program_is_readable_up_to_the_last_second(tmp_path):
    path = tmp_path / "log.mcap"
    writer = subprocess.Popen([sys.executable, "-c", WRITER, path], stdout=subprocess.PIPE)
    try:
        assert writer.stdout.readline() == b"begun\n"
        time.sleep(1.0)
    finally:
        writer.kill()
        killed = time.time()
        writer.wait()
    log = read_mcap(path)
    assert killed - 1.0 < log.time[-1] <= killed
    assert len(log.signals["b"]) == len(log.time)
    assert log.time[0] < killed - 0.9


def test_a_log_cut_anywhere_is_readable_up_to_there(tmp_path):
    path = tmp_path / "log.mcap"
    with McapLog(path, {"a": "m"}, {}) as log:
        for k in range(20):
            log.write(float(k), [np.array([float(k)])])
    whole = path.read_bytes()
    counts = []
    for size in range(200, len(whole), 97):
        path.write_bytes(whole[:size])
        shown = read_mcap(path)
        np.testing.assert_array_equal(shown.time, np.arange(len(shown.time)))
        counts.append(len(shown.time))
    assert counts == sorted(counts)
    assert counts[-1] == 20


@pytest.mark.parametrize("content", [b"", b"nothing of the kind", b"\x89MCAP0\r\nwrong"])
def test_what_is_no_log_is_refused(tmp_path, content):
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(OutputError, match=r"log\.mcap"):
        read_mcap(path)


def test_a_log_that_cannot_be_written_is_refused_before_it_begins(tmp_path):
    with pytest.raises(OutputError, match="does not exist"):
        McapLog(tmp_path / "nowhere" / "log.mcap", UNITS, {})
    with pytest.raises(OutputError, match="No such file"):
        read_mcap(tmp_path / "nowhere.mcap")
