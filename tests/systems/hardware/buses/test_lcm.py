"""LCM between two connections: messages, channels, other types, addresses."""

import math
import struct
import time

import pytest
from drake import lcmt_drake_signal, lcmt_scope
from pydrake.lcm import DrakeLcm

from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.buses.address import LCM, Address, address_of, is_address
from parapod.systems.hardware.buses.bus import Inbox
from parapod.systems.hardware.buses.connection import connect
from parapod.systems.hardware.buses.emulated_part import EmulatedBusPart
from parapod.systems.hardware.buses.lcm import USUAL, LcmBus, decoded, encoded, local
from parapod.systems.hardware.buses.message import Layout, Message, Signal
from parapod.systems.hardware.buses.part import BusPart
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from tests.systems.hardware.buses.conftest import until

LAYOUT = Layout({"position": Signal(2)})


@pytest.fixture
def buses(lcm_url):
    both = LcmBus(Address(LCM, lcm_url)), LcmBus(Address(LCM, lcm_url))
    yield both
    for bus in both:
        bus.close()


def test_drake_reads_what_is_published_and_is_read(lcm_url, buses):
    ours, _ = buses
    theirs, came = DrakeLcm(lcm_url), []
    theirs.Subscribe("LEGS_STATUS", lambda data: came.append(lcmt_drake_signal.decode(data)))

    def heard():
        ours.publish("LEGS_STATUS", Message(LAYOUT.names, (1.5, -2.5), 12.25))
        theirs.HandleSubscriptions(10)
        return came

    until(heard)
    assert came[0].coord == list(LAYOUT.names)
    assert list(came[0].val) == [1.5, -2.5]
    assert came[0].timestamp == 12_250_000
    inbox = Inbox("LEGS_COMMAND", LAYOUT, math.inf, 1.0)
    ours.subscribe(inbox)
    signal = lcmt_drake_signal()
    signal.dim, signal.coord, signal.val = 2, list(LAYOUT.names), [3.0, 4.0]
    signal.timestamp = 5_000_000

    def answered():
        theirs.Publish("LEGS_COMMAND", signal.encode())
        time.sleep(5e-3)
        return inbox.newest

    until(answered)
    assert inbox.newest.signals == {"position": (3.0, 4.0)}
    assert inbox.newest.message.stamp == 5.0


@pytest.mark.parametrize("count", [0, 1, 7])
def test_messages_are_drakes_to_the_last_byte(count):
    message = Message(
        tuple(f"größe[{i}]" for i in range(count)), tuple(0.1 * i for i in range(count)), 12.25
    )
    signal = lcmt_drake_signal()
    signal.dim, signal.timestamp = count, 12_250_000
    signal.val, signal.coord = list(message.values), list(message.names)
    assert encoded(message) == signal.encode()
    assert decoded(signal.encode()) == message


def test_data_that_is_no_message_is_refused_wherever_it_is_damaged():
    data = encoded(Message(("position[0]", "brake"), (1.0, 0.0), 2.0))
    for end in range(len(data)):
        with pytest.raises((ValueError, struct.error)):
            decoded(data[:end])
    for at in (*range(8), 11, 31, 47):  # type, number of values, lengths of names
        damaged = bytearray(data)
        damaged[at] ^= 0x15
        with pytest.raises((ValueError, struct.error)):
            decoded(bytes(damaged))


def test_a_message_of_another_type_is_named(buses, lcm_url):
    ours, _ = buses
    inbox = Inbox("LEGS_COMMAND", LAYOUT, math.inf, 60.0)
    ours.subscribe(inbox)
    theirs = DrakeLcm(lcm_url)

    def refused():
        theirs.Publish("LEGS_COMMAND", lcmt_scope().encode())
        time.sleep(5e-3)
        return inbox.problem(time.monotonic()).fault is DeviceFault.CORRUPT

    until(refused)
    words = inbox.problem(time.monotonic()).words
    assert "is not of the type lcmt_drake_signal" in words


def test_channels_are_those_of_others(buses):
    ours, theirs = buses

    def seen():
        ours.publish("MINE", Message((), (), 1.0))
        theirs.publish("YOURS", Message((), (), 1.0))
        time.sleep(5e-3)
        return ours.channels()

    until(seen)
    assert "YOURS" in ours.channels()
    assert "MINE" not in ours.channels()


def test_a_part_that_nobody_serves_says_what_there_is(buses, lcm_url, monkeypatch):
    _, theirs = buses

    def heard(address):
        bus = LcmBus(address)
        until(lambda: theirs.publish("ARM_STATUS", Message((), (), 1.0)) or bus.channels())
        return bus

    monkeypatch.setattr("parapod.systems.hardware.buses.part.connect", heard)
    part = BusPart("legs", Address(LCM, lcm_url), {"position": Signal(2)}, {}, patience=0.1)
    with pytest.raises(DeviceError) as caught:
        part.configure()
    assert caught.value.fault is DeviceFault.UNPLUGGED
    assert f"no message on LEGS_STATUS in 0.1 s; LCM {lcm_url} has " in str(caught.value)
    assert "ARM_STATUS" in str(caught.value)


@pytest.mark.parametrize(
    ("given", "url"),
    [
        ("", USUAL),
        ("udpm://239.255.76.67:7667", "udpm://239.255.76.67:7667?ttl=0"),
        (
            "udpm://239.255.76.67:7667?recv_buf_size=1",
            "udpm://239.255.76.67:7667?recv_buf_size=1&ttl=0",
        ),
        ("udpm://239.255.76.67:7667?ttl=1", "udpm://239.255.76.67:7667?ttl=1"),
        ("memq://", "memq://"),
    ],
)
def test_messages_stay_on_this_computer_unless_they_are_sent_farther(given, url):
    assert local(given) == url


def test_addresses_tell_the_bus_the_place_and_the_suffix():
    assert address_of("lcm", "bus") == Address(LCM)
    assert address_of("lcm://#_LEFT", "bus") == Address(LCM, "", "_LEFT")
    text = "lcm://239.255.76.67:7000?ttl=1#_2"
    assert address_of(text, "bus") == Address(LCM, "udpm://239.255.76.67:7000?ttl=1", "_2")
    assert is_address("lcm://")
    assert not is_address("my_file.py:make")
    with pytest.raises(ScenarioError, match="bus = 'ros1://' must begin with lcm or ros2"):
        address_of("ros1://", "bus")


def test_an_address_that_lcm_does_not_take_is_refused_in_a_line():
    with pytest.raises(
        DeviceError, match="'nothing://' must begin with udpm:, memq:, tcpq:, mpudpm:"
    ) as caught:
        LcmBus(Address(LCM, "nothing://"))
    assert "\n" not in str(caught.value)


def test_parts_of_one_program_share_a_connection_until_the_last_is_closed(lcm_url):
    address = Address(LCM, lcm_url, "_SHARED")
    one, other = connect(address), connect(address._replace(status="/elsewhere"))
    apart = connect(address, "emulator")
    try:
        assert one is other
        assert apart is not one
        inbox = Inbox("ARM_STATUS_SHARED", Layout({"position": Signal(1)}), math.inf, 60.0)
        other.subscribe(inbox)
        one.close()
        message = Message(("position",), (2.0,), 1.0)
        until(lambda: apart.publish("ARM_STATUS_SHARED", message) or inbox.newest)
        other.unsubscribe(inbox)
        apart.publish("ARM_STATUS_SHARED", message._replace(stamp=2.0))
        time.sleep(0.05)
        assert inbox.newest.message.stamp == 1.0
    finally:
        other.close()
        apart.close()
    again = connect(address)
    assert again is not one
    again.close()


@pytest.mark.parametrize("kind", ["off", "unplugged"])
def test_an_emulated_part_that_hears_nothing_becomes_neutral(lcm_url, kind):
    sizes = {"legs.position": 1, "legs.voltage": 2, "legs.stop": 1}
    harness = Harness(sizes, idle={"legs.voltage": 0.0, "legs.stop": 1.0})
    address, misbehaviour = Address(LCM, lcm_url, f"_{kind}"), Misbehaviour()
    part = BusPart(
        *("legs", address, {"position": Signal(1)}, {"voltage": Signal(2), "stop": Signal(1)}),
        fail_safe=("stop",),
    )
    commands = {"voltage": (3.0, -3.0), "stop": (0.0,)}
    neutral = [(0.0, 0.0), (1.0,)]

    def values():
        return [harness.get("legs.voltage"), harness.get("legs.stop")]

    def obeyed():
        part.write(commands)
        return values() == list(commands.values())

    def left():
        part.write(commands)
        return values() == neutral

    with EmulatedBusPart("legs", address, harness, misbehaviour):
        part.configure()
        part.activate()
        until(obeyed)
        misbehaviour.begin(kind, time.monotonic())
        until(left)
        part.close()


def test_a_part_tells_of_each_message_whoever_asks_for_that_and_when(lcm_url):
    address, told = Address(LCM, lcm_url, "_TOLD"), []
    harness = Harness({"legs.position": 1, "legs.voltage": 2}, {"legs.voltage": 0.0})
    part = BusPart("legs", address, {"position": Signal(1)}, {"voltage": Signal(2)})
    with EmulatedBusPart("legs", address, harness):
        part.configure()
        part.on_measured = lambda: told.append(part.read())
        until(lambda: len(told) > 3)
        part.close()
    assert not part.is_asked
    assert 0.0 < part.sends_every < math.inf
