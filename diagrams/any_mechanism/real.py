"""The real mechanism: its guard, self-test, emulation and emergency stop.

The guard sees motors that follow, encoders that are right, loops that can be closed.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.any_mechanism.design import BuiltMechanism, PositionServos
from parapod.diagrams.any_mechanism.drivers import fittings_of
from parapod.diagrams.any_mechanism.ports import PART
from parapod.diagrams.any_mechanism.scenario import MechanismScenario
from parapod.diagrams.guard import AGE, DriveLimits, Sign, SignGuard, first_of
from parapod.diagrams.real import RealMachine, SelfTest

_POSITION, _STOP, _CURRENT = f"{PART}.position", f"{PART}.emergency_stop", f"{PART}.current"
_COMMAND, _POSE = f"{PART}.position_command", "pose_estimated"


@dataclass(frozen=True)
class MotorLimits(DriveLimits):
    """Limits of what is normal: design choices.

    Attributes:
        following: largest distance of a motor from where it was led, by its speed [s].
    """

    following: float = 0.1
    fastest: float = 2.0

    @classmethod
    def for_machine(cls, built: BuiltMechanism, force_per_current: float) -> "MotorLimits":
        """Limits of a mechanism: ways by the speeds of its motors, currents by their forces.

        Args:
            built: its motors are taken.
            force_per_current: force of a motor by its current [N/A, N m/A].
        """
        motors = built.motors
        # Encoders are read at instants that are not quite regular.
        fastest = 2.0 * max(motors.velocities)
        return cls(fastest=fastest, current=min(motors.forces) / force_per_current)


class MotorGuard(SignGuard[MotorLimits]):
    """Ends a job in which a motor does not follow or pushes too hard, or no loop could be closed.

    The motors then stop and hold.
    """

    part = PART
    signals = frozenset((_POSITION, _CURRENT, _COMMAND, _POSE, AGE, _STOP))

    def __init__(self, scenario: MechanismScenario, limits: MotorLimits | None = None):
        """Begins to watch.

        Args:
            scenario: its `control.period` and `machine` are taken.
            limits: limits of normal behaviour; None: those of the machine.
        """
        built, per_current = scenario.machine.built, scenario.machine.force_per_current_N_A
        limits = limits or MotorLimits.for_machine(built, per_current)
        super().__init__(scenario.control.period, limits)
        self._far = limits.following * np.array(built.motors.velocities)
        self._led: NDArray[Any] | None = None

    def _distances(self, values: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
        """See `SignGuard`; motors that turn have no distances, see `_signs`."""
        return None

    def _signs(self, values: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, Sign]]:
        """See `SignGuard`."""
        persists = self._limits.persists
        if _COMMAND in values:
            command, self._led = self._led, values[_COMMAND].copy()
            if command is not None and np.isfinite(command).all():
                far = ~(np.abs(values[_POSITION] - command) <= self._far)
                words = f"is {self._limits.following:g} s of its largest speed off its way"
                yield from first_of("following_error", far, words, persists, (PART,))
        if _POSE in values and not np.isfinite(values[_POSE]).all():
            words = "the loops cannot be closed where the encoders say that the motors are"
            yield "loops_open", Sign(words, persists, (PART,))


# Lag of a drive behind set values, and of its velocity's loop, where devices command it [ms].
_ARRIVAL, _LAG = 15.0, 5.0


def make_real(scenario: MechanismScenario) -> RealMachine[MechanismScenario]:
    """Motors that may be moved alone, and their ends."""
    motors, drives = scenario.machine.built.motors, scenario.machine.drives
    by_devices: dict[str, Any] = {"machine.drives.resolution": 0.0}
    if isinstance(drives, PositionServos):
        # A drive without a lag would run from one set value to the next, and stand in between.
        by_devices |= {
            "machine.drives.arrival_ms": _ARRIVAL,
            "machine.drives.time_constant_ms": _LAG,
        }
    slow = min(motors.velocities)
    move = SelfTest(
        command="position_command",
        usual=0.01 * slow,
        largest=0.05 * slow,
        measures="position",
        rest={"brake": 0.0},
        is_position=True,
    )
    return RealMachine(
        self_tests={PART: move},
        fittings={PART: fittings_of(motors)},
        exchange={"multibody": 5e-3, "kinematic": 5e-3},
        by_devices=by_devices,
        cut={f"{PART}.brake": 1.0},
        guard=MotorGuard,
    )
