"""Packets that Sabertooth 2x25 V2 motor drivers understand, as bytes and back.

The facts are from Dimension Engineering's "Sabertooth 2x25 V2 User's Guide" (April 2012), mode 4:
packetized serial. Bytes have 8 data bits, no parity, one stop bit; a packet has four of them:
address, command, data, and the low seven bits of their sum. Only addresses have the high bit set.
Up to eight drivers hear the same line and none answers.
"""

import math
from enum import IntEnum
from typing import NamedTuple

ADDRESSES = range(128, 136)
"""What the driver's switches 4 to 6 can select."""

MOTORS = 2
"""Number of motors on a driver; the first one is motor 1."""

PACKET_BYTES = 4
BITS_PER_BYTE = 10
"""Of 8N1: with start and stop bit."""

FULL = 127
"""Data that ask for the whole supply voltage."""

TIMEOUT_UNIT = 0.1
"""Of the serial timeout [s]."""

_MASK = 0x7F
_REFUSED = {16: "ramping", 17: "deadband"}


class Direction(IntEnum):
    """The way a motor turns."""

    FORWARDS = 0
    BACKWARDS = 1


class Command(IntEnum):
    """Commands that a packet can have here.

    Ramping (16) and deadband (17) are left out on purpose: see `packet`. Those for mixed drive
    (8 to 13) stop the motors when they alternate with the ones for single motors.
    """

    MOTOR_1_FORWARDS = 0
    MOTOR_1_BACKWARDS = 1
    MOTOR_2_FORWARDS = 4
    MOTOR_2_BACKWARDS = 5

    SERIAL_TIMEOUT = 14
    """Both motors stop without a packet for this many tenths of a second; 0: never, which is
    what the driver does after power-on."""

    BAUD_RATE = 15
    """One of the settings' `BAUDS`; kept in the driver's EEPROM."""


class Packet(NamedTuple):
    """Contents of a packet.

    Attributes:
        address: address of the driver.
        command: also one that is not of `Command`.
        data: 0..127.
    """

    address: int
    command: int
    data: int


class Power(NamedTuple):
    """Command to a motor.

    Attributes:
        direction: the way it turns.
        data: share of the supply voltage in steps of 1/127, 0..127.
    """

    direction: Direction
    data: int


STOPPED = Power(Direction.FORWARDS, 0)


def packet(address: int, command: int, data: int) -> bytes:
    """The bytes of a packet.

    Args:
        address: address of the driver, 128..135.
        command: one of `Command`.
        data: 0..127.

    Raises:
        ValueError: outside these ranges. Commands 16 and 17 are: they write the driver's EEPROM,
            outlast its power, and change what motors do in every mode, analog too; whoever uses
            the driver next would not know why it reacts so.
    """
    if command in _REFUSED:
        raise ValueError(
            f"command {command} ({_REFUSED[command]}) is not sent: "
            "it changes the driver's EEPROM, for every mode and beyond power-off"
        )
    if address not in ADDRESSES:
        raise ValueError(f"addresses are {ADDRESSES[0]}..{ADDRESSES[-1]}, not {address}")
    if not 0 <= data <= FULL:
        raise ValueError(f"data are 0..{FULL}, not {data}")
    body = (address, Command(command), data)
    return bytes((*body, sum(body) & _MASK))


def motor_packet(address: int, motor: int, power: Power) -> bytes:
    """The packet that drives a motor.

    Args:
        address: address of the driver.
        motor: 1 or 2.
        power: commanded power.

    Raises:
        ValueError: there is no such address or motor.
    """
    if motor not in (1, MOTORS):
        raise ValueError(f"motors are 1 and {MOTORS}, not {motor}")
    first = Command.MOTOR_1_FORWARDS if motor == 1 else Command.MOTOR_2_FORWARDS
    return packet(address, first + power.direction, power.data)


def motor_of(command: int) -> tuple[int, Direction] | None:
    """Motor (1 or 2) and direction that a command is about; None: it is about no motor."""
    match command:
        case Command.MOTOR_1_FORWARDS | Command.MOTOR_1_BACKWARDS:
            return 1, Direction(command - Command.MOTOR_1_FORWARDS)
        case Command.MOTOR_2_FORWARDS | Command.MOTOR_2_BACKWARDS:
            return 2, Direction(command - Command.MOTOR_2_FORWARDS)
    return None


def timeout_packet(address: int, timeout: float) -> bytes:
    """The packet that sets a serial timeout.

    Args:
        address: address of the driver.
        timeout: [s], a multiple of 0.1; 0 would switch it off and is refused.

    Raises:
        ValueError: it is not one that the driver can have.
    """
    units = round(timeout / TIMEOUT_UNIT) if math.isfinite(timeout) else 0
    if not 1 <= units <= FULL or not math.isclose(units * TIMEOUT_UNIT, timeout):
        raise ValueError(
            f"a serial timeout is a multiple of {TIMEOUT_UNIT} s, at most "
            f"{FULL * TIMEOUT_UNIT:.1f} s and not 0, not {timeout} s"
        )
    return packet(address, Command.SERIAL_TIMEOUT, units)


def power(voltage: float, supply: float) -> Power:
    """Power of a motor for a voltage.

    Args:
        voltage: mean one at the motor [V]; beyond the supply's: all of it; not finite: none.
        supply: supply of the driver [V].
    """
    if not math.isfinite(voltage):
        return STOPPED
    data = round(min(abs(voltage) / supply, 1.0) * FULL)
    if data == 0:
        return STOPPED
    return Power(Direction.BACKWARDS if voltage < 0.0 else Direction.FORWARDS, data)


def voltage(power: Power, supply: float) -> float:
    """Mean voltage at a motor by this command [V].

    Args:
        power: commanded power.
        supply: supply of the driver [V].
    """
    size = supply * power.data / FULL
    return -size if power.direction is Direction.BACKWARDS else size


class PacketParser:
    """Finds packets in a stream of bytes, as a driver does.

    Whatever was before, an address begins a packet: after garbage not even the next packet is
    lost, unless the garbage is in the midst of it.

    Attributes:
        rejected: number of packets with a wrong checksum.
    """

    def __init__(self) -> None:
        self.rejected = 0
        self._begun: list[int] = []

    def feed(self, data: bytes) -> list[Packet]:
        """The packets that these bytes complete.

        Args:
            data: bytes that have come next.
        """
        packets = (self._take(byte) for byte in data)
        return [packet for packet in packets if packet is not None]

    def reset(self) -> None:
        """Forgets a packet that has begun."""
        self._begun = []

    def _take(self, byte: int) -> Packet | None:
        if byte > _MASK:
            self._begun = [byte] if byte in ADDRESSES else []
            return None
        if not self._begun:
            return None
        self._begun.append(byte)
        if len(self._begun) < PACKET_BYTES:
            return None
        (*body, checksum), self._begun = self._begun, []
        if sum(body) & _MASK != checksum:
            self.rejected += 1
            return None
        return Packet(*body)
