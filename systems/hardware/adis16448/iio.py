"""An ADIS16448 behind Linux's driver for it, on this computer or another one."""

import errno
import re
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from parapod.systems.core.extras import need
from parapod.systems.core.quoting import show
from parapod.systems.hardware.adis16448.registers import (
    MEASURES,
    SCALES,
    Measured,
    mounted,
    mounting_axes,
    sample_rate,
)
from parapod.systems.hardware.adis16448.settings import IioSettings
from parapod.systems.hardware.clock import answer_time
from parapod.systems.hardware.device import Device, DeviceError, DeviceFault, Signals

# IIO's units in ours (Linux, Documentation/ABI/testing/sysfs-bus-iio): the driver's channels of
# rad/s, m/s^2, gauss, and thousandths of a degree Celsius.
_CHANNELS = {"gyro": ("anglvel", 1.0), "accel": ("accel", 1.0), "mag": ("magn", 1e-4)}
_TEMPERATURE, _MILLI = "temp0", 1e-3

# The driver's name for the sensor.
_DRIVER = "adis16448"
# One count of the magnetometer [T]: 1/7 mgauss (data sheet). The driver says 0.5 mgauss, the value
# of the ADIS16400 (Linux 6.14, drivers/iio/imu/adis16400.c), 3.5 times too much.
_MAG_RESOLUTION = SCALES["mag"].resolution

# Default port of iiod.
_PORT = 30431
_NETWORK = re.compile(r"ip:(\[[^]]+\]|[^:]+)(?::(\d+))?")

# A register read from a line that is not driven: all bits set, or none.
_STUCK = {-1: "high", 0: "low"}

# Answers of libiio when the connection or the device behind it is gone, besides the errors of
# connections that Python has classes for.
_GONE = (
    errno.ENODEV,
    errno.ENXIO,
    errno.ENOENT,
    errno.EBADF,
    errno.EHOSTUNREACH,
    errno.ENETUNREACH,
    errno.ENETDOWN,
    errno.EHOSTDOWN,
)


class Adis16448Iio(Device):
    """Angular velocity, specific force, magnetic field and temperature, from Linux IIO.

    | signal | size | unit | meaning |
    |---|---|---|---|
    | measure `gyro` | 3 | rad/s | angular velocity |
    | measure `accel` | 3 | m/s^2 | specific force; level and at rest: (0, 0, g) |
    | measure `mag` | 3 | T | magnetic field |
    | measure `temperature` | 1 | degC | of the sensor |

    Vectors are in the platform's frame, see the settings' `mounting_deg`. Scales and offsets are
    the driver's, but for the magnetometer's. The driver rounds them to six decimals, which makes
    `accel` 0.04 % and `gyro` 0.02 % too small, and its offset makes `temperature` 0.05 degC too
    small.

    `read` reads ten attributes, each of which is a transfer to the sensor: they are not of the
    same instant, and of one that samples slowly not always of the same sample. A buffer would
    need a trigger, which only a data ready line wired to an interrupt gives.

    The driver checks no CRC: a sensor that is off shows in all values being the same, -1 or 0,
    which is `SILENT`; damaged values look like others. A connection that is lost is
    made again by the next `read`.
    """

    measures: Mapping[str, int] = MEASURES

    def __init__(self, settings: IioSettings):
        """Creates a device that is not configured.

        Args:
            settings: place of the driver, and how the sensor samples.

        Raises:
            ValueError: settings that it does not have.
        """
        _check(settings)
        self._settings = settings
        self.name = f"{_DRIVER} at {settings.uri.rstrip(':')}"
        self._axes = mounting_axes(settings.mounting)
        self._context: Any = None
        self._raw: list[Any] = []
        self._scales: list[float] = []
        self._offset = self._temperature_scale = 0.0
        self._is_configured = False

    def configure(self) -> None:
        """Connects, identifies the sensor, reads its scales and sets its sample rate."""
        self.close()
        self._connect()
        self._is_configured = True

    def read(self) -> Signals:
        """The newest values."""
        if not self._is_configured:
            raise DeviceError(self.name, "is not configured", DeviceFault.UNPLUGGED)
        deadline = time.monotonic() + answer_time(0.5 * self._settings.timeout)
        if self._context is None:
            self._connect()
        with self._faults():
            counts = [_number(attribute) for attribute in self._read_raw(deadline)]
        level = _STUCK.get(int(counts[0]))
        if level is not None and counts.count(counts[0]) == len(counts):
            raise DeviceError(
                self.name,
                f"the sensor does not answer: all that the driver reads is {counts[0]:g} "
                f"(MISO is stuck {level})",
                DeviceFault.SILENT,
            )
        values = [scale * count for scale, count in zip(self._scales, counts[:9], strict=True)]
        measured: Measured = {
            name: tuple(values[3 * i : 3 * i + 3]) for i, name in enumerate(_CHANNELS)
        }
        measured["temperature"] = ((counts[9] + self._offset) * self._temperature_scale,)
        return mounted(measured, self._axes)

    def close(self) -> None:
        """Ends the connection."""
        self._is_configured = False
        self._hang_up()

    def _hang_up(self) -> None:
        # Attributes point into the context, which is destroyed with its last reference.
        self._raw = []
        self._context = None

    def _connect(self) -> None:
        try:
            with self._faults():
                _probe(self._settings.uri, answer_time(0.25 * self._settings.timeout))
                iio = need("iio")
                self._context = iio.Context(self._settings.uri)
                self._context.set_timeout(round(1e3 * answer_time(0.5 * self._settings.timeout)))
                self._set_up(self._find())
        except BaseException:
            self._hang_up()
            raise

    def _find(self) -> Any:
        device = self._context.find_device(_DRIVER)
        if device is None:
            names = [other.name or other.id for other in self._context.devices]
            there = f"there are: {', '.join(names)}" if names else "there are no devices at all"
            raise DeviceError(self.name, f"there is no {_DRIVER}; {there}", DeviceFault.CORRUPT)
        return device

    def _set_up(self, device: Any) -> None:
        rate = sample_rate(self._settings.decimation)
        device.attrs["sampling_frequency"].value = f"{rate:.6f}"
        self._raw, self._scales = [], []
        for name, (kind, unit) in _CHANNELS.items():
            for axis in "xyz":
                attributes = self._attributes(device, f"{kind}_{axis}")
                self._raw.append(attributes["raw"])
                scale = unit * _number(attributes["scale"])
                if name == "mag":
                    scale = _MAG_RESOLUTION
                self._scales.append(scale)
        attributes = self._attributes(device, _TEMPERATURE)
        self._raw.append(attributes["raw"])
        self._offset = _number(attributes["offset"])
        self._temperature_scale = _MILLI * _number(attributes["scale"])

    def _attributes(self, device: Any, channel: str) -> Any:
        channel_found = device.find_channel(channel)
        if channel_found is None:
            raise DeviceError(self.name, f"has no channel {channel}", DeviceFault.CORRUPT)
        return channel_found.attrs

    def _read_raw(self, deadline: float) -> Iterator[Any]:
        """The attributes, as long as there is time for one more."""
        for attribute in self._raw:
            if time.monotonic() > deadline:
                raise TimeoutError
            yield attribute

    @contextmanager
    def _faults(self) -> Iterator[None]:
        """Makes errors of libiio those of a device; without a connection if it cannot go on."""
        try:
            yield
        except TimeoutError as error:
            # What comes later would be taken for the answer to the next question.
            self._hang_up()
            text = f"no answer within {self._settings.timeout:g} s"
            raise DeviceError(self.name, text, DeviceFault.SILENT) from error
        except KeyError as error:
            raise DeviceError(
                self.name, f"has no attribute {error}", DeviceFault.CORRUPT
            ) from error
        except ValueError as error:
            raise DeviceError(self.name, str(error), DeviceFault.CORRUPT) from error
        except OSError as error:
            is_lost = isinstance(error, ConnectionError | socket.gaierror)
            if not is_lost and error.errno not in _GONE:
                raise DeviceError(self.name, str(error), DeviceFault.FAILED) from error
            self._hang_up()
            text = f"cannot be reached: {error}"
            raise DeviceError(self.name, text, DeviceFault.UNPLUGGED) from error


def _number(attribute: Any) -> float:
    text = attribute.value
    try:
        return float(text)
    except ValueError as error:
        raise ValueError(f"{attribute.filename} reads {text!r}, which is not a number") from error


def _probe(uri: str, timeout: float) -> None:
    """Asks iiod for its version: libiio itself gives a computer that is away 5 s.

    Args:
        uri: uri of a context; only those of a named host are asked.
        timeout: longest time for the connection, and for the answer [s].

    Raises:
        OSError: there is no answer.
    """
    match = _NETWORK.fullmatch(uri)
    if match is None:
        return
    address = match[1].strip("[]"), int(match[2] or _PORT)
    with socket.create_connection(address, timeout) as connection:
        connection.sendall(b"VERSION\r\n")
        if not connection.recv(64):
            raise ConnectionResetError("the other end has hung up")


def _check(settings: IioSettings) -> None:
    """Refuses settings that the sensor does not have."""
    if not re.match(r"[a-z]+:", settings.uri):
        raise ValueError(f'uri must be as "local:" or "ip:host", not {show(settings.uri)}')
