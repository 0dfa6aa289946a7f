"""The ADIS16448 inertial sensor: its registers, its burst, and what they mean in SI units.

"Data sheet" is that of the ADIS16448 by Analog Devices. Vectors are along the axes drawn there:
x forward, y to the left, z up, for a sensor that lies on its base.
"""

import math
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

from parapod.systems.core.physics import STANDARD_GRAVITY
from parapod.systems.core.vectors import Axes, Vector3

# Content of register PROD_ID: 16448.
PRODUCT_ID = 0x4040
# From power on to the first valid output (data sheet, "Specifications") [s]; after a reset by
# software 90 ms would do.
START_UP_TIME = 0.205
# Largest decimation D, for the mean of 2^D samples: one in 5 s. More is of no use to a controller.
MAX_DECIMATION = 12
_SAMPLE_RATE = 819.2

# DIAG_STAT, nine outputs of the sensors, BARO_OUT, TEMP_OUT and the CRC.
BURST_WORDS = 13

_GAUSS = 1e-4
_DEGREE = math.radians(1.0)
_TEMPERATURE_AT_ZERO, _TEMPERATURE_BITS = 31.0, 12
TEMPERATURE_RESOLUTION = 0.07386


class Register(IntEnum):
    """Addresses of the registers' lower bytes (data sheet, "User Registers")."""

    FLASH_CNT = 0x00
    XGYRO_OUT = 0x04
    YGYRO_OUT = 0x06
    ZGYRO_OUT = 0x08
    XACCL_OUT = 0x0A
    YACCL_OUT = 0x0C
    ZACCL_OUT = 0x0E
    XMAGN_OUT = 0x10
    YMAGN_OUT = 0x12
    ZMAGN_OUT = 0x14
    BARO_OUT = 0x16
    TEMP_OUT = 0x18
    GPIO_CTRL = 0x32
    MSC_CTRL = 0x34
    SMPL_PRD = 0x36
    SENS_AVG = 0x38
    DIAG_STAT = 0x3C
    GLOB_CMD = 0x3E
    LOT_ID1 = 0x52
    LOT_ID2 = 0x54
    PROD_ID = 0x56
    SERIAL_NUM = 0x58


# In the order of the burst.
SENSOR_OUTPUTS = (
    Register.XGYRO_OUT,
    Register.YGYRO_OUT,
    Register.ZGYRO_OUT,
    Register.XACCL_OUT,
    Register.YACCL_OUT,
    Register.ZACCL_OUT,
    Register.XMAGN_OUT,
    Register.YMAGN_OUT,
    Register.ZMAGN_OUT,
)

# MSC_CTRL: data ready signal on DIO1, active high (as delivered), and a CRC after each burst.
DATA_READY, BURST_CRC = 0x0006, 1 << 4
# SMPL_PRD: the sensor's own clock; the decimation is in the upper byte.
INTERNAL_CLOCK, DECIMATION_SHIFT = 1 << 0, 8
# SENS_AVG: a range of 1000 deg/s, and the number of taps of the Bartlett filter, as a power of 2.
RANGE_1000, FILTER_AS_DELIVERED = 0b100 << 8, 2
# GLOB_CMD.
SOFTWARE_RESET = 1 << 7

# Bits of DIAG_STAT that mean a failure (data sheet, "Status"). The others do not: 4 is a sensor
# out of its range, which shows the limit; 7 tells that magnetometer and barometer have new values;
# 8 and 9 are alarms, which are off by default.
FAILURES: Mapping[int, str] = {
    0: "magnetometer functional test failed",
    1: "barometer functional test failed",
    2: "flash update failed",
    3: "SPI communication failed",
    5: "self-test failed",
    6: "flash checksum is wrong",
    10: "x gyro self-test failed",
    11: "y gyro self-test failed",
    12: "z gyro self-test failed",
    13: "x accelerometer self-test failed",
    14: "y accelerometer self-test failed",
    15: "z accelerometer self-test failed",
}
NEW_MAGNETOMETER_DATA, SPI_FAILURE = 1 << 7, 1 << 3


class Scale(NamedTuple):
    """Meaning of the counts of a sensor.

    Attributes:
        resolution: one count, in the signal's unit.
        limit: largest value that the data sheet warrants; the registers go on a little.
    """

    resolution: float
    limit: float

    def counts(self, value: float) -> int:
        """Counts that the register shows for a value; NaN is 0."""
        if value != value:
            return 0
        return round(min(max(value, -self.limit), self.limit) / self.resolution)


# Data sheet, "Specifications": 0.04 deg/s and 1000 deg/s, 1/1200 g and 18 g, 1/7 mgauss and
# 1.9 gauss.
SCALES: Mapping[str, Scale] = {
    "gyro": Scale(0.04 * _DEGREE, 1000.0 * _DEGREE),
    "accel": Scale(STANDARD_GRAVITY / 1200.0, 18.0 * STANDARD_GRAVITY),
    "mag": Scale(1e-3 / 7.0 * _GAUSS, 1.9 * _GAUSS),
}

# The signals of a device with this sensor, and their sizes.
MEASURES: Mapping[str, int] = {"gyro": 3, "accel": 3, "mag": 3, "temperature": 1}

type Measured = dict[str, tuple[float, ...]]


def sample_rate(decimation: int) -> float:
    """Samples a second at that decimation [Hz].

    Raises:
        ValueError: the sensor does not have it.
    """
    if not 0 <= decimation <= MAX_DECIMATION:
        raise ValueError(f"decimation must be from 0 to {MAX_DECIMATION}, not {decimation}")
    return _SAMPLE_RATE / 2.0**decimation


def signed(word: int, bits: int = 16) -> int:
    """The value of a two's complement number in the lower bits of a word."""
    word &= (1 << bits) - 1
    return word - (1 << bits) if word >> (bits - 1) else word


def temperature(counts: int) -> float:
    """Temperature that TEMP_OUT means [degC]: 31 degC at 0 (data sheet, "Temperature")."""
    return _TEMPERATURE_AT_ZERO + TEMPERATURE_RESOLUTION * counts


def temperature_word(value: float) -> int:
    """Word that TEMP_OUT shows at a temperature [degC]."""
    counts = round((value - _TEMPERATURE_AT_ZERO) / TEMPERATURE_RESOLUTION)
    return counts & ((1 << _TEMPERATURE_BITS) - 1)


def decode_burst(words: Sequence[int]) -> Measured:
    """Measurements of a burst, along the sensor's axes.

    Args:
        words: all of the burst, see `BURST_WORDS`.

    Returns:
        `gyro` [rad/s], `accel` [m/s2], `mag` [T] and `temperature` [degC]. `accel` is the specific
        force: level and at rest it is 1 g along z, upwards.
    """
    measured: Measured = {}
    for index, (name, scale) in enumerate(SCALES.items()):
        first = 1 + 3 * index
        measured[name] = tuple(
            scale.resolution * signed(word) for word in words[first : first + 3]
        )
    measured["temperature"] = (temperature(signed(words[11], _TEMPERATURE_BITS)),)
    return measured


def mounting_axes(roll_pitch_yaw: Vector3) -> Axes | None:
    """The sensor's axes in the frame of the part that it is mounted on.

    Args:
        roll_pitch_yaw: roll, pitch and yaw of the sensor in that frame [rad], R = R_z R_y R_x.

    Returns:
        The axes; None if they are that frame's own.

    Raises:
        ValueError: not three finite angles.
    """
    if len(roll_pitch_yaw) != 3 or not all(map(math.isfinite, roll_pitch_yaw)):
        raise ValueError(f"mounting must be three finite angles, not {roll_pitch_yaw}")
    return Axes.from_roll_pitch_yaw(*roll_pitch_yaw) if any(roll_pitch_yaw) else None


def mounted(measured: Measured, axes: Axes | None) -> Measured:
    """The same measurement with its vectors in the frame that the axes are given in."""
    if axes is None:
        return measured
    x, y, z = axes
    rotated = dict(measured)
    for name in SCALES:
        a, b, c = measured[name]
        rotated[name] = tuple(a * x[i] + b * y[i] + c * z[i] for i in range(3))
    return rotated


def failures(diagnosis: int) -> tuple[str, ...]:
    """The failures that DIAG_STAT tells of."""
    return tuple(text for bit, text in FAILURES.items() if diagnosis >> bit & 1)


def crc16(words: Sequence[int]) -> int:
    """The CRC of a burst.

    Args:
        words: words of the burst without DIAG_STAT, which it does not cover, and without the CRC.

    The method is that of Analog Devices' example for this sensor: the lower byte of each word
    first, shifted to the right with 0x1021, from 0xFFFF, complemented, bytes swapped. Shifted to
    the right that polynomial lacks its constant term, so the CRC has but 13 bits of information;
    every odd number of damaged bits is found, of other damage all but one in 8192.
    """
    crc = 0xFFFF
    for word in words:
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ word) & 0xFF]
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ word >> 8) & 0xFF]
    crc ^= 0xFFFF
    return (crc << 8 | crc >> 8) & 0xFFFF


def _crc_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = byte >> 1 ^ (0x1021 if byte & 1 else 0)
    return byte


_CRC_TABLE = tuple(map(_crc_of_byte, range(256)))
