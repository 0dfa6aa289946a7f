"""The real chair: its guard, self-test, emulation and emergency stop.

The guard sees branches that follow and carry, encoders and feet that are right.

`current_mismatch` compares currents with the nearest forces that the ground can exert: pushing,
within its cone of friction, on the corners of the feet that stand (or are within 3 mm of the
ground), and balancing the weight of the last ten seconds. A healthy walk with 0 to 160 kg leaves 8
N unexplained. A branch held in the air by 1 A (142 N) is found at once, a UP branch whose drive
carries nothing when its leg is one of two that stand, a UPS branch when it carries 40 N or more,
which some never do.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.guard import AGE, POSITION, STOP, DriveLimits, Sign, SignGuard, first_of
from parapod.diagrams.real import RealMachine, SelfTest
from parapod.diagrams.walking_chair.design import ChairDesign, DriveScenario
from parapod.diagrams.walking_chair.homing import make_homing
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.systems.core.physics import GRAVITY
from parapod.systems.walking_chair.chair import foot_corners
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT
from parapod.systems.walking_chair.payload import LEVER, Stand, unexplained_forces
from parapod.systems.walking_chair.statics import force_map

_NODE, _MARGIN = "position_node", "support_margin"
_CURRENT, _SUPPORT, _PAYLOAD = "legs.current", "support", "payload_estimated"


@dataclass(frozen=True)
class ChairLimits(DriveLimits):
    """Limits of what is normal: design choices, of the paper's chair.

    Behind them what a walk has with drives as bought. Currents are watched by the drives.

    Attributes:
        following: largest distance of a branch from where it is to be next [m]; .9 mm, and 2.2 mm
            behind the emulated devices where a walk is halted.
        swinging: largest mean distance from there over some tenths of a second [m]; .5 mm, and
            1.4 mm where a walk is halted.
        fastest: speed of a branch [m/s]; .078.
        margin: least distance of the centre of mass from the support's edge [m]; .051.
        unexplained: largest part of a branch's force that no ground explains [N], see
            `unexplained_forces`; 8 that last, with 0 to 160 kg. A passenger of 57 kg who leans by
            40 mm at once adds up to 30.
        unexplained_persists: time for which that must last [s].
        lowest: height below which a foot in the air may touch the ground already, or still [m].
    """

    following: float = 5e-3
    fastest: float = 0.15
    swinging: float = 1.7e-3
    margin: float = 0.0
    unexplained: float = 40.0
    unexplained_persists: float = 0.3
    lowest: float = 3e-3

    @classmethod
    def for_machine(cls, machine: ChairDesign) -> "ChairLimits":
        """Limits of a chair: ways by the stroke of its branches, the others by their drives.

        Args:
            machine: its dimensions and drives are taken.
        """
        drives, usual, size = machine.drives, DriveScenario(), machine.geometry.leg.size
        return cls(
            following=cls.following * size,
            fastest=cls.fastest * drives.max_velocity_mm_s / usual.max_velocity_mm_s,
            swinging=cls.swinging * size,
            unexplained=cls.unexplained * drives.max_force_N / usual.max_force_N,
            lowest=cls.lowest * size,
        )


# Ticks between two comparisons of currents with statics, which take most of a millisecond each.
_STRIDE = 5
# Time constant of the mean distance of a branch from its way [s].
_AVERAGED = 0.3
# A branch swings if that with signs is less than this share of that without [-].
_TO_AND_FRO = 0.5
# Time constant of the payload with which currents are compared [s]: a drive that fails must not
# become a lighter passenger before it is noticed.
_REMEMBERED = 10.0
# The payload's estimate means something this long after the beginning: four time constants [s].
_SETTLED = 2.0


class ChairGuard(SignGuard[ChairLimits]):
    """Ends a walk in which a branch does not follow or carry, or swings, or no foot supports.

    The drives then stop and hold. A branch that is stuck, driven the wrong way or shown wrongly
    is off its way sooner or later. One whose drive carries nothing, or that is held where it
    should be free, has a current that no ground under the feet explains; too large currents are
    watched by the drives themselves.
    """

    signals = frozenset((POSITION, _NODE, _MARGIN, AGE, STOP, _CURRENT, _SUPPORT, _PAYLOAD))

    def __init__(self, scenario: ChairScenario, limits: ChairLimits | None = None):
        """Begins to watch.

        Args:
            scenario: its `control.period` is that of the loop; its `machine` is watched.
            limits: limits of normal behaviour; None: those of the machine.
        """
        machine, drives = scenario.machine, scenario.machine.drives
        super().__init__(scenario.control.period, limits or ChairLimits.for_machine(machine))
        self._geometry, self._masses = machine.geometry, machine.masses
        self._force_per_current = drives.force_per_current
        # Mean distances from the way, and mean sizes of these [m].
        self._off, self._size = np.zeros(len(BRANCHES)), np.zeros(len(BRANCHES))
        self._count = 0
        self._mismatch: Sign | None = None
        # Mass, and moments by gravity, of the payload, as they have been for a while [kg, kg m].
        self._payload: NDArray[Any] | None = None

    def _distances(self, values: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
        """See `SignGuard`."""
        return values[POSITION] - values[_NODE] if _NODE in values else None

    def _signs(self, values: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, Sign]]:
        """See `SignGuard`."""
        limits, off = self._limits, self._distances(values)
        if off is not None:
            yield from self._swings(off)
        if _MARGIN in values and values[_MARGIN][0] < limits.margin:
            words = "the centre of mass is not above the feet that stand"
            yield "no_support", Sign(words, limits.persists)
        if _CURRENT in values and _SUPPORT in values and _PAYLOAD in values:
            if self._count % _STRIDE == 0:
                self._mismatch = self._compared(values)
            self._count += 1
            if self._mismatch:
                yield "current_mismatch", self._mismatch

    def _swings(self, off: NDArray[Any]) -> Iterator[tuple[str, Sign]]:
        """Sign of a branch that swings about its way, as with commands that come too late."""
        share, off = -np.expm1(-self._period / _AVERAGED), np.nan_to_num(off)
        self._off += share * (off - self._off)
        self._size += share * (np.abs(off) - self._size)
        swinging = self._size > self._limits.swinging
        swinging &= np.abs(self._off) < _TO_AND_FRO * self._size
        mean = 1e3 * self._size[swinging].max(initial=0.0)
        words = f"swings about its way, {mean:.1f} mm off it on average"
        yield from first_of("oscillation", swinging, words, 0.0)

    def _compared(self, values: Mapping[str, NDArray[Any]]) -> Sign | None:
        """Sign of the branch whose current is explained least; None if all of them are."""
        lengths = values[POSITION].reshape(LEG_COUNT, 3)
        forces = self._force_per_current * values[_CURRENT]
        corners = foot_corners(self._geometry, np.zeros(3), np.eye(3), lengths)
        estimated, *place = values[_PAYLOAD]
        finite = (corners, forces, values[_PAYLOAD])
        if not all(np.isfinite(each).all() for each in finite):
            return None  # which other signs tell
        newest = estimated * np.array((1.0, *place))
        mass, *moments = payload = newest if self._payload is None else self._payload
        stands = values[_SUPPORT] > 0.5
        lowest = corners[..., 2].min(axis=-1)
        ground = lowest[stands].mean() if stands.any() else lowest.min()
        touching = stands | (lowest < ground + self._limits.lowest)
        stand = Stand(
            force_map(self._geometry, lengths),
            corners.reshape(-1, 3),
            np.repeat(touching, 3),
            self._masses.total,
            np.array(moments) / mass if mass else 0.0 * newest[1:],
        )
        lever = LEVER * self._geometry.leg.size
        own = self._masses.foot_end * GRAVITY
        off = unexplained_forces(stand, mass, forces, own, lever=lever)
        worst = int(np.abs(off).argmax())
        if abs(off[worst]) <= self._limits.unexplained:
            share = -np.expm1(-_STRIDE * self._period / _REMEMBERED)
            if self._count * self._period >= _SETTLED:
                self._payload = payload + share * (newest - payload)
            return None
        worst_force, explained = forces[worst], forces[worst] - off[worst]
        words = (
            f"holds {worst_force:.0f} N by its current, where the feet on the ground explain "
            f"{explained:.0f} N: does each foot stand, and is each screw whole and free?"
        )
        return Sign(words, self._limits.unexplained_persists, (self.part,), worst)


# Drives are motor and screw alone: their controllers are among the devices, which count, and close
# the velocity's loop over the encoder, so that neither an error of the gain nor an offset is left.
# The lag of that loop stays, because the devices make ramps and have none.
_BY_DEVICES = {
    "machine.drives.gain_error": 0.0,
    "machine.drives.offset_mm_s": 0.0,
    "machine.drives.encoder_resolution_mm": 0.0,
}
_MOVE = SelfTest(
    command="velocity_command",
    usual=0.01,
    largest=0.02,
    measures="position",
    rest={"brake": 0.0},
)


def make_real(scenario: ChairScenario) -> RealMachine[ChairScenario]:
    """The homing, which ends where the legs do, and the drives' limits."""
    leg = scenario.machine.geometry.leg
    retracted, extended = (1e3 * leg.strokes).round(3).T.tolist()
    ends = {"position_min_mm": retracted * LEG_COUNT, "position_max_mm": extended * LEG_COUNT}
    return RealMachine(
        self_tests={"legs": _MOVE},
        homings={"legs": make_homing(leg)},
        fittings={"legs": ends},
        # The quasi-static plant's statics cost more than the bodies' dynamics.
        exchange={"multibody": 2e-3, "kinematic": 5e-3, "mujoco": 2e-3},
        by_devices=_BY_DEVICES,
        cut={"legs.velocity_command": 0.0, "legs.brake": 1.0},
        guard=ChairGuard,
    )
