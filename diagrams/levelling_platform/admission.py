"""Refusal of platforms that cannot be built, stand or lift themselves, in one line each."""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from parapod.diagrams.levelling_platform.arm_admission import arm_faults
from parapod.systems.core.errors import ScenarioError

# Depth of the wheels in the ground in the lowest posture that is rounding [m].
_ROUNDED = 1e-3

# Key of the machine's that is to blame, and why.
type Refusal = tuple[str, str]


def check_platform(design: Any) -> None:
    """Refuses a platform that cannot stand, tips over, or cannot lift itself or hold its arm.

    Args:
        design: `PlatformDesign` of a platform whose legs reach a level posture.

    Raises:
        ScenarioError: names the key, and the admissible values.
    """
    rules: tuple[Callable[[Any], Iterator[Refusal]], ...] = (
        _crossed, _stopped, _flat, _grounded, _on_wheels, arm_faults, _tipped, _weak,
    )  # fmt: skip
    for rule in rules:
        for key, reason in rule(design):
            raise ScenarioError(f"{key}: {reason}", key)


def _legs(design: Any) -> str:
    return "machine.each_leg" if design.each_leg else "machine.legs"


def _crossed(design: Any) -> Iterator[Refusal]:
    """Legs that cross, or that are not numbered against the clock."""
    feet = design.stance
    sides = np.roll(feet, -1, axis=0) - feet
    turns = np.linalg.det(np.stack([sides, np.roll(sides, -1, axis=0)], axis=1))
    if (turns <= 0.0).any():
        places = ", ".join(f"({1e3 * x:.0f}, {1e3 * y:.0f})" for x, y in feet)
        yield (
            _legs(design),
            (
                f"its feet stand at {places} mm from F; from the rear left one they must go round "
                "against the clock, as the corners of a convex figure"
            ),
        )


def _stopped(design: Any) -> Iterator[Refusal]:
    """Extensions on the ground beyond the end stops."""
    low, high = (1e3 * stop for stop in design.stops)
    shortest = 1e3 * min(leg.extension_min for leg in design.geometry.legs)
    longest = 1e3 * max(leg.extension_max for leg in design.geometry.legs)
    if not low <= shortest < longest <= high:
        yield (
            "machine.legs",
            (
                f"extensions on the ground of {shortest:g} to {longest:g} mm are not within the "
                f"end stops of machine.actuators, {low:g} to {high:g} mm"
            ),
        )


def _flat(design: Any) -> Iterator[Refusal]:
    """Parallelograms that become flat, and open, where it stands."""
    low, high = design.standing_stroke
    for number, leg in enumerate(design.geometry.legs, start=1):
        shortest, longest = abs(leg.l_4 - leg.l_3), leg.l_4 + leg.l_3
        for extension, is_open in ((shortest, low <= shortest), (longest, high >= longest)):
            if is_open:
                yield (
                    _legs(design),
                    (
                        f"the parallelogram of leg {number} is flat at an extension of "
                        f"{1e3 * extension:.1f} mm, and it stands on {1e3 * low:.1f} to "
                        f"{1e3 * high:.1f} mm: l_3_mm and l_4_mm must allow for that"
                    ),
                )


def _grounded(design: Any) -> Iterator[Refusal]:
    """A drawn base that touches the ground; of one of the user's own nothing is known."""
    lowest, depth = design.level_heights[0], -float(design.structure.underside[0, 2])
    if not design.base.urdf and lowest <= depth:
        yield (
            "machine.legs",
            (
                f"its base touches the ground: in the lowest posture F is {1e3 * lowest:.0f} mm "
                f"high; it must be more than {1e3 * depth:.0f} mm"
            ),
        )


def _on_wheels(design: Any) -> Iterator[Refusal]:
    """Wheels that touch the ground before the legs have lowered the platform."""
    lowest, wheels = design.level_heights[0], design.wheel_geometry
    if lowest + wheels.height - wheels.radius < -_ROUNDED:
        yield (
            "machine.wheels.depth_mm",
            (
                f"its wheels touch the ground before its legs have lowered it: with the lowest "
                f"posture {1e3 * lowest:.0f} mm high they must be "
                f"{1e3 * (lowest - wheels.radius):.0f} mm deep at most, not "
                f"{-1e3 * wheels.height:.0f} mm"
            ),
        )


def _tipped(design: Any) -> Iterator[Refusal]:
    """A centre of mass beyond the feet, level, its arm at zero."""
    masses, feet = design.masses, design.stance
    centre = np.array(masses.centre_with([0.0] * masses.arm.count)[:2])
    sides = np.roll(feet, -1, axis=0) - feet
    outwards = np.column_stack([sides[:, 1], -sides[:, 0]])
    outwards /= np.linalg.norm(outwards, axis=1)[:, np.newaxis]
    outside = float(((centre - feet) * outwards).sum(axis=1).max())
    if outside > 0.0:
        yield (
            "machine",
            (
                f"it tips over: its centre of mass is {1e3 * outside:.0f} mm outside its feet, "
                "its arm at zero; it must be between them"
            ),
        )


def _weak(design: Any) -> Iterator[Refusal]:
    """Motors that cannot lift it."""
    needed, supply = design.friction_voltages[1], design.actuators.supply_voltage
    if needed >= supply:
        least = math.ceil(design.actuators.motor_constant_N_V * needed / supply)
        yield (
            "machine.actuators",
            (
                f"it cannot lift itself: that takes {needed:.3g} V of a supply of {supply:g} V; "
                f"motor_constant_N_V must be more than {least}"
            ),
        )
