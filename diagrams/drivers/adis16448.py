"""Drivers of the inertial sensor ADIS16448."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.systems.core.errors import OutputError, ScenarioError
from parapod.systems.core.quoting import escaped
from parapod.systems.hardware.adis16448.settings import IioSettings, SpiSettings

if TYPE_CHECKING:
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


@dataclass
class Adis16448SpiImu(SpiSettings, Driver):
    """The inertial sensor on an SPI bus of this computer: see `Adis16448Spi`."""

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        from parapod.systems.hardware.adis16448.spi import Adis16448Spi

        with named(self):
            return Adis16448Spi(self)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: the sensor's registers behind a socket."""
        from parapod.systems.hardware.adis16448.emulator import (
            Adis16448Registers,
            SpiSocketServer,
        )

        address = emulated(self.address, f"!{type(self).__name__}.address")
        registers = Adis16448Registers(harness, misbehaviour, part=self.part)
        return SpiSocketServer(address.removeprefix("unix:"), registers, misbehaviour)


@dataclass
class Adis16448IioImu(IioSettings, Driver):
    """The inertial sensor through Linux IIO, here or on another computer: see `Adis16448Iio`."""

    @property
    def is_emulated(self) -> bool:
        """See `Driver`: iiod of this computer is the emulator's."""
        return self._emulated_port is not None

    @property
    def _emulated_port(self) -> int | None:
        here, _, port = self.uri.rpartition(":")
        return int(port) if here == "ip:127.0.0.1" and port.isdecimal() else None

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        from parapod.systems.hardware.adis16448.iio import Adis16448Iio

        with named(self):
            return Adis16448Iio(self)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: the kernel's files, made up, behind Debian's own iiod."""
        from parapod.systems.hardware.adis16448.iiod import IiodServer, is_available

        port = self._emulated_port
        if port is None:
            key = f"!{type(self).__name__}.uri"
            text = (
                f"{key} = {escaped(self.uri)} is not an address of the emulator, ip:127.0.0.1:PORT"
            )
            raise ScenarioError(text, key)
        reason = is_available()
        if reason is not None:
            raise OutputError(f"iiod cannot be emulated here: {reason}; use !Adis16448SpiImu")
        return IiodServer(harness, misbehaviour, port, part=self.part)
