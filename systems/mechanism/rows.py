"""Newton's method over rows: many poses of a mechanism at once.

Equations and positions are sorted so that they fall into blocks, each solved after those on which
it depends: with the platform of a hexapod at its target, every leg is a block of its own. Where
equations follow from others, and where freedoms are left over, the blocks are those of equations
and positions that are independent of each other at one pose; the other equations are checked.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from parapod.systems.mechanism.equations import (
    BallEquation,
    CouplingEquation,
    DistanceEquation,
    Equation,
    FrameTarget,
    WeldEquation,
)
from parapod.systems.mechanism.mobility import independent_rows
from parapod.systems.mechanism.pose_solver import Tolerance
from parapod.systems.mechanism.tree import (
    Number,
    RowPose,
    RowsOfTree,
    Tree,
    Triple,
    add,
    constant_pose,
    cross,
    dot,
    minus,
    mul,
    product,
    scaled,
    subtract,
    transposed,
    turned,
)

type Floats = NDArray[np.float64]

# Rows that are solved together: what a few hundred arrays of them take fits the caches.
_TOGETHER = 2048
_ITERATIONS = 25
_CLOSED = 1e-12
_LARGEST_STEP = 0.4
_NOTHING = 1e-8


class RowEquation:
    """Equations of one loop or target, over rows.

    Attributes:
        columns: velocities on which they depend.
        size: number of equations.
    """

    columns: frozenset[int]
    size: int

    def residuals(self, rows: RowsOfTree) -> Sequence[Number]:
        """Residuals [m, rad]."""
        raise NotImplementedError

    def rates(self, rows: RowsOfTree, column: int) -> Sequence[Number]:
        """Rates of the residuals by a velocity."""
        raise NotImplementedError


class _Between(RowEquation):
    """Place of a point of one body from a point of another, in the frame of that."""

    def __init__(self, tree: Tree, one: int, point: Any, other: int, other_point: Any):
        self._one, self._other = one, other
        self._point, self._other_point = _plain(point), _plain(other_point)
        self._of_one, self._of_other = tree.movers[one], tree.movers[other]
        self.columns, self.size = self._of_one ^ self._of_other, 3

    def residuals(self, rows: RowsOfTree) -> Sequence[Number]:
        """Place of the other's point beyond the one's."""
        one = rows.pose(self._one)
        gap = minus(rows.point(self._other, self._other_point), one.place)
        return minus(turned(transposed(one.turn), gap), self._point)

    def rates(self, rows: RowsOfTree, column: int) -> Sequence[Number]:
        """Rates of that."""
        one = rows.pose(self._one)
        if column in self._of_other:
            point = rows.point(self._other, self._other_point)
            moved = rows.axis(self._other, column).moves(point)
        else:
            point = rows.point(self._one, self._point)
            moved = _back(rows.axis(self._one, column).moves(point))
        return turned(transposed(one.turn), moved)


class _Rod(RowEquation):
    """Distance of two points beyond a length."""

    def __init__(self, tree: Tree, equation: DistanceEquation):
        loop = equation.loop
        self._between = _Between(
            *(tree, int(loop.body.index()), loop.point, int(loop.other.index()), loop.other_point)
        )
        self._distance = loop.distance
        self.columns, self.size = self._between.columns, 1

    def residuals(self, rows: RowsOfTree) -> Sequence[Number]:
        """Distance beyond the rod's length."""
        gap: Any = self._between.residuals(rows)
        return (np.sqrt(dot(gap, gap)) - self._distance,)

    def rates(self, rows: RowsOfTree, column: int) -> Sequence[Number]:
        """Rate of that."""
        gap: Any = self._between.residuals(rows)
        rates: Any = self._between.rates(rows, column)
        return (dot(gap, rates) / np.sqrt(dot(gap, gap)),)


class _Weld(RowEquation):
    """Rotation and place of a frame of one body in a frame of another."""

    def __init__(self, tree: Tree, equation: WeldEquation):
        loop = equation.loop
        self._one, self._other = int(loop.body.index()), int(loop.other.index())
        self._frame, self._far = constant_pose(loop.frame), constant_pose(loop.other_frame)
        self._of_one, self._of_other = tree.movers[self._one], tree.movers[self._other]
        self.columns, self.size = self._of_one ^ self._of_other, 6

    def residuals(self, rows: RowsOfTree) -> Sequence[Number]:
        """Rotation vector, while it is small, and place."""
        one = rows.pose(self._one).times(self._frame)
        other = rows.pose(self._other).times(self._far)
        back = transposed(one.turn)
        place = turned(back, minus(other.place, one.place))
        return (*_turn_vector(product(back, other.turn)), *place)

    def rates(self, rows: RowsOfTree, column: int) -> Sequence[Number]:
        """Rates of these."""
        one = rows.pose(self._one).times(self._frame)
        if column in self._of_other:
            axis = rows.axis(self._other, column)
            place = rows.pose(self._other).times(self._far).place
            turn, moved = _turning(axis), axis.moves(place)
        else:
            axis = rows.axis(self._one, column)
            turn, moved = _back(_turning(axis)), _back(axis.moves(one.place))
        back = transposed(one.turn)
        return (*turned(back, turn), *turned(back, moved))


class _Coupled(RowEquation):
    """Position of a joint beyond a multiple of another's."""

    def __init__(self, equation: CouplingEquation):
        loop = equation.loop
        self._places = loop.joint.position_start(), loop.leader.position_start()
        self._columns = loop.joint.velocity_start(), loop.leader.velocity_start()
        self._loop = loop
        self.columns, self.size = frozenset(self._columns), 1

    def residuals(self, rows: RowsOfTree) -> Sequence[Number]:
        """Position beyond the one that the leader demands."""
        own, leader = (rows.q[place] for place in self._places)
        return (own - self._loop.ratio * leader - self._loop.offset,)

    def rates(self, rows: RowsOfTree, column: int) -> Sequence[Number]:
        """Rate of that."""
        return (1.0 if column == self._columns[0] else -self._loop.ratio,)


class _Target(RowEquation):
    """Position and orientation of a frame beyond those of a target, which each row has its own.

    Attributes:
        goal: (6, rows) targets; set before each use.
        turn: orientations of the targets, where all three angles are set.
    """

    def __init__(self, tree: Tree, equation: FrameTarget):
        frame = equation.frame
        self._body = int(frame.body().index())
        self._frame = constant_pose(frame.GetFixedPoseInBodyFrame())
        is_set = np.isfinite(equation.goal)
        self._places = np.flatnonzero(is_set[:3]).tolist()
        self._angles = np.flatnonzero(is_set[3:]).tolist()
        self.columns = tree.movers[self._body]
        self.size = len(self._places) + len(self._angles)
        self.goal: Any = None
        self._back: Any = None
        self.aim(np.nan_to_num(equation.goal)[:, None])

    def aim(self, goal: Floats) -> None:
        """Takes targets (6, rows)."""
        self.goal = goal
        if len(self._angles) == 3:
            self._back = transposed(_of_angles(*goal[3:]))

    def pose(self, rows: RowsOfTree) -> RowPose:
        """Pose of the frame in the world."""
        return rows.pose(self._body).times(self._frame)

    def residuals(self, rows: RowsOfTree) -> Sequence[Number]:
        """Position and angles beyond the target."""
        pose = self.pose(rows)
        gaps = [pose.place[k] - self.goal[k] for k in self._places]
        if len(self._angles) == 3:
            return (*gaps, *_turn_vector(product(self._back, pose.turn)))
        angles = angles_of(pose.turn) if self._angles else ()
        return (*gaps, *(_wrapped(angles[k] - self.goal[3 + k]) for k in self._angles))

    def rates(self, rows: RowsOfTree, column: int) -> Sequence[Number]:
        """Rates of these."""
        pose = self.pose(rows)
        axis = rows.axis(self._body, column)
        moved, turn = axis.moves(pose.place), _turning(axis)
        moves = [moved[k] for k in self._places]
        if len(self._angles) == 3:
            return (*moves, *turned(self._back, turn))
        if not self._angles:
            return moves
        rates = _angle_rates(pose.turn, turn)
        return (*moves, *(rates[k] for k in self._angles))


def _plain(point: Any) -> Triple:
    x, y, z = np.asarray(point, dtype=float).tolist()
    return x, y, z


def _back(vector: Triple) -> Triple:
    return scaled(-1.0, vector)


def _turning(axis: Any) -> Triple:
    """Angular velocity of what is behind an axis."""
    return axis.along if axis.through is not None else (0.0, 0.0, 0.0)


def _turn_vector(turn: Any) -> Triple:
    """Rotation vector of a small rotation; of a large one, a vector of its direction."""
    (_, a, b), (c, _, d), (e, f, _) = turn
    return scaled(0.5, (subtract(f, d), subtract(b, e), subtract(c, a)))


def _of_angles(roll: Floats, pitch: Floats, yaw: Floats) -> Any:
    """Rotation matrix of roll, pitch and yaw."""
    (a, b), (c, d), (e, f) = ((np.cos(x), np.sin(x)) for x in (roll, pitch, yaw))
    return (
        (e * c, e * d * b - f * a, e * d * a + f * b),
        (f * c, f * d * b + e * a, f * d * a - e * b),
        (-d, c * b, c * a),
    )


def angles_of(turn: Any) -> tuple[Any, Any, Any]:
    """Roll, pitch and yaw of a rotation matrix."""
    (a, _, _), (d, _, _), (g, h, i) = turn
    return np.arctan2(h, i), np.arctan2(-1.0 * g, np.hypot(h, i)), np.arctan2(d, a)


def _angle_rates(turn: Any, velocity: Triple) -> Triple:
    """Rates of roll, pitch and yaw by an angular velocity."""
    (a, _, _), (d, _, _), (g, _, _) = turn
    cos = np.hypot(a, d)
    c, s = a / cos, d / cos
    x, y, z = velocity
    along = add(mul(c, x), mul(s, y))
    roll = along / cos
    return roll, subtract(mul(c, y), mul(s, x)), add(z, mul(-1.0 * g, roll))


def _wrapped(angle: Any) -> Any:
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def row_equation(tree: Tree, equation: Equation) -> RowEquation:
    """The equations of a loop or target over rows."""
    if isinstance(equation, BallEquation):
        loop = equation.loop
        return _Between(
            *(tree, int(loop.body.index()), loop.point, int(loop.other.index()), loop.other_point)
        )
    if isinstance(equation, WeldEquation):
        return _Weld(tree, equation)
    if isinstance(equation, DistanceEquation):
        return _Rod(tree, equation)
    if isinstance(equation, FrameTarget):
        return _Target(tree, equation)
    assert isinstance(equation, CouplingEquation)
    return _Coupled(equation)


@dataclass(frozen=True)
class Block:
    """Equations that are solved together for as many velocities.

    Attributes:
        equations: equation, and number within it, of each.
        columns: velocities.
    """

    equations: tuple[tuple[int, int], ...]
    columns: tuple[int, ...]


class RowSolver:
    """Poses of a mechanism, in rows, of targets of one kind.

    Attributes:
        equations: those of the loops and of the target.
        blocks: blocks in the order in which they are solved.
    """

    def __init__(
        self,
        tree: Tree,
        equations: Sequence[Equation],
        columns: Sequence[int],
        q: Floats,
        is_length: NDArray[np.bool_],
        size: float,
        tolerance: Tolerance,
    ):
        """Sorts equations and velocities into blocks.

        Args:
            tree: the tree.
            equations: equations of loops and target.
            columns: velocities that are free.
            q: (q) pose at which it is decided which equations are independent.
            is_length: true for velocities of lengths, not of angles.
            size: length by which lengths are compared with angles [m].
            tolerance: bounds by which equations are judged.
        """
        self._tree, self._tolerance = tree, tolerance
        self.equations = [row_equation(tree, equation) for equation in equations]
        self._scale = np.where(is_length, size, 1.0)
        self._closed_enough = tolerance.enough * max(size, 1.0)
        self.blocks = self._sort(list(columns), q, size, [e.is_angle for e in equations])

    @property
    def target(self) -> Any:
        """The target, which is the last of the equations."""
        return self.equations[-1]

    def _sort(
        self, columns: list[int], q: Floats, size: float, is_angle: Sequence[Sequence[bool]]
    ) -> list[Block]:
        rows = self._tree.rows(q[:, None].copy())
        numbers = [(i, k) for i, e in enumerate(self.equations) for k in range(e.size)]
        matrix = np.zeros((len(numbers), len(columns)))
        depends = np.zeros(matrix.shape, dtype=bool)
        first = 0
        for equation, angles in zip(self.equations, is_angle, strict=True):
            for j, column in enumerate(columns):
                if column in equation.columns:
                    for k, rate in enumerate(equation.rates(rows, column)):
                        scale = self._scale[column] / (1.0 if angles[k] else size)
                        matrix[first + k, j] = np.ravel(rate)[0] * scale
                        depends[first + k, j] = not (type(rate) is float and rate == 0.0)
            first += equation.size
        nothing = self._tolerance.nothing
        used = list(independent_rows(matrix, nothing))
        free = list(independent_rows(matrix[used].T, nothing))
        if not used:
            return []
        # Loaded where it is needed: that takes longer than to read a model.
        from scipy.sparse import csr_array  # type: ignore[import-untyped]
        from scipy.sparse.csgraph import (  # type: ignore[import-untyped]
            connected_components,
            maximum_bipartite_matching,
        )

        part = depends[np.ix_(used, free)]
        matched = maximum_bipartite_matching(csr_array(part), perm_type="column")
        # Equation i is solved for velocity matched[i]; blocks are what hangs together both ways.
        needs = part[:, matched]
        count, labels = connected_components(csr_array(needs), connection="strong")
        order = _ordered(count, labels, needs)
        return [
            Block(
                tuple(numbers[used[i]] for i in np.flatnonzero(labels == label)),
                tuple(columns[free[matched[i]]] for i in np.flatnonzero(labels == label)),
            )
            for label in order
        ]

    def solve(self, q: Floats, goal: Floats | None = None) -> tuple[Floats, NDArray[np.bool_]]:
        """Closes all loops in each row.

        Args:
            q: (rows, q) positions to begin with.
            goal: (rows, 6) targets.

        Returns:
            Positions (rows, q), and whether each row fulfils all equations (rows).
        """
        solved, is_closed = np.empty_like(q), np.empty(len(q), dtype=bool)
        for first in range(0, len(q), _TOGETHER):
            part = slice(first, first + _TOGETHER)
            columns = np.ascontiguousarray(q[part].T)
            if goal is not None:
                self.target.aim(np.ascontiguousarray(goal[part].T))
            rows = self._tree.rows(columns)
            with np.errstate(all="ignore"):
                for block in self.blocks:
                    self._solve_block(rows, block)
                is_closed[part] = self._missed(rows) < self._closed_enough
            solved[part] = rows.q.T
        return solved, is_closed

    def target_of(self, q: Floats) -> Floats:
        """Targets (rows, 6) at which the target's frame is in positions (rows, q)."""
        rows = self._tree.rows(np.ascontiguousarray(q.T))
        pose: Any = self.target.pose(rows)
        parts = (*pose.place, *angles_of(pose.turn))
        return np.stack([np.broadcast_to(part, len(q)) for part in parts], axis=-1)

    def _missed(self, rows: RowsOfTree) -> Floats:
        """Largest residual of each row."""
        most = np.zeros(rows.q.shape[1])
        for equation in self.equations:
            for residual in equation.residuals(rows):
                np.maximum(most, np.abs(residual), out=most)
        return np.where(np.isnan(most), np.inf, most)

    def _solve_block(self, rows: RowsOfTree, block: Block) -> None:
        columns, count = frozenset(block.columns), rows.q.shape[1]
        for _ in range(_ITERATIONS):
            residual, parts = [], {}
            for i, k in block.equations:
                if i not in parts:
                    parts[i] = self.equations[i].residuals(rows)
                residual.append(np.broadcast_to(parts[i][k], count))
            missed = max(float(np.nanmax(np.abs(each))) for each in residual)
            if missed <= _CLOSED or not np.isfinite(missed):
                return
            rates = {
                (i, column): self.equations[i].rates(rows, column)
                for i in parts
                for column in block.columns
                if column in self.equations[i].columns
            }
            matrix = [
                [rates[i, column][k] if (i, column) in rates else 0.0 for column in block.columns]
                for i, k in block.equations
            ]
            steps = _solved(matrix, residual)
            change = np.zeros((len(self._scale), count))
            most = np.ones(count)
            for column, step in zip(block.columns, steps, strict=True):
                change[column] = step
                np.maximum(most, np.abs(step) / (_LARGEST_STEP * self._scale[column]), out=most)
            change[list(block.columns)] /= -most
            self._tree.advance(rows.q, change)
            rows.moved(columns)


def _ordered(count: int, labels: NDArray[Any], needs: NDArray[np.bool_]) -> list[int]:
    """Blocks so that each comes after those on which it depends."""
    before: list[set[int]] = [set() for _ in range(count)]
    for i, j in np.argwhere(needs):
        if labels[i] != labels[j]:
            before[labels[i]].add(int(labels[j]))
    order: list[int] = []
    while len(order) < count:
        order += [
            label for label in range(count) if label not in order and before[label] <= {*order}
        ]
    return order


def _solved(matrix: list[list[Number]], right: Sequence[Floats]) -> Sequence[Number]:
    """Solution of equations in each row."""
    count = len(right)
    if count == 1:
        return (right[0] / matrix[0][0],)
    if count == 2:
        (a, b), (c, d) = matrix
        x, y = right
        whole = subtract(mul(a, d), mul(b, c))
        return (
            subtract(mul(d, x), mul(b, y)) / whole,
            subtract(mul(a, y), mul(c, x)) / whole,
        )
    if count == 3:
        one, two, three = (tuple(row[k] for row in matrix) for k in range(3))
        goal: Any = tuple(right)
        normal = cross(two, three)  # type: ignore[arg-type]
        whole = dot(one, normal)  # type: ignore[arg-type]
        return (
            dot(goal, normal) / whole,
            dot(one, cross(goal, three)) / whole,  # type: ignore[arg-type]
            dot(one, cross(two, goal)) / whole,  # type: ignore[arg-type]
        )
    rows = len(right[0])
    dense = np.empty((rows, count, count))
    for i, line in enumerate(matrix):
        for j, number in enumerate(line):
            dense[:, i, j] = number
    try:
        solution = np.linalg.solve(dense, np.stack(right, axis=-1)[..., None])
    except np.linalg.LinAlgError:
        inverse = np.linalg.pinv(dense, rcond=_NOTHING)
        solution = inverse @ np.stack(right, axis=-1)[..., None]
    return list(solution[..., 0].T)
