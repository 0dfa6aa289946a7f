"""Wires and misbehaviour between processes."""

import mmap
import struct
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from parapod.systems.hardware.emulation.harness import (
    KINDS,
    UNPLUGGED,
    Harness,
    MutedHarness,
    SharedHarness,
)

SIZES = {"legs.voltage": 4, "legs.stop": 1, "legs.limits": 12, "imu.gyro": 3}
PARTS = ("legs", "imu")
# What another process begins with.
OTHER = f"""
import sys, time
from pathlib import Path
from parapod.systems.hardware.emulation.harness import SharedHarness
harness = SharedHarness(Path(sys.argv[1]), {SIZES}, {PARTS})
"""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "wires"


@pytest.fixture
def harness(path):
    return SharedHarness(path, SIZES, PARTS, is_new=True)


@pytest.fixture
def other(path, harness):
    """The same wires as another process opens them."""
    return SharedHarness(path, SIZES, PARTS)


@pytest.fixture
def process(path, harness):
    """Starts another process that runs some code with the same wires."""
    started = []

    def start(code):
        command = [sys.executable, "-c", OTHER + code, str(path)]
        pipe = subprocess.PIPE
        program = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        started.append(program)
        return program

    yield start
    for program in started:
        program.stdin.close()
        program.stdout.close()
        program.kill()
        program.wait()


# Wires


@pytest.mark.parametrize("reader", ["harness", "other"])
def test_what_is_set_is_read_to_the_last_bit(request, harness, reader):
    reader = request.getfixturevalue(reader)
    values = (0.1, -1.0 / 3.0, 1e300, float("-inf"))
    harness.set("legs.voltage", values)
    assert reader.get("legs.voltage") == values
    harness.set("legs.stop", [1])
    assert reader.get("legs.stop") == (1.0,)


def test_signals_and_misbehaviours_lie_apart(harness, other):
    for k, (name, size) in enumerate(SIZES.items()):
        harness.set(name, [k + 1.0] * size)
    for part in PARTS:
        harness.misbehaviour(part).begin("off", 1.0)
    for k, (name, size) in enumerate(SIZES.items()):
        assert other.get(name) == (k + 1.0,) * size
    harness.misbehaviour("legs").end()
    assert other.misbehaviour("imu").kind == "off"


@pytest.mark.parametrize("values", [(), (1.0,) * 3, (1.0,) * 5])
@pytest.mark.parametrize("make", [lambda shared: shared, lambda _: Harness(SIZES)])
def test_another_number_of_elements_is_refused_and_changes_nothing(harness, make, values):
    wires = make(harness)
    wires.set("legs.voltage", (1.0, 2.0, 3.0, 4.0))
    with pytest.raises(ValueError, match=f"^legs.voltage has 4 elements, not {len(values)}$"):
        wires.set("legs.voltage", values)
    assert wires.get("legs.voltage") == (1.0, 2.0, 3.0, 4.0)


def test_a_signal_that_there_is_not_is_refused(harness):
    with pytest.raises(KeyError):
        harness.get("legs.colour")
    with pytest.raises(KeyError):
        harness.set("legs.colour", [1.0])
    with pytest.raises(KeyError):
        harness.misbehaviour("arm")


def test_what_is_no_number_is_refused_before_it_is_on_the_wires(harness, other):
    harness.set("legs.stop", [1.0])
    with pytest.raises(struct.error, match="float"):
        harness.set("legs.stop", ["x"])
    assert other.get("legs.stop") == (1.0,)


def test_new_wires_leave_those_of_older_processes_alone(path, harness):
    harness.set("legs.stop", [1.0])
    newer = SharedHarness(path, SIZES, PARTS, is_new=True)
    assert newer.get("legs.stop") == (0.0,)
    newer.set("legs.stop", [0.5])
    assert harness.get("legs.stop") == (1.0,)


def test_wires_that_nobody_has_made_are_not_opened(tmp_path):
    with pytest.raises(FileNotFoundError):
        SharedHarness(tmp_path / "none", SIZES, PARTS)


def test_a_muted_wire_is_read_but_not_set(harness, other):
    muted = MutedHarness(harness, ["legs.voltage"])
    harness.set("legs.voltage", (1.0,) * 4)
    muted.set("legs.voltage", (2.0,) * 4)
    muted.set("legs.stop", (1.0,))
    assert muted.get("legs.voltage") == other.get("legs.voltage") == (1.0,) * 4
    assert other.get("legs.stop") == (1.0,)


def test_reads_between_two_processes_are_never_torn(harness, process):
    writer = process("""
print(flush=True)
k = 0
while True:
    k += 1
    harness.set("legs.limits", [float(k)] * 12)
""")
    writer.stdout.readline()
    seen, last, reads = set(), 0.0, 0
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        values = harness.get("legs.limits")
        assert len(set(values)) == 1, values
        assert values[0] >= last
        last = values[0]
        seen.add(last)
        reads += 1
    assert writer.poll() is None
    if len(seen) < 20:
        pytest.skip(f"the machine let the writer run {len(seen)} times while {reads} were read")


def test_the_count_by_which_torn_reads_are_known_never_goes_back(harness, process, path):
    writer = process("""
print(flush=True)
while True:
    harness.set("legs.voltage", [1.0] * 4)
""")
    writer.stdout.readline()
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, prot=mmap.PROT_READ) as memory:
        begun, last = time.monotonic(), 0
        while last < 1000 or time.monotonic() < begun + 0.3:
            assert time.monotonic() < begun + 60.0, "nothing is written"
            for _ in range(1000):
                (count,) = struct.unpack_from("=q", memory)  # of the first signal
                assert count >= last
                last = count


@pytest.fixture
def never_waits(monkeypatch):
    """never_waits() fails readings that wait from then on: those ask for the time."""

    def monotonic():
        raise AssertionError("a reading at rest waits")

    clock = SimpleNamespace(monotonic=monotonic)
    name = "parapod.systems.hardware.emulation.harness.time"
    return lambda: monkeypatch.setattr(name, clock)


def test_wires_that_nobody_writes_are_read_without_waiting(harness, other, never_waits):
    """Whatever the number of writes before."""
    never_waits()
    for k in range(4):
        harness.set("legs.stop", [float(k)])
        assert other.get("legs.stop") == (float(k),)


def test_a_write_after_one_that_was_broken_off_is_read_without_waiting(
    harness, other, path, never_waits
):
    with open(path, "r+b") as file, mmap.mmap(file.fileno(), 0) as memory:
        struct.pack_into("=q", memory, 0, 7)  # the count of the first signal
    never_waits()
    harness.set("legs.voltage", [1.0, 2.0, 3.0, 4.0])
    assert other.get("legs.voltage") == (1.0, 2.0, 3.0, 4.0)


# Misbehaviour


@pytest.mark.parametrize("kind", KINDS)
def test_a_misbehaviour_told_here_is_done_there(harness, other, kind):
    told, done = harness.misbehaviour("imu"), other.misbehaviour("imu")
    assert done.kind is None
    told.begin(kind, 12.5)
    assert done.kind == kind
    assert done.is_unplugged == (kind == UNPLUGGED)
    assert other.misbehaviour("legs").kind is None
    told.end()
    assert done.kind is None
    assert done.answers(12.5)


def test_a_misbehaviour_told_by_one_process_is_seen_by_another(harness, process, until):
    program = process("""
misbehaviour = harness.misbehaviour("imu")
for line in sys.stdin:
    if line.strip() == "well":
        misbehaviour.end()
    else:
        misbehaviour.begin(line.strip(), time.monotonic())
""")
    ours = harness.misbehaviour("imu")
    for line, kind in (("garbage", "garbage"), (UNPLUGGED, UNPLUGGED), ("well", None)):
        print(line, file=program.stdin, flush=True)
        assert until(lambda kind=kind: ours.kind == kind, timeout=60.0)


def test_a_stuck_value_is_that_of_each_beginning(harness, other):
    told, done = harness.misbehaviour("imu"), other.misbehaviour("imu")
    assert done.shown((1.0,), 0.0) == (1.0,)
    told.begin("stuck", 0.5)
    assert done.shown((2.0,), 0.6) == (2.0,)
    assert done.shown((3.0,), 0.7) == (2.0,)
    told.end()
    assert done.shown((4.0,), 0.8) == (4.0,)
    told.begin("stuck", 0.9)
    assert done.shown((5.0,), 1.0) == (5.0,)
    assert done.shown((6.0,), 1.1) == (5.0,)


def test_an_unknown_kind_is_refused_and_told_to_nobody(harness, other):
    with pytest.raises(ValueError, match="'tired' is not one of"):
        harness.misbehaviour("imu").begin("tired", 0.0)
    assert other.misbehaviour("imu").kind is None
