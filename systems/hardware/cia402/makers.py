"""Makers of CiA 402 drives: what each has of its own, a table each.

Sources: see the tables. Nothing but the EPOS2's table was ever used with a real drive's manual at
hand and a machine in mind; entries marked (?) are in no published object dictionary that was
found, and no table was verified on a drive. A drive that lacks an object refuses it while it is
set up, without power, and the error names the object.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from parapod.systems.hardware.canopen import Entry
from parapod.systems.hardware.cia402 import objects
from parapod.systems.hardware.cia402.objects import Mode
from parapod.systems.hardware.cia402.settings import Control

MAXON = 0xFB


@dataclass(frozen=True)
class Pins:
    """Digital inputs, or outputs, of a drive.

    Attributes:
        state: entry that shows the inputs, or switches the outputs; it can be mapped.
        bits: bit of each in that.
        function: entries that say what each is for; its general purpose is the number of its
            bit. Empty: there is no such choice.
        ones: words in which the bit of one must be 1 for us to use it.
        zeros: words in which it must be 0: polarity, and what the drive itself does.
        word_bits: bit of each in these words; empty: as in the state.
        quick_stop: number of the functionality, and bit of the state, of a quick stop.
    """

    state: Entry
    bits: tuple[int, ...]
    function: tuple[Entry, ...] = ()
    ones: tuple[Entry, ...] = ()
    zeros: tuple[Entry, ...] = ()
    word_bits: tuple[int, ...] = ()
    quick_stop: int | None = None

    def word_bit(self, number: int) -> int:
        """Bit of pin `number`, from 1, in the words `ones` and `zeros`."""
        return 1 << (self.word_bits or self.bits)[number - 1]

    def mask(self, number: int) -> int:
        """Bit of pin `number`, from 1, in the state."""
        return 1 << self.bits[number - 1]


@dataclass(frozen=True)
class Maker:
    """Drives of one maker that have the same objects.

    Attributes:
        name: name in errors.
        vendor: number of the maker (0x1018:01).
        models: names of its models by the high word of their product code (0x1018:02); empty:
            all of this vendor that are in no other table.
        modes: modes of operation for what is commanded, the default first.
        resolution: entry of the encoder's resolution, and counts for each of its units.
        current: entry of the motor's current.
        current_limit: entry of the largest current.
        rated_current: entry of the rated current [mA], of which torques are thousandths; None:
            set values are mA.
        is_relative: true if `current` and `current_limit` are thousandths of the rated current,
            and not mA.
        speed_limits: entries of the largest velocity, for what is commanded.
        has_counts: true if velocities are counts/s and accelerations counts/s^2, not rpm and
            rpm/s. The largest velocity of the motor (0x6080) is rpm all the same.
        inputs: digital inputs.
        outputs: digital outputs.
        fixed: entries that a drive is always to have, and their values.
        undervoltage: codes of a fault for want of the motor's supply.
        errors: words for codes of its own.
    """

    name: str
    vendor: int
    models: Mapping[int, str]
    modes: Mapping[Control, tuple[Mode, ...]]
    resolution: tuple[Entry, int]
    current: Entry
    current_limit: Entry
    inputs: Pins
    outputs: Pins
    speed_limits: Mapping[Control, tuple[Entry, ...]]
    rated_current: Entry | None = None
    is_relative: bool = False
    has_counts: bool = False
    fixed: tuple[tuple[Entry, int], ...] = ()
    undervoltage: frozenset[int] = frozenset({objects.UNDERVOLTAGE})
    errors: Mapping[int, str] = field(default_factory=dict)

    def per_rpm(self, counts_per_turn: int) -> float:
        """Velocity in the drive's unit for one rpm of its motor."""
        return counts_per_turn / 60.0 if self.has_counts else 1.0

    def mode(self, control: Control, number: int | None) -> Mode:
        """Mode of operation.

        Args:
            control: quantity that is commanded.
            number: number of the mode; None: the default.

        Raises:
            ValueError: the drives do not have it for that.
        """
        modes = self.modes[control]
        fitting = [mode for mode in modes if number in (None, mode.number)]
        if not fitting:
            able = ", ".join(dict.fromkeys(str(mode.number) for mode in modes))
            raise ValueError(f"mode of {self.name} for a {control} must be {able}, not {number}")
        return fitting[0]

    def described(self, code: int) -> str:
        """An EMCY code and its meaning."""
        words = self.errors.get(code) or objects.ERRORS.get(code, "not known")
        return f"EMCY 0x{code:04X} ({words})"


# Source: maxon motor, EPOS2 Positioning Controllers, Firmware Specification (object dictionary,
# communication objects, error codes). Digital inputs: the same, 0x2070 and 0x2071; numbers of the
# functionalities as in the maker's EPOS Command Library (`DIC_QUICK_STOP` = 5 to
# `DIC_GENERAL_PURPOSE_A` = 15); voltages: EPOS2 24/5 Hardware Reference (rel5190), 4.5.2. Digital
# outputs: 0x2078 and 0x2079 of the same specification; numbers of their functionalities as in that
# library (`DOC_READY_FAULT` = 0 to `DOC_GENERAL_PURPOSE_A` = 15); that 0x2078:01 can be mapped:
# its list of mappable objects. Current mode: 0x2030 and 0x6410:04; that 0x2030 can be mapped:
# public programs map 0x20300010. The 50/5: the maker's EDS file of it (347717); of its inputs and
# outputs those are used that the 24/5 has.
# Functionalities A to F, which no input has as the maker delivers it, where 4 to 6 are switches.
_A_TO_F = (15, 14, 13, 12, 11, 10)
EPOS2 = Maker(
    name="EPOS2",
    vendor=MAXON,
    models={0x6220: "24/5", 0x6322: "50/5"},
    modes={
        Control.VELOCITY: (objects.PROFILE_VELOCITY,),
        # The maker's own, without a profile: the driver moves the set value no faster than the
        # axis may go.
        Control.POSITION: (objects.place_mode(-1, Entry(0x2062, 0, "<i")),),
        # The maker's own as well: there is no loop but that of the current [mA].
        Control.FORCE: (objects.rate_mode(-3, Entry(0x2030, 0, "<h")),),
    },
    resolution=(Entry(0x2210, 1, "<I"), 4),  # pulses, of which an edge detector makes four counts
    # Behind a low-pass of 50 Hz: unlike 0x6078, which is not filtered, it can be sampled at 100 Hz
    # without the ripple of the current controller showing up as something slow.
    current=Entry(0x2027, 0, "<h"),
    current_limit=Entry(0x6410, 2, "<H"),
    speed_limits={
        Control.VELOCITY: (objects.MAX_VELOCITY,),
        Control.POSITION: (objects.MAX_VELOCITY,),
        Control.FORCE: (objects.MAX_VELOCITY, Entry(0x6410, 4, "<I")),
    },
    inputs=Pins(
        state=Entry(0x2071, 1, "<H"),  # 1: active; the only one of them that can be mapped
        bits=_A_TO_F,
        function=tuple(Entry(0x2070, k, "<H") for k in range(1, 7)),
        ones=(Entry(0x2071, 2, "<H"),),  # 0: the bit of the state is always 0
        # Polarity 0: active while there is voltage; execution 1: the drive itself does what the
        # functionality says.
        zeros=(Entry(0x2071, 3, "<H"), Entry(0x2071, 4, "<H")),
        quick_stop=5,
    ),
    outputs=Pins(
        state=Entry(0x2078, 1, "<H"),  # 1: active; the only one of them that can be mapped
        bits=_A_TO_F[:4],  # assumption: all of them can be general purpose
        function=tuple(Entry(0x2079, k, "<H") for k in range(1, 5)),
        ones=(Entry(0x2078, 2, "<H"),),  # 0: what is written to the bit of the state is ignored
        zeros=(Entry(0x2078, 3, "<H"),),  # 0: on while active; 1: off while active
    ),
    errors={
        0x5114: "supply voltage of the output stage too low",
        0x8111: "CAN overrun",
        0x81FD: "CAN bus off",
        0x81FE: "CAN receive queue overflow",
        0x81FF: "CAN transmit queue overflow",
        0xFF01: "Hall sensor error",
        0xFF02: "index pulse error",
        0xFF06: "negative limit switch",
        0xFF07: "positive limit switch",
        0xFF09: "software position limit",
        0xFF0A: "position sensor breach",
        0xFF0B: "system overloaded",
    },
)

MAKERS = {"epos2": EPOS2}


def maker_of(vendor: int, product: int) -> Maker | None:
    """Maker whose drive has this identity; None: no table has it.

    Args:
        vendor: 0x1018:01.
        product: 0x1018:02.
    """
    of_vendor = [maker for maker in MAKERS.values() if maker.vendor == vendor]
    named = [maker for maker in of_vendor if product >> 16 in maker.models]
    return next(iter(named + [maker for maker in of_vendor if not maker.models]), None)
