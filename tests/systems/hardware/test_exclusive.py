"""Devices that no two programs may have open, seen by two programs."""

import os
import subprocess
import sys
import threading

import pytest

from parapod.systems.hardware.device import Device, DeviceError
from parapod.systems.hardware.exclusive import is_kept, lock_path, only_program

# Says whether it could have the place, and keeps it until its input ends.
PROGRAM = """
import sys
from parapod.systems.hardware.exclusive import InUse, only_program
try:
    with only_program(sys.argv[1]):
        print("has it", flush=True)
        sys.stdin.read()
except InUse as error:
    print(error, flush=True)
"""


@pytest.fixture
def place(tmp_path):
    name = str(tmp_path / "bus")
    yield name
    lock_path(name).unlink(missing_ok=True)


@pytest.fixture
def other(place):
    """other(): another program that wants the place, and what it says."""
    programs = []

    def begin():
        program = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, place],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        programs.append(program)
        return program, program.stdout.readline().strip()

    yield begin
    for program in programs:
        program.kill()
        program.communicate()


class Part(Device):
    name = "part"

    def __init__(self, place, fails=False):
        self.place, self._fails, self.closed = place, fails, 0

    def configure(self):
        if self._fails:
            raise DeviceError(self.name, "is another one")

    def close(self):
        self.closed += 1


def test_another_program_waits_until_the_first_has_closed_all_its_devices(place, other):
    refusal = f"process {os.getpid()} has it open; end that program first"
    with Part(place):
        with Part(place):  # two devices of this program on one bus
            assert other()[1] == refusal
        assert other()[1] == refusal
    assert other()[1] == "has it"


def test_a_device_of_another_program_is_neither_configured_nor_closed(place, other):
    program, said = other()
    assert said == "has it"
    part = Part(place)
    with pytest.raises(DeviceError, match=f"^part: process {program.pid} has it open; end"), part:
        pytest.fail("opened")
    assert part.closed == 0
    with Part(""):  # what several may use
        pass
    # The kernel unlocks what a killed program had.
    program.kill()
    program.wait()
    with part:
        pass
    assert part.closed == 1


def test_a_device_that_refuses_is_closed_and_given_back(place, other):
    part = Part(place, fails=True)
    with pytest.raises(DeviceError, match="is another one"), part:
        pytest.fail("opened")
    assert part.closed == 1
    assert other()[1] == "has it"


def test_a_planted_link_is_not_followed(place, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    lock_path(place).symlink_to(victim)
    with pytest.raises(DeviceError, match=r"^part: .*symbolic link"), Part(place):
        pytest.fail("opened")
    assert victim.read_text() == "precious"


def test_a_lock_that_cannot_be_written_holds_all_the_same(place, other):
    lock_path(place).touch(0o444)  # as another user's, for all but root
    with only_program(place):
        assert is_kept(place)
        assert other()[1].endswith("has it open; end that program first")
    assert other()[1] == "has it"


def test_nothing_is_left_of_a_lock_and_looking_at_one_takes_it_from_nobody(place):
    assert not is_kept(place)
    looked = []
    over = threading.Event()

    def look():
        while not over.is_set():
            looked.append(is_kept(place))

    looking = threading.Thread(target=look)
    looking.start()
    try:
        for _ in range(200):
            with only_program(place):
                assert is_kept(place)
    finally:
        over.set()
        looking.join()
    assert looked
    assert not lock_path(place).exists()
