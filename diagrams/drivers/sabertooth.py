"""The driver of actuators on Sabertooth motor drivers with a serial line."""

from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.diagrams.scenario import choice, quantity
from parapod.systems.core.errors import ScenarioError
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.device import Device
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour, MutedHarness
from parapod.systems.hardware.sabertooth.emulator import SabertoothPty
from parapod.systems.hardware.sabertooth.protocol import BAUDS
from parapod.systems.hardware.sabertooth.serial import SabertoothSerial
from parapod.systems.hardware.sabertooth.settings import SabertoothParams


@dataclass
class SabertoothLegs(Driver):
    """Actuators on Sabertooth 2x25 V2 in packet serial mode: see `SabertoothSerial`.

    The encoders need another driver, such as `NiDaqEncoders`.

    Attributes:
        part: of the machine.
        port: the serial port.
        baud: speed of the line [bit/s].
        addresses: of the drivers, in the order of the legs: two legs each, motors 1 and 2.
        supply_voltage: of the drivers [V].
        serial_timeout_ms: silence after which the drivers stop by themselves [ms].
    """

    part: str = "legs"
    port: str = "emulator/sabertooth"
    baud: int = choice(38400, tuple(BAUDS))
    addresses: list[int] = field(default_factory=lambda: [128, 129])
    supply_voltage: float = quantity(12.0, 1.0, 48.0)
    serial_timeout_ms: float = quantity(100.0, 100.0, 200.0)

    def make(self, ports: PartPorts) -> Device:
        """See `Driver`."""
        legs = ports.commands.get("voltage", 0)
        motors = [(address, motor) for address in self.addresses for motor in (1, 2)]
        if len(motors) < legs:
            key = "hardware.drivers"
            raise ScenarioError(
                f"{key}: !SabertoothLegs: {legs} legs need {(legs + 1) // 2} addresses, "
                f"not {len(self.addresses)}",
                key,
            )
        with named(self):
            params = SabertoothParams(
                port=resolved(self.port),
                baud=self.baud,
                addresses=tuple(self.addresses),
                actuators=tuple(motors[:legs]),
                supply_voltage=self.supply_voltage,
                serial_timeout=1e-3 * self.serial_timeout_ms,
            )
        return SabertoothSerial(params)

    def emulate(
        self, harness: Harness, misbehaviour: Misbehaviour
    ) -> AbstractContextManager[object]:
        """See `Driver`: the drivers behind a pseudo terminal; the relay is another device's."""
        link = emulated(self.port, f"!{type(self).__name__}.port")
        wires = MutedHarness(harness, ["legs.stop"])
        supply, addresses = self.supply_voltage, self.addresses
        return SabertoothPty(link, wires, misbehaviour, addresses, supply, self.baud)
