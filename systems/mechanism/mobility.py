"""Freedoms of a mechanism, and how near a pose is to a singular one.

Singular positions after C. Gosselin and J. Angeles, Singularity analysis of closed-loop kinematic
chains, IEEE Transactions on Robotics and Automation 6 (1990) 281-290, and D. Zlatanov, R. G.
Fenton and B. Benhabib, 1994, for loops that lose rank. Lengths are compared with angles by the
mechanism's size: all measures are pure numbers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.tree import JointIndex

from parapod.systems.mechanism.pose_solver import EXACT, ROUNDED, PoseSolver

type Floats = NDArray[np.float64]

# Poses near home at which ranks are taken: at a singular one they are smaller. Size of the steps
# that lead there [rad, lengths].
_POSES, _STEP = 3, 0.05
# Share by which rounding may make one of two equal lengths the longer one [-].
_SAME = 1e-6


@dataclass(frozen=True)
class Mobility:
    """Freedoms of a mechanism.

    Attributes:
        equations: number of equations of all loops.
        rank: number of those that are independent of each other, in almost every pose.
        freedoms: degrees of freedom.
        redundant: number of equations of each loop that follow from those of all other loops, by
            the loop's name; loops without any are left out.
        governed: number of freedoms that the motors govern.
        idle: joints that can move while all motors stand still.
        home_is_singular: true if loops have fewer independent equations at home.
    """

    equations: int
    rank: int
    freedoms: int
    redundant: Mapping[str, int]
    governed: int
    idle: tuple[JointIndex, ...]
    home_is_singular: bool


@dataclass(frozen=True)
class Dexterity:
    """Distance of a pose from singular ones; 0 is singular, 1 as far as can be.

    Attributes:
        loops: smallest by largest singular value of the loops' Jacobian; 0 where freedoms split.
        held: the same of its part for joints without motors; 0 where the mechanism can move while
            its motors stand still (type 2, parallel).
        moved: smallest by largest singular value of a frame's Jacobian, of as many as it has
            freedoms at home; 0 where the frame loses one whatever the motors do (type 1, serial).
            NaN without a frame.
    """

    loops: float
    held: float
    moved: float


def mobility(solver: PoseSolver, home: Floats, motor_columns: Sequence[int]) -> Mobility:
    """Freedoms of a mechanism, as almost every pose has them.

    Args:
        solver: solver of its poses.
        home: (q) a pose with all loops closed.
        motor_columns: velocities of its motors.
    """
    poses = [home, *poses_near(solver, home)]
    matrices = [scaled_jacobian(solver, q) for q in poses]
    nothing = solver.tolerance.nothing
    ranks = [_rank(matrix, nothing) for matrix in matrices]
    matrix = matrices[int(np.argmax(ranks))]
    rank, count = max(ranks), matrix.shape[1]
    redundant, first = {}, 0
    for equation in solver.loops:
        others = np.delete(matrix, slice(first, first + equation.size), axis=0)
        if surplus := equation.size - (rank - _rank(others, nothing)):
            redundant[equation.name] = surplus
        first += equation.size
    held = np.vstack((matrix, np.eye(count)[list(motor_columns)]))
    can_move = np.abs(null_space(held, nothing)).max(axis=1, initial=0.0) > np.sqrt(nothing)
    idle = [
        joint.index()
        for joint in solver.joints
        if can_move[joint.velocity_start() : joint.velocity_start() + joint.num_velocities()].any()
    ]
    governed = _rank(held, nothing) - rank
    return Mobility(
        len(matrix), rank, count - rank, redundant, governed, tuple(idle), ranks[0] < rank
    )


def dexterity(
    solver: PoseSolver,
    of: Mobility,
    q: Floats,
    motor_columns: Sequence[int],
    moves: Floats | None = None,
    rank: int = 0,
) -> Dexterity:
    """Distance of a pose from singular ones.

    Args:
        solver: solver of its poses.
        of: its freedoms.
        q: (q) positions, all loops closed.
        motor_columns: velocities of its motors.
        moves: (6, motors) angular and linear velocity of a frame by those of the motors; None:
            no frame's motion counts.
        rank: freedoms that the frame has at home.
    """
    matrix = scaled_jacobian(solver, q)
    free = np.delete(matrix, list(motor_columns), axis=1)
    held = _ratio(free, min(of.rank, free.shape[1]))
    moved = np.nan
    if moves is not None:
        scale = np.repeat((1.0, 1.0 / solver.size), 3)[:, None]
        motors = np.where(solver.is_length[list(motor_columns)], solver.size, 1.0)
        moved = _ratio(scale * moves * motors, rank)
    return Dexterity(_ratio(matrix, of.rank), held, moved)


def scaled_jacobian(solver: PoseSolver, q: Floats) -> Floats:
    """Jacobian of the loops (equations, v) with lengths by the mechanism's size."""
    solver.plant.SetPositions(solver.context, q)
    matrix = solver.jacobian(solver.loops)
    is_angle = [angle for equation in solver.loops for angle in equation.is_angle]
    rows = np.where(is_angle, 1.0, 1.0 / solver.size)
    columns = np.where(solver.is_length, solver.size, 1.0)
    return np.asarray(rows[:, None] * matrix * columns)


def is_rounded(solver: PoseSolver, q: Floats) -> bool:
    """Whether some equations follow from others but for the rounding of a file's numbers."""
    values = np.linalg.svd(scaled_jacobian(solver, q), compute_uv=False)
    least, most = (limit.nothing * values.max(initial=0.0) for limit in (EXACT, ROUNDED))
    return bool(((values > least) & (values < most)).any())


def null_space(matrix: Floats, nothing: float = EXACT.nothing) -> Floats:
    """Directions (n, k), orthonormal, that a matrix (m, n) takes to nothing.

    Args:
        matrix: the matrix.
        nothing: share of its largest singular value below which one is none.
    """
    if not len(matrix):
        return np.eye(matrix.shape[1])
    _, values, right = np.linalg.svd(matrix)
    rank = int((values > nothing * values.max(initial=0.0)).sum())
    return np.asarray(right[rank:].T)


def independent_rows(
    matrix: Floats, nothing: float = EXACT.nothing, enough: float = 1.0 - _SAME
) -> tuple[int, ...]:
    """Independent rows of a matrix, each the first of the longest beside those before it.

    Args:
        matrix: the matrix.
        nothing: length of a row that counts as zero [-].
        enough: share of the longest one's length that is long enough [-].
    """
    rest, rows = np.array(matrix), list[int]()
    for _ in range(_rank(matrix, nothing)):
        lengths = np.linalg.norm(rest, axis=1)
        # The first of those that are long enough, whatever the last bits are.
        row = int(np.argmax(lengths > enough * lengths.max()))
        along = rest[row] / lengths[row]
        rest = rest - np.outer(rest @ along, along)
        rows.append(row)
    return tuple(sorted(rows))


def poses_near(solver: PoseSolver, home: Floats) -> list[Floats]:
    """Closed poses near home, in directions that loops let it go."""
    generator = np.random.default_rng(0)
    free = null_space(scaled_jacobian(solver, home), solver.tolerance.nothing)
    scale = np.where(solver.is_length, solver.size, 1.0)
    poses = []
    for _ in range(_POSES):
        way = scale * (free @ generator.normal(size=free.shape[1]))
        poses.append(solver.newton(solver.loops, solver.moved(home, _STEP * way)))
    return poses


def _rank(matrix: Floats, nothing: float) -> int:
    if not matrix.size:
        return 0
    values = np.linalg.svd(matrix, compute_uv=False)
    return int((values > nothing * values.max()).sum())


def _ratio(matrix: Floats, rank: int) -> float:
    """The singular value of a rank by the largest one; 0 where the matrix has less rank."""
    if not matrix.size or not rank:
        return 1.0
    values = np.linalg.svd(matrix, compute_uv=False)
    return float(values[rank - 1] / values[0]) if rank <= len(values) else 0.0
