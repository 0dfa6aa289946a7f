"""Means against the vibration of an arm's rod: commands that are shaped, and legs that damp."""

import math
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from pydrake.systems.primitives import Adder, ConstantVectorSource

from parapod.diagrams.levelling_platform.position_loops import loop_response
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import Wired, named
from parapod.systems.arm.input_shaper import InputShaper, Shaper
from parapod.systems.arm.vibration import LumpedRod, VibrationDamper, VibrationFeedforward
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.damped_posture import DampedPosture
from parapod.systems.levelling_platform.inclination_loop import ForwardKinematics

# Frequencies of two planes that differ by less are shaped as one [-].
_ALIKE = 0.01
# Residual that an extra insensitive shaper leaves [-]: with all else less than 5 %.
_TOLERANCE = 0.04
_KEY = "control.arm_damping_by_legs"
_FED_FORWARD, _DAMPING = "displacement_fed_forward", "displacement_damping"


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


def known_rod(scenario: LevellingScenario) -> LumpedRod:
    """First modes of the arm's rod, as far as the controller knows them.

    Args:
        scenario: its `control` and `machine` are used.

    Raises:
        ScenarioError: an arm that does not bend.
    """
    control, rod = scenario.control, scenario.machine.arm.bending
    if rod is None:
        raise ScenarioError(f"{_KEY} must be none: the arm of the machine is rigid", _KEY)
    modes = LumpedRod.of(rod, scenario.machine.masses.gravity)
    if control.arm_damping_ratio is not None:
        modes = replace(modes, damping_ratio=control.arm_damping_ratio)
    if control.arm_frequencies_Hz:
        omegas = sorted(2.0 * math.pi * frequency for frequency in control.arm_frequencies_Hz)
        x, y = modes.frequencies
        planes = (omegas[0], omegas[-1]) if x <= y else (omegas[-1], omegas[0])
        modes = replace(modes, frequencies=planes)
    return modes


def feedforward_system(scenario: LevellingScenario) -> VibrationFeedforward:
    """The system that makes displacements of the arm's commands.

    Raises:
        ScenarioError: an arm that does not bend, or a vibration above what the period carries.
    """
    rod, arm = known_rod(scenario), scenario.machine.masses.arm
    response = partial(loop_response, scenario)
    try:
        return VibrationFeedforward(rod, arm, scenario.control.period, response=response)
    except ValueError as error:
        key = "control.arm_frequencies_Hz"
        raise ScenarioError(f"{key}: {error}", key) from None


def damping_systems(scenario: LevellingScenario, enable: str) -> list[Wired]:
    """Systems from arm and encoders to `posture_damped_state`; none where the legs do not damp.

    Args:
        scenario: its `control` and `machine` are used.
        enable: signal that tells that postures are followed.

    Raises:
        ScenarioError: as `feedforward_system`.
    """
    kind = scenario.control.arm_damping_by_legs
    if kind == "none":
        return []
    rod, arm, geometry = (
        known_rod(scenario),
        scenario.machine.masses.arm,
        scenario.geometry_as_known,
    )
    systems: list[Wired] = []
    if kind == "feedback":
        nothing = named("no_feedforward", ConstantVectorSource(np.zeros(4)))
        systems.append((nothing, {"y0": _FED_FORWARD}))
    else:
        fed = {"arm_command": "arm.position_command", "displacement": _FED_FORWARD}
        systems.append((feedforward_system(scenario), fed))
    moved = _FED_FORWARD
    if kind != "feedforward":
        moved = "displacement"
        response = partial(loop_response, scenario)
        damper = VibrationDamper(rod, arm, scenario.control.period, response=response)
        measured = {"arm_position": "arm.position", "posture": "posture_by_legs"}
        damps = {"enable": enable, "fed_forward": _FED_FORWARD, "displacement": _DAMPING}
        total = {"u0": _FED_FORWARD, "u1": _DAMPING, "sum": moved}
        systems += [
            (ForwardKinematics(geometry), {"posture": "posture_by_legs"}),
            (damper, measured | damps),
            (named("displacements", Adder(2, 4)), total),
        ]
    inclined = {"arm_position": "arm.position_command", "displacement": moved}
    return [*systems, (DampedPosture(rod, arm, geometry), inclined)]
