"""Poses of a tree's bodies in many configurations at once: rows of NumPy's in place of a context.

Each joint is a chain of turns and slides along z, so that a pose is a product of constant
matrices and of these. Numbers that are the same in all rows stay plain, and zeros are left out:
only what differs costs a call of NumPy. All constants come from Drake's plant.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint

type Floats = NDArray[np.float64]
# A number of all rows, or one of each.
type Number = float | Floats
type Triple = tuple[Number, Number, Number]
type Matrix = tuple[Triple, Triple, Triple]

# Size of a number in a constant matrix that rounding leaves of zero or one.
_ROUNDING = 1e-15
_IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class RowPose:
    """Pose of a body in each row: its rotation matrix by rows, and its origin [m]."""

    turn: Matrix
    place: Triple

    def times(self, other: "RowPose") -> "RowPose":
        """This pose after another one."""
        return RowPose(product(self.turn, other.turn), self.point(other.place))

    def point(self, place: Triple) -> Triple:
        """A point of the body in the world."""
        return plus(turned(self.turn, place), self.place)


@dataclass(frozen=True)
class Axis:
    """Line about or along which a velocity moves what is behind it.

    Attributes:
        along: direction in the world.
        through: a point on it [m]; None for a slide.
    """

    along: Triple
    through: Triple | None

    def moves(self, point: Triple) -> Triple:
        """Velocity of a point behind it."""
        if self.through is None:
            return self.along
        return cross(self.along, minus(point, self.through))


@dataclass(frozen=True)
class Link:
    """One turn or slide about or along z, between constant poses.

    Attributes:
        before: its pose behind what is before it; its z is the axis.
        is_turn: true for a turn, false for a slide.
        position: place of its position among those of the plant; -1 for a weld.
        velocity: place of its velocity.
    """

    before: RowPose
    is_turn: bool
    position: int
    velocity: int


class Tree:
    """The tree of a plant.

    Attributes:
        links: turns and slides on the way to each body from its parent body, by the body's index.
        after: constant pose behind the last of these.
        parents: parent body of each body; -1 for the world.
        movers: velocities that move each body.
    """

    def __init__(self, plant: MultibodyPlant, joints: Sequence[Joint]):
        """Reads the constants.

        Args:
            plant: finalized.
            joints: all of its joints, welds included.

        Raises:
            NotImplementedError: a joint of a kind that has no rows.
        """
        self._plant = plant
        context = plant.CreateDefaultContext()
        count = plant.num_bodies()
        self.parents, self.movers = [-1] * count, [frozenset[int]()] * count
        self.chain: list[tuple[Link, ...]] = [()] * count
        self.after = [RowPose(_IDENTITY, (0.0, 0.0, 0.0))] * count
        self._floating: dict[int, int] = {}
        pending = list(joints)
        reached = {0}
        while pending:
            joint = next((j for j in pending if self._ends(j)[0] in reached), None)
            is_back = joint is None
            if joint is None:
                joint = next(j for j in pending if self._ends(j)[1] in reached)
            pending.remove(joint)
            self._add(joint, context, is_back)
            reached.add(self._ends(joint)[0 if is_back else 1])

    @staticmethod
    def _ends(joint: Joint) -> tuple[int, int]:
        return int(joint.parent_body().index()), int(joint.child_body().index())

    def _add(self, joint: Joint, context: Any, is_back: bool) -> None:
        parent, child = self._ends(joint)
        X_PF = joint.frame_on_parent().CalcPoseInBodyFrame(context)
        X_MB = joint.frame_on_child().CalcPoseInBodyFrame(context).inverse()
        first, rate, kind = joint.position_start(), joint.velocity_start(), joint.type_name()
        any_joint: Any = joint
        # Axes, turns and places of positions, from the parent on.
        steps: list[tuple[NDArray[np.float64], bool, int]] = []
        if kind == "revolute":
            steps = [(any_joint.revolute_axis(), True, 0)]
        elif kind == "prismatic":
            steps = [(any_joint.translation_axis(), False, 0)]
        elif kind == "universal":
            steps = [(np.eye(3)[0], True, 0), (np.eye(3)[1], True, 1)]
        elif kind == "ball_rpy":
            steps = [(np.eye(3)[k], True, k) for k in (2, 1, 0)]
        elif kind == "weld":
            X_PF = X_PF.multiply(any_joint.X_FM())
        elif kind == "quaternion_floating":
            self._floating[child] = first
        else:
            raise NotImplementedError(f"the {kind} joint {joint.name()} has no rows")
        if is_back:
            assert kind in ("revolute", "prismatic", "weld")
            steps = [(-axis, turns, place) for axis, turns, place in steps]
            X_PF, X_MB, parent, child = X_MB.inverse(), X_PF.inverse(), child, parent
        self.parents[child] = parent
        own = frozenset(range(rate, rate + joint.num_velocities()))
        self.movers[child] = self.movers[parent] | own
        links, rest = [], RigidTransform()
        for k, (axis, turns, place) in enumerate(steps):
            frame = _frame_along(np.asarray(axis, dtype=float))
            before = (X_PF if k == 0 else RigidTransform()).multiply(rest).multiply(frame)
            links.append(Link(constant_pose(before), turns, first + place, rate + place))
            rest = frame.inverse()
        self.chain[child] = tuple(links)
        end = rest.multiply(X_MB) if steps else X_PF.multiply(X_MB)
        self.after[child] = constant_pose(end)

    def advance(self, q: Floats, change: Floats) -> None:
        """Moves positions (q, rows), in place, by velocities (v, rows) that act for a second."""
        for links in self.chain:
            for link in links:
                q[link.position] += change[link.velocity]
        for body, first in self._floating.items():
            rate = min(self.movers[body])
            q[first + 4 : first + 7] += change[rate + 3 : rate + 6]
            w, x, y, z = q[first : first + 4]
            a, b, c = 0.5 * change[rate : rate + 3]
            turned_on = np.array(
                (
                    w - a * x - b * y - c * z,
                    x + a * w + b * z - c * y,
                    y + b * w + c * x - a * z,
                    z + c * w + a * y - b * x,
                )
            )
            q[first : first + 4] = turned_on / np.sqrt((turned_on**2).sum(axis=0))

    def rows(self, q: Floats) -> "RowsOfTree":
        """Poses in rows.

        Args:
            q: (q, rows) positions of the plant; each a contiguous row of numbers.
        """
        return RowsOfTree(self, q)


class RowsOfTree:
    """Poses of bodies and axes of joints, computed when they are asked for."""

    def __init__(self, tree: Tree, q: Floats):
        self._tree, self.q = tree, q
        world = RowPose(_IDENTITY, (0.0, 0.0, 0.0))
        self._poses: dict[int, RowPose] = {0: world}
        self._axes: dict[int, Axis] = {}
        self._points: dict[tuple[int, Triple], Triple] = {}

    def moved(self, velocities: frozenset[int]) -> None:
        """Forgets what some velocities move."""
        tree = self._tree
        for body in [b for b in self._poses if tree.movers[b] & velocities]:
            del self._poses[body]
        self._points.clear()

    def pose(self, body: int) -> RowPose:
        """Pose of a body in the world."""
        if body not in self._poses:
            self._poses[body] = self._pose(body)
        return self._poses[body]

    def point(self, body: int, place: Triple) -> Triple:
        """A point of a body in the world."""
        key = body, place
        if key not in self._points:
            self._points[key] = self.pose(body).point(place)
        return self._points[key]

    def axis(self, body: int, velocity: int) -> Axis:
        """Axis of a velocity that moves a body."""
        self.pose(body)
        return self._axes[velocity]

    def _pose(self, body: int) -> RowPose:
        tree, q = self._tree, self.q
        if body in tree._floating:
            first = tree._floating[body]
            turn = _of_quaternion(*q[first : first + 4])
            x, y, z = q[first + 4 : first + 7]
            place = (x, y, z)
            rate = min(tree.movers[body])
            for k, unit in enumerate(_IDENTITY):
                self._axes[rate + k] = Axis(unit, place)
                self._axes[rate + 3 + k] = Axis(unit, None)
            pose = RowPose(turn, place)
            return pose.times(tree.after[body])
        pose = self.pose(tree.parents[body])
        for link in tree.chain[body]:
            pose = pose.times(link.before)
            (a, b, z), (c, d, y), (e, f, x) = pose.turn
            along = (z, y, x)
            value = q[link.position]
            if link.is_turn:
                self._axes[link.velocity] = Axis(along, pose.place)
                cos, sin = np.cos(value), np.sin(value)
                pose = RowPose(
                    tuple(
                        (
                            add(mul(cos, one), mul(sin, two)),
                            subtract(mul(cos, two), mul(sin, one)),
                            three,
                        )
                        for one, two, three in ((a, b, z), (c, d, y), (e, f, x))
                    ),  # type: ignore[arg-type]
                    pose.place,
                )
            else:
                self._axes[link.velocity] = Axis(along, None)
                pose = RowPose(pose.turn, plus(pose.place, scaled(value, along)))
        return pose.times(tree.after[body])


def mul(a: Number, b: Number) -> Number:
    """Product of two numbers."""
    if a.__class__ is float:
        if a == 0.0:
            return 0.0
        if a == 1.0:
            return b
    if b.__class__ is float:
        if b == 0.0:
            return 0.0
        if b == 1.0:
            return a
    return a * b


def add(a: Number, b: Number) -> Number:
    """Sum of two numbers."""
    if a.__class__ is float and a == 0.0:
        return b
    if b.__class__ is float and b == 0.0:
        return a
    return a + b


def subtract(a: Number, b: Number) -> Number:
    """Difference of two numbers."""
    if b.__class__ is float and b == 0.0:
        return a
    return a - b


def dot(one: Triple, other: Triple) -> Number:
    """Scalar product."""
    return add(add(mul(one[0], other[0]), mul(one[1], other[1])), mul(one[2], other[2]))


def plus(one: Triple, other: Triple) -> Triple:
    """Sum of two vectors."""
    return add(one[0], other[0]), add(one[1], other[1]), add(one[2], other[2])


def minus(one: Triple, other: Triple) -> Triple:
    """Difference of two vectors."""
    return (
        subtract(one[0], other[0]),
        subtract(one[1], other[1]),
        subtract(one[2], other[2]),
    )


def scaled(factor: Number, vector: Triple) -> Triple:
    """Multiple of a vector."""
    return mul(factor, vector[0]), mul(factor, vector[1]), mul(factor, vector[2])


def cross(one: Triple, other: Triple) -> Triple:
    """Vector product."""
    (a, b, c), (x, y, z) = one, other
    return (
        subtract(mul(b, z), mul(c, y)),
        subtract(mul(c, x), mul(a, z)),
        subtract(mul(a, y), mul(b, x)),
    )


def turned(matrix: Matrix, vector: Triple) -> Triple:
    """A vector turned by a matrix."""
    return dot(matrix[0], vector), dot(matrix[1], vector), dot(matrix[2], vector)


def product(one: Matrix, other: Matrix) -> Matrix:
    """Product of two matrices."""
    columns: Any = transposed(other)
    return tuple(tuple(dot(row, column) for column in columns) for row in one)  # type: ignore[return-value]


def transposed(matrix: Matrix) -> Matrix:
    """A matrix with its rows as columns."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    return (a, d, g), (b, e, h), (c, f, i)


def _of_quaternion(w: Floats, x: Floats, y: Floats, z: Floats) -> Matrix:
    """Rotation matrix of a unit quaternion."""
    xx, yy, zz, xy, xz, yz = 2 * x * x, 2 * y * y, 2 * z * z, 2 * x * y, 2 * x * z, 2 * y * z
    wx, wy, wz = 2 * w * x, 2 * w * y, 2 * w * z
    return (
        (1.0 - yy - zz, xy - wz, xz + wy),
        (xy + wz, 1.0 - xx - zz, yz - wx),
        (xz - wy, yz + wx, 1.0 - xx - yy),
    )


def constant_pose(pose: RigidTransform) -> RowPose:
    """A pose that is the same in all rows; numbers next to zero and one are these."""

    def plain(number: float) -> float:
        nearest = float(round(number))
        return nearest if math.isclose(number, nearest, abs_tol=_ROUNDING) else float(number)

    rows: Any = pose.rotation().matrix().tolist()
    turn: Any = tuple(tuple(map(plain, row)) for row in rows)
    place: Any = tuple(map(float, pose.translation()))
    return RowPose(turn, place)


def _frame_along(axis: NDArray[np.float64]) -> RigidTransform:
    """Frame whose z is an axis."""
    if axis[2] > 1.0 - 1e-12:
        return RigidTransform()
    return RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2), np.zeros(3))
