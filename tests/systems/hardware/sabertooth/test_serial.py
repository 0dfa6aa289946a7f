import errno
import itertools
import math
import os
import time

import pytest
import serial

from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.hardware.sabertooth import serial as sabertooth_serial
from parapod.systems.hardware.sabertooth.emulator import SabertoothPty
from parapod.systems.hardware.sabertooth.protocol import Command, PacketParser, packet
from parapod.systems.hardware.sabertooth.serial import SabertoothSerial
from parapod.systems.hardware.sabertooth.settings import SabertoothSettings

WANTED = (1.0, -2.0, 12.0, -0.5)
STILL = (0.0,) * 4
STEP = 12.0 / 127.0
# What a busy computer may add to a timeout [s].
MARGIN = 0.1


def until(condition, timeout=60.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


def command(voltage, stop=0.0):
    return {"voltage": voltage, "stop": (stop,)}


def fault_of(call, *arguments):
    try:
        call(*arguments)
    except DeviceError as error:
        return error.fault
    return None


@pytest.fixture
def harness():
    return Harness({"legs.voltage": 4, "legs.stop": 1})


@pytest.fixture
def misbehaviour():
    return Misbehaviour()


@pytest.fixture
def drivers(harness, misbehaviour, tmp_path):
    with SabertoothPty(tmp_path / "legs", harness, misbehaviour) as drivers:
        yield drivers


def made(link, timeout=200.0, **settings):
    return SabertoothSerial(
        SabertoothSettings(port=str(link), serial_timeout_ms=timeout, **settings)
    )


@pytest.fixture
def device(drivers):
    device = made(drivers.link)
    yield device
    device.close()


@pytest.fixture
def active(device):
    device.configure()
    device.activate()
    return device


def drive(device, harness, wanted=WANTED, timeout=60.0, expected=None):
    """Writes until the motors have the voltages; returns when the last write began [s]."""
    expected = pytest.approx(wanted if expected is None else expected, abs=0.51 * STEP)
    began = 0.0

    def arrived():
        nonlocal began
        began = time.monotonic()
        device.write(command(wanted))
        return harness.get("legs.voltage") == expected

    until(arrived, timeout)
    return began


def hold(device, seconds, wanted=WANTED):
    """Writes a constant command, at some 100 Hz."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        device.write(command(wanted))
        time.sleep(0.01)


# --- opening


def test_what_is_no_serial_port_is_refused(tmp_path):
    (tmp_path / "text").write_text("")
    device = made(tmp_path / "text")
    with pytest.raises(DeviceError, match="Inappropriate ioctl"):
        device.configure()


def test_port_without_permission_is_refused(device, monkeypatch):
    def refuse(path, *_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)

    # Not by the file's mode, which root need not heed.
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(DeviceError, match="Permission denied"):
        device.configure()


def test_port_of_another_program_is_refused(drivers, active, harness):
    other = made(drivers.link)
    with pytest.raises(DeviceError, match="exclusively lock"):
        other.configure()
    drive(active, harness)
    active.close()
    other.configure()
    other.close()


def test_new_drivers_are_brought_to_the_speed_of_the_line(harness, tmp_path):
    link = tmp_path / "legs"
    with SabertoothPty(link, harness, baud=9600) as drivers:
        with made(link) as deaf:
            deaf.activate()
            hold(deaf, 0.05)
            assert drivers.timeouts == (0.0, 0.0)  # nobody listens, and nobody can know
        with made(link, power_on_baud=9600) as device:
            assert drivers.bauds == (38400, 38400)
            device.activate()
            drive(device, harness)


def test_baud_rate_is_left_alone_if_it_is_right(fake, clock):
    open_device(clock, baud=9600, power_on_baud=9600)
    assert not [p for p in fake.packets if p.command == Command.BAUD_RATE]


# --- commands


def test_actuators_are_in_the_order_of_the_addresses(drivers, harness):
    settings = SabertoothSettings(port=str(drivers.link), addresses=[129, 128])
    with SabertoothSerial(settings, 3) as device:
        assert device.commands == {"voltage": 3, "stop": 1}
        device.activate()
        drive(device, harness, (1.0, 2.0, 3.0), expected=(3.0, 0.0, 1.0, 2.0))


@pytest.mark.parametrize("stop", [1.0, math.nan])
def test_stop_takes_the_voltage_from_all(active, harness, stop):
    drive(active, harness)
    active.write(command(WANTED, stop))
    until(lambda: harness.get("legs.voltage") == STILL)
    assert harness.get("legs.stop") == (0.0,)
    drive(active, harness)


@pytest.mark.parametrize("end", ["neutral", "deactivate", "close"])
def test_every_end_is_neutral_before_the_timeout_can_have_done_it(active, harness, end, judge):
    drive(active, harness)
    with judge() as judged:
        getattr(active, end)()
        until(lambda: harness.get("legs.voltage") == STILL)
    judged.check(0.15)


def test_wrong_number_of_voltages_is_refused(active):
    with pytest.raises(ValueError, match="voltage has 4 elements, not 3"):
        active.write(command((0.0,) * 3))


# --- serial timeout


def test_motors_stop_when_nothing_is_written(active, harness, judge):
    written = drive(active, harness)
    with judge() as judged:
        until(lambda: harness.get("legs.voltage") == STILL)
    # A packet cannot arrive before it is written, however late this program is afterwards.
    assert time.monotonic() - written > 0.2 - 0.02
    judged.check(0.2 + MARGIN)


@pytest.mark.parametrize("timeout", [0.1, 0.2])
def test_timeout_is_set_at_every_start(drivers, timeout):
    device = made(drivers.link, 1e3 * timeout)
    for start in (device.configure, device.activate, device.configure, device.activate):
        for address in (128, 129):
            drivers.restart(address)
        assert drivers.timeouts == (0.0, 0.0)
        start()
        until(lambda: drivers.timeouts == pytest.approx((timeout, timeout)))
    device.close()


def test_timeout_comes_back_to_a_driver_that_lost_its_power(drivers, harness, monkeypatch):
    monkeypatch.setattr(sabertooth_serial, "_ARMING_INTERVAL", 0.2)
    with made(drivers.link) as device:
        device.activate()
        drive(device, harness)
        drivers.restart(129)
        assert drivers.timeouts == (pytest.approx(0.2), 0.0)
        hold(device, 0.3)
        assert drivers.timeouts == pytest.approx((0.2, 0.2))


# --- what the line can carry


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


class FakePort:
    """A port that sends as slowly as a real one, in the test's own time."""

    def __init__(self, clock):
        self._clock, self._parser = clock, PacketParser()
        self.baud, self.is_stuck = 38400, False
        self.log, self.packets, self._idle_from = [], [], 0.0

    def __call__(self, port, baud, **_):
        self.baud = baud
        return self

    def write(self, data):
        self.log.append((self._clock(), len(data)))
        self.packets += self._parser.feed(data)
        self._idle_from = max(self._idle_from, self._clock()) + len(data) * 10 / self.baud

    @property
    def out_waiting(self):
        if self.is_stuck:
            return 4096
        return math.ceil(max(self._idle_from - self._clock(), 0.0) * self.baud / 10 - 1e-6)

    def reset_output_buffer(self):
        self.is_stuck, self._idle_from = False, 0.0

    def close(self):
        assert self.out_waiting == 0


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def fake(clock, monkeypatch):
    port = FakePort(clock)
    monkeypatch.setattr(serial, "Serial", port)
    return port


def open_device(clock, **settings):
    settings = SabertoothSettings(serial_timeout_ms=200.0, **settings)
    device = SabertoothSerial(settings, clock=clock)
    device.configure()
    device.activate()
    clock.now += 1.0
    return device


def busiest(log, rate):
    """By how many bytes what was written in any time exceeds what the line carries in it."""
    surplus = most = 0.0
    previous = log[0][0]
    for at, size in log:
        surplus = max(surplus - (at - previous) * rate, 0.0) + size
        most, previous = max(most, surplus), at
    return most


@pytest.mark.parametrize("baud", [9600, 19200, 38400])
@pytest.mark.parametrize("period", [0.001, 0.01, 0.02])
def test_line_is_never_asked_for_more_than_it_carries(fake, clock, baud, period):
    device = open_device(clock, baud=baud)
    fake.log.clear()
    for k in range(2000):
        device.write(command([math.sin(0.1 * k + i) * 12.0 for i in range(4)]))
        assert fake.out_waiting <= 4 * 5
        clock.now += period
    assert busiest(fake.log, baud / 10) <= 4 * 5 + 1e-6


@pytest.mark.parametrize("baud", [9600, 38400])
def test_stops_in_quick_succession_do_not_fill_the_port(fake, clock, baud):
    device = open_device(clock, baud=baud)
    fake.log.clear()
    for k in range(2000):
        device.write(command(WANTED, stop=float(k % 2)))
        clock.now += 0.001
    assert busiest(fake.log, baud / 10) <= 2 * 4 * 5 + 1e-6


def test_fast_line_carries_every_command(fake, clock):
    device = open_device(clock, baud=38400)
    for k in range(300):
        fake.packets.clear()
        device.write(command([0.01 * k + i for i in range(4)]))
        motors = {(p.address, p.command) for p in fake.packets if p.command != 14}
        assert motors == {(128, 0), (128, 4), (129, 0), (129, 4)}
        clock.now += 0.01


def test_slow_line_serves_motors_in_turn(fake, clock):
    device = open_device(clock, baud=9600)
    served = {motor: [clock.now] for motor in itertools.product((128, 129), (0, 4))}
    for k in range(1000):
        fake.packets.clear()
        device.write(command([1.0 + (k % 80) * 0.1 + i for i in range(4)]))
        for p in fake.packets:
            if p.command != Command.SERIAL_TIMEOUT:
                served[p.address, p.command].append(clock.now)
        clock.now += 0.01
    for times in served.values():
        # Four motors at 240 packets/s: 60 Hz each; three periods at most between two packets.
        assert len(times) / 10.0 > 58.0
        assert max(b - a for a, b in itertools.pairwise(times)) < 0.031


def test_changed_command_goes_before_constant_ones(fake, clock, monkeypatch):
    monkeypatch.setattr(sabertooth_serial, "_ARMING_INTERVAL", 100.0)
    device = open_device(clock, baud=9600)
    device.write(command(WANTED))
    clock.now += 0.006
    fake.packets.clear()
    device.write(command((*WANTED[:3], 7.0)))
    assert [(p.address, p.command) for p in fake.packets] == [(129, 4)]


def test_constant_commands_are_repeated_on_a_slow_line(fake, clock):
    device = open_device(clock, baud=9600)
    fake.packets.clear()
    for _ in range(1000):
        device.write(command(WANTED))
        clock.now += 0.001
    sent = {(a, c): 0 for a, c in ((128, 0), (128, 5), (129, 0), (129, 5))}
    for p in fake.packets:
        if p.command != Command.SERIAL_TIMEOUT:
            sent[p.address, p.command] += 1
    assert min(sent.values()) >= 20  # refresh_interval is 50 ms


def test_timeout_is_set_again_every_second(fake, clock):
    device = open_device(clock, baud=9600)
    fake.packets.clear()
    for k in range(1000):
        device.write(command([1.0 + (k % 80) * 0.1 + i for i in range(4)]))
        clock.now += 0.01
    for address in (128, 129):
        count = fake.packets.count((address, Command.SERIAL_TIMEOUT, 2))
        assert 9 <= count <= 11


def test_stop_does_not_wait_for_room(fake, clock):
    device = open_device(clock, baud=9600)
    device.write(command(WANTED))
    fake.packets.clear()
    device.write(command(WANTED, stop=1.0))
    assert sorted(fake.packets) == [(128, 0, 0), (128, 4, 0), (129, 0, 0), (129, 4, 0)]
    fake.packets.clear()
    device.write(command(WANTED, stop=1.0))
    assert fake.packets == []


def test_port_that_sends_nothing_is_told(fake, clock):
    device = open_device(clock)
    device.write(command(WANTED))
    fake.is_stuck = True
    for _ in range(20):
        device.write(command(WANTED))  # not so long that the drivers would miss it
        clock.now += 0.01
    with pytest.raises(DeviceError, match="nothing leaves the port; 4096 bytes wait") as caught:
        device.write(command(WANTED))
    assert caught.value.fault is DeviceFault.SILENT
    fake.is_stuck = False
    device.write(command(WANTED))


def test_port_that_sends_nothing_can_be_closed(fake, clock, judge):
    device = open_device(clock)
    fake.is_stuck = True
    with judge() as judged:
        device.close()
    judged.check(0.2 + MARGIN)
    assert not fake.is_stuck


def test_full_port_is_silent_and_not_gone(fake, clock, monkeypatch):
    device = open_device(clock)

    def write(_):
        raise serial.SerialTimeoutException("Write timeout")

    monkeypatch.setattr(fake, "write", write)
    assert fault_of(device.write, command(WANTED)) is DeviceFault.SILENT
    monkeypatch.undo()
    fake.packets.clear()
    device.write(command(STILL))
    assert len(fake.packets) >= 4  # what has not arrived is not taken for known


# --- misbehaviour


def test_unplugged_port_is_told_by_every_call_and_the_motors_stop(active, harness, misbehaviour):
    drive(active, harness)
    misbehaviour.begin("unplugged", time.monotonic())
    until(lambda: fault_of(active.write, command(WANTED)) is DeviceFault.UNPLUGGED)
    for call in (active.read, active.neutral, active.deactivate, active.activate):
        assert fault_of(call) is DeviceFault.UNPLUGGED
    until(lambda: harness.get("legs.voltage") == STILL)


def test_drivers_that_hear_nothing_stop_and_come_back(active, harness, misbehaviour):
    drive(active, harness)
    misbehaviour.begin("off", time.monotonic())

    def is_still():
        active.write(command(WANTED))
        return harness.get("legs.voltage") == STILL

    until(is_still)
    misbehaviour.end()
    drive(active, harness)


def test_damaged_packets_do_nothing_wrong(active, drivers, harness, misbehaviour):
    drive(active, harness)
    misbehaviour.begin("garbage", time.monotonic())
    expected = pytest.approx(WANTED, abs=0.51 * STEP)
    for _ in range(30):
        active.write(command(WANTED))
        assert harness.get("legs.voltage") == expected
        time.sleep(0.01)
    assert drivers.rejected > 10
    drive(active, harness, STILL)  # some packets get through


# --- the emulator by itself


def test_drivers_do_without_a_wire_for_the_stop(tmp_path):
    harness = Harness({"legs.voltage": 3})
    link = tmp_path / "legs"
    with SabertoothPty(link, harness), serial.Serial(str(link), 38400) as port:
        port.write(packet(129, 1, 127))
        until(lambda: harness.get("legs.voltage") == (0.0, 0.0, -12.0))
        port.write(packet(130, 0, 127) + packet(128, 4, 127))
        until(lambda: harness.get("legs.voltage") == (0.0, 12.0, -12.0))
    assert not link.is_symlink()


def test_more_actuators_than_motors_are_refused(tmp_path):
    with pytest.raises(ValueError, match="5 elements for 4 motors"):
        SabertoothPty(tmp_path / "legs", Harness({"legs.voltage": 5}))


def test_on_a_garbled_line_more_packets_are_lost_than_arrive(harness, misbehaviour, tmp_path):
    link = tmp_path / "legs"
    sent = [packet(128, 0, value) for value in range(1, 71)]
    with SabertoothPty(link, harness, misbehaviour) as drivers:
        misbehaviour.begin("garbage", time.monotonic())
        with serial.Serial(str(link), 38400) as port:
            port.write(b"".join(sent))
            until(lambda: 2 * drivers.rejected > len(sent))
            assert drivers.rejected < len(sent)
