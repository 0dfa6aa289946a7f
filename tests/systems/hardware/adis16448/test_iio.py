import errno
import socket
import time
from types import SimpleNamespace

import pytest

from parapod.systems.core.errors import MissingExtra
from parapod.systems.core.extras import need
from parapod.systems.hardware.adis16448 import iio as adis16448_iio
from parapod.systems.hardware.adis16448.iio import Adis16448Iio
from parapod.systems.hardware.adis16448.iiod import IiodServer, is_available
from parapod.systems.hardware.adis16448.registers import SCALES
from parapod.systems.hardware.adis16448.settings import IioSettings
from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from tests.conftest import standing_still


def why_not():
    """Why there can be no emulated driver here, or no client of it."""
    try:
        need("iio")
    except MissingExtra as error:
        return str(error)
    return is_available()


REASON = why_not()
needs_iiod = pytest.mark.skipif(REASON is not None, reason=f"iiod cannot run here: {REASON}")

TIMEOUT = 2.0
# What a busy computer may add to a timeout [s].
MARGIN = 0.3
# How much of the values the driver's rounded scales leave.
SCALE_ERRORS = {"gyro": 3e-4, "accel": 5e-4, "mag": 1e-9}


@pytest.fixture(scope="module")
def harness():
    return Harness({"imu.gyro": 3, "imu.accel": 3, "imu.mag": 3})


@pytest.fixture(scope="module")
def misbehaviour():
    return Misbehaviour()


@pytest.fixture(scope="module")
def server(harness, misbehaviour):
    with IiodServer(harness, misbehaviour) as server:
        yield server


@pytest.fixture
def imu(server, misbehaviour):
    misbehaviour.end()
    until(lambda: server.process is not None)
    with device(server) as imu:
        yield imu
    misbehaviour.end()


def made(uri, **settings):
    return Adis16448Iio(IioSettings(uri=uri, timeout_ms=1e3 * TIMEOUT, **settings))


def device(server, **settings):
    return made(server.uri, **settings)


def until(condition, timeout=60.0):
    """Waits for a condition; a device that fails has not fulfilled it."""
    deadline = time.monotonic() + timeout
    while True:
        try:
            if condition():
                return
        except DeviceError:
            pass
        assert time.monotonic() < deadline
        time.sleep(0.001)


def fails(call, *arguments):
    """The error that a call raises."""
    with pytest.raises(DeviceError) as caught:
        call(*arguments)
    return caught.value


def reads(imu, harness, **signals):
    """Puts signals on the wires and waits until they arrive within half a count."""
    for name, values in signals.items():
        harness.set(f"imu.{name}", values)

    def has_arrived():
        measured = imu.read()
        return all(
            abs(shown - value) < 0.51 * SCALES[name].resolution + SCALE_ERRORS[name] * abs(value)
            for name, values in signals.items()
            for shown, value in zip(measured[name], values, strict=True)
        )

    until(has_arrived)
    return imu.read()


@needs_iiod
def test_signals_arrive_within_half_a_count(imu, harness):
    reads(imu, harness, gyro=(0.1, -0.2, 0.3), accel=(0.5, -1.0, 9.8), mag=(22e-6, 0.0, -42e-6))
    reads(imu, harness, gyro=(-10.0, 17.0, 0.0), accel=(-100.0, 170.0, 0.0), mag=(1e-4, 0.0, 0.0))


@needs_iiod
def test_signals_beyond_the_range_show_its_limit(imu, harness):
    harness.set("imu.accel", (1e3, -1e3, 0.0))
    limit = 18.0 * 9.80665
    until(lambda: imu.read()["accel"] == pytest.approx((limit, -limit, 0.0), rel=5e-4))


@needs_iiod
def test_temperature_arrives(imu, server):
    for value in (-20.0, 25.0):
        server.temperature = value
        # Half a count, and what the driver's integer offset leaves.
        expected = pytest.approx([value], abs=0.04 + 0.06)
        until(lambda expected=expected: imu.read()["temperature"] == expected)


@needs_iiod
def test_mounting_turns_the_vectors(imu, server, harness):
    reads(imu, harness, accel=(1.0, 2.0, 9.8))
    with device(server, mounting_deg=[180.0, 0.0, 0.0]) as turned:
        assert turned.read()["accel"] == pytest.approx((1.0, -2.0, -9.8), abs=0.01)


@needs_iiod
@pytest.mark.parametrize(("decimation", "rate"), [(3, 102.4), (0, 819.2), (12, 0.2)])
def test_sample_rate_is_set(imu, server, decimation, rate):
    with device(server, decimation=decimation):
        assert server.rate == pytest.approx(rate)


@needs_iiod
def test_sensor_that_is_not_there_is_refused_with_those_that_are(harness, misbehaviour):
    with IiodServer(harness, misbehaviour, device="adis16400") as other:
        error = fails(device(other).configure)
    assert error.fault is DeviceFault.CORRUPT
    assert "there is no adis16448; there are: adis16400" in str(error)


@needs_iiod
def test_sensor_that_is_off_is_told_by_what_the_driver_reads(imu, misbehaviour, harness):
    reads(imu, harness, accel=(0.0, 0.0, 9.80665))
    misbehaviour.begin("off", time.monotonic())
    words = "all that the driver reads is -1 (MISO is stuck high)"

    def is_told():
        try:
            imu.read()
        except DeviceError as error:
            return words in str(error)
        return False

    until(is_told)


@needs_iiod
def test_wrong_sensor_shows_what_it_should(imu, misbehaviour, harness):
    reads(imu, harness, gyro=(0.5, 0.0, 0.0))
    misbehaviour.begin("wrong", time.monotonic())
    until(lambda: imu.read()["gyro"][0] == pytest.approx(-0.5, abs=1e-3))


@needs_iiod
def test_computer_that_hangs_is_silent_in_time(imu, server, harness, judge):
    reads(imu, harness, gyro=(0.1, 0.0, 0.0))
    with standing_still(server.process.pid):
        # libiio calls its own timeout a broken connection.
        assert fails(imu.read).fault in (DeviceFault.SILENT, DeviceFault.UNPLUGGED)
        with judge() as judged:
            assert fails(imu.read).fault is DeviceFault.SILENT
        judged.check(TIMEOUT + MARGIN)
    reads(imu, harness, gyro=(0.2, 0.0, 0.0))


class FakeIio:
    """The part of libiio that the device uses, with attributes that fail as they are told to."""

    def __init__(self, value="1.0", channels=True, rate=True):
        self.value = value
        self.attrs = {"sampling_frequency": SimpleNamespace(value="")} if rate else {}
        self._names = ("raw", "scale", "offset")
        self._channels = channels

    def context(self, uri):
        return SimpleNamespace(
            set_timeout=lambda _: None, find_device=lambda _: self, devices=[self]
        )

    def find_channel(self, name):
        attributes = {kind: Attribute(f"in_{name}_{kind}", self) for kind in self._names}
        return SimpleNamespace(attrs=attributes) if self._channels else None


class Attribute:
    def __init__(self, filename, iio):
        self.filename, self._iio = filename, iio

    @property
    def value(self):
        if isinstance(self._iio.value, Exception):
            raise self._iio.value
        return self._iio.value


@pytest.mark.parametrize(
    ("iio", "fault", "text"),
    [
        (FakeIio(channels=False), DeviceFault.CORRUPT, "has no channel anglvel_x"),
        (FakeIio(rate=False), DeviceFault.CORRUPT, "has no attribute 'sampling_frequ"),
        (FakeIio("x"), DeviceFault.CORRUPT, "in_anglvel_x_scale reads 'x', which is not a num"),
        (FakeIio(OSError(errno.EIO, "EIO")), DeviceFault.FAILED, "EIO"),
        (FakeIio(OSError(errno.EACCES, "EACCES")), DeviceFault.FAILED, "EACCES"),
        (FakeIio(OSError(errno.ENODEV, "ENODEV")), DeviceFault.UNPLUGGED, "ENODEV"),
        (FakeIio(OSError(errno.ETIMEDOUT, "-")), DeviceFault.SILENT, "no answer within"),
    ],
)
def test_errors_of_the_driver_are_faults(monkeypatch, iio, fault, text):
    fake = SimpleNamespace(Context=iio.context)
    monkeypatch.setattr(adis16448_iio, "need", lambda _: fake)
    error = fails(made("local:").configure)
    assert error.fault is fault
    assert str(error).startswith("adis16448 at local: ")
    assert text in str(error)


def test_scale_of_the_magnetometer_is_not_the_drivers(monkeypatch):
    # The driver says 0.5 mgauss a count in place of 1/7.
    iio = FakeIio("2.0")
    monkeypatch.setattr(adis16448_iio, "need", lambda _: SimpleNamespace(Context=iio.context))
    with made("local:") as imu:
        iio.value = "700"
        measured = imu.read()
    assert measured["mag"] == pytest.approx([700 * 1e-7 / 7.0] * 3)
    assert measured["gyro"] == pytest.approx([1400.0] * 3)


def test_host_that_has_no_address_is_named():
    imu = made("ip:host.invalid")
    with pytest.raises(DeviceError, match=r"host\.invalid: cannot be reached") as caught:
        imu.configure()
    assert caught.value.fault is DeviceFault.UNPLUGGED


def test_server_that_accepts_and_says_nothing_is_silent_in_time(judge):
    with socket.create_server(("127.0.0.1", 0)) as mute, judge() as judged:
        error = fails(made(f"ip:127.0.0.1:{mute.getsockname()[1]}").configure)
    judged.check(TIMEOUT + MARGIN)
    assert error.fault is DeviceFault.SILENT
