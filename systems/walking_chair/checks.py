"""Checks before a step is made: strokes, speeds, forces and support of a gait.

Each refusal names the branch or the leg, the time and the admissible values.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import first_of_largest, of_width
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.physics import GRAVITY
from parapod.systems.walking_chair.chair import chair_inverse, foot_corners
from parapod.systems.walking_chair.gait import TrotGait, Walk, gait_branches
from parapod.systems.walking_chair.geometry import (
    BRANCHES,
    LEGS,
    ChairGeometry,
    LegGeometry,
    branch_names,
)
from parapod.systems.walking_chair.masses import ChairMasses, Passenger, centre_of_mass
from parapod.systems.walking_chair.payload import FORCE_LIMIT
from parapod.systems.walking_chair.statics import STIFFNESS, force_map, rest

# A length that was computed for an actuator at its stroke's end must be admissible [m].
_STROKE_TOLERANCE = 1e-9
_SPEED_TOLERANCE = 1e-9  # [m/s]
_FORCE_TOLERANCE = 1e-6  # [N]


def _at(time: float | None) -> str:
    return "" if time is None else f" at {time:.3f} s"


class StrokeExceeded(ParapodError):
    """A branch that would have to be shorter or longer than its actuator allows.

    Attributes:
        branch: its name, as in "branch 12".
        time: time [s]; None for a posture without time.
        length: the length that it would need [m]; NaN if no length would do.
        admissible: (smallest, largest) length [m].
        missing: distance of the length from its range [m].
    """

    def __init__(
        self, branch: str, time: float | None, length: float, admissible: tuple[float, float]
    ):
        self.branch, self.time, self.length, self.admissible = branch, time, length, admissible
        low, high = admissible
        self.missing = max(low - length, length - high)
        stroke = f"stroke {1e3 * low:.1f}..{1e3 * high:.1f} mm"
        if math.isnan(length):
            text = f"{branch} has no length that puts the foot there{_at(time)} (its {stroke})"
        else:
            text = (
                f"{branch} would need a length of {1e3 * length:.3f} mm{_at(time)}, "
                f"{1e3 * self.missing:.3f} mm outside its {stroke}"
            )
        super().__init__(text)


class SpeedExceeded(ParapodError):
    """A branch that would have to move faster than its actuator does.

    Attributes:
        branch: its name, as in "branch 12".
        time: time [s]; None for a state without time.
        speed: speed that it would need, either way [m/s]; NaN if the foot is out of reach.
        limit: largest speed [m/s].
    """

    def __init__(self, branch: str, time: float | None, speed: float, limit: float):
        self.branch, self.time, self.speed, self.limit = branch, time, speed, limit
        super().__init__(
            f"{branch} would move at {1e3 * speed:.3f} mm/s{_at(time)}, "
            f"{1e3 * (speed - limit):.3f} mm/s faster than its limit {1e3 * limit:.1f} mm/s"
        )


def stroke_excess(geometry: LegGeometry, length: ArrayLike) -> NDArray[np.float64]:
    """Excess of each branch over its stroke.

    Args:
        geometry: the leg.
        length: (..., 3) lengths of the branches UP, UPS, UPS [m].

    Returns:
        (..., 3) excess [m]: positive outside, negative for the distance to the nearer end inside;
        NaN for NaN.
    """
    inputs = of_width(length, 3, "length")
    low, high = geometry.strokes.T
    return np.maximum(low - inputs, inputs - high)


def check_strokes(
    geometry: LegGeometry,
    length: ArrayLike,
    time: ArrayLike | None = None,
    legs: Sequence[int] = LEGS,
) -> None:
    """Refuses lengths outside the strokes.

    Args:
        geometry: the legs.
        length: (..., n, 3) lengths of the branches of n legs [m].
        time: (...) of each posture [s], for the error; None for postures without time.
        legs: numbers 1..4 of the n legs.

    Raises:
        StrokeExceeded: names the branch that is furthest outside, or has no length at all.
        ValueError: wrong shapes.
    """
    lengths = _of_legs(length, legs, "length")
    worst = _worst(stroke_excess(geometry, lengths), _STROKE_TOLERANCE)
    if worst is not None:
        low, high = geometry.strokes[worst[-1]].tolist()
        name, when = _name(worst, legs), _time(time, lengths.shape[:-2], worst)
        raise StrokeExceeded(name, when, float(lengths[worst]), (low, high))


def check_speeds(
    velocity: ArrayLike,
    limit: float,
    time: ArrayLike | None = None,
    legs: Sequence[int] = LEGS,
) -> None:
    """Refuses velocities above a limit, either way.

    Args:
        velocity: (..., n, 3) of the branches of n legs [m/s].
        limit: largest speed of each branch [m/s].
        time: (...) of each state [s], for the error; None for states without time.
        legs: numbers 1..4 of the n legs.

    Raises:
        SpeedExceeded: names the fastest branch.
        ValueError: wrong shapes.
    """
    speeds = np.abs(_of_legs(velocity, legs, "velocity"))
    worst = _worst(speeds - limit, _SPEED_TOLERANCE)
    if worst is not None:
        name, when = _name(worst, legs), _time(time, speeds.shape[:-2], worst)
        raise SpeedExceeded(name, when, float(speeds[worst]), limit)


def _of_legs(value: ArrayLike, legs: Sequence[int], name: str) -> NDArray[np.float64]:
    array = of_width(value, 3, name)
    if array.ndim < 2 or array.shape[-2] != len(legs):
        raise ValueError(f"{name} must have shape (..., {len(legs)}, 3), not {array.shape}")
    return array


def _worst(excess: NDArray[np.float64], tolerance: float) -> tuple[int, ...] | None:
    """Index of the largest excess, NaN being the largest of all; None if all are tolerable."""
    return None if (excess <= tolerance).all() else first_of_largest(excess, tolerance)


def _name(index: tuple[int, ...], legs: Sequence[int]) -> str:
    return branch_names(legs)[3 * index[-2] + index[-1]]


def _time(time: ArrayLike | None, shape: tuple[int, ...], index: tuple[int, ...]) -> float | None:
    return None if time is None else float(np.broadcast_to(time, shape)[index[:-2]])


# Speed that the paper gives for each actuator [m/s].
SPEED_LIMIT = 0.080
# Times looked at in each phase; what is between them exceeds them by 0.3 um at most.
_GAIT_TIMES = 1001


def check_gait(geometry: ChairGeometry, gait: TrotGait, speed_limit: float = SPEED_LIMIT) -> None:
    """Refuses a gait that takes a branch out of its stroke or beyond a speed.

    All cycles are alike, so the first is looked at.

    Args:
        geometry: the chair.
        gait: the gait.
        speed_limit: largest speed of each actuator [m/s].

    Raises:
        StrokeExceeded: names the branch and the time of the largest excess.
        SpeedExceeded: names the branch and the time of the largest speed.
    """
    one = replace(gait, cycles=1)
    time = np.linspace(0.0, one.duration, len(one.phases) * (_GAIT_TIMES - 1) + 1)
    motion = gait_branches(geometry, one, time)
    check_strokes(geometry.leg, motion.length, time)
    check_speeds(motion.velocity, speed_limit, time)


# Instants looked at in each phase.
_FORCE_TIMES = 5


class ForceExceeded(ParapodError):
    """A branch that would have to push or pull harder than its actuator does.

    Attributes:
        branch: its name, as in "branch 12".
        time: instant in the gait's time [s].
        force: force, positive where it pushes [N].
        limit: largest force [N].
    """

    def __init__(self, branch: str, time: float, force: float, limit: float):
        self.branch, self.time, self.force, self.limit = branch, time, force, limit
        super().__init__(
            f"{branch} would have to hold {force:.1f} N at {time:.3f} s, "
            f"{abs(force) - limit:.1f} N more than its limit {limit:.1f} N"
        )


class Stances(NamedTuple):
    """Stances of a level chair, unloaded.

    Attributes:
        times: (k) [s].
        corners: (k, 4, 3, 3) of the feet from S, along the body's axes [m].
        by_vertical: (k, 12, 12) branch forces by vertical forces on the corners [-].
    """

    times: NDArray[np.float64]
    corners: NDArray[np.float64]
    by_vertical: NDArray[np.float64]


def walked_stances(geometry: ChairGeometry, walk: Walk) -> Stances:
    """Stances in the lift and the first cycle of each gait of a walk, and in its end."""
    times = _instants(walk)
    motion = walk.motions(geometry, times)
    body = np.asarray(motion.body.position)
    lengths = chair_inverse(geometry, body, np.eye(3), motion.feet.position, motion.references)
    corners = foot_corners(geometry, body, np.eye(3), lengths) - body[:, None, None, :]
    return Stances(times, corners, np.array([force_map(geometry, at)[..., 2] for at in lengths]))


def resting_forces(
    stances: Stances,
    passenger: Passenger,
    masses: ChairMasses = ChairMasses(),
    stiffness: float = STIFFNESS,
) -> NDArray[np.float64]:
    """Forces (k, 12) of the branches of a chair at rest, which share the load as springs [N].

    Args:
        stances: k stances.
        passenger: person on the seat.
        masses: masses of the chair.
        stiffness: axial stiffness of a branch [N/m].
    """
    forces = []
    for places, vertical in zip(stances.corners, stances.by_vertical, strict=True):
        mass, centre = centre_of_mass(masses, passenger, places.mean(axis=-2))
        own = masses.foot_end * GRAVITY
        at_rest = rest(places.reshape(12, 3), vertical, mass * GRAVITY, centre, own, stiffness)
        forces.append(at_rest.branch_forces)
    return np.array(forces)


def check_forces(
    geometry: ChairGeometry,
    walk: Walk,
    passenger: Passenger,
    masses: ChairMasses = ChairMasses(),
    limit: float = FORCE_LIMIT,
    stiffness: float = STIFFNESS,
) -> None:
    """Refuses a passenger who is too heavy for the branches, which share the load as springs.

    All cycles are alike, so the first phases of each gait are looked at.

    Args:
        geometry: the chair.
        walk: the gaits.
        passenger: person on the seat.
        masses: masses of the chair.
        limit: largest force of a branch, either way [N].
        stiffness: axial stiffness of a branch [N/m].

    Raises:
        ForceExceeded: names the branch and the time of the largest force.
    """
    times, forces = walk_forces(geometry, walk, passenger, masses, stiffness)
    refuse_forces(forces, limit, times, BRANCHES)


def walk_forces(
    geometry: ChairGeometry,
    walk: Walk,
    passenger: Passenger,
    masses: ChairMasses = ChairMasses(),
    stiffness: float = STIFFNESS,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Forces of the branches at rest at instants of a walk.

    Args:
        geometry: the chair.
        walk: the gaits.
        passenger: person on the seat.
        masses: masses of the chair.
        stiffness: axial stiffness of a branch [N/m].

    Returns:
        (k) times in the first phases of each gait [s], and (k, 12) forces [N].
    """
    stances = walked_stances(geometry, walk)
    return stances.times, resting_forces(stances, passenger, masses, stiffness)


def refuse_forces(
    forces: NDArray[np.float64],
    limit: float,
    times: NDArray[np.float64],
    branches: Sequence[str],
) -> None:
    """Refuses forces above a limit, either way.

    Args:
        forces: (k, n) of n branches at k times [N].
        limit: largest force of a branch [N].
        times: (k) [s].
        branches: names of the n branches.

    Raises:
        ForceExceeded: names the branch that bears most, and when first.
    """
    worst = _worst(np.abs(forces) - limit, _FORCE_TOLERANCE)
    if worst is not None:
        when, branch = worst
        force = float(forces[worst])
        raise ForceExceeded(branches[branch], float(times[when]), force, limit)


def _instants(walk: Walk) -> np.ndarray:
    """Times in the lift and the first cycle of each gait, and in its end."""
    instants, begin = [], 0.0
    for gait in walk.gaits:
        first = np.linspace(0.0, 4.0 * gait.phase_duration, 4 * _FORCE_TIMES + 1)
        instants.append(begin + first)
        begin += gait.duration
    return np.concatenate(instants)
