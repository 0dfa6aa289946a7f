"""The real centre: its guard, self-test, emulation and emergency stop.

The guard sees legs that follow, encoders that are right, data that is young.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from parapod.diagrams.guard import AGE, POSITION, STOP, DriveLimits, SignGuard
from parapod.diagrams.machining_centre.design import CentreDesign, LegScenario
from parapod.diagrams.machining_centre.drivers import fittings_of
from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.real import RealMachine, SelfTest

_ERROR, _CURRENT = "length_error", "legs.current"


@dataclass(frozen=True)
class CentreLimits(DriveLimits):
    """Limits of what is normal: design choices, of the paper's centre.

    Attributes:
        fastest: speed of a leg [m/s]; twice that of the drives as they are set, as encoders are
            read at instants that are not quite regular.
    """

    following: float = 4e-3
    fastest: float = 0.3
    current: float = 4.0

    @classmethod
    def for_machine(cls, machine: CentreDesign) -> "CentreLimits":
        """Limits of a centre: ways by the length of its legs, the others by their drives.

        Args:
            machine: its dimensions and drives are taken.
        """
        legs = machine.legs
        by_speed = legs.max_velocity_mm_s / LegScenario().max_velocity_mm_s
        return cls(
            following=cls.following * machine.geometry.size,
            fastest=cls.fastest * by_speed,
            current=legs.max_force_N / legs.force_per_current_N_A,
        )


class CentreGuard(SignGuard[CentreLimits]):
    """Ends a job in which a leg does not follow, pushes too hard, or is measured wrongly.

    The drives then stop and hold, and all locks and clamps close. What locks and clamps tell is
    watched by the sequencer, which ends a job itself.
    """

    signals = frozenset((POSITION, _ERROR, _CURRENT, AGE, STOP))

    def __init__(self, scenario: CentreScenario, limits: CentreLimits | None = None):
        """Begins to watch.

        Args:
            scenario: its `control.period` and `machine` are taken.
            limits: limits of normal behaviour; None: those of the machine.
        """
        limits = limits or CentreLimits.for_machine(scenario.machine)
        super().__init__(scenario.control.period, limits)

    def _distances(self, values: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
        """See `SignGuard`."""
        return values.get(_ERROR)


# Lag of a drive behind set values, and of its velocity's loop, where devices command it [ms].
_ARRIVAL, _LAG = 15.0, 5.0
# One leg of six moves the platform; one of eight would only strain the other seven.
_MOVES_ALONE = 3

# A drive without a lag would run from one set value to the next, and stand in between.
_BY_DEVICES = {
    "machine.legs.encoder_resolution_mm": 0.0,
    "machine.legs.arrival_ms": _ARRIVAL,
    "machine.legs.time_constant_ms": _LAG,
}
_MOVE = SelfTest(
    command="position_command",
    usual=0.002,
    largest=0.01,
    measures="position",
    rest={"brake": 0.0, "locks.command": 0.0, "clamps.command": 1.0},
    is_position=True,
)


def make_real(scenario: CentreScenario) -> RealMachine[CentreScenario]:
    """Legs that may be moved alone, and their strokes."""
    limbs = scenario.machine.limbs
    return RealMachine(
        self_tests={"legs": _MOVE} if limbs == _MOVES_ALONE else {},
        fittings={"legs": fittings_of(scenario.machine.geometry)},
        exchange={"multibody": 5e-3, "kinematic": 5e-3},
        by_devices=_BY_DEVICES,
        cut={"legs.brake": 1.0},
        switches=("locks.closed", "clamps.closed"),
        guard=CentreGuard,
    )
