"""Walk of a leg on the bench, from standing to standing: plate, belt, foot and hip at any time.

The leg stands; unloads; swings, while the plate goes over into its path; walks a number of
strides; swings once more, to where it stands at last; and loads.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.motion_laws import joined, quintic
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.path import (
    Broken,
    PathLimits,
    PlatePath,
    check_path,
    first_broken,
    refuse_broken,
)
from parapod.systems.terrain_simulator.support import Support

_SAMPLES = 193  # samples of each swing between two speeds


class WalkMotion(NamedTuple):
    """Motion that a walk asks for at times (...).

    Attributes:
        pose: (3, ..., 3) x, z, phi of the plate, their rates and the rates of these [m, rad, s].
        belt: (...) speed of the belt, positive to the rear [m/s].
        foot: (3, ..., 2) x, z of the foot's middle from the hip, and their derivatives [m, s].
        force: (...) force of the ground on the foot, upwards [N].
        hip_force: (...) force on the hip's slide, upwards: what the other legs carry [N].
        stance: (...) whether the foot stands on the plate.
        distance: (3, ...) way of the body, and its derivatives [m, s].
        rise: (3, ...) height of the body over that of the distance zero, and its derivatives.
        bounce: (3, ...) height of the hip above its mean over the body, and its derivatives.
    """

    pose: Array
    belt: Array
    foot: Array
    force: Array
    hip_force: Array
    stance: NDArray[np.bool_]
    distance: Array
    rise: Array
    bounce: Array


class _Piece(NamedTuple):
    """Strides of one speed.

    Attributes:
        begin: time at which the swing before them begins [s].
        path: path of the plate; its time is counted from there.
        strides: number of them.
    """

    begin: float
    path: PlatePath
    strides: int


@dataclass(frozen=True)
class BenchWalk:
    """A walk: a path of the plate between two times at which all stands.

    Attributes:
        path: path of the plate; its `phase` is set to where the foot lifts off.
        mass: mass that the leg carries with its hip, itself included [kg].
        hip_height: height of the hip above the plate's middle, with the body at the height of the
            foothold [m].
        foot_radius: radius of the round foot [m].
        clearance: height of the foot above the plate in the middle of the swing [m].
        begin: time for which the leg stands first [s].
        shift: time in which it unloads, and in which it loads [s].
        strides: number of strides at the gait's speed [-].
        run_up: number of strides in which it speeds up before them, and slows down after them [-].
        is_inertial: true if the hip's drive adds the force with which a body resists the
            acceleration of its rise: the bench's body does not rise, the ground falls.
        is_even: true if the load is handed over evenly and the body does not bounce; see
            `Support`.
    """

    path: PlatePath
    mass: float
    hip_height: float
    foot_radius: float = 0.02
    clearance: float = 0.03
    begin: float = 0.5
    shift: float = 0.3
    strides: int = 4
    run_up: int = 1
    is_inertial: bool = True
    is_even: bool = False

    def __post_init__(self) -> None:
        for name in ("mass", "hip_height", "shift"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ValueError(f"{name} must be positive, not {getattr(self, name)!r}")
        for name in ("foot_radius", "clearance", "begin", "run_up"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise ValueError(f"{name} must not be negative, but is {getattr(self, name)!r}")
        if not self.strides >= 1:
            raise ValueError(f"strides must be at least 1, not {self.strides!r}")
        object.__setattr__(self, "path", replace(self.path, phase=self.path.gait.duty))

    @cached_property
    def support(self) -> Support:
        """Force of the leg, and bounce of the body."""
        return Support(self.path.gait, self.mass, self.is_even)

    @property
    def period(self) -> float:
        """Duration of a stride [s]."""
        return 1.0 / self.path.gait.frequency

    @property
    def swing(self) -> float:
        """Duration of a swing [s]."""
        return (1.0 - self.path.gait.duty) * self.period

    @property
    def lift_off(self) -> float:
        """Time at which the foot first lifts off [s]."""
        return self.begin + self.shift

    @property
    def landing(self) -> float:
        """Time at which it lands for the last time [s]."""
        return self.lift_off + (self.strides + 2 * self.run_up) * self.period + self.swing

    @property
    def duration(self) -> float:
        """Time at which it stands with its whole load again [s]."""
        return self.landing + self.shift

    @property
    def steady(self) -> tuple[float, float]:
        """Touchdowns between which all strides have the gait's speed [s]."""
        first = self.lift_off + self.run_up * self.period + self.swing
        return first, first + (self.strides - 1) * self.period

    @property
    def hip(self) -> tuple[float, float]:
        """x, z of the hip while the body does not bounce [m]."""
        return self.path.x_c, self.path.z_c + self.hip_height

    @cached_property
    def pieces(self) -> tuple[_Piece, ...]:
        """Strides that speed up, those of the gait's speed, and those that slow down."""
        full, n = self.path.gait.speed, self.run_up
        parts = [full * k / (n + 1) for k in range(1, n + 1)]
        plan = [*((speed, 1) for speed in parts), (full, self.strides)]
        plan += [(speed, 1) for speed in reversed(parts)]
        pieces_found: list[_Piece] = []
        time, position, before = self.lift_off, self.path.start, 0.0
        for speed, strides in plan:
            # The body changes its speed in the swing; extrapolate the path back to the lift-off.
            start = position + 0.5 * (before - speed) * self.swing
            path = replace(self.path.at_speed(speed), start=start, clock=time - self.lift_off)
            pieces_found.append(_Piece(time, path, strides))
            time += strides * self.period
            position, before = start + speed * strides * self.period, speed
        return tuple(pieces_found)

    def at(self, time: ArrayLike) -> WalkMotion:
        """Motion at times (...) [s].

        Raises:
            ValueError: a time that is not finite.
        """
        t = np.asarray(time, dtype=np.float64)
        moving = np.clip(t, self.lift_off, self.landing)
        since = moving - self.lift_off
        share = np.mod(since / self.period + self.path.gait.duty, 1.0)
        values, belt = self._values(moving)
        *pose, x, z, rise, distance, bounce = values
        foot = np.stack((x, z - bounce)) + self.foot_radius * _normal(pose[2])
        foot[0, 0] -= self.hip[0]
        foot[1, 0] -= self.hip[1]
        foot[1] += self.clearance * self.path.gait.dipped(share)
        swings = (t > self.lift_off) & (t < self.landing)
        lands = moving > self.landing - self.swing
        stance = ~swings | ((share < self.path.gait.duty) & ~lands)
        unloaded = np.clip((t - self.begin) / self.shift, 0.0, 1.0)
        loaded = np.clip((t - self.landing) / self.shift, 0.0, 1.0)
        standing = self.support.weight * (1.0 - quintic(unloaded)[0] + quintic(loaded)[0])
        walked = np.where(lands, 0.0, self.support.force(share))
        force = np.where(swings, walked, standing)
        inertial = rise[2] if self.is_inertial else 0.0
        return WalkMotion(
            pose=np.moveaxis(np.stack(pose), 0, -1),
            belt=belt,
            foot=np.moveaxis(foot, 0, -1),
            force=force,
            hip_force=self.mass * (GRAVITY + bounce[2] - inertial) - force,
            stance=stance,
            distance=distance,
            rise=rise,
            bounce=bounce,
        )

    def _values(self, t: Array) -> tuple[Array, Array]:
        """Pose, foothold, rise, distance and bounce (8, 3, ...), and the belt (...)."""
        values, belt = np.zeros((8, 3, *t.shape)), np.zeros(t.shape)
        before, ran = self._rest(self.path.start, self.lift_off), 0.0
        for piece in self.pieces:
            end = piece.begin + piece.strides * self.period
            touchdown = piece.begin + self.swing
            after, runs = _state(piece, self.support, np.array(touchdown))
            self._join(t, piece.begin, (before, after), (ran, float(runs)), values, belt)
            inside = (t >= touchdown) & (t < end)
            values[:, :, inside], belt[inside] = _state(piece, self.support, t[inside])
            before, last = _state(piece, self.support, np.array(end))
            ran = float(last)
        slowing = 0.5 * self.pieces[-1].path.gait.speed * self.swing
        rest = self._rest(float(before[6, 0]) + slowing, self.landing)
        self._join(t, self.landing - self.swing, (before, rest), (ran, 0.0), values, belt)
        return values, belt

    def _join(
        self,
        t: Array,
        begin: float,
        states: tuple[Array, Array],
        belts: tuple[float, float],
        values: Array,
        belt: Array,
    ) -> None:
        """Fills in a swing that leads from one state to another.

        Rates and accelerations go over by a polynomial, and what is missing of the way then is
        done by the law of the gait's return, as in any other swing.
        """
        inside = (t >= begin) & (t <= begin + self.swing)
        progress, duration = (t[inside] - begin) / self.swing, self.swing
        (p, v, a), (q, w, b) = states[0].T, states[1].T
        by_itself = p + 0.5 * duration * (v + w) + duration**2 / 12.0 * (a - b)
        lead = joined(progress, duration, states[0], np.stack((by_itself, w, b), axis=-1))
        gait = self.path.gait
        returned = gait.returned(gait.duty + (1.0 - gait.duty) * progress)
        values[:, :, inside] = lead + np.multiply.outer(q - by_itself, returned)
        belt[inside] = belts[0] + (belts[1] - belts[0]) * quintic(progress)[0]

    def _rest(self, distance: float, time: float) -> Array:
        """State (8, 3) of a leg that stands, its hip above the foot.

        Args:
            distance: way of the body [m].
            time: at which it begins or ends to stand [s].
        """
        path, terrain = self.path, self.path.terrain
        z = path.z_c + float(terrain.lift(time - self.lift_off).height)
        phi, height = -float(terrain.slope(distance)), float(terrain.height(distance))
        rest = np.zeros((8, 3))
        rest[:, 0] = (path.x_c, z, phi, path.x_c, z, height, distance, 0.0)
        return rest


def _state(piece: _Piece, support: Support, t: Array) -> tuple[Array, Array]:
    """Pose, foothold, rise, distance and bounce (8, 3, ...), and the belt (...), as it walks."""
    gait, since = piece.path.gait, t - piece.begin
    walking = piece.path.at(since)
    pose = np.stack((walking.pose, walking.velocity, walking.acceleration))
    zero = np.zeros_like(since)
    distance = np.stack((piece.path.start + gait.speed * since, zero + gait.speed, zero))
    values = np.stack(
        (
            *np.moveaxis(pose, -1, 0),
            *np.moveaxis(walking.foothold, (-1, -2), (0, 1)),
            np.moveaxis(walking.rise, -1, 0),
            distance,
            support.bounce(gait.frequency * since + gait.duty),
        )
    )
    return values, walking.belt


def check_walk(geometry: BenchGeometry, walk: BenchWalk, limits: PathLimits | None = None) -> None:
    """Refuses a walk on which the bench would break a limit, its run-up included.

    Args:
        geometry: the bench.
        walk: the walk.
        limits: limits of the walk besides the mechanism's; None for the defaults.

    Raises:
        PathRefused: names the limit that is broken first, when, and the admissible speed.
    """
    limits_used = PathLimits() if limits is None else limits
    for piece in walk.pieces:
        check_path(geometry, piece.path, limits_used, piece.strides * walk.period)
    # Swings between speeds.
    swings = [*(piece.begin for piece in walk.pieces), walk.landing - walk.swing]
    times = np.concatenate([np.linspace(one, one + walk.swing, _SAMPLES) for one in swings])

    def broken(speed: float) -> Broken | None:
        slower = replace(walk, path=walk.path.at_speed(speed))
        return first_broken(geometry, times, slower.at(times).pose, limits_used)

    refuse_broken(broken, walk.path.gait.speed)


def _normal(phi: Array) -> Array:
    """Unit vector (2, 3, ...) off the plate, from its angle and that's derivatives (3, ...)."""
    angle, rate, acceleration = phi
    s, c = np.sin(angle), np.cos(angle)
    return np.array(
        (
            (s, c * rate, c * acceleration - s * rate**2),
            (c, -s * rate, -s * acceleration - c * rate**2),
        )
    )
