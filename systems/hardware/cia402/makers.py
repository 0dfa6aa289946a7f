"""Makers of CiA 402 drives: what each has of its own, a table each.

Sources stand above each table. No table was verified on a drive. Entries marked (?) are in no
published object dictionary that was read. A drive that lacks an object refuses it while it is set
up, without power, and the error names the object.
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
            bit. Empty: it cannot be chosen.
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
        Control.POSITION: (Mode(-1, Entry(0x2062, 0, "<i"), is_place=True),),
        # The maker's own as well: the current [mA] is the only loop.
        Control.FORCE: (Mode(-3, Entry(0x2030, 0, "<h")),),
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

# Bits of digital inputs and outputs that the standard leaves to the maker (0x60FD, 0x60FE).
_OWN_BITS = tuple(range(16, 24))
_CYCLIC = {
    # The driver leads the set values of the cyclic one on a ramp.
    Control.VELOCITY: (objects.PROFILE_VELOCITY, objects.CYCLIC_VELOCITY),
    Control.POSITION: (objects.CYCLIC_POSITION_FED,),
    Control.FORCE: (objects.CYCLIC_TORQUE,),
}
_HOLDING = (objects.QUICK_STOP_OPTION, objects.QUICK_STOP_AND_HOLD)
_UNITS = ((objects.POSITION_UNIT, objects.COUNTS_UNIT), (objects.VELOCITY_UNIT, objects.RPM_UNIT))
_BOTH = (objects.MAX_VELOCITY, objects.MAX_MOTOR_VELOCITY)

# Source: the maker's EDS file of an EPOS4 Module 50/5 (product 0x6150): indices, types, defaults
# and what can be mapped. (?) The sensor's resolution in counts; general purpose A to H as numbers
# 16 to 23, of which the file shows 16, 17 and 19 as defaults; the quick stop as 28; thousandths of
# the rated torque as those of the nominal current; the words for codes.
EPOS4 = Maker(
    name="EPOS4",
    vendor=MAXON,
    models={},
    modes=_CYCLIC,
    resolution=(Entry(0x3000, 5, "<I"), 1),
    current=Entry(0x30D1, 1, "<i"),  # averaged
    current_limit=Entry(0x3001, 2, "<I"),
    rated_current=Entry(0x3001, 1, "<I"),
    speed_limits={
        Control.VELOCITY: _BOTH,
        Control.POSITION: _BOTH,
        Control.FORCE: (objects.MAX_MOTOR_VELOCITY,),
    },
    inputs=Pins(
        state=objects.INPUTS,
        bits=_OWN_BITS,  # 1 to 4, and the high-speed ones as 5 to 8
        function=tuple(Entry(0x3142, k, "<B") for k in range(1, 9)),
        zeros=(Entry(0x3141, 2, "<H"),),
        word_bits=tuple(range(8)),
        quick_stop=28,
    ),
    outputs=Pins(
        state=objects.OUTPUTS,
        bits=_OWN_BITS[:3],  # the third is the high-speed one
        function=tuple(Entry(0x3151, k, "<B") for k in range(1, 4)),
        zeros=(Entry(0x3150, 2, "<H"),),
        word_bits=tuple(range(3)),
    ),
    fixed=(_HOLDING, *_UNITS, (objects.TORQUE_OFFSET, 0)),
    errors={
        0x2320: "power stage protection",
        0x5114: "supply voltage of the output stage too low",
        0x81FD: "CAN bus off",
        0x8A80: "negative limit switch",
        0x8A81: "positive limit switch",
        0x8A82: "software position limit",
        0x8A88: "safe torque off",
    },
)

# Source: Nanotec's EDS file of a C5-E-1-09 (FIR-v1650) for what it has: 0x2031, 0x2039, 0x203B,
# 0x3240, 0x3250, 0x605A, 0x6065, 0x608F, 0x60C2, 0x60FD, 0x60FE; its manuals of PD4-C and PD4-E
# for torques and currents (0x6071, 0x2031, 0x203B), and of PD6-C for 0x60A9 and its default. (?)
# Units of positions (0x60A8), abort connection (0x6007), the consumer of heartbeats (0x1016) and a
# quick stop that holds are not in that EDS file: a firmware without them is refused, since nothing
# would stop its motor when the bus breaks. Only the driver limits its velocity.
NANOTEC = Maker(
    name="Nanotec",
    vendor=0x26C,
    models={},
    modes=_CYCLIC | {Control.POSITION: (objects.CYCLIC_POSITION,)},
    resolution=(Entry(0x608F, 1, "<I"), 1),
    current=Entry(0x2039, 2, "<i"),  # of the field-oriented control's quadrature axis
    current_limit=Entry(0x2031, 0, "<I"),
    rated_current=Entry(0x203B, 1, "<I"),
    speed_limits={},
    inputs=Pins(
        state=objects.INPUTS,
        bits=_OWN_BITS[:6],
        zeros=(Entry(0x3240, 1, "<I"), Entry(0x3240, 2, "<I")),  # limit switches, and polarity
        word_bits=tuple(range(6)),
    ),
    outputs=Pins(
        state=objects.OUTPUTS,
        bits=_OWN_BITS[:2],
        zeros=(Entry(0x3250, 2, "<I"),),
        word_bits=tuple(range(2)),
    ),
    fixed=(_HOLDING, *_UNITS),
    undervoltage=frozenset({0x3100}),
    errors={
        0x2300: "overcurrent",
        0x3100: "supply voltage out of range",
        0x4200: "overtemperature",
        0x7305: "encoder 1 error",
        0x8612: "limit switch",
    },
)

# Source: identity, units (counts/s but for 0x6080), CA[18] as the resolution, 0x6073, 0x6075,
# 0x6078, bits of 0x60FD and 0x60FE, and codes: public programs that drive them over EtherCAT (NASA
# JPL's JSD; ETH Zurich's elmo_ethercat_sdk, also for 0x6007 and 0x60C2); rated current in mA:
# Elmo's CANopen DSP 402 Implementation Guide. (?) A quick stop that holds (option 6; those
# programs use 2), and heartbeats that are consumed. Functions and polarity of inputs and outputs
# are set with the maker's program: general purpose, active with voltage.
ELMO = Maker(
    name="Elmo Gold",
    vendor=0x9A,
    models={0x0003: "Gold"},
    modes=_CYCLIC,
    resolution=(Entry(0x3034, 18, "<I"), 1),
    current=objects.CURRENT,
    current_limit=objects.MAX_CURRENT,
    rated_current=objects.RATED_CURRENT,
    is_relative=True,
    has_counts=True,
    speed_limits=EPOS4.speed_limits,
    inputs=Pins(objects.INPUTS, _OWN_BITS[:6]),
    outputs=Pins(objects.OUTPUTS, _OWN_BITS[:6]),
    fixed=(_HOLDING, (objects.TORQUE_OFFSET, 0)),
    undervoltage=frozenset({0x3120}),
    errors={
        0x2340: "short circuit",
        0x3120: "undervoltage",
        0x3130: "loss of a phase",
        0x3310: "overvoltage",
        0x4310: "overtemperature of the drive",
        0x5441: "motor disabled by a switch",
        0x5442: "motion aborted by a switch",
        0x7121: "motor stuck",
        0x7300: "feedback error",
        0x7306: "commutation failed",
        0x7380: "loss of feedback",
        0x8311: "peak current exceeded",
    },
)

MAKERS = {"epos2": EPOS2, "epos4": EPOS4, "nanotec": NANOTEC, "elmo": ELMO}


def maker_of(vendor: int, product: int) -> Maker | None:
    """Maker whose drive has this identity; None: no table has it.

    Args:
        vendor: 0x1018:01.
        product: 0x1018:02.
    """
    of_vendor = [maker for maker in MAKERS.values() if maker.vendor == vendor]
    named = [maker for maker in of_vendor if product >> 16 in maker.models]
    return next(iter(named + [maker for maker in of_vendor if not maker.models]), None)
