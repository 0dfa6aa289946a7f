"""The way along which a mechanism's frame is led: waypoints, or a tour of its coordinates."""

import itertools
import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from parapod.diagrams.any_mechanism.design import BuiltMechanism, MechanismDesign
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.schema import Schema, quantity
from parapod.systems.core.vectors import Array
from parapod.systems.mechanism.coordinates import PARTS, part_unit

type Floats = NDArray[np.float64]

_KEYS = tuple(f"{name}_{'mm' if i < 3 else 'deg'}" for i, name in enumerate(PARTS))
# Way from home that is looked for along a coordinate [sizes of the mechanism; rad], its share
# to which it is found, and the number of steps in which it is gone.
_FARTHEST, _TURNED, _FOUND = 1.0, 3.0, 5e-4
_STEPS = 32
# Least distance from a singular position within a tour, by that at home [-].
_NEAR = 0.3
# Way of a motor that is not foreseen and no jump, in a step [rad, sizes of the mechanism].
_JUMP = 0.05
# Leg of a tour before its pace is set, and the shortest one [s]; instants between two waypoints at
# which the way is looked at.
_LEG, _SHORTEST, _LOOKS = 1.0, 0.2, 50
# Way beyond an end of a joint up to which it counts as at the end [m, rad].
_BEYOND = 1e-5
_TRIES = 4  # number of tours that are tried, each half as wide
_END = 1e6  # [s]


@dataclass
class Waypoint(Schema):
    """Pose that is taken at a time, as a distance from that at home; coordinates alone count.

    Attributes:
        time: time at which it is taken, at rest [s].
        x_mm: along the world's x axis [mm].
        y_mm: along its y axis [mm].
        z_mm: along its z axis [mm].
        roll_deg: roll [deg].
        pitch_deg: pitch [deg].
        yaw_deg: yaw [deg].
    """

    time: float = quantity(1.0, 0.0, 1e5)
    x_mm: float = quantity(0.0, -1e5, 1e5)
    y_mm: float = quantity(0.0, -1e5, 1e5)
    z_mm: float = quantity(0.0, -1e5, 1e5)
    roll_deg: float = quantity(0.0, -360.0, 360.0)
    pitch_deg: float = quantity(0.0, -360.0, 360.0)
    yaw_deg: float = quantity(0.0, -360.0, 360.0)


@dataclass
class TrackScenario(Schema):
    """The way along which the frame is led; from rest to rest, with continuous accelerations.

    Attributes:
        waypoints: poses that are taken one after the other; empty: a tour, which goes along each
            coordinate in turn, both ways, as far as the motors can, and back.
        share: share of that way that a tour takes [-].
        speed: share of the motors' largest speeds and accelerations that a tour takes [-].
        begin: time for which the frame stands first [s].
        end: time for which it stands at last [s].
    """

    waypoints: list[Waypoint] = field(default_factory=list)
    share: float = quantity(0.5, 0.01, 0.99)
    speed: float = quantity(0.5, 0.01, 1.0)
    begin: float = quantity(0.5, 0.1, 60.0)
    end: float = quantity(0.5, 0.0, 60.0)


@dataclass(frozen=True, eq=False)
class Track:
    """A way of a mechanism's frame.

    Attributes:
        path: its coordinates (k) over time [m, rad].
        duration: end of the run [s].
        times: (n) instants at which it has been looked at [s].
        positions: (n, q) positions of all joints there [m, rad].
        rates: (n, motors) speeds of the motors there [m/s, rad/s].
        accelerations: (n, motors) their accelerations there [m/s^2, rad/s^2].
    """

    path: PiecewisePolynomial
    duration: float
    times: Floats
    positions: Floats
    rates: Floats
    accelerations: Floats

    def ahead(self, period: float) -> Trajectory:
        """The coordinates that are to be had a period later."""
        path: Any = self.path.Clone()
        path.shiftRight(-period)
        return cast("Trajectory", path)


def make_track(design: MechanismDesign, scenario: TrackScenario) -> Track:
    """The way of a scenario, looked at throughout.

    Raises:
        ScenarioError: a pose that the frame does not get to, or waypoints out of order.
    """
    waypoints = tuple(
        (point.time, *(getattr(point, key) for key in _KEYS)) for point in scenario.waypoints
    )
    settings = scenario.share, scenario.speed, scenario.begin, scenario.end
    return _tracked(design.built, design.drives.acceleration, waypoints, *settings)


@lru_cache(maxsize=16)
def _tracked(
    built: BuiltMechanism,
    acceleration: float,
    waypoints: tuple[tuple[float, ...], ...],
    share: float,
    speed: float,
    begin: float,
    end: float,
) -> Track:
    if waypoints:
        times, poses = _asked(built, waypoints, begin)
        return _looked_at(built, smooth_path(times, poses), times, end)
    for count in reversed(range(_TRIES)):
        times, poses = _tour(built, share, begin)
        try:
            slow = _looked_at(built, smooth_path(times, poses), times, end)
            break
        except ScenarioError:  # between ends that it gets to, there may be poses that it does not
            if not count:
                raise
            share *= 0.5
    # The same way at the pace that is asked for.
    paced = max(
        float((np.abs(slow.rates) / built.motors.velocities).max()) / speed,
        math.sqrt(float(np.abs(slow.accelerations).max()) / (speed * acceleration)),
        _SHORTEST / _LEG,
    )
    times = [0.0, *(begin + paced * (time - begin) for time in times[1:])]
    looks = np.where(slow.times > begin, begin + paced * (slow.times - begin), slow.times)
    path = smooth_path(times, poses)
    rates, accelerations = slow.rates / paced, slow.accelerations / paced**2
    return Track(path, times[-1] + end, looks, slow.positions, rates, accelerations)


def _asked(
    built: BuiltMechanism, waypoints: tuple[tuple[float, ...], ...], begin: float
) -> tuple[list[float], list[Array]]:
    """Times of the waypoints, and the poses (k) there."""
    times, poses = [0.0, begin], [built.home, built.home]
    scale = np.array([1.0 / part_unit(part)[1] for part in range(len(PARTS))])
    for i, (time, *way) in enumerate(waypoints):
        key = f"track.waypoints.{i}"
        if not time > times[-1]:
            raise ScenarioError(
                f"{key}.time = {time:g} s must be above {times[-1]:g} s", f"{key}.time"
            )
        for part, value in enumerate(way):
            if value and part not in built.parts:
                keys = ", ".join(_KEYS[each] for each in built.parts)
                raise ScenarioError(
                    f"{key}.{_KEYS[part]} must be 0: {built.frame} is led by {keys}",
                    f"{key}.{_KEYS[part]}",
                )
        times.append(time)
        poses.append(built.home + (scale * way)[list(built.parts)])
    return times, poses


def _tour(built: BuiltMechanism, share: float, begin: float) -> tuple[list[float], list[Array]]:
    """Times and poses (k) of a tour, all of whose legs take as long."""
    times, poses = [0.0, begin], [built.home, built.home]
    ways = {(i, s): farthest(built, i, s)[0] for i in range(len(built.parts)) for s in (1.0, -1.0)}
    if not any(ways.values()):
        stopped = f"; at an end there: {', '.join(built.stopped)}" if built.stopped else ""
        raise ScenarioError(
            f"track: {built.frame} cannot leave its home{stopped}; give another machine.home",
            "machine.home",
        )
    for i in range(len(built.parts)):
        for sign in (1.0, -1.0):
            pose = built.home.copy()
            pose[i] += share * ways[i, sign]
            for goal in (pose, built.home):
                times.append(times[-1] + _LEG)
                poses.append(goal)
    return times, poses


@lru_cache(maxsize=64)
def farthest(built: BuiltMechanism, part: int, sign: float) -> tuple[float, Array]:
    """Way from home along a coordinate to the end of a motor or to where singular positions are.

    Args:
        built: the mechanism.
        part: number of the coordinate, among those in which it is led.
        sign: 1 or -1, the direction.

    Returns:
        The way [m, rad], and the positions (q) there.
    """
    mechanism = built.mechanism
    most = _FARTHEST * mechanism.size if built.parts[part] < 3 else _TURNED
    low, q, step = 0.0, built.q, most / _STEPS
    # In steps, for beyond an end it may go on, then in halves.
    while step > _FOUND * most:
        ahead = _reached(built, part, sign * (low + step), q) if low < most else None
        if ahead is None:
            step *= 0.5
        else:
            low, q = low + step, ahead
    return sign * low, q


def _reached(built: BuiltMechanism, part: int, way: float, near: Array) -> Array | None:
    """Positions (q) at a distance from home along a coordinate; None where it does not get."""
    goal = np.full(len(PARTS), np.nan)
    goal[list(built.parts)] = built.home
    goal[built.parts[part]] += way
    q = _next(built, goal, near)
    if q is None or built.mechanism.beyond_limits(q):
        return None
    here, home = (built.mechanism.dexterity(pose, built.frame) for pose in (q, built.q))
    is_near = here.held < _NEAR * home.held or here.moved < _NEAR * home.moved
    return None if is_near else q


def _next(built: BuiltMechanism, goal: Array, near: Array) -> Array | None:
    """Positions (q) that bring the frame to a goal from those near by; None: it cannot get there.

    Newton's method alone finds them. Motors that would jump to another branch do not count.
    """
    mechanism, parts = built.mechanism, list(built.parts)
    q = mechanism.nearby(built.frame, goal, near)
    if q is None:
        return None
    went = mechanism.motor_positions(q) - mechanism.motor_positions(near)
    try:
        foreseen = built.motor_rates(near, goal[parts] - built.parts_at(near))
    except ParapodError:
        return None
    off = np.abs(went - foreseen) / built.scale
    is_jump = (off > _JUMP + 0.5 * np.abs(foreseen) / built.scale).any()
    return None if is_jump else q


def smooth_path(times: list[float], poses: list[Array]) -> PiecewisePolynomial:
    """Quintics (k) through poses at rest, whose accelerations are continuous.

    Args:
        times: increasing [s].
        poses: (k) each.
    """
    pieces = []
    for i, (begin, end) in enumerate(itertools.pairwise(poses)):
        duration, way = times[i + 1] - times[i], end - begin
        shares = (10.0 / duration**3, -15.0 / duration**4, 6.0 / duration**5)
        column = [
            [Polynomial(np.array([first, 0.0, 0.0, *(part * share for share in shares)]))]
            for first, part in zip(begin, way, strict=True)
        ]
        pieces.append(np.array(column))
    last = [[Polynomial(np.array([value]))] for value in poses[-1]]
    return PiecewisePolynomial([*pieces, np.array(last)], [*times, times[-1] + _END])


def _looked_at(
    built: BuiltMechanism, path: PiecewisePolynomial, times: list[float], end: float
) -> Track:
    """The track that stands for a while at its end, with positions and rates throughout.

    Raises:
        ScenarioError: a pose that the frame does not get to, and when.
    """
    mechanism, q = built.mechanism, built.q
    pieces = [np.linspace(*ends, _LOOKS, endpoint=False) for ends in itertools.pairwise(times)]
    looks = np.concatenate((*pieces, times[-1:]))
    positions, rates = [], []
    speeds = path.MakeDerivative()
    for time in looks.tolist():
        goal = np.full(len(PARTS), np.nan)
        goal[list(built.parts)] = path.value(time).ravel()
        try:
            ahead = _next(built, goal, q)
            if ahead is None:
                mechanism.inverse(built.frame, goal, q)  # raises with the reason, if out of reach
                raise ScenarioError("a motor would have to jump")
            q = ahead
            rates.append(built.motor_rates(q, speeds.value(time).ravel()))
        except ParapodError as error:
            raise ScenarioError(
                f"track: {built.frame} does not get to its pose at {time:.2f} s: {error}", "track"
            ) from None
        beyond = mechanism.beyond_limits(q)
        if max(beyond.values(), default=0.0) > _BEYOND:
            name, far = max(beyond.items(), key=lambda each: each[1])
            hint = f"; at an end at home: {', '.join(built.stopped)}" if built.stopped else ""
            raise ScenarioError(
                f"track: {name} would be {far:.4g} beyond its limits at {time:.2f} s [m, rad]"
                f"{hint}",
                "track",
            )
        positions.append(q)
    speeds_of_motors = np.array(rates)
    accelerations = np.gradient(speeds_of_motors, looks, axis=0)
    return Track(
        path, times[-1] + end, looks, np.array(positions), speeds_of_motors, accelerations
    )
