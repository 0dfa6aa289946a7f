"""Motion of the plate that gives a leg whose hip is fixed the footholds of a terrain.

The hip does not move along the rail; so in stance the plate moves back at the body's speed under
the foot that stands on it, and in swing it returns to the next foothold. The paper shows such
motions (Figure 2) without their equations: those here are assumed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.gait import Gait
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    LIMITS,
    margins,
    slider_accelerations,
    slider_rates,
)
from parapod.systems.terrain_simulator.terrain import Terrain

__all__ = [
    "Broken",
    "Gait",
    "PathLimits",
    "PathRefused",
    "PlateMotion",
    "PlatePath",
    "check_path",
    "first_broken",
    "refuse_broken",
]

_LINE = LIMITS.index("line P T A_3")
_STRIDES = 10  # strides that are checked if no duration is given
_STANCE, _SWING = 48, 192  # least samples of each; even, so that the middle of a swing is one
_LONGEST = 0.004  # longest step between samples [s], for the ground's own motion
_ROUNDING = 1e-9  # share of a limit that is still within it
# Shares of the path's speed among which an admissible one is sought before bisection.
_SCANNED = (*(n / 16 for n in range(15, 0, -1)), 1 / 32, 1 / 64)
_BISECTIONS = 10
_ACCEPTED = 0.99  # share of the named speed that is accepted for certain
# Limits besides `LIMITS`, and their units.
_RATES = (
    ("horizontal speed of the plate", "m/s"),
    ("vertical speed of the plate", "m/s"),
    ("turn of the plate", "rad/s"),
    *((f"speed of slider {n}", "m/s") for n in (1, 2, 3)),
    *((f"acceleration of slider {n}", "m/s^2") for n in (1, 2, 3)),
    ("length of the belt", "m"),
)


class PlateMotion(NamedTuple):
    """Motion of the plate at times (...).

    Attributes:
        pose: (..., 3) x, z, phi; phi > 0 is front end down [m, m, rad].
        velocity: (..., 3) their rates [m/s, m/s, rad/s].
        acceleration: (..., 3) the rates of these [m/s^2, m/s^2, rad/s^2].
        belt: (...) speed of a treadmill's belt, positive to the rear [m/s]; 0 for a pedal.
        stance: (...) whether the foot stands on the plate.
        foothold: (..., 3, 2) x, z of the ground under the foot, and their derivatives: the plate's
            middle, without the dip, or a place on the belt [m, m/s, m/s^2].
        rise: (..., 3) height of the body above that of the distance zero, and its derivatives
            [m, m/s, m/s^2].
    """

    pose: Array
    velocity: Array
    acceleration: Array
    belt: Array
    stance: NDArray[np.bool_]
    foothold: Array
    rise: Array


@dataclass(frozen=True)
class PlatePath:
    """Path of the plate over a terrain in a gait.

    Each stride has the height and the slope of its own foothold, over which the hip is in the
    middle of the stance. The body rises along a uniform cubic B-spline of these heights: at one
    speed where they rise evenly, and without jumps of its acceleration anywhere. So pose, velocity
    and acceleration of the plate are continuous over all strides.

    Attributes:
        terrain: the ground.
        gait: the gait.
        x_c: place of the plate's middle below the hip [m].
        z_c: its height with the body at the height of the foothold [m].
        dip: depth by which the plate keeps clear of the foot in the middle of the swing [m].
        phase: share of a stride that has passed at the time 0; 0 is touchdown [-].
        start: distance of the body at the time 0 [m].
        treadmill: true if a belt carries the foot back, and the plate stays at x_c.
        clock: time of a ground that moves, at the time 0 [s].
    """

    terrain: Terrain
    gait: Gait
    x_c: float
    z_c: float
    dip: float = 0.0
    phase: float = 0.0
    start: float = 0.0
    treadmill: bool = False
    clock: float = 0.0

    def __post_init__(self) -> None:
        for name in ("x_c", "z_c", "dip", "phase", "start", "clock"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, not {getattr(self, name)!r}")
        if not self.dip >= 0.0:
            raise ValueError(f"dip must not be negative, but is {self.dip!r}")

    def at_speed(self, speed: float) -> "PlatePath":
        """The same strides a second over the same terrain at another speed [m/s]."""
        return replace(self, gait=replace(self.gait, speed=speed))

    def footholds(self, stride: ArrayLike) -> Array:
        """Distance (...) [m] of the foothold of strides (...), whole numbers from touchdown 0."""
        gait = self.gait
        since = np.asarray(stride) - self.phase + 0.5 * gait.duty
        return np.asarray(self.start + gait.stride * since)

    def at(self, time: ArrayLike) -> PlateMotion:
        """Motion of the plate at times (...) [s].

        Raises:
            ValueError: a time that is not finite.
        """
        times = np.asarray(time, dtype=np.float64)
        if not np.isfinite(times).all():
            raise ValueError("times must be finite")
        gait, f = self.gait, self.gait.frequency
        strides = f * times + self.phase
        stride = np.floor(strides)
        share = strides - stride
        stance = share < gait.duty

        # Heights of this foothold, of two before and of two after it.
        numbers, which = np.unique(stride, return_inverse=True)
        near = self.footholds(numbers[:, np.newaxis] + np.arange(-2.0, 3.0))
        heights = self.terrain.height(near)[which.reshape(times.shape)]
        slopes = self.terrain.slope(near[:, 2:4])[which.reshape(times.shape)]
        this, rise = heights[..., 2], heights[..., 3] - heights[..., 2]

        S = gait.returned(share)  # in swing from 0 to 1
        # Way of the foothold along the rail from below the hip, and the plate's turn.
        along = gait.stride * (
            np.stack((0.5 * gait.duty - share, np.full_like(S[0], -f), np.zeros_like(S[0]))) + S
        )
        phi = -np.diff(slopes, axis=-1)[..., 0] * S
        phi[0] -= slopes[..., 0]
        # Height of the foothold over that of the body.
        lift = np.stack(self.terrain.lift(times + self.clock))
        body = gait.body(heights, share)
        z = rise * S + lift - body
        z[0] += this + self.z_c
        foothold = np.stack((along, z), axis=-1)
        foothold[0, ..., 0] += self.x_c
        if self.dip:
            z -= self.dip * gait.dipped(share)
        belt = np.zeros_like(S[0])
        if self.treadmill:
            belt = gait.speed / np.cos(phi[0])
            z -= _product(along, _tangent(-phi))
            along = np.zeros_like(along)
        along[0] += self.x_c
        pose, velocity, acceleration = np.stack((along, z, phi), axis=-1)
        along_and_up = np.moveaxis(foothold, 0, -2)
        risen = np.moveaxis(body, 0, -1)
        return PlateMotion(pose, velocity, acceleration, belt, stance, along_and_up, risen)


@dataclass(frozen=True)
class PathLimits:
    """Limits of a path besides those of the mechanism's places.

    Attributes:
        sin_mu: least sine of the transmission angle at T [-]; assumed: below it small loads take
            the plate past the line P T A_3.
        slider_speed: largest speed of a slider [m/s]; assumed, the paper names no actuator.
        slider_acceleration: largest acceleration of a slider [m/s^2]; assumed too.
        horizontal: largest speed of the plate along the rail, Table 1 [m/s].
        vertical: its largest vertical speed, Table 1 [m/s].
        turn: its largest rate, Table 1 [rad/s].
    """

    sin_mu: float = 0.25
    slider_speed: float = 3.5
    slider_acceleration: float = 110.0
    horizontal: float = 2.75
    vertical: float = 2.5
    turn: float = math.radians(900.0)

    def __post_init__(self) -> None:
        for field in fields(self):
            if not getattr(self, field.name) > 0.0:
                raise ValueError(
                    f"{field.name} must be positive, not {getattr(self, field.name)!r}"
                )


class PathRefused(ParapodError):
    """A path on which the bench would break a limit.

    Attributes:
        limit: the limit that is broken first: of `LIMITS`, or as in "speed of slider 1".
        instant: first instant at which it is broken [s].
        worst: worst value on the path: a speed [m/s; rad/s], acceleration [m/s^2] or length
            [m]; for `LIMITS` the least margin, negative [m; sin mu for the line P T A_3].
        admissible: largest admissible speed of the body [m/s] at the same frequency of strides
            over the same way, 99 % of which is accepted too; None if there is no such speed.
    """

    def __init__(
        self, limit: str, instant: float, worst: float, admissible: float | None, words: str
    ):
        self.limit, self.instant, self.worst, self.admissible = limit, instant, worst, admissible
        rest = (
            "no speed is admissible"
            if admissible is None
            else f"the largest admissible speed is {admissible:.4g} m/s"
        )
        super().__init__(f"{words}; {rest}")


def check_path(
    geometry: BenchGeometry,
    path: PlatePath,
    limits: PathLimits | None = None,
    duration: float | None = None,
) -> None:
    """Refuses a path on which the bench would break a limit.

    The admissible speed is sought downwards in steps of 1/16 of the path's, over the way that the
    path goes in its duration, and between two such steps by bisection: over terrains on which a
    slower walk has other footholds it need not be the only one.

    Args:
        geometry: the bench.
        path: the path.
        limits: limits of the path besides `margins`; None for the defaults.
        duration: duration from the time 0 on [s]; None for ten strides.

    Raises:
        PathRefused: names the limit that is broken first, when, and the admissible speed.
        ValueError: a duration that is not positive.
    """
    limits_used = PathLimits() if limits is None else limits
    lasting = _STRIDES / path.gait.frequency if duration is None else duration
    if not (math.isfinite(lasting) and lasting > 0.0):
        raise ValueError(f"duration must be positive, not {lasting!r}")
    way = path.gait.speed * lasting

    def broken(speed: float) -> Broken | None:
        slower = path.at_speed(speed)
        times = _instants(slower, way / speed if way else lasting)
        motion = slower.at(times)
        belt = _belt_length(slower, motion.pose)
        return first_broken(geometry, times, np.stack(motion[:3]), limits_used, belt)

    refuse_broken(broken, path.gait.speed)


def _instants(path: PlatePath, duration: float) -> Array:
    """Times from 0 to the duration, with all touchdowns, lift-offs and middles of swings [s]."""
    gait = path.gait
    stance, swing = (
        2 * math.ceil(0.5 * max(least, share / gait.frequency / _LONGEST))
        for least, share in ((_STANCE, gait.duty), (_SWING, 1.0 - gait.duty))
    )
    shares = np.concatenate(
        (
            np.linspace(0.0, gait.duty, stance, endpoint=False),
            np.linspace(gait.duty, 1.0, swing, endpoint=False),
        )
    )
    last = math.floor(duration * gait.frequency + path.phase)
    strides = np.arange(math.floor(path.phase), last + 1.0)
    times = (np.add.outer(strides, shares).ravel() - path.phase) / gait.frequency
    return np.concatenate(([0.0], times[(times > 0.0) & (times < duration)], [duration]))


def _belt_length(path: PlatePath, pose: Array) -> Array:
    """Length (...) of the belt that a stance needs [m]; 0 of a pedal."""
    length = path.gait.stance / np.cos(pose[..., 2])
    return np.asarray(length if path.treadmill else 0.0 * length)


class Broken(NamedTuple):
    """A limit that a motion breaks first.

    Attributes:
        limit: see `PathRefused`.
        instant: see there [s].
        worst: see there.
        words: a sentence about it.
    """

    limit: str
    instant: float
    worst: float
    words: str


def first_broken(
    geometry: BenchGeometry,
    times: Array,
    motion: Array,
    limits: PathLimits,
    belt: Array | None = None,
) -> Broken | None:
    """Limit that a motion of the plate breaks first; None if it keeps all.

    Args:
        geometry: the bench.
        times: instants (k) [s].
        motion: (3, k, 3) poses, their rates and the rates of these [m, rad, s].
        limits: limits of the path besides `margins`.
        belt: length (k) of the belt that is needed [m]; None: none.
    """
    pose, velocity, acceleration = motion
    margins_along = margins(geometry, pose)
    margins_along[:, _LINE] -= limits.sin_mu
    values = np.concatenate(
        (
            -margins_along,
            np.abs(velocity),
            np.abs(slider_rates(geometry, pose, velocity)),
            np.abs(slider_accelerations(geometry, pose, velocity, acceleration)),
            0.0 * margins_along[:, :1] if belt is None else belt[:, np.newaxis],
        ),
        axis=1,
    )
    most = np.array(
        [0.0] * len(LIMITS)
        + [limits.horizontal, limits.vertical, limits.turn]
        + [limits.slider_speed] * 3
        + [limits.slider_acceleration] * 3
        + [geometry.plate]
    )
    within = values <= most * (1.0 + _ROUNDING)
    if within.all():
        return None
    when = int(np.argmin(within.all(axis=1)))
    # A link that is too short leaves NaN behind: what it is short of comes before it.
    broken = (values[when] > most) & ~within[when]
    which = int(np.argmax(broken if broken.any() else ~within[when]))
    worst, instant = float(np.nanmax(values[:, which])), float(times[when])
    if which < len(LIMITS):
        name, words = LIMITS[which], f"{1e3 * worst:.2f} mm are missing"
        if which == _LINE:
            words = f"sin mu comes to {limits.sin_mu - worst:.3g}, less than {limits.sin_mu:.3g}"
        worst = -worst
    else:
        name, unit = _RATES[which - len(LIMITS)]
        words = f"{worst:.4g} {unit} is more than {most[which]:.4g} {unit}"
    return Broken(name, instant, worst, f"{name}: {words}, first at {instant:.3f} s")


def refuse_broken(broken: Callable[[float], Broken | None], speed: float) -> None:
    """Refuses a motion that breaks a limit, with the largest speed that does not.

    Args:
        broken: limit that is broken at a speed [m/s] over the same way; None: none.
        speed: the speed that is asked for [m/s].

    Raises:
        PathRefused: a limit is broken at that speed.
    """
    violation = broken(speed)
    if violation is not None:
        slower = _admissible(lambda other: broken(other) is None, speed)
        raise PathRefused(
            violation.limit, violation.instant, violation.worst, slower, violation.words
        )


def _admissible(passes: Callable[[float], bool], commanded: float) -> float | None:
    """Largest speed [m/s] that passes, and 99 % of which does."""
    refused = commanded
    for share in _SCANNED:
        speed, high = share * commanded, refused
        while speed < high and passes(speed):
            low = speed
            for _ in range(_BISECTIONS):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if passes(middle) else (low, middle)
            if passes(_ACCEPTED * low):
                return low
            high = _ACCEPTED * low
        refused = min(refused, speed)
    return None


def _tangent(angle: Array) -> Array:
    """Tangent (3, ...) of an angle and its derivatives, from the angle and its."""
    value, rate, acceleration = angle
    tangent = np.tan(value)
    steep = 1.0 + tangent**2
    return np.stack((tangent, steep * rate, steep * (acceleration + 2.0 * tangent * rate**2)))


def _product(one: Array, other: Array) -> Array:
    """Product (3, ...) and its derivatives, from two values and theirs."""
    return np.stack(
        (
            one[0] * other[0],
            one[1] * other[0] + one[0] * other[1],
            one[2] * other[0] + 2.0 * one[1] * other[1] + one[0] * other[2],
        )
    )
