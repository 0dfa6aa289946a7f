"""Logs of programs that run, are killed, have a slow disk or none."""

import os
import shlex
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from parapod.diagrams.machine import find_machine
from parapod.sims.output.logs.files import read_log
from parapod.sims.output.logs.live import LiveLog
from parapod.systems.core.errors import OutputError
from parapod.systems.core.scenario_file import dump_scenario
from tests.conftest import standing_still

pytest.importorskip("mcap")
pytest.importorskip("rosbags")
UNITS, SIZES = {"legs.extension": "m", "status.age": "s"}, (4, 1)


def until(condition, timeout=60.0):
    """Waits for what must happen."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(1e-3)


@pytest.fixture
def told():
    return []


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.mcap"


def test_a_log_is_read_as_it_was_written(path, told):
    times = 0.01 * np.arange(1000)
    extension = np.random.default_rng(0).normal(size=(1000, 4))
    age = np.where(np.arange(1000) % 2, np.nan, np.inf)
    before = time.time()
    with LiveLog(path, UNITS, SIZES, {"scenario": "seed: 1\n"}, told.append) as log:
        for k, t in enumerate(times):
            log.write(t, [extension[k], age[k]])
    shown = read_log(path)
    np.testing.assert_array_equal(shown.time, times)
    np.testing.assert_array_equal(shown.signals["legs.extension"], extension)
    np.testing.assert_array_equal(shown.signals["status.age"][:, 0], age)
    assert shown.metadata["scenario"] == "seed: 1\n"
    assert shown.metadata["units"] == UNITS
    assert before <= shown.metadata["wall_time"] <= time.time()
    assert (told, log.lost) == ([], 0)


def test_what_was_written_is_in_the_file_soon(path):
    with LiveLog(path, UNITS, SIZES, {}) as log:
        log.write(0.5, [np.zeros(4), [0.0]])
        until(lambda: read_log(path).time.tolist() == [0.5])


# SIGINT is ignored by children of shells without job control, hence the default handler.
WRITER = """
import signal, sys, time
from pathlib import Path
import numpy as np
from parapod.sims.output.logs.live import LiveLog
signal.signal(signal.SIGINT, signal.default_int_handler)
with LiveLog(Path(sys.argv[1]), {"a": "m", "b": "V"}, (4, 12), {}) as log:
    print(log.process, flush=True)
    for k in range(100000):
        log.write(time.time(), [np.zeros(4), np.zeros(12)])
        time.sleep(0.005)
"""


@pytest.fixture
def writer(path):
    """A program that logs, and the number of the process that writes."""
    program = subprocess.Popen(
        [sys.executable, "-c", WRITER, path],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    yield program, int(program.stdout.readline())
    program.kill()
    program.communicate()


def is_over(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    with open(f"/proc/{process}/stat") as stat:
        return stat.read().rpartition(")")[2].split()[0] == "Z"


@pytest.mark.parametrize("name", ["SIGKILL", "SIGINT"])
def test_the_log_of_a_program_that_is_ended_is_whole(writer, path, name):
    from mcap.reader import make_reader

    program, process = writer
    until(lambda: len(read_log(path).time) > 20)
    killed = time.time()
    os.killpg(program.pid, getattr(signal, name))  # Ctrl-C is for all of a terminal's programs
    program.wait(60.0)
    ended = time.time()
    until(lambda: is_over(process))
    log = read_log(path)
    assert killed - 1.0 < log.time[-1] <= ended
    assert len(log.signals["b"]) == len(log.time) > 20
    with open(path, "rb") as stream:
        assert make_reader(stream).get_summary() is not None


def test_a_process_that_is_killed_is_told_at_once_and_the_program_goes_on(path, told):
    log = LiveLog(path, UNITS, SIZES, {}, told.append)
    log.__enter__()
    log.write(0.0, [np.zeros(4), [0.0]])
    until(lambda: len(read_log(path).time) == 1)
    os.kill(log.process, signal.SIGKILL)
    until(lambda: log.write(1.0, [np.zeros(4), [0.0]]) or told)
    log.write(2.0, [np.zeros(4), [0.0]])
    with pytest.raises(OutputError, match=r"cannot write .*: its process has ended$"):
        log.__exit__(None, None, None)
    assert len(told) == 1
    assert read_log(path).time[0] == 0.0


def test_a_disk_that_becomes_full_is_told_at_once(path, told):
    # As on a full disk: the kernel lets the process write so much and no more.
    limit = f'ulimit -f 40; exec {shlex.quote(sys.executable)} -c "$0" {shlex.quote(str(path))}'
    program = """
import sys, time
from pathlib import Path
import numpy as np
from parapod.sims.output.companion import Companion
from parapod.sims.output.logs.live import LiveLog
from parapod.systems.core.errors import OutputError
import signal
# Its last words are heard when the pipe to it is broken already.
lines = Companion.lines
def late(companion):
    companion._process.wait()
    time.sleep(0.2)
    return lines(companion)
Companion.lines = late
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
told = []
try:
    with LiveLog(Path(sys.argv[1]), {"a": "m"}, (12,), {}, told.append) as log:
        for k in range(2000):
            log.write(0.001 * k, [np.full(12, 0.1 * k)])
            time.sleep(0.001)
            if told:
                print("told after", k)
                break
except OutputError as error:
    print("error", error)
"""
    done = subprocess.run(["sh", "-c", limit, program], capture_output=True, text=True)
    said, error = done.stdout.splitlines()
    assert said.startswith("told after")
    assert error.endswith("File too large")
    assert len(read_log(path).time) > 10


def test_a_disk_that_stands_still_costs_samples_and_no_time(path, told, judge):
    with LiveLog(path, UNITS, SIZES, {}, told.append) as log:
        log.write(0.0, [np.zeros(4), [0.0]])
        with standing_still(log.process), judge() as judged:
            for k in range(40_000):  # more than the pipe holds
                log.write(float(k), [np.full(4, k), [0.0]])
    judged.check(4.0)
    assert log.lost > 1000
    assert "the disk is too slow; samples are left out" in told[0]
    assert told[-1].endswith(f": {log.lost} samples are missing")
    shown = read_log(path)
    assert len(shown.time) == 40_001 - log.lost
    np.testing.assert_array_equal(shown.signals["legs.extension"][1:, 2], shown.time[1:])


def test_a_log_that_cannot_be_written_is_refused_before_it_begins(tmp_path):
    with pytest.raises(OutputError, match="does not exist"):
        LiveLog(tmp_path / "nowhere" / "log.mcap", UNITS, SIZES, {})


def test_the_machine_is_drawn_behind_the_samples(path, told):
    from rosbags.highlevel import AnyReader

    machine = find_machine("levelling_platform")
    scenario = dump_scenario(machine.scenario(backend="kinematic"))
    metadata = {"experiment": "level", "scenario": scenario}
    units = {"legs.extension": "m", "attitude_estimated": "rad"}
    with LiveLog(path, units, (4, 2), metadata, told.append) as log:
        for k in range(3):
            log.write(0.1 * k, [np.full(4, 0.41), np.zeros(2)])
    assert told == []
    with AnyReader([path]) as reader:
        counts = {each.topic: each.msgcount for each in reader.connections}
        stamps = {}
        for connection, stamp, _ in reader.messages():
            stamps.setdefault(connection.topic, []).append(stamp)
    assert counts == {"/legs": 3, "/loop": 3, "/robot_description": 1, "/scene": 1, "/tf": 3}
    assert stamps["/tf"] == stamps["/legs"]
    assert len(read_log(path).time) == 3
