import errno
import itertools
import os
import termios
import time
import tty

import can
import pytest

from parapod.systems.hardware.cia402.controller import Timing
from parapod.systems.hardware.cia402.emulator import Cia402Nodes
from parapod.systems.hardware.cia402.settings import GearSettings
from parapod.systems.hardware.cia402.velocities import Cia402Velocities
from parapod.systems.hardware.device import DeviceError
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.hardware.emulation.slcan import Frame, SlcanPty, decoded, encoded

CHANNELS = (f"test_slcan {k}" for k in itertools.count())
FRAMES = [
    (Frame(0x203, bytes.fromhex("0F00E8030000")), b"t20360F00E8030000\r"),
    (Frame(0x080, b""), b"t0800\r"),
    (Frame(0x77F, b"\x05"), b"t77F105\r"),
    (Frame(0x123, bytes(range(8)), True), b"T0000012380001020304050607\r"),
]


def until(condition, timeout=60.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


# --- frames


@pytest.mark.parametrize(("frame", "line"), FRAMES)
def test_frames_are_lines(frame, line):
    assert encoded(frame) == line
    assert decoded(line[:-1].decode()) == frame


@pytest.mark.parametrize(
    "line", ["", "O", "t", "t12", "t1239", "t123100FF", "t1232AA", "t8001FF", "tXYZ0", "r1230"]
)
def test_other_lines_are_no_frames(line):
    with pytest.raises(ValueError, match=r"."):
        decoded(line)


# --- the adapter


class Client:
    """Bytes of a serial port, without python-can."""

    def __init__(self, path):
        self._file = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._file)
        termios.tcflush(self._file, termios.TCIOFLUSH)

    def ask(self, line, answer):
        os.write(self._file, line)
        self.expect(answer)

    def expect(self, answer):
        got = b""
        while len(got) < len(answer):
            got += os.read(self._file, len(answer) - len(got))
        assert got == answer

    def is_cut_off(self):
        try:
            os.write(self._file, b"C\r")
        except OSError as error:
            return error.errno == errno.EIO
        return False

    def close(self):
        os.close(self._file)


@pytest.fixture
def adapter(tmp_path):
    with SlcanPty(next(CHANNELS), tmp_path / "can0") as adapter:
        yield adapter


@pytest.fixture
def client(adapter):
    client = Client(adapter.link)
    yield client
    client.close()


@pytest.fixture
def bus(adapter):
    with can.Bus(interface="virtual", channel=adapter._channel, ignore_config=True) as bus:
        yield bus


def test_commands_are_answered(client):
    client.ask(b"\r", b"\r")
    client.ask(b"C\r", b"\r")
    client.ask(b"O\r", b"\a")  # no bit rate yet
    client.ask(b"S8\r", b"\r")
    client.ask(b"O\r", b"\r")
    client.ask(b"S8\r", b"\a")  # not while open
    client.ask(b"V\r", b"V1013\r")
    client.ask(b"t12\r", b"\a")
    client.ask(b"q\r", b"\a")


def test_frames_pass_both_ways_byte_for_byte(client, bus):
    client.ask(b"S8\rO\r", b"\r\r")
    for frame, line in FRAMES:
        client.ask(line, b"Z\r" if frame.is_extended else b"z\r")
        message = bus.recv(5.0)
        assert (message.arbitration_id, bytes(message.data)) == (frame.can_id, frame.data)
        assert message.is_extended_id == frame.is_extended
        bus.send(message)
        client.expect(line)


def test_nothing_passes_at_another_bit_rate_or_when_closed(client, bus):
    client.ask(b"t0800\r", b"\a")
    client.ask(b"S6\rO\rt0800\r", b"\r\rz\r")
    client.ask(b"C\rS8\rO\rt0811FF\r", b"\r\r\rz\r")
    assert bus.recv(5.0).arbitration_id == 0x081


def test_link_leads_to_a_new_terminal_after_an_unplugging(tmp_path):
    misbehaviour = Misbehaviour()
    link = tmp_path / "can0"
    with SlcanPty(next(CHANNELS), link, misbehaviour):
        client = Client(link)
        misbehaviour.begin("unplugged", time.monotonic())
        until(lambda: not link.exists())
        until(client.is_cut_off)
        client.close()
        misbehaviour.end()
        until(link.exists)
        client = Client(link)
        client.ask(b"S8\r", b"\r")
        client.close()
    assert not link.is_symlink()


# --- drives behind it


def test_wrong_bit_rate_reaches_no_node(tmp_path):
    sizes = {"velocity_command": 4, "brake": 1, "position": 4, "velocity": 4}
    harness = Harness({f"wheels.{name}": size for name, size in sizes.items()})
    with Cia402Nodes(harness, channel=next(CHANNELS), link=tmp_path / "can0") as nodes:
        settings = GearSettings(channel=str(nodes.adapter.link), bitrate=500_000)
        with pytest.raises(DeviceError, match="node 1 does not answer; nodes that do: none"):
            Cia402Velocities(settings, Timing(sdo_timeout=0.1)).configure()
