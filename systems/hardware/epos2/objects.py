"""The objects of an EPOS2 that parapod uses, and where they travel on the bus.

Source: maxon motor, EPOS2 Positioning Controllers, Firmware Specification (object dictionary,
communication objects, error codes); CiA 301 for the communication profile. Digital inputs: the
same, 0x2070 and 0x2071; numbers of the functionalities as in the maker's EPOS Command Library
(`DIC_QUICK_STOP` = 5 to `DIC_GENERAL_PURPOSE_A` = 15); voltages: EPOS2 24/5 Hardware Reference
(rel5190), 4.5.2. Digital outputs: 0x2078 and 0x2079 of the same specification; numbers of their
functionalities as in that library (`DOC_READY_FAULT` = 0 to `DOC_GENERAL_PURPOSE_A` = 15); that
0x2078:01 can be mapped: the maker's list of mappable objects. Position mode: 0x2062 and 0x6065.
Current mode: 0x2030 and 0x6410:04; that 0x2030 can be mapped: public programs map 0x20300010.
"""

from typing import NamedTuple

from parapod.systems.hardware.canopen import ON_ARRIVAL, ON_SYNC, Entry, Pdo

# Number of errors in the history; writing 0 empties it. A reset of a fault leaves it alone.
ERROR_COUNT = Entry(0x1003, 0, "<B")
HISTORY_SIZE = 5
# From the newest to the oldest; the code is the low word.
ERROR_HISTORY = tuple(Entry(0x1003, k, "<I") for k in range(1, HISTORY_SIZE + 1))
ERROR_CODE = ERROR_HISTORY[0]
VENDOR = Entry(0x1018, 1, "<I")
PRODUCT = Entry(0x1018, 2, "<I")  # hardware version << 16 | application
# Actual current behind a low-pass of 50 Hz [mA]: unlike 0x6078, which is not filtered, it can be
# sampled at 100 Hz without the ripple of the current controller showing up as something slow.
CURRENT = Entry(0x2027, 0, "<h")
# Meaning of each digital input: the number of a functionality, which is its bit in the four words
# below; no two inputs may have the same.
INPUT_COUNT = 6  # digital inputs of an EPOS2 24/5
INPUT_FUNCTION = tuple(Entry(0x2070, k, "<H") for k in range(1, INPUT_COUNT + 1))
INPUT_STATE = Entry(0x2071, 1, "<H")  # 1: active; the only one of them that can be mapped
INPUT_MASK = Entry(0x2071, 2, "<H")  # 0: the bit of the state is always 0
INPUT_POLARITY = Entry(0x2071, 3, "<H")  # 0: active while there is voltage; 1: while there is none
INPUT_EXECUTION = Entry(0x2071, 4, "<H")  # 1: the drive itself does what the functionality says
# Set value of position mode [counts]: there is no profile, the axis goes there at once.
POSITION_SETTING = Entry(0x2062, 0, "<i")
# Set value of current mode [mA]: the motor has this current at once, whatever its velocity.
CURRENT_SETTING = Entry(0x2030, 0, "<h")
# Meaning of each digital output: the number of a functionality, which is its bit in the three
# words below; no two outputs may have the same.
OUTPUT_COUNT = (
    4  # digital outputs of an EPOS2 24/5 (assumption: all of them can be general purpose)
)
OUTPUT_FUNCTION = tuple(Entry(0x2079, k, "<H") for k in range(1, OUTPUT_COUNT + 1))
OUTPUT_STATE = Entry(0x2078, 1, "<H")  # 1: active; the only one of them that can be mapped
OUTPUT_MASK = Entry(0x2078, 2, "<H")  # 0: what is written to the bit of the state is ignored
OUTPUT_POLARITY = Entry(0x2078, 3, "<H")  # 0: on while active; 1: off while active
ENCODER_PULSES = Entry(0x2210, 1, "<I")  # per turn, of which an edge detector makes four counts
ABORT_CONNECTION = Entry(0x6007, 0, "<h")  # reaction to a lost heartbeat
CONTROLWORD = Entry(0x6040, 0, "<H")
STATUSWORD = Entry(0x6041, 0, "<H")
MODE = Entry(0x6060, 0, "<b")
POSITION = Entry(0x6064, 0, "<i")  # [counts]
MAX_FOLLOWING_ERROR = Entry(0x6065, 0, "<I")  # [counts]; a larger one is a fault
VELOCITY = Entry(0x606C, 0, "<i")  # [rpm] of the motor
MAX_VELOCITY = Entry(0x607F, 0, "<I")  # [rpm]
ACCELERATION = Entry(0x6083, 0, "<I")  # [rpm/s]
DECELERATION = Entry(0x6084, 0, "<I")  # [rpm/s]
QUICK_STOP_DECELERATION = Entry(0x6085, 0, "<I")  # [rpm/s]
PROFILE_TYPE = Entry(0x6086, 0, "<h")  # 0: trapezoidal
TARGET_VELOCITY = Entry(0x60FF, 0, "<i")  # [rpm]
OUTPUT_CURRENT_LIMIT = Entry(0x6410, 2, "<H")  # [mA] of the motor data
MAX_MOTOR_VELOCITY = Entry(0x6410, 4, "<I")  # [rpm] of the motor data, in current mode

MAXON = 0xFB
EPOS2_24_5 = 0x6220
QUICK_STOP_FUNCTION = 5  # functionality of a digital input: it stops the drive
ABORT_BY_QUICK_STOP = 3


def general_purpose(number: int) -> int:
    """Functionality of a digital input or output that the drive leaves alone: A for 1, and so on.

    None of them is another input's as the maker delivers it, where inputs 4 to 6 are switches.
    """
    return 16 - number


# Statusword, position and velocity are ten bytes, and a frame has eight.
COMMAND = Pdo(0x200, 0x1400, 0x1600, ON_ARRIVAL, (CONTROLWORD, TARGET_VELOCITY))
# A velocity alone: a controlword with it would end a quick stop of another origin.
TARGET = Pdo(0x300, 0x1401, 0x1601, ON_ARRIVAL, (TARGET_VELOCITY,))
# The digital outputs, of nodes that switch something, in a frame of their own: they are switched
# while the axes are braked as well.
OUTPUTS = Pdo(0x400, 0x1402, 0x1602, ON_ARRIVAL, (OUTPUT_STATE,))
STATUS = Pdo(0x180, 0x1800, 0x1A00, ON_SYNC, (STATUSWORD, POSITION))
# Process data with the digital inputs of a node that measures some: they fill the eight bytes.
STATUS_AND_INPUTS = STATUS._replace(entries=(STATUSWORD, POSITION, INPUT_STATE))
MOTION = Pdo(0x280, 0x1801, 0x1A01, ON_SYNC, (VELOCITY,))
# In the same frame: two bytes cost less there than a frame of their own.
MOTION_AND_CURRENT = MOTION._replace(entries=(VELOCITY, CURRENT))
# Communication parameters of all process data: those that are not used a drive might send or obey
# on its own.
COMMUNICATION = (0x1400, 0x1401, 0x1402, 0x1403, 0x1800, 0x1801, 0x1802, 0x1803)


class Mode(NamedTuple):
    """A mode of operation, and the process data that command it.

    Attributes:
        number: its number (0x6060).
        command: controlword, and set value where that is zero with most controlwords.
        target: set value alone.
    """

    number: int
    command: Pdo
    target: Pdo

    @property
    def setting(self) -> Entry:
        """Entry of the set value."""
        return self.target.entries[0]


PROFILE_VELOCITY = Mode(3, COMMAND, TARGET)
# The maker's own, without a profile: the driver moves the set value no faster than the
# axis may go. A controlword comes without one: no order within a frame could make an axis jump.
POSITION_MODE = Mode(
    -1,
    COMMAND._replace(entries=(CONTROLWORD,)),
    TARGET._replace(entries=(POSITION_SETTING,)),
)
# The maker's own as well: there is no loop but that of the current.
CURRENT_MODE = Mode(
    -3,
    COMMAND._replace(entries=(CONTROLWORD, CURRENT_SETTING)),
    TARGET._replace(entries=(CURRENT_SETTING,)),
)


HEARTBEAT_LOST, UNDERVOLTAGE, FOLLOWING_ERROR = 0x8130, 0x3220, 0x8611
ERRORS = {
    0x1000: "generic error",
    0x2310: "overcurrent",
    0x3210: "overvoltage",
    UNDERVOLTAGE: "undervoltage",
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
    FOLLOWING_ERROR: "following error",
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
