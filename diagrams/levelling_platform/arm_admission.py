"""Refusal of arms that their drives cannot hold or swing, or that hit platform or ground."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.zero_moment_point import ArmMove

# Postures in which the weight of an arm is looked at, and least number of positions of a joint.
_POSTURES, _LEAST = 4096, 3
# Instants of a swing that are looked at.
_INSTANTS = 101
# Rounding of a speed or an acceleration by its limit [-].
_ROUNDED = 1e-9
_STEP = 1e-3  # resolution of durations in messages [s]


def arm_faults(design: Any) -> Iterator[tuple[str, str]]:
    """Reasons for which an arm cannot be, each with its key.

    Args:
        design: `PlatformDesign` of the platform.
    """
    yield from _soft(design)
    yield from _weak(design)
    yield from _inside(design)


def _soft(design: Any) -> Iterator[tuple[str, str]]:
    """A rod that does not stand upright."""
    rod, gravity = design.arm.bending, design.masses.gravity
    if rod is None or rod.buckling > gravity:
        return
    softest = min(rod.bending_stiffness)
    yield (
        "machine.arm.bending_stiffness_Nm2",
        (
            f"{softest:g} N m^2 is too soft: upright, the rod buckles under its own weight; it "
            f"must be above {softest * gravity / rod.buckling:.3g}"
        ),
    )


def _weak(design: Any) -> Iterator[tuple[str, str]]:
    """Drives that do not hold the arm in every posture, on a level platform."""
    masses = design.masses
    arm = masses.arm
    if not arm.count:
        return
    count = max(_LEAST, int(_POSTURES ** (1.0 / arm.count)))
    ranges = [
        np.linspace(max(joint.lower, -math.pi), min(joint.upper, math.pi), count)
        if joint.kind == "revolute"
        else np.linspace(joint.lower, joint.upper, _LEAST)
        for joint in arm.joints
    ]
    postures = [grid.ravel() for grid in np.meshgrid(*ranges, indexing="ij")]
    still = [0.0] * arm.count
    reaction = arm.reaction(postures, still, still, (0.0, 0.0, -masses.gravity))
    yield from _too_weak(design, reaction.efforts, "to hold the arm", "machine.arm.drives")


def _too_weak(
    design: Any, efforts: Sequence[Any], purpose: str, key: str
) -> Iterator[tuple[str, str]]:
    """Drives whose largest effort is less than these (n)."""
    arm = design.masses.arm
    largest = design.arm.efforts(arm.count)
    for joint, limit, effort in zip(arm.joints, largest, efforts, strict=True):
        needed, unit = float(np.max(np.abs(effort))), "N m" if joint.unit == "rad" else "N"
        if needed > limit:
            yield (
                key,
                (
                    f"the drive of {joint.name!r} is too weak: {purpose} takes {needed:.3g} "
                    f"{unit}, and it has {limit:g} {unit}; max_effort_Nm must be "
                    f"{math.ceil(needed)} or more"
                ),
            )


def _inside(design: Any) -> Iterator[tuple[str, str]]:
    """An arm that is within the drawn base at zero; of a base of one's own nothing is known."""
    arm, (first, *_) = design.masses.arm, design.structure.underside
    if design.base.urdf or not arm.count:
        return
    half_length, half_width, depth = (-float(side) for side in first)
    for name, (x, y, z) in _places(arm, [0.0] * arm.count):
        if abs(x) < half_length and abs(y) < half_width and -depth < z < 0.0:
            yield (
                "machine.arm.base_mm",
                (
                    f"at zero {name} is {-1e3 * z:.0f} mm below the top of the platform's base; "
                    "it must be above it, or beside it"
                ),
            )


def _places(arm: Any, position: Sequence[Any]) -> Iterator[tuple[str, Any]]:
    """Joints and tip of an arm, by words, and their places from F [m]."""
    for joint, pose in zip(arm.joints, arm.link_poses(position), strict=True):
        yield f"the joint {joint.name!r}", pose.place
    yield "the arm's tip", arm.tip_pose(position).place


def check_swing(
    design: Any, goal: Sequence[float], duration: float, keys: tuple[str, str]
) -> None:
    """Refuses a swing along a cubic that the arm's drives cannot follow, or that hits the ground.

    The platform is level, at its working height.

    Args:
        design: `PlatformDesign` of the platform.
        goal: positions (n) of the arm's joints at the end of the swing, which begins at zero
            [rad or m].
        duration: duration of the swing [s].
        keys: keys of the swing's angle and of its duration.

    Raises:
        ScenarioError: names the key, and the admissible values.
    """
    masses, drives = design.masses, design.arm_drives
    arm, (angle_key, duration_key) = masses.arm, keys
    for joint, position in zip(arm.joints, goal, strict=True):
        if not joint.lower <= position <= joint.upper:
            raise ScenarioError(
                f"{angle_key}: {joint.name!r} goes from {joint.shown(joint.lower)} to "
                f"{joint.shown(joint.upper)}, not to {joint.shown(position)}",
                angle_key,
            )
    start = (0.0,) * arm.count
    fastest, quickest = zip(
        *((drive.max_velocity, drive.max_acceleration) for drive in drives), strict=True
    )
    shortest = ArmMove.within(start, tuple(goal), fastest, quickest).duration
    if duration < shortest * (1.0 - _ROUNDED):
        least = _STEP * math.ceil(shortest / _STEP - _ROUNDED)
        raise ScenarioError(
            f"{duration_key} = {duration:g} s is too short for the speed and acceleration of the "
            f"arm's drives: it must be {least:g} s or more",
            duration_key,
        )
    move = ArmMove(start, tuple(goal), duration)
    motions = [move.at(time) for time in np.linspace(0.0, duration, _INSTANTS)[:-1].tolist()]
    positions, rates, accelerations = (np.array(part).T for part in zip(*motions, strict=True))
    gravity = (0.0, 0.0, -masses.gravity)
    efforts = arm.reaction(list(positions), list(rates), list(accelerations), gravity).efforts
    for key, reason in _too_weak(design, efforts, "the swing", duration_key):
        raise ScenarioError(f"{key}: {reason}", key)
    for name, place in _places(arm, list(positions)):
        lowest = float(np.min(place[2])) + design.working_height
        if lowest < 0.0:
            raise ScenarioError(
                f"{angle_key}: {name} would be {-1e3 * lowest:.0f} mm below level ground; the "
                "swing must end above it",
                angle_key,
            )
