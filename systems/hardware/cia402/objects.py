"""The standard's objects that parapod uses of a drive, and how they travel as process data.

Source: CiA 301 (communication profile) and CiA 402-2 (IEC 61800-7-201) for indices, types and
error codes. What a maker has of its own, or leaves out, is in `makers`.
"""

from collections.abc import Iterable
from typing import NamedTuple

from parapod.systems.hardware.canopen import ON_ARRIVAL, ON_SYNC, Entry, Pdo

# The profile is the low word: 402 of a drive.
DEVICE_TYPE, DRIVE_PROFILE = Entry(0x1000, 0, "<I"), 402
# Number of errors in the history; writing 0 empties it. A reset of a fault leaves it alone.
ERROR_COUNT = Entry(0x1003, 0, "<B")
HISTORY_SIZE = 5
# From the newest to the oldest; the code is the low word.
ERROR_HISTORY = tuple(Entry(0x1003, k, "<I") for k in range(1, HISTORY_SIZE + 1))
ERROR_CODE = ERROR_HISTORY[0]
VENDOR = Entry(0x1018, 1, "<I")
PRODUCT = Entry(0x1018, 2, "<I")
ABORT_CONNECTION = Entry(0x6007, 0, "<h")  # reaction to a lost heartbeat
CONTROLWORD = Entry(0x6040, 0, "<H")
STATUSWORD = Entry(0x6041, 0, "<H")
QUICK_STOP_OPTION = Entry(0x605A, 0, "<h")
DISABLE_OPTION = Entry(0x605C, 0, "<h")  # reaction to operation that is disabled
MODE = Entry(0x6060, 0, "<b")
POSITION = Entry(0x6064, 0, "<i")  # [counts]
MAX_FOLLOWING_ERROR = Entry(0x6065, 0, "<I")  # [counts]; a larger one is a fault
VELOCITY = Entry(0x606C, 0, "<i")  # velocity of the motor, in the drive's unit
TARGET_TORQUE = Entry(0x6071, 0, "<h")  # [1/1000 of the rated torque]
MAX_CURRENT = Entry(0x6073, 0, "<H")  # [1/1000 of the rated current]
RATED_CURRENT = Entry(0x6075, 0, "<I")  # [mA]
CURRENT = Entry(0x6078, 0, "<h")  # [1/1000 of the rated current]
TARGET_POSITION = Entry(0x607A, 0, "<i")  # [counts]
MAX_VELOCITY = Entry(0x607F, 0, "<I")  # largest velocity of profiles
MAX_MOTOR_VELOCITY = Entry(0x6080, 0, "<I")  # [rpm]
ACCELERATION = Entry(0x6083, 0, "<I")
DECELERATION = Entry(0x6084, 0, "<I")
QUICK_STOP_DECELERATION = Entry(0x6085, 0, "<I")
PROFILE_TYPE = Entry(0x6086, 0, "<h")  # 0: trapezoidal
HOME_OFFSET = Entry(0x607C, 0, "<i")  # [counts]
HOMING_METHOD = Entry(0x6098, 0, "<b")
HOMING_SPEEDS = (Entry(0x6099, 1, "<I"), Entry(0x6099, 2, "<I"))  # to the switch, and to its edge
HOMING_ACCELERATION = Entry(0x609A, 0, "<I")
POSITION_UNIT, VELOCITY_UNIT = Entry(0x60A8, 0, "<I"), Entry(0x60A9, 0, "<I")
VELOCITY_OFFSET = Entry(0x60B1, 0, "<i")  # fed forward to the velocity of cyclic positions
TORQUE_OFFSET = Entry(0x60B2, 0, "<h")  # [1/1000 of the rated torque]
# Time between two set values of a cyclic mode: a number, and the exponent of ten of its unit [s].
PERIOD, PERIOD_EXPONENT = Entry(0x60C2, 1, "<B"), Entry(0x60C2, 2, "<b")
INPUTS = Entry(0x60FD, 0, "<I")
OUTPUTS = Entry(0x60FE, 1, "<I")
TARGET_VELOCITY = Entry(0x60FF, 0, "<i")

ABORT_BY_QUICK_STOP = 3
DISABLE_FREELY = 0  # at once, and not on a ramp: a brake closes then
# On the ramp of a quick stop, and then it holds.
QUICK_STOP_AND_HOLD = 6
COUNTS_UNIT, RPM_UNIT = 0x00B5_0000, 0x00B4_4700  # CiA 303-2: increments; turns per minute
# Mode of operation, bit of the controlword that begins, and bits of the statusword at the end.
HOMING, HOMING_START, HOMING_ATTAINED, HOMING_ERROR = 6, 0x10, 0x1400, 0x2000
HOMING_HERE = (35, 37)  # methods that move nothing: the home is where the axis is
# Bytes of a CAN frame: statusword, position and velocity are ten.
_FRAME = 8


def received(number: int, *entries: Entry) -> Pdo:
    """Process data that a drive obeys on arrival.

    Args:
        number: number of the process data object, from 1.
        entries: the objects that it carries.
    """
    k = number - 1
    return Pdo(0x200 + 0x100 * k, 0x1400 + k, 0x1600 + k, ON_ARRIVAL, entries)


def sent(entries: Iterable[Entry]) -> tuple[Pdo, ...]:
    """Process data with which a drive answers SYNC: as few frames as their order allows.

    Args:
        entries: the objects that they carry.
    """
    frames: list[list[Entry]] = [[]]
    for entry in entries:
        if sum(each.size for each in (*frames[-1], entry)) > _FRAME:
            frames.append([])
        frames[-1].append(entry)
    return tuple(
        Pdo(0x180 + 0x100 * k, 0x1800 + k, 0x1A00 + k, ON_SYNC, tuple(frame))
        for k, frame in enumerate(frames)
    )


class Mode(NamedTuple):
    """A mode of operation, and the process data that command it.

    Attributes:
        number: its number (0x6060).
        command: controlword, and set value where that is zero with most controlwords.
        target: set value alone, and its offset if there is one: a controlword with it would end
            a quick stop of another origin.
    """

    number: int
    command: Pdo
    target: Pdo

    @property
    def setting(self) -> Entry:
        """Entry of the set value."""
        return self.target.entries[0]

    @property
    def offset(self) -> Entry | None:
        """Entry of what is fed forward; None: nothing is."""
        return self.target.entries[1] if len(self.target.entries) > 1 else None


def rate_mode(number: int, setting: Entry) -> Mode:
    """Mode in which a set value of zero keeps an axis still: it may come with any controlword."""
    return Mode(number, received(1, CONTROLWORD, setting), received(2, setting))


def place_mode(number: int, setting: Entry, offset: Entry | None = None) -> Mode:
    """Mode whose set value is a place.

    A controlword comes without one: no order within a frame could make an axis jump.
    """
    entries = (setting,) if offset is None else (setting, offset)
    return Mode(number, received(1, CONTROLWORD), received(2, *entries))


PROFILE_VELOCITY = rate_mode(3, TARGET_VELOCITY)
CYCLIC_POSITION = place_mode(8, TARGET_POSITION)
CYCLIC_POSITION_FED = place_mode(8, TARGET_POSITION, VELOCITY_OFFSET)
CYCLIC_VELOCITY = rate_mode(9, TARGET_VELOCITY)
CYCLIC_TORQUE = rate_mode(10, TARGET_TORQUE)

HEARTBEAT_LOST, UNDERVOLTAGE, FOLLOWING_ERROR = 0x8130, 0x3220, 0x8611
ERRORS = {
    0x1000: "generic error",
    0x2310: "overcurrent",
    0x3210: "overvoltage",
    UNDERVOLTAGE: "undervoltage",
    0x4210: "overtemperature",
    0x5113: "supply voltage (5 V) too low",
    0x6100: "internal software error",
    0x6320: "software parameter error",
    0x7320: "position sensor error",
    0x8110: "CAN overrun (objects lost)",
    0x8120: "CAN passive mode",
    HEARTBEAT_LOST: "CAN heartbeat lost",
    0x8140: "CAN recovered from bus off",
    0x8150: "CAN identifiers collide",
    0x8210: "CAN process data of wrong length",
    FOLLOWING_ERROR: "following error",
}
