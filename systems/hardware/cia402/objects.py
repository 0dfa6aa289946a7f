"""The standard's objects that parapod uses of a drive, and how they travel as process data.

Source: CiA 301 (communication profile) and CiA 402-2 (IEC 61800-7-201) for indices, types and
error codes. What a maker has of its own, or leaves out, is in `makers`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

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
    """Process data object `number`, from 1, whose entries a drive obeys on arrival."""
    k = number - 1
    return Pdo(0x200 + 0x100 * k, 0x1400 + k, 0x1600 + k, ON_ARRIVAL, entries)


def sent(entries: Iterable[Entry]) -> tuple[Pdo, ...]:
    """Process data with which a drive answers SYNC: as few frames as the entries' order allows."""
    frames: list[list[Entry]] = [[]]
    for entry in entries:
        if sum(each.size for each in (*frames[-1], entry)) > _FRAME:
            frames.append([])
        frames[-1].append(entry)
    return tuple(
        Pdo(0x180 + 0x100 * k, 0x1800 + k, 0x1A00 + k, ON_SYNC, tuple(frame))
        for k, frame in enumerate(frames)
    )


@dataclass(frozen=True)
class Mode:
    """A mode of operation, and the process data that command it.

    Attributes:
        number: its number (0x6060).
        setting: entry of the set value.
        is_place: true if that is a place, and not zero where an axis is to stand: a controlword
            comes without it then, as no order within a frame could make an axis jump.
        offset: entry of what is fed forward; None: nothing is.
    """

    number: int
    setting: Entry
    is_place: bool = False
    offset: Entry | None = None

    @cached_property
    def command(self) -> Pdo:
        """Controlword, and the set value unless it is a place."""
        return received(1, CONTROLWORD, *(() if self.is_place else (self.setting,)))

    @cached_property
    def target(self) -> Pdo:
        """Set value and offset alone: a controlword would end a quick stop of another origin."""
        return received(2, self.setting, *(() if self.offset is None else (self.offset,)))


PROFILE_VELOCITY = Mode(3, TARGET_VELOCITY)
CYCLIC_POSITION = Mode(8, TARGET_POSITION, is_place=True)
CYCLIC_POSITION_FED = Mode(8, TARGET_POSITION, is_place=True, offset=VELOCITY_OFFSET)
CYCLIC_VELOCITY = Mode(9, TARGET_VELOCITY)
CYCLIC_TORQUE = Mode(10, TARGET_TORQUE)

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
