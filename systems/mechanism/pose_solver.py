"""Newton's method for one pose of a mechanism: the smallest step that fulfils its equations.

Where that does not converge, or ends beyond a joint's limits, SNOPT solves a program with Drake's
own constraints of the plant, and Newton's method refines what it finds.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.inverse_kinematics import (
    AddMultibodyPlantConstraints,
    OrientationConstraint,
    PositionConstraint,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.solvers import MathematicalProgram, SnoptSolver

from parapod.systems.mechanism.equations import Equation, FrameTarget, Gap, UnsolvedPose, gap_of

type Floats = NDArray[np.float64]

# Residual at which an equation is fulfilled, at best [m, rad by the mechanism's size].
_CLOSED = 1e-13
# Most steps of Newton's method, and the largest one [rad, lengths of the mechanism].
_STEPS, _LARGEST_STEP = 80, 0.4
# Violation of a joint's limit that is rounding [rad, m].
ROUNDING = 1e-9
# Random poses from which loops are tried to be closed, and how far the last ones are [rad, sizes].
_TRIES, _SPREAD = 40, 2.0
_ROTATING = ("ball_rpy", "quaternion_floating", "rpy_floating")


@dataclass(frozen=True)
class Tolerance:
    """Bounds by which equations of a mechanism are judged.

    Attributes:
        nothing: share of the largest singular value below which one is none [-].
        enough: residual at which an equation is fulfilled, where rounding or a singular position
            leave no less [rad, lengths of the mechanism].
    """

    nothing: float
    enough: float


# Numbers that fit, and those of a file that has rounded them: loops of which some follow from
# others then contradict each other a little.
EXACT, ROUNDED = Tolerance(1e-8, 1e-9), Tolerance(1e-5, 1e-6)


@dataclass(frozen=True)
class Pose:
    """Positions of all joints, and how well they do.

    Attributes:
        q: (q) positions of the plant [m, rad, quaternions].
        gaps: loops and targets that are missed, the worst one first; empty where all is closed.
        beyond: joints beyond their limits, by index, with how far [m, rad].
    """

    q: Floats
    gaps: tuple[Gap, ...]
    beyond: Mapping[int, float]

    @property
    def is_closed(self) -> bool:
        """Whether all loops are closed and all targets met."""
        return not self.gaps


class PoseSolver:
    """Solver of equations between the positions of a plant.

    Attributes:
        plant: the plant.
        context: scratch memory: nothing in it outlives a call.
        joints: joints of the plant that move.
        is_length: true for velocities of the plant that are those of lengths [m/s], not of angles.
        size: length by which lengths and angles are compared [m].
        loops: equations of its loops.
        tolerance: bounds by which they are judged.
    """

    def __init__(self, plant: MultibodyPlant, loops: Sequence[Equation]):
        """Takes a plant.

        Args:
            plant: finalized.
            loops: equations of its loops.
        """
        self.loops, self.tolerance = tuple(loops), EXACT
        self.plant, self.context = plant, plant.CreateDefaultContext()
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        self.joints = tuple(joint for joint in joints if joint.num_velocities())
        self._lower = plant.GetPositionLowerLimits()
        self._upper = plant.GetPositionUpperLimits()
        kinds = [joint.type_name() for joint in self.joints]
        self._has_plain_rates = not any(kind in _ROTATING for kind in kinds)
        self._quaternions = [
            joint.position_start()
            for joint in self.joints
            if joint.type_name() == "quaternion_floating"
        ]
        self.is_length = np.zeros(plant.num_velocities(), dtype=bool)
        for joint, kind in zip(self.joints, kinds, strict=True):
            first = joint.velocity_start()
            if kind == "prismatic":
                self.is_length[first] = True
            elif kind in ("quaternion_floating", "rpy_floating"):
                self.is_length[first + 3 : first + 6] = True
            elif kind == "planar":
                self.is_length[first : first + 2] = True
        self.size = self._size()
        self._largest_step = np.where(self.is_length, _LARGEST_STEP * self.size, _LARGEST_STEP)

    def _size(self) -> float:
        """Largest distance of two bodies in the file's pose."""
        poses: Any = self.plant.get_body_poses_output_port().Eval(self.context)
        places = np.array([pose.translation() for pose in poses[1:]] or [np.zeros(3)])
        spread = float(np.linalg.norm(places.max(axis=0) - places.min(axis=0)))
        return spread or 1.0

    def residual(self, equations: Sequence[Equation]) -> Floats:
        """Residuals of equations in the scratch memory's pose [m, rad]."""
        parts = [equation.residual(self.plant, self.context) for equation in equations]
        return np.concatenate(parts) if parts else np.zeros(0)

    def jacobian(self, equations: Sequence[Equation]) -> Floats:
        """Rates of these by velocities (equations, v)."""
        parts = [equation.jacobian(self.plant, self.context) for equation in equations]
        return np.vstack(parts) if parts else np.zeros((0, self.plant.num_velocities()))

    def moved(self, q: Floats, change: Floats) -> Floats:
        """Positions after velocities have acted for a unit of time.

        Raises:
            UnsolvedPose: a ball joint is turned so far that Drake's numbers for it end.
        """
        if self._has_plain_rates:
            return q + change
        self.plant.SetPositions(self.context, q)
        try:
            rates = np.asarray(self.plant.MapVelocityToQDot(self.context, change))
        except RuntimeError as error:  # a pitch of 90 deg
            reason, *_ = str(error).partition(". ")
            raise UnsolvedPose(f"a ball joint cannot turn so far: {reason}") from None
        moved = q + rates
        for first in self._quaternions:
            moved[first : first + 4] /= np.linalg.norm(moved[first : first + 4])
        return moved

    def way(self, start: Floats, end: Floats) -> Floats:
        """Velocities that lead from one pose to another within a unit of time, about."""
        if self._has_plain_rates:
            return end - start
        self.plant.SetPositions(self.context, start)
        return np.asarray(self.plant.MapQDotToVelocity(self.context, end - start))

    def newton(
        self, equations: Sequence[Equation], start: Floats, columns: NDArray[np.intp] | None = None
    ) -> Floats:
        """Positions that fulfil equations, or those that miss them least."""
        q, context = start, self.context
        self.plant.SetPositions(context, q)
        residual = self.residual(equations)
        missed = float(np.abs(residual).max(initial=0.0))
        closed = _CLOSED * max(self.size, 1.0)
        with suppress(UnsolvedPose):  # where Drake's numbers for an attitude end
            for _ in range(_STEPS):
                if missed <= closed:
                    break
                matrix = self.jacobian(equations)
                part = matrix if columns is None else matrix[:, columns]
                step = np.linalg.lstsq(part, -residual, rcond=self.tolerance.nothing)[0]
                change = np.zeros(matrix.shape[1])
                change[slice(None) if columns is None else columns] = step
                change /= max(1.0, float((np.abs(change) / self._largest_step).max()))
                for share in (1.0, 0.5, 0.25, 0.125, 0.0625):
                    ahead = self.moved(q, share * change)
                    if not np.isfinite(ahead).all():
                        continue
                    self.plant.SetPositions(context, ahead)
                    residual_ahead = self.residual(equations)
                    missed_ahead = float(np.abs(residual_ahead).max())
                    if missed_ahead < missed:
                        break
                else:
                    break
                q, residual = ahead, residual_ahead
                missed = missed_ahead
        self.plant.SetPositions(context, q)
        return q

    def scattered(
        self, equations: Sequence[Equation], start: Floats, columns: NDArray[np.intp]
    ) -> list[Pose]:
        """Poses that fulfil equations, solved from random ones about a start.

        First those within limits, then the others, each the nearest to the start first. A file
        whose joints are all at zero often has its links stretched out, and Newton's method cannot
        leave that.
        """
        random, poses = np.random.default_rng(0), []
        scale = np.where(self.is_length, self.size, 1.0)
        for i in range(_TRIES):
            change = np.zeros(len(scale))
            spread = _SPREAD * (i + 1) / _TRIES
            change[columns] = (spread * scale * random.uniform(-1.0, 1.0, len(scale)))[columns]
            begin = self.moved(start, change)
            if self._has_plain_rates:
                begin = np.clip(begin, self._lower, self._upper)
            pose = self.judge(equations, self.newton(equations, begin, columns))
            if pose.is_closed:
                way = float(np.linalg.norm(self.way(start, pose.q) / scale))
                poses.append((bool(pose.beyond), way, i, pose))
        return [pose for *_, pose in sorted(poses, key=lambda each: each[:3])]

    def least(
        self, equations: Sequence[Equation], start: Floats, columns: NDArray[np.intp]
    ) -> Floats:
        """Positions that miss equations by the least sum of squares, where none fulfil them."""
        # Loaded where it is needed: that takes longer than to read a model.
        from scipy.optimize import least_squares  # type: ignore[import-untyped]

        scale = np.where(self.is_length, self.size, 1.0)[columns]

        def moved(step: Floats) -> Floats:
            change = np.zeros(self.plant.num_velocities())
            change[columns] = scale * step
            return self.moved(start, change)

        def missed(step: Floats) -> Floats:
            self.plant.SetPositions(self.context, moved(step))
            return self.residual(equations)

        least = least_squares(missed, np.zeros(len(columns)), max_nfev=_STEPS)
        return moved(least.x)

    def by_program(
        self, targets: Sequence[FrameTarget], start: Floats, columns: NDArray[np.intp]
    ) -> Floats:
        """Positions within limits that are nearest to a start, by SNOPT, then by Newton."""
        plant, program = self.plant, MathematicalProgram()
        context = plant.CreateDefaultContext()
        q: Any = program.NewContinuousVariables(plant.num_positions())
        try:
            AddMultibodyPlantConstraints(plant, q, program, context)
        except RuntimeError:  # constraints of kinds that Drake has no program for
            return start
        free = set(columns.tolist())
        for joint in self.joints:
            if joint.velocity_start() not in free and joint.num_positions() == 1:
                place = joint.position_start()
                program.AddBoundingBoxConstraint(start[place], start[place], q[place])
        for target in targets:
            self._add_target(program, q, context, target)
        program.AddQuadraticErrorCost(np.eye(len(start)), start, q)
        result = SnoptSolver().Solve(program, start, None)
        near = np.asarray(result.GetSolution(q), dtype=float)
        for first in self._quaternions:
            near[first : first + 4] /= np.linalg.norm(near[first : first + 4])
        solved = self.newton((*self.loops, *targets), near, columns)
        # Limits on which the program's result lies stay where the polish moves them by rounding.
        return solved

    def _add_target(
        self, program: MathematicalProgram, q: Any, context: Any, target: FrameTarget
    ) -> None:
        """Adds a frame's target to a program; angles only where all three are."""
        plant, goal = self.plant, target.goal
        world, is_set = plant.world_frame(), np.isfinite(goal)
        low = np.where(is_set[:3], goal[:3], -np.inf)
        high = np.where(is_set[:3], goal[:3], np.inf)
        if is_set[:3].any():
            position = PositionConstraint(
                plant, world, low, high, target.frame, np.zeros(3), context
            )
            program.AddConstraint(position, q)
        if is_set[3:].all():
            turn = target.goal_rotation
            orientation = OrientationConstraint(
                *(plant, world, turn, target.frame, type(turn)(), 0.0, context)
            )
            program.AddConstraint(orientation, q)

    def beyond_limits(self, q: Floats) -> dict[int, float]:
        """Joints beyond their limits, by index, with how far [m, rad]."""
        excess = np.maximum(self._lower - q, q - self._upper)
        far: dict[int, float] = {}
        for joint in self.joints:
            first, count = joint.position_start(), joint.num_positions()
            most = float(excess[first : first + count].max())
            if most > ROUNDING:
                far[int(joint.index())] = most
        return far

    def is_within_limits(self, q: Floats) -> NDArray[np.bool_]:
        """Whether no joint is beyond its limits, in positions (..., q)."""
        excess = np.maximum(self._lower - q, q - self._upper)
        return np.asarray((excess <= ROUNDING).all(axis=-1))

    def gaps(self, equations: Sequence[Equation]) -> tuple[Gap, ...]:
        """Gaps of equations in the scratch memory's pose."""
        return tuple(
            gap_of(equation, equation.residual(self.plant, self.context)) for equation in equations
        )

    def judge(self, equations: Sequence[Equation], q: Floats) -> Pose:
        """Positions, with the equations that they miss and the limits that they exceed."""
        self.plant.SetPositions(self.context, q)
        enough = self.tolerance.enough * max(self.size, 1.0)
        open_gaps = [gap for gap in self.gaps(equations) if max(gap.length, gap.angle) > enough]
        open_gaps.sort(key=lambda gap: -max(gap.length / self.size, gap.angle))
        return Pose(q, tuple(open_gaps), self.beyond_limits(q))
