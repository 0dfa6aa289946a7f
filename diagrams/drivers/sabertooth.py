"""The driver of actuators on Sabertooth motor drivers with a serial line."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.sabertooth.settings import SabertoothSettings

if TYPE_CHECKING:
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


@dataclass
class SabertoothLegs(SabertoothSettings, Driver):
    """Actuators on Sabertooth 2x25 V2 in packet serial mode: see `SabertoothSerial`.

    The encoders need another driver, such as `NiDaqEncoders`.
    """

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        from parapod.systems.hardware.sabertooth.serial import SabertoothSerial

        legs = ports.commands.get("voltage", 0)
        if len(self.motors) < legs:
            key = "hardware.drivers"
            raise ScenarioError(
                f"{key}: !SabertoothLegs: {legs} legs need {(legs + 1) // 2} addresses, "
                f"not {len(self.addresses)}",
                key,
            )
        with named(self):
            return SabertoothSerial(self, legs)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: the drivers behind a pseudo terminal; the relay is another device's."""
        from parapod.systems.hardware.emulation.harness import MutedHarness
        from parapod.systems.hardware.sabertooth.emulator import SabertoothPty

        link = emulated(self.port, f"!{type(self).__name__}.port")
        wires = MutedHarness(harness, [f"{self.part}.stop"])
        return SabertoothPty(
            link, wires, misbehaviour, self.addresses, self.supply_voltage, self.baud, self.part
        )
