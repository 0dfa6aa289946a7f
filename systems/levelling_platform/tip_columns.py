"""Points that the tip of a rod on a turntable reaches on level ground, column by column.

Over a place on the ground the tip comes at heights from a lowest to a highest one. At an attitude
of the platform the joints that bring the tip there solve two equations, by Newton's method on
`CarriedArm.tip_position`; the legs then move it straight up and down by what `height_range` leaves
them. (Their feet slip by that, and the tip moves sideways by up to .3 mm, which is left out.)
A turntable that is locked stays at zero: then roll and arm are solved for.

* A rod reaches a place with its tip above the joint, or below it. The attitudes are a grid, with
  lines at zero, where the ranges of heights have edges, and ends at their corners. Along an edge
  between two attitudes of the grid everything changes continuously; where a limit of legs or
  joints is passed, the edge ends there, by linear interpolation.
* Where the arm is at the end of its joint, roll and pitch are solved for, along a grid of turns.
  That is the lower boundary of a reach up to the horizontal.
* What lies between two heights that are reached is reached as well, as attitudes between them are
  admissible. Above and below the joint are two intervals, but for places that are out of reach at
  some attitudes: there the two meet, where the rod is horizontal.

Strokes of the legs, limits of the joints, the ground, the platform's base and its stability
margin count, the latter two at the grid's points only.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.vectors import Array
from parapod.systems.levelling_platform.carried_arm import CarriedArm
from parapod.systems.levelling_platform.kinematics import forward_kinematics, height_range
from parapod.systems.levelling_platform.plane import to_platform
from parapod.systems.levelling_platform.workspace import boundary

_LEVEL = (0.0, 0.0)
# Points along each edge of the legs' faces, by which the largest attitudes are known.
_EDGE = 9
# Most steps of Newton's method, their largest parts, step after which none is needed, and step of
# differences [rad]; distance from its place at which the tip is there [m]. Near the rim, where two
# solutions meet, each step only halves what is left.
_NEWTON, _LONGEST, _SHORT, _DIFFERENCE, _REACHED = 16, 0.3, 1e-4, 1e-6, 1e-6
# Way by which a limit may be passed [rad or m].
_SLACK = 1e-9
# Room of joints below which no solution is looked for [rad], smallest determinant [m^2] and
# distance [m] by which is divided.
_FAR, _SINGULAR, _TINY = 0.4, 1e-9, 1e-9
# Swings by which the reach is bounded; turns at the end of the arm's joint, and half
# their range by that which attitudes make up for.
_SWINGS, _AT_END, _WIDER = 61, 17, 1.2
# Share of its horizontal reach that a rod has there where it is nearly horizontal [-].
_NEARLY = 0.9995
# Without turntable, steps of the pitch and of the arm, by those with it.
_FINER, _FINEST = 2, 8
# Places that are worked on at once, so that they stay in the cache.
_ROWS = 64
# Places of roll, pitch, turntable and arm in a chain.
_ROLL, _PITCH, _TURN, _SWING = 0, 1, 3, 4


@dataclass(frozen=True)
class TipColumns:
    """Columns of the tip's reach.

    Attributes:
        carried: platform on level ground, with a rod on a turntable.
        steps: steps of roll, and of pitch, from zero to either end; 0: the platform stays level.
        is_locked: true if the turntable stays at zero.
    """

    carried: CarriedArm
    steps: int
    is_locked: bool = False

    def intervals(self, places: Array) -> Array:
        """Lowest and highest z (2, k, 2) of the tip over places, above and below its joint [m].

        Not a number where it does not come.

        Args:
            places: x and y (k, 2) of the places [m].
        """
        parts = [self._intervals(places[i : i + _ROWS]) for i in range(0, len(places), _ROWS)]
        return np.concatenate(parts, axis=1)

    def lengths(self, places: Array) -> Array:
        """Lengths of the columns (k) over places (k, 2) [m]."""
        (low, high) = self.intervals(places)
        common = np.minimum(*high.T) - np.maximum(*low.T)
        return np.nansum(high - low, axis=1) - np.maximum(np.nan_to_num(common), 0.0)

    def grid(self, count: int) -> tuple[Array, Array]:
        """Places (n, m, 2) that fill the reach, and the areas that they stand for.

        They are around the arm's joint, closer together towards the rim: by azimuth and the sine
        of an angle; without the turntable in a fan, by that sine and about the roll.

        Args:
            count: places in each of two directions, without the turntable twice as many in one.

        Returns:
            Places [m] and areas (n, m) [m^2].
        """
        share = (np.arange(count) + 0.5) / count
        other = share[:, np.newaxis]
        if not self.is_locked:
            azimuth, angle = 2.0 * math.pi * other, 0.5 * math.pi * share
            radius = self.radius(azimuth)
            r = radius * np.sin(angle)
            places = np.stack([r * np.cos(azimuth), r * np.sin(azimuth)], axis=-1)
            return self.joint[:2] + places, r * radius * np.cos(angle) * (math.pi / count) ** 2
        arm = self.carried.arm.joints[1]
        x, y, _ = self._offsets(np.linspace(arm.lower, arm.upper, _SWINGS), 0.0).reshape(-1, 3).T
        widest, rolls = float(np.abs(x).max()), y / self._height_over(x)
        low, high = float(rolls.min()), float(rolls.max())
        # Twice as many along x, which goes from rim to rim.
        angle = 0.5 * math.pi * np.concatenate([-share[::-1], share])
        roll = low + (high - low) * other
        x = widest * np.sin(angle)
        height = self._height_over(x)
        places = np.stack(np.broadcast_arrays(x, roll * height), axis=-1)
        area = widest * np.cos(angle) * height * math.pi * (high - low) / (2 * count**2)
        return self.joint[:2] + places, np.broadcast_to(area, (count, 2 * count))

    def volume(self, count: int) -> float:
        """Volume of the reach [m^3].

        Args:
            count: columns in each of two directions.
        """
        places, areas = self.grid(count)
        return float(self.lengths(places.reshape(-1, 2)) @ areas.ravel())

    def radius(self, azimuth: ArrayLike) -> Array:
        """Largest horizontal distances (...) of the tip from the joint of the level platform [m].

        Args:
            azimuth: directions (...) to which the turntable turns [rad].
        """
        turn = np.asarray(azimuth, dtype=float)[..., np.newaxis]
        swings = np.linspace(0.0, largest_swing(self.carried), _SWINGS)
        x, y, _ = np.moveaxis(self._offsets(swings, turn), -1, 0)
        return np.asarray((x * np.cos(turn) + y * np.sin(turn)).max(axis=(0, -1)))

    @cached_property
    def joint(self) -> Array:
        """Place (3) of the arm's joint, the platform level in the middle of its heights [m]."""
        joint: Array = self._joints_at(np.zeros((1, 2)))[0]
        return joint

    @property
    def height(self) -> float:
        """Height of the platform in the middle of those of the level one [m]."""
        return float(self.carried.postures[0, 2])

    @property
    def _length(self) -> float:
        return self.carried.arm.tip_place[2]

    @cached_property
    def _level_radius(self) -> float:
        return float(replace(self, steps=0).radius(0.0))

    def _height_over(self, x: Array) -> Array:
        """Height of a tip above the joint that is x in front of it, over the ground [m]."""
        height: Array = self.joint[2] + np.sqrt(np.maximum(self._length**2 - x * x, 0.0))
        return height

    def _joints_at(self, attitudes: Array) -> Array:
        """Places (m, 3) of the arm's joint at attitudes (m, 2)."""
        params = self.carried.params
        short = replace(params, arm=replace(params.arm, tip_place=(0.0, 0.0, 0.0)))
        heights = np.full(len(attitudes), self.height)
        carried = replace(self.carried, rod=None, params=short)
        return carried.tip_position(np.column_stack([attitudes, heights]), (0.0, 0.0))

    @cached_property
    def _rows(self) -> tuple[Array, Array]:
        """All rolls and pitches of the grid, from end to zero to end [rad]."""
        geometry = self.carried.geometry
        if not self.steps:
            return np.zeros(1), np.zeros(1)
        ends = forward_kinematics(geometry, boundary(geometry, _EDGE), _LEVEL)[:, :2]
        count = self.steps * (_FINER if self.is_locked else 1) + 1
        rolls, pitches = (
            np.append(np.linspace(a.min(), 0.0, count)[:-1], np.linspace(0.0, a.max(), count))
            for a in ends.T
        )
        return rolls, pitches

    @property
    def attitudes(self) -> Array:
        """Rolls and pitches (m, 2) of the grid that legs can take, and their neighbours [rad].

        Without the turntable pitches only.
        """
        return self._graph[0]

    @cached_property
    def _graph(self) -> tuple[Array, NDArray[np.int_]]:
        """`attitudes`, and edges (2, e): pairs of neighbours, and each with itself."""
        rolls, pitches = self._rows
        rolls = np.zeros(1) if self.is_locked else rolls
        attitudes = np.stack(np.meshgrid(rolls, pitches, indexing="ij"), axis=-1).reshape(-1, 2)
        index = np.arange(len(attitudes)).reshape(len(rolls), len(pitches))
        pairs = (index, index), (index[1:], index[:-1]), (index[:, 1:], index[:, :-1])
        edges = np.concatenate([np.stack([a.ravel(), b.ravel()]) for a, b in pairs], axis=1)
        if self.is_locked:
            return attitudes, edges
        low, high = np.moveaxis(height_range(self.carried.geometry, attitudes, _LEVEL), -1, 0)
        edges = edges[:, (high - low > -_SLACK)[edges].any(axis=0)]
        rows, edges = np.unique(edges, return_inverse=True)
        return attitudes[rows], edges.reshape(2, -1)

    def _offsets(self, swing: ArrayLike, turn: ArrayLike) -> Array:
        """Offsets (m, ..., 3) of the tip from the joint at all attitudes, for joints (...) [m]."""
        rolls, pitches = self._rows
        attitudes = np.stack(np.meshgrid(rolls, pitches), axis=-1).reshape(-1, 2)
        low, high = np.moveaxis(height_range(self.carried.geometry, attitudes, _LEVEL), -1, 0)
        attitudes = attitudes[high - low > -_SLACK]
        postures = np.column_stack([attitudes, np.full(len(attitudes), self.height)])
        joints = np.stack(np.broadcast_arrays(turn, swing), axis=-1)
        shape = (len(postures), *(1,) * (joints.ndim - 1), 3)
        return self.carried.tip_position(postures.reshape(shape), joints) - self.joint

    def _intervals(self, places: Array) -> Array:
        """`intervals` of a few places."""
        unknown = (_ROLL, _SWING) if self.is_locked else (_TURN, _SWING)
        chains, meets = self._chains(places)
        parts = [self._solve(chains, places, unknown).along(*self._graph[1])]
        if self.steps:
            samples = self._solve(self._chains_by_joints(places), places, (_ROLL, _PITCH))
            first = np.arange(samples.is_admissible.shape[1])
            parts.append(samples.along(first, np.minimum(first + 1, first[-1])))
        low, high, is_above = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
        ends = []
        for side in (is_above | meets[:, np.newaxis], ~is_above & ~meets[:, np.newaxis]):
            lowest = np.where(side, low, math.inf).min(axis=1)
            highest = np.where(side, high, -math.inf).max(axis=1)
            ends.append(np.where(lowest <= highest, [lowest, highest], math.nan))
        return np.stack(ends, axis=-1)

    def _chains(self, places: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Chains (k, m, 2, 5) that a rigid rod would have, above and below its joint.

        An attitude at which a place is out of reach is inclined towards the place so far that the
        rod reaches it, nearly horizontal.

        Returns:
            The chains, and flags (k) of places for which attitudes have been changed.
        """
        joint = self._joints_at(self.attitudes)
        way = places[:, np.newaxis] - joint[:, :2]
        along = way * (1.0, 0.0) if self.is_locked else way
        out = np.hypot(*np.moveaxis(along, -1, 0))
        radius = self._level_radius
        beyond = np.where(out > radius, out - _NEARLY * radius, 0.0)
        move = along * (beyond / np.maximum(out, _TINY))[..., np.newaxis]
        roll, pitch = self.attitudes.T
        roll, pitch = roll - move[..., 1] / joint[:, 2], pitch + move[..., 0] / joint[:, 2]
        up = np.sqrt(np.maximum(self._length**2 - (out - beyond) ** 2, 0.0))
        up = up[..., np.newaxis] * np.array([1.0, -1.0])
        x, y = np.moveaxis(way - move, -1, 0)
        x, y, roll, pitch = (part[..., np.newaxis] for part in (x, y, roll, pitch))
        if self.is_locked:
            roll = np.clip(-y / (joint[:, 2:] + up), -_LONGEST, _LONGEST)
            turn, swing = 0.0, np.arctan2(x, up) - pitch
        else:
            x, y, z = to_platform((x, y, up), roll, pitch)
            turn, swing = np.arctan2(y, x), np.arctan2(np.hypot(x, y), z)
        chains = np.broadcast_arrays(roll, pitch, self.height, turn, swing)
        return np.stack(chains, axis=-1), (beyond > 0.0).any(axis=1)

    def _chains_by_joints(self, places: Array) -> Array:
        """Chains (k, m, 1 or 2, 5) of the level platform, roll and pitch of which are to follow.

        With a locked turntable at swings all over the arm's range, else at its ends and at turns.
        """
        arm = self.carried.arm.joints[1]
        if self.is_locked:
            swing = np.linspace(arm.lower, arm.upper, _FINEST * self.steps + 1)[:, np.newaxis]
            turn = np.zeros((len(places), 1, 1))
        else:
            swing = np.array([arm.lower, arm.upper])
            height = self._tips(np.array([[0.0, 0.0, self.height, 0.0, q] for q in swing]))[:, 2]
            x, y = (places - self.joint[:2]).T[..., np.newaxis, np.newaxis]
            half = (
                _WIDER
                * np.abs(self.attitudes).max()
                * np.abs(height)
                / np.maximum(_TINY, np.hypot(x, y))
            )
            turn = np.linspace(-1.0, 1.0, _AT_END)[:, np.newaxis] * np.minimum(half, math.pi)
            turn = turn + np.arctan2(y, x) + math.pi * (swing < 0.0)
        return np.stack(np.broadcast_arrays(0.0, 0.0, self.height, turn, swing), axis=-1)

    def _solve(self, chains: Array, places: Array, unknown: tuple[int, int]) -> "_Samples":
        """Chains (k, m, 2, 5) brought over their places (k, 2) by two of their coordinates."""
        is_near = self._room(chains) > -_FAR
        targets = np.broadcast_to(places[:, np.newaxis, np.newaxis], (*chains.shape[:-1], 2))
        moves = np.zeros((3, chains.shape[-1]))
        moves[(1, 2), unknown] = _DIFFERENCE
        solved, chain, target = chains.copy(), chains[is_near], targets[is_near]
        left = np.arange(len(chain))
        for _ in range(_NEWTON):
            tips = self._tips(chain[left, np.newaxis] + moves)[..., :2]
            (a, c), (b, d) = np.moveaxis(tips[:, 1:] - tips[:, :1], 0, -1) / _DIFFERENCE
            x, y = (target[left] - tips[:, 0]).T
            size = a * d - b * c
            size = np.where(np.abs(size) < _SINGULAR, _SINGULAR, size)
            step = np.stack([d * x - b * y, a * y - c * x], axis=-1) / size[:, np.newaxis]
            chain[left[:, np.newaxis], unknown] += np.clip(step, -_LONGEST, _LONGEST)
            left = left[np.abs(step).max(axis=-1) > _SHORT]
        tip = self._tips(chain)
        solved[is_near], z = chain, np.full(is_near.shape, math.nan)
        z[is_near], is_admissible = tip[:, 2], is_near.copy()
        is_admissible[is_near] = np.linalg.norm(tip[:, :2] - target, axis=-1) < _REACHED
        low, high = np.moveaxis(
            height_range(self.carried.geometry, solved[..., :2], _LEVEL), -1, 0
        )
        settled = solved[is_admissible]
        postures = np.column_stack([settled[:, :2], high[is_admissible]])
        is_admissible[is_admissible] = self.carried.admits(postures, settled[:, 3:])
        ends = np.stack([z + low, z + high]) - self.height
        room = np.stack([high - low, self._room(solved)]) + _SLACK
        return _Samples(ends, room, is_admissible, z > self.joint[2])

    def _tips(self, chain: Array) -> Array:
        return self.carried.tip_position(chain[..., :3], chain[..., 3:])

    def _room(self, chain: Array) -> Array:
        """Room (...) of the joints, below zero beyond their limits [rad].

        Half a turn further the arm swings to the other side.
        """
        turn, swing = np.moveaxis(chain[..., 3:], -1, 0)
        turntable, arm = self.carried.arm.joints
        rooms = []
        for k in (0,) if self.is_locked else (-2, -1, 0, 1, 2):
            q, turned = (-1) ** k * swing, turn + k * math.pi
            room = np.minimum(q - arm.lower, arm.upper - q)
            if not self.is_locked:
                room = np.minimum(room, turned - turntable.lower)
                room = np.minimum(room, turntable.upper - turned)
            rooms.append(room)
        most: Array = np.max(rooms, axis=0)
        return most


class _Samples(NamedTuple):
    """Chains (k, m, 2) that are to bring the tip over places (k)."""

    ends: Array  # lowest and highest z of the tip (2, ...) [m]
    room: Array  # what is left of heights and of the joints' ranges (2, ...) [m, rad]
    is_admissible: NDArray[np.bool_]  # tip there, clear of base and ground, stable
    is_above: NDArray[np.bool_]  # the joint

    def along(self, first: NDArray[np.int_], second: NDArray[np.int_]) -> tuple[Any, ...]:
        """Lowest and highest z along edges (k, e), infinite for none, and whether above."""
        room, other = self.room[:, :, first], self.room[:, :, second]
        with np.errstate(divide="ignore", invalid="ignore"):
            passed = room / (room - other)
        begin = np.where(room >= 0.0, 0.0, np.where(other >= 0.0, passed, 2.0)).max(axis=0)
        end = np.where(other >= 0.0, 1.0, np.where(room >= 0.0, passed, -1.0)).min(axis=0)
        counts = self.is_admissible[:, first] & self.is_admissible[:, second] & (begin <= end)
        start, way = self.ends[:, :, first], self.ends[:, :, second] - self.ends[:, :, first]
        ends = np.stack([start + begin * way, start + end * way])
        low = np.where(counts, ends[:, 0].min(axis=0), math.inf)
        high = np.where(counts, ends[:, 1].max(axis=0), -math.inf)
        size = len(low), -1
        above = np.broadcast_to(self.is_above[:, first], low.shape)
        return np.maximum(low, 0.0).reshape(size), high.reshape(size), above.reshape(size)


def largest_swing(carried: CarriedArm) -> float:
    """Largest lean of the arm to either side [rad].

    Args:
        carried: platform, with a rod on a turntable.
    """
    arm = carried.arm.joints[1]
    return max(-arm.lower, arm.upper)
