import math
import random
import socket
import tempfile
import time
from types import SimpleNamespace

import pytest

from parapod.systems.hardware.adis16448 import spi as adis16448_spi
from parapod.systems.hardware.adis16448.emulator import (
    Adis16448Registers,
    SpiSocketServer,
)
from parapod.systems.hardware.adis16448.registers import (
    BURST_CRC,
    BURST_WORDS,
    FAILURES,
    INTERNAL_CLOCK,
    RANGE_1000,
    SCALES,
    Register,
)
from parapod.systems.hardware.adis16448.settings import SpiSettings
from parapod.systems.hardware.adis16448.spi import Adis16448Spi
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour

START_UP = 0.01
TIMEOUT = 0.2
# What a busy computer may add to a timeout [s].
MARGIN = 0.3
BURST = [Register.GLOB_CMD, 0] + [0, 0] * BURST_WORDS


@pytest.fixture
def harness():
    wires = Harness({"imu.gyro": 3, "imu.accel": 3, "imu.mag": 3})
    wires.set("imu.accel", (0.0, 0.0, 9.80665))
    return wires


@pytest.fixture
def misbehaviour():
    return Misbehaviour()


@pytest.fixture
def sensor(harness, misbehaviour):
    with Adis16448Registers(harness, misbehaviour, START_UP) as sensor:
        yield sensor


@pytest.fixture
def imu(sensor):
    with device(sensor) as imu:
        yield imu


@pytest.fixture
def socket_path():
    # The path of a Unix socket is short.
    with tempfile.TemporaryDirectory(prefix="spi") as folder:
        yield f"{folder}/imu"


@pytest.fixture
def server(sensor, misbehaviour, socket_path):
    with SpiSocketServer(socket_path, sensor, misbehaviour) as server:
        yield server


def device(bus=None, start_up_time=START_UP, **settings):
    settings = {"timeout_ms": 1e3 * TIMEOUT} | settings
    return Adis16448Spi(SpiSettings(**settings), bus, start_up_time)


def fails(call, *arguments):
    """The error that a call raises."""
    with pytest.raises(DeviceError) as caught:
        call(*arguments)
    return caught.value


def begin(misbehaviour, kind):
    misbehaviour.begin(kind, time.monotonic())


def until_it_reads(imu, timeout=60.0):
    deadline = time.monotonic() + timeout
    while True:
        try:
            return imu.read()
        except DeviceError:
            assert time.monotonic() < deadline
            time.sleep(0.001)


class Damaged:
    """A bus that damages what is received, one burst for each entry of `masks`."""

    def __init__(self, bus):
        self.bus, self.masks = bus, []

    def xfer2(self, values):
        received = list(self.bus.xfer2(values))
        if self.masks and len(values) == len(BURST):
            word, mask = self.masks.pop(0)
            received[2 * word] ^= mask >> 8
            received[2 * word + 1] ^= mask & 0xFF
        return received

    def close(self):
        pass


# --- values


def test_signals_arrive_within_half_a_count(imu, harness):
    generator = random.Random(0)
    for _ in range(50):
        truth = {}
        for name, scale in SCALES.items():
            truth[name] = [generator.uniform(-scale.limit, scale.limit) for _ in range(3)]
            harness.set(f"imu.{name}", truth[name])
        measured = imu.read()
        for name, scale in SCALES.items():
            assert measured[name] == pytest.approx(truth[name], abs=0.501 * scale.resolution)


def test_temperature_arrives(imu, sensor):
    for value in (-20.0, 25.0, 60.0):
        sensor.temperature = value
        assert imu.read()["temperature"] == pytest.approx([value], abs=0.04)


def test_signals_beyond_the_range_show_its_limit(imu, harness):
    for name, scale in SCALES.items():
        harness.set(f"imu.{name}", (2.0 * scale.limit, -2.0 * scale.limit, math.nan))
        limit = scale.limit
        assert imu.read()[name] == pytest.approx((limit, -limit, 0.0), rel=1e-9)


def test_mounting_turns_the_vectors(sensor):
    with device(sensor, mounting_deg=[180.0, 0.0, 0.0]) as imu:
        assert imu.read()["accel"] == pytest.approx((0.0, 0.0, -9.80665))


# --- life


@pytest.mark.parametrize("decimation", [0, 3, 12])
def test_range_decimation_and_crc_are_set(sensor, decimation):
    with device(sensor, decimation=decimation):
        registers = sensor.registers
        assert registers[Register.SMPL_PRD] == decimation << 8 | INTERNAL_CLOCK
        assert registers[Register.SENS_AVG] == RANGE_1000
        assert registers[Register.MSC_CTRL] & BURST_CRC


def test_configure_resets_and_waits_for_the_start(sensor):
    sensor.registers[Register.GPIO_CTRL] = 0x000F
    begin = time.monotonic()
    with device(sensor, start_up_time=0.1):
        assert time.monotonic() - begin >= 0.1
        assert sensor.registers[Register.GPIO_CTRL] == 0


def test_sensor_that_is_just_starting_is_waited_for(sensor):
    sensor.power_cycle()
    with device(sensor, start_up_time=0.5) as imu:
        imu.read()


def test_another_product_is_refused_with_what_it_answers(sensor):
    sensor.product = 16445
    error = fails(device(sensor).configure)
    assert error.fault is DeviceFault.CORRUPT
    assert "PROD_ID is 0x403D (16445), not 0x4040 (16448)" in str(error)
    # Nothing was written: settings are as delivered.
    assert not sensor.registers[Register.MSC_CTRL] & BURST_CRC


def test_sensor_without_crc_is_refused(sensor, monkeypatch):
    real = sensor._write

    def write(address, data):
        real(address, data & ~BURST_CRC if address == Register.MSC_CTRL else data)

    monkeypatch.setattr(sensor, "_write", write)
    error = fails(device(sensor).configure)
    assert error.fault is DeviceFault.CORRUPT
    assert "MSC_CTRL is 0x0006 after 0x0016 was written" in str(error)


# --- faults


def test_every_damaged_bit_of_a_burst_is_refused(sensor):
    bus = Damaged(sensor)
    with device(bus, timeout_ms=5000.0) as imu:
        # The first word came before the command, and DIAG_STAT the CRC does not cover.
        for word in range(2, BURST_WORDS + 1):
            for bit in range(16):
                bus.masks = [(word, 1 << bit)] * 2
                error = fails(imu.read)
                assert error.fault is DeviceFault.CORRUPT
                assert "CRC of the burst is 0x" in str(error)
                assert not bus.masks
        imu.read()


def test_single_damaged_burst_is_read_again(sensor):
    bus = Damaged(sensor)
    with device(bus) as imu:
        expected = imu.read()
        before = sensor.transfers
        bus.masks = [(5, 1 << 3)]
        assert imu.read() == expected
        assert sensor.transfers == before + 2


def test_failures_are_named(imu, sensor):
    for bit, text in FAILURES.items():
        sensor.failed = 1 << bit
        error = fails(imu.read)
        assert error.fault is DeviceFault.FAILED
        assert text in str(error)
    sensor.failed = 1 << 10 | 1 << 6
    assert "flash checksum is wrong, x gyro self-test failed" in str(fails(imu.read))
    sensor.failed = 0
    imu.read()


def test_sensor_that_has_failed_is_not_configured(sensor):
    sensor.failed = 1 << 15
    error = fails(device(sensor).configure)
    assert error.fault is DeviceFault.FAILED
    assert "z accelerometer self-test failed (DIAG_STAT 0x8000)" in str(error)


@pytest.mark.parametrize(("level", "text"), [(0xFF, "0xFFFF"), (0x00, "0x0000")])
def test_stuck_line_is_silence(imu, sensor, monkeypatch, level, text):
    monkeypatch.setattr(sensor, "xfer2", lambda values: [level] * len(values))
    for call in (imu.read, imu.read, device(sensor).configure):
        error = fails(call)
        assert error.fault is DeviceFault.SILENT
        assert f"all that is read is {text} (MISO is stuck" in str(error)
    monkeypatch.undo()
    imu.read()


def test_wrong_sensor_shows_the_opposite(imu, misbehaviour, harness):
    harness.set("imu.gyro", (0.5, 0.0, 0.0))
    begin(misbehaviour, "wrong")
    assert imu.read()["gyro"][0] == pytest.approx(-0.5, abs=4e-4)


def test_sensor_that_lost_its_supply_is_set_up_again(imu, sensor):
    sensor.power_cycle()
    assert not sensor.registers[Register.MSC_CTRL] & BURST_CRC
    assert fails(imu.read).fault is DeviceFault.SILENT
    until_it_reads(imu)
    assert sensor.registers[Register.MSC_CTRL] & BURST_CRC
    assert sensor.registers[Register.SMPL_PRD] == 3 << 8 | INTERNAL_CLOCK


def test_sensor_that_has_another_length_is_corrupt(imu, sensor, monkeypatch):
    monkeypatch.setattr(sensor, "xfer2", lambda values: [0] * (len(values) - 2))
    error = fails(imu.read)
    assert error.fault is DeviceFault.CORRUPT
    assert "bytes were received for 28" in str(error)


# --- registers


def test_register_is_answered_while_the_next_word_is_sent(sensor):
    assert sensor.xfer2([Register.PROD_ID, 0]) == [0, 0]
    assert sensor.xfer2([Register.TEMP_OUT, 0]) == [0x40, 0x40]
    # 25 degC are -81 counts, in 12 bits.
    assert sensor.xfer2([0, 0]) == [0x0F, 0xAF]
    pair = sensor.xfer2([Register.PROD_ID, 0, 0, 0])
    assert pair[2:] == [0x40, 0x40]


def test_transfer_that_is_not_of_whole_words_is_told_once(sensor):
    sensor.xfer2([Register.PROD_ID, 0, 0])
    sensor.xfer2([Register.DIAG_STAT, 0])
    assert sensor.xfer2([Register.DIAG_STAT, 0]) == [0, 1 << 3]
    assert sensor.xfer2([0, 0]) == [0, 0]


# --- sockets


def test_two_clients_share_a_chip(server):
    with device(address=server.address) as one, device(address=server.address) as other:
        # The second one has reset the sensor and set it up alike.
        assert until_it_reads(one) == other.read()


def test_server_that_hangs_is_silent_in_time(socket_path, judge):
    with socket.socket(socket.AF_UNIX) as listener, judge() as judged:
        listener.bind(socket_path)
        listener.listen()
        error = fails(device(address=f"unix:{socket_path}").configure)
    judged.check(TIMEOUT + MARGIN)
    assert error.fault is DeviceFault.SILENT
    assert "no answer within 0.2 s" in str(error)


def test_slow_bus_does_not_take_longer_than_the_timeout(imu, sensor, monkeypatch, judge):
    real = sensor.xfer2

    def slow(values):
        time.sleep(0.04)
        return real(values)

    monkeypatch.setattr(sensor, "xfer2", slow)
    imu.read()
    # Set up again, it would be more than a dozen transfers.
    imu._is_set_up = False
    with judge() as judged:
        assert fails(imu.read).fault is DeviceFault.SILENT
    judged.check(TIMEOUT + MARGIN)


def test_socket_that_a_killed_server_left_is_replaced(sensor, socket_path):
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(socket_path)
    with SpiSocketServer(socket_path, sensor), device(address=f"unix:{socket_path}") as imu:
        imu.read()


def test_transfer_that_comes_in_pieces_is_answered(server, socket_path):
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(socket_path)
        connection.settimeout(5.0)
        for byte in b"\x00\x04\x56\x00\x00\x00":
            connection.sendall(bytes([byte]))
        assert connection.recv(6, socket.MSG_WAITALL)[4:] == b"\x40\x40"


# --- spidev


class FakeSpiDev:
    """The part of spidev that the device uses, without a bus."""

    made: list = []  # noqa: RUF012

    def __init__(self):
        self.path, self.is_closed = None, False
        FakeSpiDev.made.append(self)

    def open_path(self, path):
        self.path = path
        if path == "/dev/spidev9.9":
            raise FileNotFoundError(2, "No such file or directory", path)

    def xfer2(self, values):
        return self.chip.xfer2(values)

    def close(self):
        self.is_closed = True


@pytest.mark.parametrize("address", ["/dev/spidev0.1", "0.1"])
def test_bus_of_this_computer_is_opened_in_mode_3(sensor, monkeypatch, address):
    monkeypatch.setattr(FakeSpiDev, "chip", sensor, raising=False)
    monkeypatch.setattr(adis16448_spi, "need", lambda _: SimpleNamespace(SpiDev=FakeSpiDev))
    with device(address=address, clock_khz=500.0) as imu:
        imu.read()
        bus = FakeSpiDev.made[-1]
        assert (bus.path, bus.mode, bus.max_speed_hz) == ("/dev/spidev0.1", 3, 500_000)
    assert bus.is_closed


def test_bus_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr(adis16448_spi, "need", lambda _: SimpleNamespace(SpiDev=FakeSpiDev))
    error = fails(device(address="9.9").configure)
    assert error.fault is DeviceFault.UNPLUGGED
    assert "/dev/spidev9.9" in str(error)
    assert FakeSpiDev.made[-1].is_closed
