"""Settings of Sabertooth motor drivers that share a serial line."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.hardware.addresses import resolved

BAUDS: Mapping[int, int] = MappingProxyType({2400: 1, 9600: 2, 19200: 3, 38400: 4})
"""Speeds [bit/s] and the data of `Command.BAUD_RATE` that select them."""

_MOTORS = (1, 2)


@dataclass
class SabertoothSettings(Schema):
    """Sabertooth 2x25 V2 motor drivers in packet serial mode, two actuators on each.

    Attributes:
        part: part of the machine, as in the names of its ports.
        port: serial port; a level converter to 5 V leads from it to the drivers' inputs S1.
        baud: speed of the line [bit/s]; at 38400 four packets take 4.2 ms, at the maker's setting
            of 9600 they take 16.7 ms.
        power_on_baud: speed at which the drivers still listen [bit/s], where it is another one, as
            with new ones (9600): it is changed once, and they remember it without power.
        addresses: addresses of the motor drivers, as their switches 4 to 6 are set, in the order
            of the actuators: two each, motors 1 and 2.
        supply_voltage: supply of the motor drivers [V]; the prototype's actuators are for 12 V.
        serial_timeout_ms: silence after which the drivers stop the motors by themselves [ms]; a
            multiple of 100, the unit of their setting. 200 at most: it counts from the last
            packet, which a controller that dies has sent before, so that actuators stand within
            200 ms of its death, apart from what the port still held (one set of packets).
    """

    part: str = "legs"
    port: str = "emulator/sabertooth"
    baud: int = choice(38400, tuple(BAUDS))
    power_on_baud: int | None = choice(None, tuple(BAUDS))
    addresses: list[int] = field(default_factory=lambda: [128, 129])
    supply_voltage: float = quantity(12.0, 1.0, 48.0)
    serial_timeout_ms: float = quantity(100.0, 100.0, 200.0)

    @property
    def path(self) -> str:
        """Path of the port, an emulator's address resolved."""
        return resolved(self.port)

    @property
    def place(self) -> str:
        """See `Device`: the port, wherever this program was started."""
        return os.path.abspath(self.path)

    @property
    def motors(self) -> list[tuple[int, int]]:
        """Address of the driver and motor on it, one by one."""
        return [(address, motor) for address in self.addresses for motor in _MOTORS]

    @property
    def serial_timeout(self) -> float:
        """Silence after which the drivers stop the motors by themselves [s]."""
        return 1e-3 * self.serial_timeout_ms
