"""The arm's tip put to a point by platform and arm together: the redundancy is used, and told.

Roll, pitch and height of the platform and the arm's n joints are one chain x of 3 + n, more than
the three numbers of a point, or the five of a point and a direction of view, ask for. What is
free is chosen: of all x that bring the tip there, that with the least

    sum over the legs of (d_i - d_i0)^2 + c^2 sum over the joints of (q_j - q_j0)^2,

where d_0 are the extensions of a posture with room to all sides and q_0 is where the arm is. The
length c is small, so that arm and turntable do what they can, and the legs only what is left. It
is found by Newton's method along the nearest solution of the linearised condition,

    x' = x_0 + V J^T (J V J^T)^-1 (target - f(x) + J (x - x_0)),

with the inverse V of that sum's matrix and the Jacobian J (Siciliano and others, Robotics, 2009,
section 3.5). It serves a serial arm of any joints, rigid or with a rod that sags, behind drives
that give way under its weight; and what it finds is proved by the forward kinematics:
`TipSolution.error`.

It starts from where the arm is, then from places all over its joints' ranges, on a level platform,
and, where that leaves less than a tenth of the stroke, on one whose legs are all in the middle of
it. Of what they lead to, that counts which the arm reaches soonest, among those with stroke,
stability and room. Where none does, the nearest point within stroke and joints follows from
sequential quadratic programming.

Points are in the world W: its origin is in the middle of the four feet on the ground's plane, its
z axis is vertical, and x is the direction in which the platform looks with legs of one length.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize  # type: ignore[import-untyped]
from scipy.stats import qmc  # type: ignore[import-untyped]

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.serial_arm import LinkPose, SerialArm, rotated, turned_back
from parapod.systems.core.batching import of_width
from parapod.systems.core.elementwise import Elementwise, nan_without_warning, sqrt
from parapod.systems.core.errors import ParapodError
from parapod.systems.core.triples import Vector3, cross, dot, plus, scaled
from parapod.systems.core.vectors import Array
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    height_range,
    posture_jacobian,
)
from parapod.systems.levelling_platform.leg import (
    FeetPose,
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
from parapod.systems.levelling_platform.statics import KinematicPlatformParams
from parapod.systems.levelling_platform.tip import TipSolution
from parapod.systems.levelling_platform.zero_moment_point import (
    ArmMotion,
    Footing,
    tipping_margin,
)

# Way of a leg that counts as much as a radian of a joint [m], or as a metre of one that slides.
_JOINTS = 1e-3
# Steps of Newton's method, their largest parts [rad or m], and change at which they end; then
# steps that only meet the target, which errors of the Jacobian had kept some nanometres away.
_STEPS, _LONGEST, _SMALLEST, _LAST = 25, 0.5, 1e-6, 3
# Step of differences [rad or m], and damping of directions in which nothing moves.
_DIFFERENCE, _DAMPING = 1e-7, 1e-12
# Largest roll and pitch that are looked at [rad].
_STEEPEST = 0.3
# Places over the joints' ranges from which a solution is looked for.
_STARTS = 16
# Positions of the arm that tell its extent.
_SAMPLES = 1024
# Share of the stroke that a solution should leave, and share of that which counts as alike [-].
_RESERVE, _ALIKE = 0.1, 0.7
# Places along each link that must be clear of base and ground.
_ALONG = np.linspace(0.0, 1.0, 9)[1:]
# Numbers of a point with a direction of view.
_POINT_AND_VIEW = 6
# Largest distance of unit vectors of a view that counts as reached [-].
_SEEN = 1e-6
# Most steps of the search for the nearest point, and change of its square at which it ends.
_SEARCH = {"maxiter": 200, "ftol": 1e-16}


class UnreachableTip(ParapodError):
    """A point that the arm's tip does not reach.

    Attributes:
        point: the point (3) [m].
        nearest: the nearest point that it reaches (3) [m].
    """

    def __init__(self, point: Array, nearest: Array):
        self.point, self.nearest = point, nearest
        there, here = (", ".join(f"{1e3 * x:.1f}" for x in place) for place in (point, nearest))
        away = 1e3 * float(np.linalg.norm(point - nearest))
        super().__init__(
            f"the tip does not reach ({there}) mm; the nearest point that it reaches is ({here}) "
            f"mm, {away:.1f} mm away"
        )


class BarredTip(ParapodError):
    """A point at which the tip could be, but for the platform's stability or its parts."""


class Reach(NamedTuple):
    """A posture and joints that bring the tip to a point.

    Attributes:
        solution: posture, joints, extensions, error and stroke left.
        margin: stability margin of the platform then [m].
    """

    solution: TipSolution
    margin: float


@dataclass(frozen=True)
class CarriedArm:
    """Platform on some ground and the arm on it, as one chain.

    Attributes:
        geometry: the platform.
        params: masses, and the arm.
        rod: rod on the last link that bends; None: it is rigid.
        ground: roll and pitch of the ground [rad].
        foot_offsets: heights of the feet above the ground's plane (4) [m].
        payload: mass that the tip bears besides [kg].
        margin: least stability margin [m].
        base: half length, half width and depth of the platform's base below F, out of which the
            arm stays [m]; None where nothing is known of it.
        rates: largest rates (n) of the joints, by which ways are compared [rad/s or m/s]; None:
            all alike.
    """

    geometry: PlatformGeometry
    params: KinematicPlatformParams
    rod: FlexibleRod | None = None
    ground: tuple[float, float] = (0.0, 0.0)
    foot_offsets: tuple[float, ...] = (0.0,) * LEG_COUNT
    payload: float = 0.0
    margin: float = 0.0
    base: tuple[float, float, float] | None = None
    rates: tuple[float, ...] | None = None

    @cached_property
    def loaded(self) -> KinematicPlatformParams:
        """Masses, and the arm with its payload."""
        return replace(self.params, arm=self.params.arm.bearing(self.payload))

    @property
    def arm(self) -> SerialArm:
        """The arm with its payload."""
        return self.loaded.arm

    @cached_property
    def _bending(self) -> FlexibleRod | None:
        rod = self.rod
        return replace(rod, tip_mass=rod.tip_mass + self.payload) if rod is not None else None

    @cached_property
    def _footprint(self) -> list[Point]:
        return footprint(self.geometry.legs, self.ground)

    @cached_property
    def postures(self) -> Array:
        """Postures (1 or 2, 3) with room to all sides: level, and legs in mid-stroke."""
        middle = 0.5 * (self.geometry.extension_min + self.geometry.extension_max)
        parallel = forward_kinematics(
            self.geometry, [middle] * LEG_COUNT, self.ground, foot_offsets=self.foot_offsets
        )
        low, high = height_range(self.geometry, (0.0, 0.0), self.ground, self.foot_offsets)
        level = [[0.0, 0.0, 0.5 * (low + high)]] if low < high else []
        return np.array([*level, parallel])

    @cached_property
    def extent(self) -> Array:
        """Smallest and largest places (2, 3) of the tip, the platform level: sampled [m]."""
        joints = self._spread(np.zeros(self.arm.count), _SAMPLES)
        places = self.tip_position(self.postures[0], joints)
        return np.array([places.min(axis=0), places.max(axis=0)])

    def tip_position(self, posture: ArrayLike, joints: ArrayLike) -> Array:
        """Place of the tip (..., 3) in the world, sagging at rest [m].

        Args:
            posture: roll, pitch, height (..., 3) of the platform [rad, rad, m].
            joints: positions (..., n) of the joints [rad or m].
        """
        chain = self._chain(posture, joints)
        return self._forward(chain)[0][..., :3]

    def view(self, posture: ArrayLike, joints: ArrayLike) -> Array:
        """Direction of view (..., 3) in the world: the z axis of the tip, turned by the sag.

        Args:
            posture: roll, pitch, height (..., 3) of the platform [rad, rad, m].
            joints: positions (..., n) of the joints [rad or m].
        """
        chain = self._chain(posture, joints)
        return self._forward(chain)[0][..., 3:]

    def deflection(self, posture: ArrayLike, joints: ArrayLike) -> Array:
        """Way of the tip (..., 3), in the world, from where a rigid rod has it [m].

        Args:
            posture: roll, pitch, height (..., 3) of the platform [rad, rad, m].
            joints: positions (..., n) of the joints [rad or m].
        """
        rigid = replace(self, rod=None)
        return self.tip_position(posture, joints) - rigid.tip_position(posture, joints)

    def platform_pose(self, posture: Sequence[float]) -> Array:
        """Quaternion (w, x, y, z) and place (7) in the world of a platform in a posture (3)."""
        on_feet, _ = self._on_feet(*posture)
        return np.array(on_feet.pose(posture, normal_of(*self.ground)))

    def posture_jacobian(self, posture: ArrayLike, joints: ArrayLike) -> Array:
        """Derivative of the tip's place by the posture (3, 3) [m/rad, m/rad, -].

        Args:
            posture: roll, pitch, height (3) of the platform [rad, rad, m].
            joints: positions (n) of the joints [rad or m].
        """
        chain = self._chain(posture, joints)
        return self._derivative(chain[np.newaxis], 3)[1][0, :, :3]

    def solve(
        self, point: ArrayLike, joints: ArrayLike, view: ArrayLike | None = None
    ) -> TipSolution:
        """Postures and joints that bring the tip to points, by Newton's method from one start.

        What misses its point says so.

        Args:
            point: points (..., 3) in the world [m].
            joints: positions (n) at which the arm is, and from which its ways count [rad or m].
            view: directions of view (..., 3), unit vectors in the world; None: any.
        """
        targets = _targets(point, view)
        flat = targets.reshape(-1, targets.shape[-1])
        start = np.append(self.postures[0], np.asarray(joints, dtype=float))
        chain = self._newton(flat, np.tile(start, (len(flat), 1)))
        return self._solution(chain.reshape(*targets.shape[:-1], -1), targets)

    def reach(
        self, point: ArrayLike, joints: ArrayLike | None = None, view: ArrayLike | None = None
    ) -> Reach:
        """The posture and joints that bring the tip to a point (3) [m].

        Args:
            point: point (3) in the world [m].
            joints: positions (n) at which the arm is [rad or m]; None: at zero.
            view: direction of view (3), a unit vector in the world; None: any.

        Raises:
            UnreachableTip: stroke and joints do not reach it; has the nearest point that they do.
            BarredTip: the platform would not stand firmly enough, or the arm be in its base or
                below the ground; or it cannot stand on such ground at all.
        """
        if not self._stands:
            roll, pitch = self.ground
            raise BarredTip(
                f"the platform does not stand on ground of roll {math.degrees(roll):.6g} deg and "
                f"pitch {math.degrees(pitch):.6g} deg, its feet as high as they are"
            )
        place = np.asarray(point, dtype=float)
        target = _targets(place, view)
        at = np.zeros(self.arm.count) if joints is None else np.asarray(joints, dtype=float)
        level, wide = self.postures[:1], np.vstack([at, self._spread(at, _STARTS)])
        for joints, postures in ((at[np.newaxis], level), (wide, level), (wide, self.postures)):
            solutions = self._from(target, joints, postures)
            best = self._best(solutions, target, at)
            if best is not None and solutions.stroke_left[best] >= self._reserve:
                return self._row(solutions, best)
        if best is None:
            solutions = self._nearest(target, solutions)
            best = self._best(solutions, target, at)
        if best is None:
            self._refuse(target, solutions)
        assert best is not None
        return self._row(solutions, best)

    def margins(self, solution: TipSolution) -> Array:
        """Stability margins (...) of solutions, the arm at rest [m]."""
        footing = Footing(solution.extension, solution.posture[..., :2], self.ground)
        return np.asarray(
            tipping_margin(self.geometry, self.loaded, footing, ArmMotion(solution.joints))
        )

    def admits(self, posture: ArrayLike, joints: ArrayLike) -> NDArray[np.bool_]:
        """Flags (...): the arm is out of base and ground, and the platform stands firmly enough.

        Args:
            posture: roll, pitch, height (..., 3) of the platform [rad, rad, m].
            joints: positions (..., n) of the joints [rad or m].
        """
        chain = self._chain(posture, joints)
        return self._admits(self._solution(chain, self._forward(chain)[0]))

    def _admits(self, solution: TipSolution) -> NDArray[np.bool_]:
        return self._is_clear(solution) & (self.margins(solution) >= self.margin)

    def _chain(self, posture: ArrayLike, joints: ArrayLike) -> Array:
        y, q = of_width(posture, 3, "posture"), of_width(joints, self.arm.count, "joints")
        shape = np.broadcast_shapes(y.shape[:-1], q.shape[:-1])
        parts = (np.broadcast_to(part, (*shape, part.shape[-1])) for part in (y, q))
        return np.concatenate(list(parts), axis=-1).astype(float)

    @nan_without_warning
    def _forward(self, chain: Array) -> tuple[Array, Array]:
        """Place of the tip and its direction of view (..., 6), and extensions (..., 4)."""
        is_single = chain.ndim == 1
        # One chain in plain numbers, which is several times faster.
        roll, pitch, height, *joints = chain.tolist() if is_single else np.moveaxis(chain, -1, 0)
        on_feet, extension = self._on_feet(roll, pitch, height)
        centre = plus(on_feet.along, scaled(normal_of(*self.ground), height))
        place, axis = self._on_platform(joints, roll, pitch)
        tip = about_vertical(plus(centre, to_world(place, roll, pitch)), on_feet.yaw)
        view = about_vertical(to_world(axis, roll, pitch), on_feet.yaw)
        if is_single:
            return np.array([*tip, *view]), np.array(extension)
        numbers = np.broadcast_arrays(*tip, *view)
        return np.stack(numbers, axis=-1), np.stack(np.broadcast_arrays(*extension), axis=-1)

    def _on_feet(
        self, roll: Elementwise, pitch: Elementwise, height: Elementwise
    ) -> tuple[FeetPose, list[Elementwise]]:
        """Place and heading over the feet, and extensions (4)."""
        normal, legs = normal_of(*self.ground), self.geometry.legs
        g = to_platform(normal, roll, pitch)
        extension = [
            extension_on_plane(leg, g, height - offset - leg.foot_radius)
            for leg, offset in zip(legs, self.foot_offsets, strict=True)
        ]
        return pose_on_feet(legs, extension, (roll, pitch), normal, self._footprint), extension

    def _on_platform(
        self, joints: Sequence[Elementwise], roll: Elementwise, pitch: Elementwise
    ) -> tuple[Vector3, Vector3]:
        """Place of the tip from F, and its direction of view, in the platform's frame."""
        up = scaled(to_platform((0.0, 0.0, 1.0), roll, pitch), self.params.gravity)
        behind = self.arm.yielded(joints, scaled(up, -1.0))
        if self._bending is None:
            pose = self.arm.tip_pose(behind)
            return pose.place, _third(pose)
        link = self.arm.link_poses(behind)[-1]
        x, y, z = turned_back(link.rotation, up)
        in_plane, across = self._bending.sag(x, z, 0), self._bending.sag(y, z, 1)
        p_x, p_y, p_z = self.arm.tip_place
        place = (
            p_x + in_plane.across,
            p_y + across.across,
            p_z - in_plane.along - across.along,
        )
        axis = _third(LinkPose(place, self.arm.tip_rotation))
        turn = -across.slope, in_plane.slope, 0.0
        axis = plus(axis, cross(turn, axis))
        axis = scaled(axis, 1.0 / sqrt(dot(axis, axis)))
        return plus(link.place, rotated(link.rotation, place)), rotated(link.rotation, axis)

    def _derivative(self, chain: Array, width: int) -> tuple[Array, Array]:
        """Place, and view if it counts (m, width), and their derivative (m, width, 3 + n)."""
        size = chain.shape[-1]
        moved = chain[:, np.newaxis] + np.vstack([np.zeros(size), _DIFFERENCE * np.eye(size)])
        values = self._forward(moved)[0][..., :width]
        derivative = (values[:, 1:] - values[:, :1]) / _DIFFERENCE
        return values[:, 0], np.swapaxes(derivative, 1, 2)

    @cached_property
    def _freedom(self) -> Array:
        """The matrix V (3 + n, 3 + n): how far each part moves for what it costs."""
        legs = posture_jacobian(self.geometry, self.postures[-1], self.ground)
        freedom = np.zeros((3 + self.arm.count,) * 2)
        freedom[:3, :3] = np.linalg.inv(legs.T @ legs)
        freedom[3:, 3:] = np.eye(self.arm.count) / _JOINTS**2
        return freedom

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        """Smallest and largest chain: joints by their limits, postures by what legs can be."""
        stroke = self.geometry.extension_max, self.geometry.extension_min
        extension = np.tile(np.array([stroke]).T, LEG_COUNT)
        (_, _, low), (_, _, high) = forward_kinematics(
            self.geometry, extension, self.ground, foot_offsets=self.foot_offsets
        )
        joints, turn = self.arm.joints, _STEEPEST
        lower = [-turn, -turn, low, *(joint.lower for joint in joints)]
        upper = [turn, turn, high, *(joint.upper for joint in joints)]
        return np.array(lower), np.array(upper)

    @property
    def _stands(self) -> bool:
        """Flag of ground on which one of `postures` stands, not too steep."""
        lower, upper = self._limits
        joints = np.zeros(self.arm.count)
        stroke = self.geometry.extension_min, self.geometry.extension_max
        is_flat = np.abs(self.postures[:, :2]).max(axis=-1) <= _STEEPEST
        _, extension = self._forward(self._chain(self.postures, joints))
        # Twice the stroke: feet at several heights need other postures than these.
        is_one = (np.abs(extension - np.mean(stroke)) <= np.ptp(stroke)).all(axis=-1)
        return bool((lower <= upper).all() and (is_flat & is_one).any())

    def _newton(self, target: Array, start: Array) -> Array:
        """Chains (m, 3 + n) that meet targets (m, 3 or 6), each nearest to its start."""
        chain, is_held = start, np.zeros(start.shape, dtype=bool)
        for _ in range(_STEPS):
            last = chain
            chain, is_held = self._step(target, chain, np.where(is_held, chain, start), is_held)
            if np.abs(chain - last).max(initial=0.0) < _SMALLEST:
                break
        for _ in range(_LAST):
            chain, is_held = self._step(target, chain, chain, is_held)
        return chain

    def _step(
        self, target: Array, chain: Array, nearest: Array, is_held: Array
    ) -> tuple[Array, Array]:
        """Chains after a step, and flags of what their limits hold from now on."""
        lower, upper = self._limits
        width = target.shape[-1]
        value, jacobian = self._derivative(chain, width)
        jacobian = np.nan_to_num(jacobian)
        missed = np.nan_to_num(target - value)
        missed += np.einsum("mij,mj->mi", jacobian, chain - nearest)
        free = 1.0 - is_held
        spread = self._freedom * free[:, :, np.newaxis] * free[:, np.newaxis, :]
        spread = spread @ np.swapaxes(jacobian, 1, 2)
        square = jacobian @ spread
        size = np.trace(square, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] + _DAMPING
        force = np.linalg.solve(square + _DAMPING * size * np.eye(width), missed[..., np.newaxis])
        step = nearest + (spread @ force)[..., 0] - chain
        longest = np.abs(step).max(axis=-1, keepdims=True)
        step *= _LONGEST / np.maximum(longest, _LONGEST)
        moved = np.clip(chain + step, lower, upper)
        return moved, is_held | ((moved != chain + step) & (moved == chain))

    def _solution(self, chain: Array, target: Array) -> TipSolution:
        value, extension = self._forward(chain)
        error = np.linalg.norm(value[..., :3] - target[..., :3], axis=-1)
        low, high = self.geometry.extension_min, self.geometry.extension_max
        left = np.minimum(extension - low, high - extension).min(axis=-1)
        return TipSolution(
            chain[..., :3],
            chain[..., 3:],
            extension,
            np.where(np.isnan(error), math.inf, error),
            np.where(np.isnan(left), -math.inf, left),
        )

    def _spread(self, joints: Array, count: int) -> Array:
        """Positions (count, n) all over the joints' ranges, half a turn from where they are."""
        lower, upper = (limit[3:] for limit in self._limits)
        lower, upper = np.maximum(lower, joints - math.pi), np.minimum(upper, joints + math.pi)
        spread = qmc.Halton(self.arm.count, scramble=False).random(count + 1)[1:]
        positions: Array = lower + spread * (upper - lower)
        return positions

    def _from(self, target: Array, joints: Array, postures: Array) -> TipSolution:
        """Solutions from positions (m, n) of the joints, with each of some postures."""
        chains = [np.hstack([np.tile(each, (len(joints), 1)), joints]) for each in postures]
        start = np.concatenate(chains)
        return self._solution(self._newton(np.tile(target, (len(start), 1)), start), target)

    @property
    def _reserve(self) -> float:
        """Stroke that a solution should leave [m]."""
        return _RESERVE * (self.geometry.extension_max - self.geometry.extension_min)

    def _row(self, solutions: TipSolution, row: int) -> Reach:
        solution = _rows(solutions, row)
        return Reach(solution, float(self.margins(solution)))

    def _best(self, solutions: TipSolution, target: Array, joints: Array) -> int | None:
        """Row of the admissible solution that the arm reaches soonest, if it leaves stroke."""
        fits = self._is_there(solutions, target) & self._admits(solutions)
        if not fits.any():
            return None
        left = np.where(fits, solutions.stroke_left, -math.inf)
        fits = left >= _ALIKE * min(float(left.max()), self._reserve)
        rates = np.ones(self.arm.count) if self.rates is None else np.array(self.rates)
        time = (np.abs(solutions.joints - joints) / rates).max(axis=-1, initial=0.0)
        # To a microsecond: last digits decide nothing.
        return int(np.argmin(np.where(fits, np.round(time, 6), math.inf)))

    def _is_there(self, solutions: TipSolution, target: Array) -> NDArray[np.bool_]:
        is_there = solutions.is_reached
        if target.shape[-1] == _POINT_AND_VIEW:
            view = self.view(solutions.posture, solutions.joints)
            is_there &= np.linalg.norm(view - target[3:], axis=-1) < _SEEN
        return is_there

    def _refuse(self, target: Array, solutions: TipSolution) -> None:
        """Says why none of the solutions will do.

        Raises:
            UnreachableTip: none reaches the target.
            BarredTip: the others.
        """
        place, is_there = target[:3], self._is_there(solutions, target)
        where = ", ".join(f"{1e3 * x:.1f}" for x in place)
        if not is_there.any():
            best = int(np.argmin(solutions.error))
            nearest = self.tip_position(solutions.posture[best], solutions.joints[best])
            if target.shape[-1] == _POINT_AND_VIEW:
                self.reach(place)
                raise BarredTip(
                    f"the tip reaches ({where}) mm, but cannot look along its view there"
                )
            raise UnreachableTip(place, nearest)
        there = _rows(solutions, is_there)
        if not self._is_clear(there).any():
            raise BarredTip(
                f"the tip reaches ({where}) mm only with the arm in the platform's base or below "
                "the ground"
            )
        margin = self.margins(_rows(there, self._is_clear(there))).max()
        raise BarredTip(
            f"with the tip at ({where}) mm {1e3 * margin:.0f} mm would be left to the edge "
            f"between the feet, which must be {1e3 * self.margin:.0f} mm or more"
        )

    def _nearest(self, target: Array, solutions: TipSolution) -> TipSolution:
        """Chain (1) within stroke and joints, tip above the ground, that is nearest to a target.

        Args:
            target: the target (3 or 6).
            solutions: chains, of which that whose tip is nearest is the start.
        """
        limits, width = self._limits, target.shape[-1]
        up = np.array(normal_of(*self.ground))
        low, high = self.geometry.extension_min, self.geometry.extension_max

        def distance(chain: Array) -> tuple[float, Array]:
            value, jacobian = self._derivative(chain[np.newaxis], width)
            off = np.nan_to_num(value[0] - target)
            return 1e3 * float(off @ off), 2e3 * np.nan_to_num(jacobian[0]).T @ off

        def room(chain: Array) -> Array:
            tip, extension = self._forward(chain)
            extension = np.nan_to_num(extension, nan=-1.0)
            above = up @ np.nan_to_num(tip[:3])
            return np.concatenate([1e2 * (extension - low), 1e2 * (high - extension), [above]])

        best = int(np.argmin(np.round(solutions.error, 6)))
        start = np.append(self.postures[0], solutions.joints[best])
        result = minimize(
            distance,
            start,
            jac=True,
            method="SLSQP",
            bounds=list(zip(*limits, strict=True)),
            constraints={"type": "ineq", "fun": room},
            options=_SEARCH,
        )
        return self._solution(result.x[np.newaxis], target)

    def _is_clear(self, solution: TipSolution) -> NDArray[np.bool_]:
        """Flags of solutions (m) whose arm is out of the base, and above the ground."""
        poses = self.arm.link_poses(list(np.moveaxis(solution.joints, -1, 0)))
        roll, pitch, height = np.moveaxis(solution.posture, -1, 0)
        tip, _ = self._on_platform(list(np.moveaxis(solution.joints, -1, 0)), roll, pitch)
        places = [
            np.stack(np.broadcast_arrays(*place, height)[:3], axis=-1)
            for place in (*(pose.place for pose in poses), tip)
        ]
        points = [places[0]]
        for last, following in pairwise(places):
            points += [last + share * (following - last) for share in _ALONG]
        x, y, z = np.moveaxis(np.stack(points), -1, 0)
        up = to_platform(normal_of(*self.ground), roll, pitch)
        is_clear = dot((x, y, z), up) + height > 0.0
        if self.base is not None:
            length, width, depth = self.base
            is_clear &= ~((np.abs(x) < length) & (np.abs(y) < width) & (-depth < z) & (z < 0.0))
        clear: NDArray[np.bool_] = is_clear.all(axis=0)
        return clear


def _targets(point: ArrayLike, view: ArrayLike | None) -> Array:
    """Points, with directions of view if these count (..., 3 or 6)."""
    points = np.asarray(of_width(point, 3, "point"), dtype=float)
    if view is None:
        return points
    views = np.asarray(of_width(view, 3, "view"), dtype=float)
    views = views / np.linalg.norm(views, axis=-1, keepdims=True)
    return np.concatenate(np.broadcast_arrays(points, views), axis=-1)


def _rows(solution: TipSolution, which: Any) -> TipSolution:
    return TipSolution(*(part[which] for part in solution))


def _third(pose: LinkPose) -> Vector3:
    """The z axis of a frame."""
    (_, _, x), (_, _, y), (_, _, z) = pose.rotation
    return x, y, z
