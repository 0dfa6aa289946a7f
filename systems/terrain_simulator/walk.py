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

from parapod.systems.core.motion_laws import quintic
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.path import PlateMotion, PlatePath
from parapod.systems.terrain_simulator.support import GRAVITY, Support


class WalkMotion(NamedTuple):
    """Motion that a walk asks for at times (...).

    Attributes:
        pose: (3, ..., 3) x, z, phi of the plate, their rates and the rates of these [m, rad, s].
        belt: (...) speed of the belt, positive to the rear [m/s].
        foot: (3, ..., 2) x, z of the foot's middle from the hip, and their derivatives [m, s].
        force: (...) force of the ground on the foot, upwards [N].
        hip_force: (...) force on the hip's slide, upwards: what the other legs carry [N].
        stance: (...) whether the foot stands on the plate.
        distance: (...) way of the body [m].
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
        strides: number of strides between the two swings [-].
        is_inertial: whether the hip's drive adds the force with which a body resists the
            acceleration of its rise: the bench's body does not rise, the ground falls.
    """

    path: PlatePath
    mass: float
    hip_height: float
    foot_radius: float = 0.02
    clearance: float = 0.03
    begin: float = 0.5
    shift: float = 0.3
    strides: int = 4
    is_inertial: bool = True

    def __post_init__(self) -> None:
        for name in ("mass", "hip_height", "shift"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ValueError(f"{name} must be positive, not {getattr(self, name)!r}")
        for name in ("foot_radius", "clearance", "begin"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise ValueError(f"{name} must not be negative, but is {getattr(self, name)!r}")
        if not self.strides >= 1:
            raise ValueError(f"strides must be at least 1, not {self.strides!r}")
        object.__setattr__(self, "path", replace(self.path, phase=self.path.gait.duty))

    @cached_property
    def support(self) -> Support:
        """Force of the leg, and bounce of the body."""
        return Support(self.path.gait, self.mass)

    @property
    def swing(self) -> float:
        """Duration of a swing [s]."""
        return (1.0 - self.path.gait.duty) / self.path.gait.frequency

    @property
    def lift_off(self) -> float:
        """Time at which the foot first lifts off [s]."""
        return self.begin + self.shift

    @property
    def landing(self) -> float:
        """Time at which it lands for the last time [s]."""
        return self.lift_off + self.strides / self.path.gait.frequency + self.swing

    @property
    def duration(self) -> float:
        """Time at which it stands with its whole load again [s]."""
        return self.landing + self.shift

    @property
    def steady(self) -> tuple[float, float]:
        """Times between which the strides are whole, and each begins with a touchdown [s]."""
        first = self.lift_off + self.swing
        return first, first + (self.strides - 1) / self.path.gait.frequency

    @property
    def hip(self) -> tuple[float, float]:
        """x, z of the hip while the body does not bounce [m]."""
        return self.path.x_c, self.path.z_c + self.hip_height

    def at(self, time: ArrayLike) -> WalkMotion:
        """Motion at times (...) [s].

        Raises:
            ValueError: a time that is not finite.
        """
        t = np.asarray(time, dtype=np.float64)
        f, duty = self.path.gait.frequency, self.path.gait.duty
        since = np.clip(t - self.lift_off, 0.0, self.landing - self.lift_off)
        share = np.mod(f * since + duty, 1.0)
        walking = self.path.at(since)
        values = self._values(since, walking)
        # Share of the walk in what is done, from rest and back to rest.
        leads = np.minimum(since / self.swing, 1.0)
        ends = np.clip((since - self.strides / f) / self.swing, 0.0, 1.0)
        is_last = ends > 0.0
        weight = np.stack(quintic(np.where(is_last, 1.0 - ends, leads)))
        weight *= np.stack((np.ones_like(t), *(self._by(is_last, n) for n in (1, 2))))
        first, last = (self._rest(n).reshape(8, 3, *[1] * t.ndim) for n in (0, 1))
        rest = np.where(is_last, last, first)
        away = values - rest
        value, rate, acceleration = away[:, 0], away[:, 1], away[:, 2]
        w, dw, ddw = weight
        blended = (
            np.stack(
                (
                    w * value,
                    w * rate + dw * value,
                    w * acceleration + 2.0 * dw * rate + ddw * value,
                ),
                axis=1,
            )
            + rest
        )
        *pose, x, z, rise, distance, bounce = blended
        phi = pose[2]
        foot = np.stack((x, z - bounce)) + self.foot_radius * _normal(phi)
        foot[0, 0] -= self.hip[0]
        foot[1, 0] -= self.hip[1]
        foot[1] += self.clearance * self.path.gait.dipped(share)
        swings = (t > self.lift_off) & (t < self.landing)
        stance = ~swings | (walking.stance & ~is_last)
        unloaded = np.clip((t - self.begin) / self.shift, 0.0, 1.0)
        loaded = np.clip((t - self.landing) / self.shift, 0.0, 1.0)
        standing = self.support.weight * (1.0 - quintic(unloaded)[0] + quintic(loaded)[0])
        walked = np.where(is_last, 0.0, self.support.force(share))
        force = np.where(swings, walked, standing)
        inertial = rise[2] if self.is_inertial else 0.0
        hip_force = self.mass * (GRAVITY + bounce[2] - inertial) - force
        return WalkMotion(
            pose=np.moveaxis(np.stack(pose), 0, -1),
            belt=w * walking.belt,
            foot=np.moveaxis(foot, 0, -1),
            force=force,
            hip_force=hip_force,
            stance=stance,
            distance=distance[0],
            rise=rise,
            bounce=bounce,
        )

    def _by(self, is_last: NDArray[np.bool_], order: int) -> Array:
        """Derivative of a swing's share by time, to a power; the last one runs backwards."""
        return np.where(is_last, -1.0, 1.0) ** order / self.swing**order

    def _values(self, since: Array, walking: PlateMotion) -> Array:
        """Pose, foothold, rise, distance and bounce (8, 3, ...) while walking."""
        pose = np.stack((walking.pose, walking.velocity, walking.acceleration))
        gait = self.path.gait
        zero = np.zeros_like(since)
        distance = np.stack((self.path.start + gait.speed * since, zero + gait.speed, zero))
        bounce = self.support.bounce(gait.frequency * since + gait.duty)
        return np.stack(
            (
                *np.moveaxis(pose, -1, 0),
                *np.moveaxis(walking.foothold, -1, 0),
                walking.rise,
                distance,
                bounce,
            )
        )

    def _rest(self, which: int) -> Array:
        """The same (8, 3) where the leg stands before and after: hip above the foot."""
        gait = self.path.gait
        middle = 0.5 * gait.duty / gait.frequency
        time = np.array(-middle if which == 0 else self.landing - self.lift_off + middle)
        rest = self._values(time, self.path.at(time))
        rest[:, 1:], rest[-1] = 0.0, 0.0
        return rest


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
