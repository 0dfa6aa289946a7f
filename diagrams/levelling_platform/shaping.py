"""Shaping of the arm's commands: the vibration of its rod is not excited in the first place."""

import math
from typing import Any

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.arm.input_shaper import InputShaper, Shaper
from parapod.systems.core.errors import ScenarioError

# Frequencies of two planes that differ by less are shaped as one [-].
_ALIKE = 0.01
# Residual that an extra insensitive shaper leaves [-]: with all else less than 5 %.
_TOLERANCE = 0.04


def arm_shaper(scenario: LevellingScenario) -> Shaper | None:
    """Impulses with which the arm's commands are convolved; None where they are left as they are.

    Args:
        scenario: its `control` and `machine` are used.

    Raises:
        ScenarioError: no frequency is known.
    """
    control, rod = scenario.control, scenario.machine.arm.bending
    if control.arm_shaper == "none":
        return None
    frequencies, damping = control.arm_frequencies_Hz, control.arm_damping_ratio
    if frequencies is None:
        if rod is None:
            key = "control.arm_frequencies_Hz"
            raise ScenarioError(f"{key} must be given: the arm of the machine is rigid", key)
        first = sorted(rod.loaded_frequencies(scenario.machine.masses.gravity)[:, 0].tolist())
        frequencies = [first[0] / (2.0 * math.pi)]
        if first[1] > (1.0 + _ALIKE) * first[0]:
            frequencies.append(first[1] / (2.0 * math.pi))
    if damping is None:
        damping = 0.0 if rod is None else rod.damping_ratio
    omegas = [2.0 * math.pi * frequency for frequency in frequencies]
    kind: Any = control.arm_shaper
    try:
        return Shaper.by_name(kind, omegas, [damping] * len(omegas), _TOLERANCE)
    except ValueError as error:
        raise ScenarioError(f"control.arm_shaper: {error}", "control.arm_shaper") from None


def shaping_system(scenario: LevellingScenario) -> InputShaper | None:
    """The system that shapes the arm's commands; None where they are left as they are.

    Raises:
        ScenarioError: as `arm_shaper`, or frequencies above what the period carries.
    """
    count, shaper = scenario.machine.masses.arm.count, arm_shaper(scenario)
    if shaper is None or not count:
        return None
    try:
        return InputShaper(shaper, count, scenario.control.period)
    except ValueError as error:
        key = "control.arm_frequencies_Hz"
        raise ScenarioError(f"{key}: {error}", key) from None
