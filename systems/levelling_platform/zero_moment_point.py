"""Distance of the platform from tipping over: support polygon, zero-moment point, margin.

The platform stands still on its feet while the arm moves. The ground then has to bear gravity and
what accelerating the arm takes: the resultant R and, about the platform's centre F, the moment

    M = c_p x m_p g + M_a,

with the platform's mass m_p at c_p; R_a and M_a are the wrench of the moving arm, by `SerialArm`,
and R = m_p g + R_a.

The zero-moment point is where the line of R meets the ground's plane when M has been shifted
there, so that only a moment about the plane's normal n is left:

    z = (n x M - h R) / (n . R)

from F, h above the plane. With the arm at rest that is the point under the centre of mass in the
direction of gravity. The platform does not tip while the point is inside the support polygon, the
convex hull of the feet that stand. As they go round F in the order of the legs, a convex
quadrilateral over the whole stroke, it is those of them that stand, in that order.

Points of the plane have coordinates (x, y) [m] along the ground's axes R_y(pitch) R_x(roll), from
the foot of the perpendicular from F. The plane is as far below F as the standing feet are on
average; feet that stand a little above or below it count where they are perpendicular to it.
Leading dimensions are batch dimensions and broadcast. Inside the polygon,
`turntable.stability_margin` is the same for an arm at rest on level ground.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import columns, stack
from parapod.systems.core.elementwise import Elementwise, clamp, nan_without_warning, sqrt
from parapod.systems.core.triples import Vector3, cross, plus, scaled
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import to_platform, to_world, upwards
from parapod.systems.levelling_platform.statics import KinematicPlatformParams

type Profile = Literal["cubic", "quintic"]

# Peak rate and peak acceleration of a move from 0 to 1 in unit time.
_PEAKS: dict[str, tuple[float, float]] = {
    "cubic": (1.5, 6.0),
    "quintic": (1.875, 10.0 / math.sqrt(3.0)),
}
# Instants of a move that are looked at: that many intervals, and one more for each of these
# ways [rad or m] that it is long. Between two of them the margin of the paper's platform is
# smaller by .05 mm at most.
_INTERVALS = 40
_STEP = 0.04


class ArmMotion(NamedTuple):
    """Motion of an arm at an instant.

    Attributes:
        position: (..., n) of its joints [rad or m].
        rate: (..., n) [rad/s or m/s]; None: at rest.
        acceleration: (..., n) [rad/s^2 or m/s^2]; None: none.
    """

    position: ArrayLike
    rate: ArrayLike | None = None
    acceleration: ArrayLike | None = None


@dataclass(frozen=True)
class ArmMove:
    """A move of an arm from rest to rest, all joints along the same polynomial of time.

    Attributes:
        start: (n) positions of the joints at which it begins [rad or m].
        goal: (n) positions at which it ends [rad or m].
        duration: [s]; above zero unless it goes nowhere.
        profile: "cubic" has a continuous rate, "quintic" a continuous acceleration too.
    """

    start: tuple[float, ...]
    goal: tuple[float, ...]
    duration: float
    profile: Profile = "cubic"

    @classmethod
    def within(
        cls,
        start: tuple[float, ...],
        goal: tuple[float, ...],
        rate: tuple[float, ...],
        acceleration: tuple[float, ...],
        profile: Profile = "cubic",
    ) -> Self:
        """The shortest move with these largest rates and accelerations (n) of the joints."""
        peak_rate, peak_acceleration = _PEAKS[profile]
        duration = 0.0
        for a, b, v, w in zip(start, goal, rate, acceleration, strict=True):
            way = abs(b - a)
            duration = max(duration, peak_rate * way / v, math.sqrt(peak_acceleration * way / w))
        return cls(start, goal, duration, profile)

    def at(self, elapsed: float) -> ArmMotion:
        """The motion this long after the beginning [s]; at rest before it and from its end on."""
        if elapsed >= self.duration:
            return ArmMotion(self.goal)
        if elapsed < 0.0:
            return ArmMotion(self.start)
        way = [b - a for a, b in zip(self.start, self.goal, strict=True)]
        s, s_1, s_2 = _profile(self.profile, elapsed / self.duration)
        v, w = s_1 / self.duration, s_2 / (self.duration * self.duration)
        return ArmMotion(
            tuple(a + s * each for a, each in zip(self.start, way, strict=True)),
            tuple(v * each for each in way),
            tuple(w * each for each in way),
        )

    def sampled(self) -> ArmMotion:
        """The motion at instants (n) from the beginning to the end, both included, moving."""
        start, way = np.array(self.start), np.subtract(self.goal, self.start)
        intervals = _INTERVALS + int(np.abs(way).max(initial=0.0) / _STEP)
        progress = np.linspace(0.0, 1.0, intervals + 1)[:, np.newaxis]
        s, s_1, s_2 = _profile(self.profile, progress)
        time = self.duration or math.inf  # a move that goes nowhere is at rest
        return ArmMotion(start + s * way, s_1 * way / time, s_2 * way / (time * time))


def _profile(profile: Profile, t: Elementwise) -> tuple[Elementwise, Elementwise, Elementwise]:
    """Share of the way in unit time, and its two derivatives."""
    time_left = 1.0 - t
    if profile == "cubic":
        return t * t * (3.0 - 2.0 * t), 6.0 * t * time_left, 6.0 - 12.0 * t
    return (
        t * t * t * (10.0 + t * (6.0 * t - 15.0)),
        30.0 * t * t * time_left * time_left,
        60.0 * t * time_left * (time_left - t),
    )


type Point = tuple[Elementwise, Elementwise]

# Keeps 0 / 0 away from edges without length.
_TINY = 1e-300


class Footing(NamedTuple):
    """Stance of the platform.

    Attributes:
        extension: (..., 4) of the actuators [m].
        attitude: (..., 2) roll and pitch of the platform against gravity [rad].
        ground: (..., 2) roll and pitch of the ground [rad].
        standing: (..., 4) above 0.5 for each foot that stands on the ground.
    """

    extension: ArrayLike
    attitude: ArrayLike = (0.0, 0.0)
    ground: ArrayLike = (0.0, 0.0)
    standing: ArrayLike = (1.0, 1.0, 1.0, 1.0)


@nan_without_warning
def support_polygon(geometry: PlatformGeometry, footing: Footing) -> NDArray[np.float64]:
    """Corners of the support polygon in the ground's plane, anticlockwise seen from above.

    Args:
        geometry: the platform.
        footing: stance of the platform.

    Returns:
        (..., 4, 2) [m]. There are always four: a foot that does not stand is at the corner of the
        next one that does.
    """
    (extension, attitude, ground, standing), shape = _columns(footing)
    corners, _ = _polygon(geometry, extension, _ground_axes(attitude, ground), standing)
    flat = stack([number for corner in corners for number in corner], shape)
    return flat.reshape(*shape, LEG_COUNT, 2)


@nan_without_warning
def zero_moment_point(
    geometry: PlatformGeometry,
    params: KinematicPlatformParams,
    footing: Footing,
    motion: ArmMotion,
) -> NDArray[np.float64]:
    """Point in which the resultant of gravity and of the arm's inertia meets the ground's plane.

    Args:
        geometry: the platform.
        params: masses.
        footing: stance of the platform.
        motion: motion of the arm.

    Returns:
        (..., 2) [m]; NaN where the resultant does not press on the ground, or no foot stands.
    """
    (extension, attitude, ground, standing, *arm), shape = _columns(
        footing, params.arm.count, motion
    )
    axes = _ground_axes(attitude, ground)
    _, height = _polygon(geometry, extension, axes, standing)
    return stack(_point(params, axes, attitude, ground, height, arm), shape)


@nan_without_warning
def tipping_margin(
    geometry: PlatformGeometry,
    params: KinematicPlatformParams,
    footing: Footing,
    motion: ArmMotion,
) -> NDArray[np.float64]:
    """Distance of the zero-moment point from the edge of the support polygon, in the plane.

    Args:
        geometry: the platform.
        params: masses.
        footing: stance of the platform.
        motion: motion of the arm.

    Returns:
        (...) [m]; negative outside. Minus infinity with fewer than three standing feet, where the
        resultant does not press on the ground, where the legs cannot be built, and for any input
        that is not finite; never NaN.
    """
    with np.errstate(over="ignore"):
        arrays, shape = _columns(footing, params.arm.count, motion)
        extension, attitude, ground, standing, *arm = arrays
        axes = _ground_axes(attitude, ground)
        corners, height = _polygon(geometry, extension, axes, standing)
        point = _point(params, axes, attitude, ground, height, arm)
        distance = _signed_distance(corners, point)
        feet = sum(1.0 * (foot > 0.5) for foot in standing)
        # Zero if everything is finite, NaN otherwise.
        doubt = sum(0.0 * number for block in (*arrays, *corners, point) for number in block)
        is_known = (doubt == 0.0) & (feet >= 3.0)
    margin = stack([_choose(is_known, distance, -math.inf)], shape)
    return margin[..., 0]


def move_margin(
    geometry: PlatformGeometry,
    params: KinematicPlatformParams,
    footing: Footing,
    move: ArmMove,
    with_acceleration: bool = True,
) -> float:
    """Smallest `tipping_margin` along a move of the arm, and at rest before and after it.

    Args:
        geometry: the platform.
        params: masses.
        footing: stance of the platform meanwhile; no batch.
        move: move of the arm.
        with_acceleration: False counts gravity only, as if the arm moved slowly.
    """
    position, rate, acceleration = map(np.asarray, move.sampled())
    if with_acceleration:
        ends = np.array([move.start, move.goal])
        still = np.zeros(ends.shape)
        motion = ArmMotion(
            np.concatenate([position, ends]),
            np.concatenate([rate, still]),
            np.concatenate([acceleration, still]),
        )
    else:
        motion = ArmMotion(position)
    return float(tipping_margin(geometry, params, footing, motion).min())


def _columns(
    footing: Footing, joints: int = 0, motion: ArmMotion | None = None
) -> tuple[list[list[Elementwise]], tuple[int, ...]]:
    blocks: list[tuple[ArrayLike, int, str]] = [
        (footing.extension, 4, "extension"),
        (footing.attitude, 2, "attitude"),
        (footing.ground, 2, "ground"),
        (footing.standing, 4, "standing"),
    ]
    if motion is not None:
        still = (0.0,) * joints
        blocks += [
            (still if value is None else value, joints, name)
            for name, value in motion._asdict().items()
        ]
    return columns(*blocks)


def _ground_axes(attitude: list[Elementwise], ground: list[Elementwise]) -> list[Vector3]:
    """The platform's axes x, y and z, as the ground's axes see them."""
    return [
        to_platform(to_world(axis, *attitude), *ground)
        for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    ]


def _seen(axes: list[Vector3], vector: Vector3) -> Vector3:
    """A vector of the platform in the ground's axes."""
    x, y, z = (scaled(axis, part) for axis, part in zip(axes, vector, strict=True))
    return plus(plus(x, y), z)


def _polygon(
    geometry: PlatformGeometry,
    extension: list[Elementwise],
    axes: list[Vector3],
    standing: list[Elementwise],
) -> tuple[list[Point], Elementwise]:
    """Corners of the support polygon, and the height of F above the plane."""
    # Feet are at minus these vectors.
    to_centre = [
        _seen(axes, foot_to_centre(leg, d))
        for leg, d in zip(geometry.legs, extension, strict=True)
    ]
    stands = [foot > 0.5 for foot in standing]
    corners = [(-x, -y) for x, y, _ in to_centre]
    for i in (2, 1, 0, 3, 2, 1, 0):
        (x, y), (next_x, next_y) = corners[i], corners[(i + 1) % LEG_COUNT]
        corners[i] = _choose(stands[i], x, next_x), _choose(stands[i], y, next_y)
    count = sum(1.0 * foot for foot in stands)
    total = sum(_choose(foot, z, 0.0) for foot, (_, _, z) in zip(stands, to_centre, strict=True))
    return corners, total / _choose(count > 0.5, count, math.nan) + geometry.foot_radius


def _point(
    params: KinematicPlatformParams,
    axes: list[Vector3],
    attitude: list[Elementwise],
    ground: list[Elementwise],
    height: Elementwise,
    arm: list[list[Elementwise]],
) -> Point:
    """The zero-moment point (x, y) in the ground's axes, by the motion of the arm."""
    platform = _seen(axes, params.centre_of_mass)
    on_platform = scaled(upwards(*ground), -params.gravity * params.mass)
    position, rate, acceleration = arm
    gravity = scaled(upwards(*attitude), -params.gravity)
    on_arm = params.arm.reaction(position, rate, acceleration, gravity)
    x, y, z = plus(on_platform, _seen(axes, on_arm.force))
    m_x, m_y, _ = plus(cross(platform, on_platform), _seen(axes, on_arm.moment))
    z = _choose(z < 0.0, z, math.nan)
    return (-m_y - height * x) / z, (m_x - height * y) / z


def _signed_distance(corners: list[Point], point: Point) -> Elementwise:
    """Distance of a point from the edge of an anticlockwise convex polygon, negative outside."""
    x, y = point
    nearest, side = math.inf, math.inf
    for i, (x_1, y_1) in enumerate(corners):
        x_2, y_2 = corners[(i + 1) % LEG_COUNT]
        a, b, p, q = x_2 - x_1, y_2 - y_1, x - x_1, y - y_1
        share = _to_unit((a * p + b * q) / (a * a + b * b + _TINY))
        p_left, q_left = p - share * a, q - share * b
        nearest = _least(nearest, p_left * p_left + q_left * q_left)
        side = _least(side, a * q - b * p)  # zero for an edge without length
    distance = sqrt(nearest)
    return _choose(side >= 0.0, distance, -distance)


def _choose(condition: Any, a: Elementwise, b: Elementwise) -> Elementwise:
    return (a if condition else b) if type(condition) is bool else np.where(condition, a, b)


def _least(a: Elementwise, b: Elementwise) -> Elementwise:
    return min(a, b) if type(a) is float and type(b) is float else np.minimum(a, b)


def _to_unit(x: Elementwise) -> Elementwise:
    """The nearest number of [0, 1]."""
    return clamp(x, 0.0, 1.0) if type(x) is float else np.clip(x, 0.0, 1.0)
