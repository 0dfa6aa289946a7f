"""Which actuators are on which Sabertooth motor drivers, and where their serial line is."""

import math
from dataclasses import dataclass

from parapod.systems.hardware.sabertooth.protocol import (
    ADDRESSES,
    BAUDS,
    BITS_PER_BYTE,
    MOTORS,
    PACKET_BYTES,
    timeout_packet,
)

# Longest time that the actuators may go on without a controller [s].
_LONGEST_TIMEOUT = 0.2


@dataclass(frozen=True)
class SabertoothParams:
    """Motor drivers on a serial line, and the actuators on them.

    Attributes:
        port: the serial port; a level converter to 5 V leads from it to the drivers' inputs S1.
        baud: speed of the line [bit/s]; at 38400 four packets take 4.2 ms, at the maker's setting
            of 9600 they take 16.7 ms.
        power_on_baud: speed at which the drivers still listen [bit/s], if it is another one (9600
            for new ones): `configure` changes it to `baud`, which the drivers keep without power
            (EEPROM), so this is for the first start only. None: they listen at `baud`.
        addresses: of the drivers, as their switches 4 to 6 are set.
        actuators: address of the driver and motor on it (1 or 2) of each actuator.
        supply_voltage: of the drivers [V]; the prototype's actuators are for 12 V.
        serial_timeout: silence after which the drivers stop the motors by themselves [s]; a
            multiple of 0.1, the unit of their setting. 0.2 at most: it counts from the last
            packet, which a controller that dies has sent before, so that actuators stand within
            0.2 s of its death, apart from what the port still held (one set of packets).
        refresh_interval: longest time between two packets to a motor [s], if `write` is called
            that often; half of `serial_timeout` at most, so that one lost packet stops nothing.
        arming_interval: longest time between two settings of a driver's serial timeout [s].
    """

    port: str = "/dev/ttyUSB0"
    baud: int = 38400
    power_on_baud: int | None = None
    addresses: tuple[int, ...] = (128, 129)
    actuators: tuple[tuple[int, int], ...] = ((128, 1), (128, 2), (129, 1), (129, 2))
    supply_voltage: float = 12.0
    serial_timeout: float = 0.2
    refresh_interval: float = 0.05
    arming_interval: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "addresses", tuple(self.addresses))
        object.__setattr__(self, "actuators", tuple((a, m) for a, m in self.actuators))
        for baud in (self.baud, self.power_on_baud):
            if baud is not None and baud not in BAUDS:
                raise ValueError(f"baud must be one of {', '.join(map(str, BAUDS))}, not {baud}")
        for name in ("supply_voltage", "arming_interval"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be above 0 and finite, not {getattr(self, name)}")
        self._check_motors()
        self._check_times()

    @property
    def name(self) -> str:
        """What errors call the drivers."""
        return f"Sabertooth on {self.port}"

    @property
    def packet_time(self) -> float:
        """What a packet takes on the line [s]."""
        return PACKET_BYTES * BITS_PER_BYTE / self.baud

    @property
    def set_size(self) -> int:
        """Number of packets in a full set: one for each motor, and one that arms a timeout."""
        return len(self.actuators) + 1

    def _check_motors(self) -> None:
        known = [address for address in self.addresses if address in ADDRESSES]
        if len(set(known)) != len(self.addresses):
            raise ValueError(
                f"addresses must be different ones of {ADDRESSES[0]}..{ADDRESSES[-1]}, "
                f"not {self.addresses}"
            )
        motors = [(address, 1 + i) for address in self.addresses for i in range(MOTORS)]
        found = [actuator for actuator in self.actuators if actuator in motors]
        if not found or len(set(found)) != len(self.actuators):
            raise ValueError(
                f"actuators must be different pairs of address and motor (1 or {MOTORS}) of the "
                f"drivers {self.addresses}, not {self.actuators}"
            )

    def _check_times(self) -> None:
        timeout_packet(self.addresses[0], self.serial_timeout)
        if self.serial_timeout > _LONGEST_TIMEOUT:
            raise ValueError(
                f"serial_timeout must be {_LONGEST_TIMEOUT} s at most, not {self.serial_timeout} "
                "s: so long the actuators would go on when the controller dies"
            )
        least, most = self.set_size * self.packet_time, 0.5 * self.serial_timeout
        if not least <= self.refresh_interval <= most:
            raise ValueError(
                f"refresh_interval must be {least:.4f} s (a set of packets at {self.baud} bit/s) "
                f"to {most} s (half of serial_timeout), not {self.refresh_interval} s"
            )
