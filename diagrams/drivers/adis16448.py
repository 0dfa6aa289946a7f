"""Drivers of the inertial sensor ADIS16448."""

import math
from contextlib import AbstractContextManager
from dataclasses import dataclass

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.diagrams.scenario import quantity
from parapod.systems.core.errors import OutputError, ScenarioError
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.adis16448.emulator import Adis16448Registers, SpiSocketServer
from parapod.systems.hardware.adis16448.iio import Adis16448Iio, Adis16448IioParams
from parapod.systems.hardware.adis16448.iiod import IiodServer, is_available
from parapod.systems.hardware.adis16448.spi import Adis16448Spi, Adis16448SpiParams
from parapod.systems.hardware.device import Device
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


@dataclass
class Adis16448SpiImu(Driver):
    """The inertial sensor on an SPI bus of this computer: see `Adis16448Spi`.

    Attributes:
        part: of the machine.
        address: "/dev/spidev0.0", bus and chip; "unix:/path" for an emulated one.
        clock_khz: of the bus [kHz].
        decimation: D of the sample rate 819.2 Hz / 2^D [-].
        mounting_deg: roll, pitch and yaw of the sensor in the platform's frame [deg].
        timeout_ms: longest time for one call [ms].
    """

    part: str = "imu"
    address: str = "unix:emulator/spi.sock"
    clock_khz: float = quantity(1000.0, 10.0, 1000.0)
    decimation: int = quantity(3, 0, 12)
    mounting_deg: list[float] = quantity([0.0] * 3, -180.0, 180.0, length=3)
    timeout_ms: float = quantity(100.0, 1.0, 10000.0)

    def make(self, ports: PartPorts) -> Device:
        """See `Driver`."""
        roll, pitch, yaw = map(math.radians, self.mounting_deg)
        with named(self):
            params = Adis16448SpiParams(
                address=resolved(self.address),
                clock=1e3 * self.clock_khz,
                decimation=self.decimation,
                mounting=(roll, pitch, yaw),
                timeout=1e-3 * self.timeout_ms,
            )
        return Adis16448Spi(params)

    def emulate(
        self, harness: Harness, misbehaviour: Misbehaviour
    ) -> AbstractContextManager[object]:
        """See `Driver`: the sensor's registers behind a socket."""
        address = emulated(self.address, f"!{type(self).__name__}.address")
        registers = Adis16448Registers(harness, misbehaviour)
        return SpiSocketServer(address.removeprefix("unix:"), registers, misbehaviour)


@dataclass
class Adis16448IioImu(Driver):
    """The inertial sensor through Linux IIO, here or on another computer: see `Adis16448Iio`.

    Attributes:
        part: of the machine.
        uri: of libiio's context: "local:", "ip:host" or "ip:host:port"; of an emulated one
            "ip:127.0.0.1:port" with any free port.
        decimation: D of the sample rate 819.2 Hz / 2^D [-].
        mounting_deg: roll, pitch and yaw of the sensor in the platform's frame [deg].
        timeout_ms: longest time for one call [ms].
    """

    part: str = "imu"
    uri: str = "local:"
    decimation: int = quantity(3, 0, 12)
    mounting_deg: list[float] = quantity([0.0] * 3, -180.0, 180.0, length=3)
    timeout_ms: float = quantity(500.0, 1.0, 10000.0)

    def make(self, ports: PartPorts) -> Device:
        """See `Driver`."""
        roll, pitch, yaw = map(math.radians, self.mounting_deg)
        with named(self):
            params = Adis16448IioParams(
                uri=self.uri,
                decimation=self.decimation,
                mounting=(roll, pitch, yaw),
                timeout=1e-3 * self.timeout_ms,
            )
        return Adis16448Iio(params)

    def emulate(
        self, harness: Harness, misbehaviour: Misbehaviour
    ) -> AbstractContextManager[object]:
        """See `Driver`: the kernel's files, made up, behind Debian's own iiod."""
        here, _, port = self.uri.rpartition(":")
        if here != "ip:127.0.0.1" or not port.isdecimal():
            key = f"!{type(self).__name__}.uri"
            text = f"{key} = {self.uri} is not an address of the emulator, ip:127.0.0.1:PORT"
            raise ScenarioError(text, key)
        reason = is_available()
        if reason is not None:
            raise OutputError(f"iiod cannot be emulated here: {reason}; use !Adis16448SpiImu")
        return IiodServer(harness, misbehaviour, int(port))
