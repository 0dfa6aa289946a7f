"""The objects of an EPOS2 that parapod uses, and where they travel on the bus.

Source: maxon motor, EPOS2 Positioning Controllers, Firmware Specification (object dictionary,
communication objects, error codes); CiA 301 for the communication profile.
"""

import struct
from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True)
class Entry:
    """An entry of the object dictionary.

    Attributes:
        index: of the object.
        subindex: within the object.
        kind: how `struct` packs it; CANopen is little-endian.
    """

    index: int
    subindex: int
    kind: str

    @property
    def mapping(self) -> int:
        """What maps the entry to a PDO: index, subindex and number of bits (CiA 301)."""
        return self.index << 16 | self.subindex << 8 | 8 * struct.calcsize(self.kind)

    def pack(self, value: int) -> bytes:
        """The value as it travels."""
        return struct.pack(self.kind, value)

    def unpack(self, data: bytes) -> int:
        """The value that has travelled.

        Raises:
            struct.error: the wrong number of bytes.
        """
        value: int = struct.unpack(self.kind, data)[0]
        return value

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex:02X}"


ERROR_CODE = Entry(0x1003, 1, "<I")  # newest error; the code is the low word
HEARTBEAT_CONSUMED = Entry(0x1016, 1, "<I")  # node id << 16 | timeout [ms]
HEARTBEAT_PRODUCED = Entry(0x1017, 0, "<H")  # [ms]; 0: none
VENDOR = Entry(0x1018, 1, "<I")
PRODUCT = Entry(0x1018, 2, "<I")  # hardware version << 16 | application
# Actual current behind a low-pass of 50 Hz [mA]: unlike 0x6078, which is not filtered, it can be
# sampled at 100 Hz without the ripple of the current controller showing up as something slow.
CURRENT = Entry(0x2027, 0, "<h")
ENCODER_PULSES = Entry(0x2210, 1, "<I")  # per turn, of which an edge detector makes four counts
ABORT_CONNECTION = Entry(0x6007, 0, "<h")  # what a lost heartbeat does
CONTROLWORD = Entry(0x6040, 0, "<H")
STATUSWORD = Entry(0x6041, 0, "<H")
MODE = Entry(0x6060, 0, "<b")
POSITION = Entry(0x6064, 0, "<i")  # [counts]
VELOCITY = Entry(0x606C, 0, "<i")  # [rpm] of the motor
MAX_VELOCITY = Entry(0x607F, 0, "<I")  # [rpm]
ACCELERATION = Entry(0x6083, 0, "<I")  # [rpm/s]
DECELERATION = Entry(0x6084, 0, "<I")  # [rpm/s]
QUICK_STOP_DECELERATION = Entry(0x6085, 0, "<I")  # [rpm/s]
PROFILE_TYPE = Entry(0x6086, 0, "<h")  # 0: trapezoidal
TARGET_VELOCITY = Entry(0x60FF, 0, "<i")  # [rpm]

MAXON = 0xFB
EPOS2_24_5 = 0x6220
PROFILE_VELOCITY = 3
ABORT_BY_QUICK_STOP = 3

SYNC_ID, NMT_ID = 0x080, 0x000
EMCY_BASE, HEARTBEAT_BASE = 0x080, 0x700
NMT_START, NMT_PRE_OPERATIONAL = 0x01, 0x80

ON_SYNC, ON_ARRIVAL = 1, 255
NOT_VALID = 1 << 31


class Pdo(NamedTuple):
    """A process data object.

    Attributes:
        base: its identifier on the bus without the node's id.
        communication: index of its communication parameters.
        mapping: index of its mapping parameters.
        transmission: its transmission type.
        entries: that it carries.
    """

    base: int
    communication: int
    mapping: int
    transmission: int
    entries: tuple[Entry, ...]

    def unpack(self, data: bytes) -> tuple[int, ...]:
        """The values that a frame carries.

        Raises:
            struct.error: the frame has the wrong length.
        """
        return struct.unpack(self.kind, data)

    def pack(self, *values: int) -> bytes:
        """The frame that carries the values."""
        return struct.pack(self.kind, *values)

    @property
    def kind(self) -> str:
        """How `struct` packs the frame."""
        return "<" + "".join(entry.kind[-1] for entry in self.entries)

    @property
    def size(self) -> int:
        """Number of bytes of the frame."""
        return struct.calcsize(self.kind)


# Statusword, position and velocity are ten bytes, and a frame has eight.
COMMAND = Pdo(0x200, 0x1400, 0x1600, ON_ARRIVAL, (CONTROLWORD, TARGET_VELOCITY))
STATUS = Pdo(0x180, 0x1800, 0x1A00, ON_SYNC, (STATUSWORD, POSITION))
MOTION = Pdo(0x280, 0x1801, 0x1A01, ON_SYNC, (VELOCITY,))
# In the same frame: two bytes cost less there than a frame of their own.
MOTION_AND_CURRENT = MOTION._replace(entries=(VELOCITY, CURRENT))
PDO_COUNT = 4  # in each direction
# What of the others a drive might send or obey on its own.
UNUSED = (0x1401, 0x1402, 0x1403, 0x1802, 0x1803)

HEARTBEAT_LOST = 0x8130
ERRORS = {
    0x1000: "generic error",
    0x2310: "overcurrent",
    0x3210: "overvoltage",
    0x3220: "undervoltage",
    0x4210: "overtemperature",
    0x5113: "supply voltage (5 V) too low",
    0x5114: "supply voltage of the output stage too low",
    0x6100: "internal software error",
    0x6320: "software parameter error",
    0x7320: "position sensor error",
    0x8110: "CAN overrun (objects lost)",
    0x8111: "CAN overrun",
    0x8120: "CAN passive mode",
    HEARTBEAT_LOST: "CAN heartbeat lost",
    0x8150: "CAN identifiers collide",
    0x81FD: "CAN bus off",
    0x81FE: "CAN receive queue overflow",
    0x81FF: "CAN transmit queue overflow",
    0x8210: "CAN process data of wrong length",
    0x8611: "following error",
    0xFF01: "Hall sensor error",
    0xFF02: "index pulse error",
    0xFF06: "negative limit switch",
    0xFF07: "positive limit switch",
    0xFF09: "software position limit",
    0xFF0A: "position sensor breach",
    0xFF0B: "system overloaded",
}


def described(code: int) -> str:
    """An EMCY code and its meaning."""
    return f"EMCY 0x{code:04X} ({ERRORS.get(code, 'not known')})"
