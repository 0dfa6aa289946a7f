import itertools
import os
import signal
import subprocess
import sys
import termios
import time
import tty

import can
import pytest

from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ds402 import DriveState
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.hardware.emulation.slcan import Frame, SlcanPty, decoded, encoded
from parapod.systems.hardware.epos2.drives import Epos2
from parapod.systems.hardware.epos2.emulator import Epos2Nodes
from parapod.systems.hardware.epos2.settings import Epos2Params

RESOLUTION = 2.0 * 3.141592653589793 / 60.0 / 26.0
CHANNELS = (f"test_slcan {k}" for k in itertools.count())
FRAMES = [
    (Frame(0x203, bytes.fromhex("0F00E8030000")), b"t20360F00E8030000\r"),
    (Frame(0x080, b""), b"t0800\r"),
    (Frame(0x77F, b"\x05"), b"t77F105\r"),
    (Frame(0x123, bytes(range(8)), True), b"T0000012380001020304050607\r"),
]


def until(condition, timeout=5.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def wires():
    return Harness(
        {
            "wheels.velocity_command": 4,
            "wheels.brake": 1,
            "wheels.position": 4,
            "wheels.velocity": 4,
        }
    )


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
        with pytest.raises(OSError, match="Input/output error"):
            os.write(client._file, b"C\r")
        client.close()
        misbehaviour.end()
        until(link.exists)
        client = Client(link)
        client.ask(b"S8\r", b"\r")
        client.close()
    assert not link.is_symlink()


# --- wheel drives behind it


@pytest.fixture
def harness():
    return wires()


@pytest.fixture
def misbehaviour():
    return Misbehaviour()


@pytest.fixture
def nodes(harness, misbehaviour, tmp_path):
    channel, link = next(CHANNELS), tmp_path / "can0"
    with Epos2Nodes(harness, channel=channel, link=link, misbehaviour=misbehaviour) as nodes:
        yield nodes


@pytest.fixture
def drives(nodes):
    params = Epos2Params(
        interface="slcan",
        channel=str(nodes.adapter.link),
        acceleration=1e4,
        deceleration=1e4,
        quick_stop_deceleration=1e4,
        heartbeat_timeout=2.0,
        timeout=0.2,
        sdo_timeout=0.5,
    )
    drives = Epos2(params)
    yield drives
    drives.close()


def test_round_trip(drives, nodes, harness):
    drives.configure()
    drives.activate()
    wanted = (1.0, -2.0, 0.1234, 10.0)
    drives.write({"velocity_command": wanted, "brake": (0.0,)})
    expected = pytest.approx(wanted, abs=0.51 * RESOLUTION)
    until(lambda: harness.get("wheels.velocity_command") == expected)
    harness.set("wheels.velocity", wanted)
    until(lambda: drives.read()["velocity"] == expected)
    harness.set("wheels.velocity", (0.0,) * 4)
    drives.deactivate()
    until(lambda: set(nodes.states) == {DriveState.SWITCH_ON_DISABLED})


def test_wrong_bit_rate_reaches_no_node(nodes):
    params = Epos2Params(channel=str(nodes.adapter.link), bitrate=500_000, sdo_timeout=0.1)
    with pytest.raises(DeviceError, match="node 1 does not answer; nodes that do: none"):
        Epos2(params).configure()


def test_unplugged_adapter_is_told_and_can_come_back(drives, nodes, harness, misbehaviour):
    drives.configure()
    drives.activate()
    misbehaviour.begin("unplugged", time.monotonic())
    until(lambda: fault_of(drives.read) is DeviceFault.UNPLUGGED)
    command = {"velocity_command": (1.0,) * 4, "brake": (0.0,)}
    assert fault_of(drives.write, command) is DeviceFault.UNPLUGGED
    drives.close()
    assert fault_of(drives.configure) is DeviceFault.UNPLUGGED
    misbehaviour.end()
    until(nodes.adapter.link.exists)
    drives.configure()
    drives.activate()
    drives.write(command)
    expected = pytest.approx((1.0,) * 4, abs=RESOLUTION)
    until(lambda: harness.get("wheels.velocity_command") == expected)


def fault_of(call, *arguments):
    try:
        call(*arguments)
    except DeviceError as error:
        return error.fault
    return None


def test_damaged_lines_do_not_end_the_connection(drives, nodes, misbehaviour):
    drives.configure()
    drives.activate()
    misbehaviour.begin("garbage", time.monotonic())
    for _ in range(10):
        assert fault_of(drives.read) in (None, DeviceFault.CORRUPT, DeviceFault.SILENT)
    misbehaviour.end()
    until(lambda: fault_of(drives.read) is None)


CLIENT = """
import sys, time
from parapod.systems.hardware.epos2.drives import Epos2
from parapod.systems.hardware.epos2.settings import Epos2Params

drives = Epos2(Epos2Params(channel=sys.argv[1], acceleration=1e4))
drives.configure()
drives.activate()
while True:
    drives.read()
    drives.write({"velocity_command": (2.0,) * 4, "brake": (0.0,)})
    time.sleep(0.002)
"""


def is_moving(harness):
    return harness.get("wheels.velocity_command") == pytest.approx((2.0,) * 4, abs=RESOLUTION)


def test_wheels_stop_when_the_client_is_killed(nodes, harness):
    command = [sys.executable, "-c", CLIENT, str(nodes.adapter.link)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as client:
        until(lambda: is_moving(harness) or client.poll() is not None, timeout=15.0)
        assert is_moving(harness), client.stderr.read()
        client.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        until(lambda: harness.get("wheels.brake") == (1.0,))
        stopped = time.monotonic()
    assert harness.get("wheels.velocity_command") == (0.0,) * 4
    assert stopped - killed < 0.2
    until(lambda: set(nodes.states) == {DriveState.FAULT})
