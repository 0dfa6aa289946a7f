"""Inverse kinematics of the arm's tip: height of the platform, turntable and arm for a point.

Points are in the world W: its origin is in the middle of the four feet on the ground's plane, its
z axis is vertical, and x is where the platform looks with legs of one length. The tip of a rod on
a turntable is

    p = F(h) + R (b + (L - s) u + sag),

with the platform's centre F at height h above the plane, its attitude R, the joints' common place
b, the rod's direction u by turntable and arm, and its sag and shortening s under its own weight.
At an attitude, points that the tip reaches are a shell: spheres of radius L about b, whose height
the legs set. So the arm points, and the legs bring the rod's length to the point: for a rigid rod
in closed form, as |p - F(h) - R b| = L has one root within the legs' stroke, and turntable and arm
follow from the direction. The sag, some hundredths of the length, is compensated by aiming beside
the point by what the tip misses it; every step leaves about a thirtieth of the error. Beyond
83 deg of lean that does not converge, as the height does little there: such points count as not
reached.

What is left is in the answer: `TipSolution.error` is the distance of the tip from the point by
the exact forward kinematics, whatever has been solved for. The attitude is free: two angles with
which stroke and stability may be bought, see `TipReach.with_attitude`. `CarriedArm.reach` chooses
them, for any arm, and refuses what cannot be; this is for points by the million.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.core.batching import of_width
from parapod.systems.core.elementwise import Elementwise, nan_without_warning
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.triples import Vector3, dot, minus, plus, scaled
from parapod.systems.core.vectors import Array
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import height_range
from parapod.systems.levelling_platform.leg import (
    Point,
    extension_on_plane,
    footprint,
    pose_on_feet,
)
from parapod.systems.levelling_platform.plane import (
    about_vertical,
    normal_of,
    to_platform,
    to_world,
)

# Degree of the polynomials by which the platform's centre moves with its height: exact to
# nanometres over the stroke.
_DEGREE = 7
# Steps of Newton's method along the height; aims beside the point, each of which leaves a
# thirtieth of the sag.
_NEWTON, _AIMS = 2, 5
# Distance from the point at which the tip counts as there [m].
REACHED = 1e-6
# Heights from the middle at which a solution is looked for, by the range of heights [-]; and those
# that Newton's method may pass [m].
_BEYOND, _FARTHEST = 0.75, 0.5
_TINY = 1e-300  # keeps 0 / 0 away
# Rows that are solved at once, so that they stay in the processor's cache.
_ROWS = 16_384


# Cosine and sine of an angle.
type Axis = tuple[Elementwise, Elementwise]


class TipSolution(NamedTuple):
    """Posture, joints and legs that bring the tip to points, and what they are worth.

    Attributes:
        posture: roll, pitch, height (..., 3) of the platform [rad, rad, m].
        joints: turntable and arm (..., 2) [rad].
        extension: extensions of the legs (..., 4) [m].
        error: distance of the tip from the point, by the forward kinematics (...) [m].
        stroke_left: stroke that the tightest leg has left (...), below zero out of stroke [m].
    """

    posture: Array
    joints: Array
    extension: Array
    error: Array
    stroke_left: Array

    @property
    def is_reached(self) -> NDArray[np.bool_]:
        """Flags of tips that are at their points, with all legs in their stroke (...)."""
        return (self.error < REACHED) & (self.stroke_left >= 0.0)


@dataclass(frozen=True)
class TipReach:
    """Reach of a rod's tip on some ground, at an attitude of the platform.

    Attributes:
        geometry: the platform.
        arm: a turntable about z, and a joint across it in the same place; the tip is along its
            link's z axis.
        rod: the rod that bends; None: it is rigid.
        ground: roll and pitch of the ground [rad].
        attitude: roll and pitch of the platform [rad].
    """

    geometry: PlatformGeometry
    arm: SerialArm
    rod: FlexibleRod | None = None
    ground: tuple[float, float] = (0.0, 0.0)
    attitude: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuses other arms.

        Raises:
            ValueError: an arm that is not a rod on a turntable.
        """
        axes = [joint.axis for joint in self.arm.joints]
        if axes != [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)] or any(self.arm.joints[1].place):
            raise ValueError("the arm must be a rod on a turntable: joints about z and y, in one")

    def with_attitude(self, roll: float, pitch: float) -> Self:
        """The same at another attitude [rad]: the platform's two free angles."""
        return replace(self, attitude=(roll, pitch))

    @cached_property
    def heights(self) -> tuple[float, float]:
        """Smallest and largest height of the platform at the attitude [m]."""
        low, high = height_range(self.geometry, self.attitude, self.ground).tolist()
        return low, high

    @nan_without_warning
    def tip_position(self, height: ArrayLike, joints: ArrayLike) -> Array:
        """Place of the tip (..., 3) in the world, sagging at rest [m].

        Args:
            height: heights of the platform (...) [m].
            joints: turntable and arm (..., 2) [rad].
        """
        turn, swing = np.moveaxis(of_width(joints, 2, "joints"), -1, 0)
        centre, _, yaw = self._centre(np.asarray(height, dtype=float))
        angles = (np.cos(turn), np.sin(turn)), (np.cos(swing), np.sin(swing))
        base = plus(self.arm.joints[0].place, self._from_base(*angles))
        return _join(about_vertical(plus(centre, to_world(base, *self.attitude)), yaw))

    @nan_without_warning
    def solve(self, point: ArrayLike) -> TipSolution:
        """Height, turntable and arm that bring the tip to points; what misses says so.

        Args:
            point: points (..., 3) in the world [m].
        """
        points = np.asarray(of_width(point, 3, "point"), dtype=float)
        flat = points.reshape(-1, 3)
        parts = [self._solve(flat[i : i + _ROWS]) for i in range(0, max(len(flat), 1), _ROWS)]
        shape = points.shape[:-1]
        joined = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return TipSolution(*(part.reshape((*shape, *part.shape[1:])) for part in joined))

    @property
    def _length(self) -> float:
        return self.arm.tip_place[2]

    @cached_property
    def _normal(self) -> Vector3:
        return normal_of(*self.ground)

    @cached_property
    def _footprint(self) -> list[Point]:
        return footprint(self.geometry.legs, self.ground)

    def _centre(self, height: Elementwise) -> tuple[Vector3, list[Elementwise], Elementwise]:
        """Platform's centre before its feet turn it, extensions of the legs, and yaw [rad]."""
        roll, pitch = self.attitude
        g = to_platform(self._normal, roll, pitch)
        above, legs = height - self.geometry.foot_radius, self.geometry.legs
        extension = [extension_on_plane(leg, g, above) for leg in legs]
        on_feet = pose_on_feet(legs, extension, self.attitude, self._normal, self._footprint)
        return plus(on_feet.along, scaled(self._normal, height)), extension, on_feet.yaw

    @cached_property
    def _yaw(self) -> float:
        """Yaw in the middle of the heights, from which it departs by less than 1e-6 rad."""
        return float(self._centre(0.5 * sum(self.heights))[2])

    @cached_property
    def _base(self) -> Array:
        """Coefficients (_DEGREE + 1, 4) by the height from the middle [m].

        Of the joints' place in a world that has been turned by `_yaw` [m], and of what is left of
        the yaw there [rad].
        """
        low, high = self.heights
        nodes = np.cos(math.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
        half, middle = 0.5 * (high - low), 0.5 * (high + low)
        centre, _, yaw = self._centre(middle + half * nodes)
        base = plus(centre, to_world(self.arm.joints[0].place, *self.attitude))
        more = yaw - self._yaw
        values = np.column_stack([*about_vertical(base, more), more])
        coefficients = np.linalg.solve(np.vander(nodes, increasing=True), values)
        powers: Array = coefficients / half ** np.arange(_DEGREE + 1)[:, np.newaxis]
        return powers

    def _from_base(self, turn: Axis, swing: Axis) -> Vector3:
        """Tip from the joints' place, in the platform's frame, for cosine and sine of each."""
        (cos_t, sin_t), (cos_s, sin_s) = turn, swing
        across, sideways, along = 0.0, 0.0, self._length
        if self.rod is not None:
            up_x, up_y, up_z = to_platform((0.0, 0.0, GRAVITY), *self.attitude)
            out = cos_t * up_x + sin_t * up_y
            f_z = sin_s * out + cos_s * up_z
            sag = self.rod.sag(cos_s * out - sin_s * up_z, f_z, 0)
            across, along = sag.across, along - sag.along
            if up_x or up_y:
                sag = self.rod.sag(cos_t * up_y - sin_t * up_x, f_z, 1)
                sideways, along = sag.across, along - sag.along
        out = along * sin_s + across * cos_s
        return (
            out * cos_t - sideways * sin_t,
            out * sin_t + sideways * cos_t,
            along * cos_s - across * sin_s,
        )

    def _solve(self, points: Array) -> TipSolution:
        """`solve` for points (n, 3)."""
        x, y, z = about_vertical(tuple(points.T), -self._yaw)
        aim: Vector3 = (x, y, z)
        shift: Elementwise = np.zeros(len(points))
        aims, last = _AIMS if self.rod is not None else 1, (aim, aim)
        widest = _BEYOND * (self.heights[1] - self.heights[0])
        for i in range(aims):
            shift = self._shift_to(aim, shift, is_first=i == 0)
            shift = np.clip(shift, -widest, widest)
            place = self._base_at(shift)
            more = self._more_at(shift)
            along = _turned_back(minus(aim, place), more)
            v_x, v_y, v_z = to_platform(along, *self.attitude)
            out_squared = v_x * v_x + v_y * v_y
            out, whole = np.sqrt(out_squared), np.sqrt(out_squared + v_z * v_z)
            turn = np.divide(v_x, out, out=np.ones_like(out), where=out > 0.0), v_y / (out + _TINY)
            swing = v_z / whole, out / whole
            if i + 1 < aims:
                along = to_world(self._from_base(turn, swing), *self.attitude)
                tip = plus(place, _turned_back(along, -more))
                missed = minus((x, y, z), tip)
                following = plus(aim, missed)
                if i:
                    # Anderson's acceleration by the aim before.
                    change = minus(missed, last[0])
                    share = dot(missed, change) / (dot(change, change) + _TINY)
                    following = minus(following, scaled(minus(following, last[1]), share))
                last, aim = (missed, plus(aim, missed)), following
        roll, pitch = self.attitude
        height = sum(self.heights) * 0.5 + shift
        centre, extension, yaw = self._centre(height)
        more = yaw - self._yaw
        base = plus(self.arm.joints[0].place, self._from_base(turn, swing))
        tip = about_vertical(plus(centre, to_world(base, roll, pitch)), more)
        missed = minus((x, y, z), tip)
        error = np.sqrt(dot(missed, missed))
        d = np.stack(extension, axis=-1)
        left = np.minimum(d - self.geometry.extension_min, self.geometry.extension_max - d)
        return TipSolution(
            np.stack(np.broadcast_arrays(roll, pitch, height), axis=-1),
            np.stack([np.arctan2(v_y, v_x), np.arctan2(out, v_z)], axis=-1),
            d,
            np.where(np.isnan(error), math.inf, error),
            np.where(np.isnan(d).any(axis=-1), -math.inf, left.min(axis=-1)),
        )

    def _base_at(self, shift: Elementwise) -> Vector3:
        """Place of the joints in the world for heights from the middle."""
        x, y, z = (_polynomial(column, shift) for column in self._base.T[:3].tolist())
        return x, y, z

    def _more_at(self, shift: Elementwise) -> Elementwise:
        """Yaw beyond that in the middle of the heights."""
        return _polynomial(self._base[:, 3].tolist(), shift)

    def _shift_to(self, aim: Vector3, start: Elementwise, is_first: bool) -> Elementwise:
        """Height from the middle at which the rod's length reaches a point.

        Of the two roots the one that is nearer to the middle of the legs' stroke.
        """
        rise, shift = self._base[1, :3].tolist(), start
        if is_first:
            # A quadratic, for the joints move nearly along a line.
            v = minus(aim, self._base_at(shift))
            along, k_k = dot(v, rise), dot(rise, rise)
            root = np.sqrt(along * along - k_k * (dot(v, v) - self._length**2))
            shift = shift + (along - np.copysign(root, along)) / k_k
        for _ in range(_NEWTON if is_first else 1):
            shift = np.clip(shift, -_FARTHEST, _FARTHEST)
            v = minus(aim, self._base_at(shift))
            shift = shift + 0.5 * (dot(v, v) - self._length**2) / dot(v, rise)
        return shift


def _polynomial(coefficients: list[float], x: Elementwise) -> Elementwise:
    *lower, value = coefficients
    for coefficient in reversed(lower):
        value = value * x + coefficient
    return value


def _turned_back(vector: Vector3, yaw: Elementwise) -> Vector3:
    """A vector turned by minus a yaw so small that its square does not count."""
    x, y, z = vector
    return x + yaw * y, y - yaw * x, z


def _join(parts: Vector3) -> Array:
    return np.stack(np.broadcast_arrays(*parts), axis=-1)
