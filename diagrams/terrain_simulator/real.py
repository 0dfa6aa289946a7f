"""The real bench: its guard, self-test, emulation and emergency stop.

The guard sees sliders that follow, a plate that is held, cells that bear.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.guard import AGE, DriveLimits, Sign, SignGuard
from parapod.diagrams.real import RealMachine, SelfTest
from parapod.diagrams.terrain_simulator.design import BenchDesign
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.systems.terrain_simulator.kinematics import singularity

_POSITION, _VELOCITY, _STOP = "sliders.position", "sliders.velocity", "sliders.emergency_stop"
_COMMAND, _CURRENT, _CELLS = "sliders.position_command", "sliders.current", "cells.force"
_POSE, _HIP = "pose_estimated", "hip.position"
# Poses that a walk asks for and that the plate is led to, and a signal that walks alone have.
_ASKED, _LED, _WALKS = "pose_asked", "pose_desired", "done"
# Share of the asked sine of the transmission angle, and of the slide's way [-].
_SIN_MU, _LOW = 0.48, 0.02


@dataclass(frozen=True)
class BenchLimits(DriveLimits):
    """Limits of what is normal: design choices, of the paper's benches.

    Attributes:
        delay: time for which a slider may be behind besides, at its speed [s].
        fastest: speed of a slider [m/s]; twice that of the drives as they are set, as encoders are
            read at instants that are not quite regular.
        crushed: largest force of a cell [N].
        sin_mu: least sine of the transmission angle, half of what is asked for: below it small
            loads turn the plate over [-].
        behind: largest distance of the plate from where a walk has it while a leg is driven [m],
            and largest angle [rad].
        lowest: height of the hip below which nothing carries it [m].
    """

    following: float = 5e-3
    fastest: float = 7.0
    current: float = 40.0
    delay: float = 0.04
    crushed: float = 3000.0
    sin_mu: float = 0.12
    behind: tuple[float, float] = (5e-3, 0.05)
    lowest: float = 0.42

    @classmethod
    def for_machine(cls, machine: BenchDesign) -> "BenchLimits":
        """Limits of a bench: ways by the length of its links, the others by its drives and cells.

        Args:
            machine: its dimensions, drives, cells and slide are taken.
        """
        low, high = machine.hip_min_mm, machine.hip_max_mm
        sliders, size = machine.sliders, machine.geometry.size
        way, angle = cls.behind
        return cls(
            following=cls.following * size,
            fastest=2.0 * sliders.max_velocity_m_s,
            current=sliders.max_force_N / sliders.force_per_current_N_A,
            crushed=machine.cells.capacity_N,
            sin_mu=_SIN_MU * sliders.least_sin_mu,
            behind=(way * size, angle),
            lowest=(low + _LOW * (high - low)) / 1e3,
        )


class BenchGuard(SignGuard[BenchLimits]):
    """Ends a walk in which a slider does not follow or pushes too hard, or the hip falls.

    The drives then stop and hold; the hip's slide is held by its brake.
    """

    part = "sliders"
    signals = frozenset(
        (
            *(_POSITION, _VELOCITY, _COMMAND, _CURRENT, _CELLS, _POSE, _HIP, AGE, _STOP),
            *(_ASKED, _LED, _WALKS),
        )
    )

    def __init__(self, scenario: TerrainBenchScenario, limits: BenchLimits | None = None):
        """Begins to watch.

        Args:
            scenario: its `control.period` and `machine` are taken.
            limits: limits of normal behaviour; None: those of the machine.
        """
        limits = limits or BenchLimits.for_machine(scenario.machine)
        super().__init__(scenario.control.period, limits)
        self._geometry = scenario.machine.geometry
        self._drives_leg = scenario.drives_leg
        self._led: NDArray[Any] | None = None

    def _distances(self, values: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
        """See `SignGuard`; of what a slider's speed explains nothing is left."""
        if _COMMAND not in values:
            return None
        command, self._led = self._led, values[_COMMAND].copy()
        if command is None:
            return None
        delayed = self._limits.delay * np.abs(values.get(_VELOCITY, np.zeros(3)))
        off: NDArray[Any] = np.abs(values[_POSITION] - command) - delayed
        return np.maximum(off, 0.0)

    def _signs(self, values: Mapping[str, NDArray[Any]]) -> Iterator[tuple[str, Sign]]:
        """See `SignGuard`."""
        limits = self._limits
        if _CELLS in values and not (np.abs(values[_CELLS]) <= limits.crushed).all():
            words = f"a force cell bears more than {limits.crushed:g} N"
            yield "cells_overloaded", Sign(words, limits.persists)
        if _POSE in values and values[_POSE].any():
            sin_mu = float(singularity(self._geometry, values[_POSE]).sin_mu)
            if not sin_mu >= limits.sin_mu:
                words = f"plate and strut are nearly in line (sin mu = {sin_mu:.2f})"
                yield "singularity", Sign(words, 0.0)
        if self._drives_leg and {_ASKED, _LED, _WALKS} <= values.keys():
            off = np.abs(values[_ASKED] - values[_LED])
            if not (off <= (limits.behind[0], *limits.behind)).all():
                words = "the plate is not where the walk has it, and the leg would step beside it"
                yield "plate_behind", Sign(words, limits.persists)
        if _HIP in values and values[_HIP][0] < limits.lowest:
            yield "hip_low", Sign("the hip is at the end of its slide", limits.persists)


# Lag of a drive behind set values, and of its velocity's loop, where devices command it [ms].
_ARRIVAL, _LAG = 10.0, 3.0

_BY_DEVICES = {
    "machine.sliders.encoder_resolution_mm": 0.0,
    "machine.sliders.arrival_ms": _ARRIVAL,
    "machine.sliders.time_constant_ms": _LAG,
}
_MOVE = SelfTest(
    command="position_command",
    usual=0.002,
    largest=0.01,
    measures="position",
    rest={"brake": 0.0},
    is_position=True,
)


def make_real(scenario: TerrainBenchScenario) -> RealMachine[TerrainBenchScenario]:
    """The drives' limits, and what may be moved alone."""
    machine = scenario.machine
    rail = machine.geometry.slider_min, machine.geometry.slider_max
    ends = {
        "sliders": [[1e3 * end] * 3 for end in rail],
        "hip": [[machine.hip_min_mm], [machine.hip_max_mm]],
    }
    names = "position_min_mm", "position_max_mm"
    return RealMachine(
        self_tests={"sliders": _MOVE},
        fittings={part: dict(zip(names, both, strict=True)) for part, both in ends.items()},
        exchange={"multibody": 5e-3, "kinematic": 5e-3},
        by_devices=_BY_DEVICES,
        cut={"sliders.brake": 1.0, "hip.brake": 1.0, "hip.force_command": 0.0, "belt.brake": 1.0},
        guard=BenchGuard,
    )
