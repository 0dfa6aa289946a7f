"""Settings of an ADIS16448, on an SPI bus of this computer or behind Linux's driver for it.

"Data sheet" is that of the ADIS16448 by Analog Devices.
"""

import math
from dataclasses import dataclass

from parapod.systems.core.schema import Schema, quantity
from parapod.systems.hardware.addresses import resolved


class _Sensor:
    """Settings of a sensor in SI units, whatever it is connected to."""

    mounting_deg: list[float]
    timeout_ms: float

    @property
    def mounting(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw of the sensor in the platform's frame [rad]."""
        roll, pitch, yaw = map(math.radians, self.mounting_deg)
        return roll, pitch, yaw

    @property
    def timeout(self) -> float:
        """Longest time for one call [s]."""
        return 1e-3 * self.timeout_ms


@dataclass
class SpiSettings(_Sensor, Schema):
    """Sensor on an SPI bus of this computer, or an emulated one.

    Attributes:
        part: part of the machine, as in the names of its ports.
        address: bus and chip, as in "/dev/spidev0.0", or "0.0" for short; "unix:/path" for the
            socket of an emulated one.
        clock_khz: clock of the bus [kHz]; bursts allow 1 MHz at most (data sheet).
        decimation: D, for samples at 819.2 Hz / 2^D that each are the mean of 2^D [-] (data
            sheet); 3, as in simulation.
        mounting_deg: roll, pitch and yaw of the sensor in the platform's frame [deg],
            R = R_z R_y R_x.
        timeout_ms: longest time for one call [ms], but for `configure`, which waits up to two
            start-up times more; ten periods of 100 Hz.
    """

    part: str = "imu"
    address: str = "unix:emulator/spi.sock"
    clock_khz: float = quantity(1000.0, 10.0, 1000.0)
    decimation: int = quantity(3, 0, 12)
    mounting_deg: list[float] = quantity([0.0] * 3, -180.0, 180.0, length=3)
    timeout_ms: float = quantity(100.0, 1.0, 10000.0)

    @property
    def place(self) -> str:
        """See `Device`: the bus's file, or an emulator's socket, its address resolved."""
        address = resolved(self.address)
        return address if address.startswith(("/", "unix:")) else f"/dev/spidev{address}"

    @property
    def clock(self) -> float:
        """Clock of the bus [Hz]."""
        return 1e3 * self.clock_khz


@dataclass
class IioSettings(_Sensor, Schema):
    """Sensor behind Linux's driver, here or on another computer that runs iiod.

    Attributes:
        part: part of the machine, as in the names of its ports.
        uri: libiio's name of the context: "local:" for this computer's kernel, "ip:host" or
            "ip:host:port" for a computer that runs iiod, or what else libiio has; for an emulated
            one "ip:127.0.0.1:port" with any free port.
        decimation: D, for samples at 819.2 Hz / 2^D [-] (data sheet); 3, as in simulation.
        mounting_deg: roll, pitch and yaw of the sensor in the platform's frame [deg],
            R = R_z R_y R_x.
        timeout_ms: longest time for one call [ms]; ten periods of 20 Hz. libiio gives a computer
            that stops answering in the middle of a connection's beginning 5 s.
    """

    part: str = "imu"
    uri: str = "local:"
    decimation: int = quantity(3, 0, 12)
    mounting_deg: list[float] = quantity([0.0] * 3, -180.0, 180.0, length=3)
    timeout_ms: float = quantity(500.0, 1.0, 10000.0)
