"""A mechanism with closed loops, posed numerically: freedoms, poses, and motion of its motors.

Drake's plant has the kinematics of the tree that is left where loops are cut; loops are equations
between its positions.
"""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable, Joint, JointIndex

from parapod.systems.core.errors import ScenarioError
from parapod.systems.mechanism.equations import (
    Equation,
    FrameTarget,
    Gap,
    UnsolvedPose,
    equations_of,
    pose_vector,
)
from parapod.systems.mechanism.mobility import (
    Dexterity,
    Mobility,
    dexterity,
    independent_rows,
    is_rounded,
    mobility,
    null_space,
    poses_near,
    scaled_jacobian,
)
from parapod.systems.mechanism.model import add_model
from parapod.systems.mechanism.parts import Model, frames_by_name, joints_by_name, named
from parapod.systems.mechanism.pose_solver import ROUNDED, ROUNDING, Pose, PoseSolver
from parapod.systems.mechanism.rows import RowSolver
from parapod.systems.mechanism.tree import Tree
from parapod.systems.physics.description import joints_of
from parapod.systems.physics.loops import Loop, find_constraints

type Floats = NDArray[np.float64]

_V = JacobianWrtVariable.kV
# Step of the plant, which is never simulated [s]: Drake couples joints only where there is one.
_STEP = 1e-3
# Longest way of motors and targets that is made in one step [rad, lengths], and the shortest.
_LONGEST_WAY, _SHORTEST_WAY = 0.2, 1e-5
# Way that no mechanism goes [rad, lengths].
_FARTHEST = 1e3
# Gaps that rounding of a file may leave [rad, lengths].
_ROUNDED_GAP = 1e-5
# Motion of a part of a pose, by that of all joints, below which it stands [-].
_IDLE = 1e-7
# Share of the motion of the part that moves most with which an earlier part is chosen [-].
_FAVOURED = 0.3
# Most steps of a way over rows.
_MOST_STEPS = 40


class Mechanism:
    """A mechanism with closed loops.

    Attributes:
        plant: the tree that is left where its loops are cut, finalized.
        loops: constraints that close it.
        motors: its joints with motors, in the order in which their positions are given.
        joints: its joints that move.
        notes: parts of its file that are read in another way than they are written, or not.
        size: length by which lengths and angles are compared [m].
        equations: equations of the loops.
        is_length: true for velocities of the plant that are those of lengths [m/s], not of angles.
        motor_columns: places of the motors' velocities among those of the plant.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        motors: Sequence[JointIndex] | None = None,
        loops: Sequence[Loop] | None = None,
        notes: Sequence[str] = (),
    ):
        """Takes a plant.

        Args:
            plant: finalized.
            motors: joints with motors; None: those that have actuators in the plant.
            loops: constraints that close it; None: all of the plant.
            notes: notes of its file.

        Raises:
            WiringError: a weld of the plant that cannot be read back from it.
        """
        self.plant = plant
        self.loops = tuple(find_constraints(plant).loops if loops is None else loops)
        if motors is None:
            actuators = map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
            motors = [actuator.joint().index() for actuator in actuators]
        self.motors: tuple[Joint, ...] = tuple(plant.get_joint(index) for index in motors)
        self.notes = tuple(notes)
        self.equations = equations_of(self.loops)
        self._solver = PoseSolver(plant, self.equations)
        self._context = self._solver.context
        self.joints, self.size = self._solver.joints, self._solver.size
        self.is_length = self._solver.is_length
        self.motor_columns = [joint.velocity_start() for joint in self.motors]
        self._motor_places = [joint.position_start() for joint in self.motors]
        self._joints, self._frames = joints_by_name(plant), frames_by_name(plant)
        self._names = {int(joint.index()): name for name, joint in self._joints.items()}
        self._parts: dict[str, tuple[int, ...]] = {}
        self._of_rows: dict[tuple[str, bytes], RowSolver] = {}

    @classmethod
    def load(
        cls,
        path: str | Path,
        loops_file: str | Path | None = None,
        motors: Sequence[str] = (),
        is_free: bool | None = None,
        least_mass: float = 0.0,
    ) -> "Mechanism":
        """The mechanism of a model file.

        Args:
            path: URDF, SDFormat, MJCF, or model directives (.dmd.yaml).
            loops_file: file of its loops and motors, see `LoopsFile`; None: the one beside it, see
                `add_model`.
            motors: joints with motors, in place of those of the files; * and ? stand for any
                characters.
            is_free: false welds the base to the world, true does not; None: as an MJCF says, and
                false for other files.
            least_mass: mass of links that are lighter, but not massless [kg].

        Raises:
            ScenarioError: a file that cannot be read, or names what the model does not have.
        """
        plant = MultibodyPlant(_STEP)
        loops = None if loops_file is None else Path(loops_file)
        model = add_model(plant, Path(path), loops, motors, is_free, least_mass=least_mass)
        plant.Finalize()
        return cls.of_model(model)

    @classmethod
    def of_model(cls, model: Model) -> "Mechanism":
        """The mechanism of a model in a plant that is finalized."""
        constraints = find_constraints(model.plant, model.loops)
        notes = list(model.notes)
        if constraints.others:
            notes.append(f"not read: {constraints.others} constraints that close no loop")
        return cls(model.plant, model.motors, constraints.loops, notes)

    def __repr__(self) -> str:
        return (
            f"<mechanism: {len(self.joints)} joints, {len(self.loops)} loops, "
            f"{len(self.motors)} motors>"
        )

    def frame(self, name: str) -> Frame:
        """Frame, or frame of the link, of a name.

        Raises:
            ScenarioError: there is none of the name.
        """
        return named(name, self._frames, "frame", "the mechanism")

    def joint(self, name: str) -> Joint:
        """Joint of a name.

        Raises:
            ScenarioError: there is none of the name.
        """
        return named(name, self._joints, "joint", "the mechanism")

    def name(self, joint: Joint) -> str:
        """Name of a joint, with its model instance where another one has the same."""
        return self._names[int(joint.index())]

    @property
    def passive(self) -> tuple[Joint, ...]:
        """Joints without motors."""
        indices = {int(joint.index()) for joint in self.motors}
        return tuple(joint for joint in self.joints if int(joint.index()) not in indices)

    @cached_property
    def mobility(self) -> Mobility:
        """Freedoms of the mechanism.

        Raises:
            UnsolvedPose: its loops cannot be closed.
        """
        return mobility(self._solver, self.home, self.motor_columns)

    def check_motors(self) -> None:
        """Refuses motors that do not fit.

        Raises:
            ScenarioError: no motor, more than freedoms, or motors that work against each other.
            UnsolvedPose: its loops cannot be closed.
        """
        of, names = self.mobility, ", ".join(map(self.name, self.motors))
        if not names:
            single = [self.name(joint) for joint in self.joints if joint.num_velocities() == 1]
            raise ScenarioError(
                f"no joint has a motor: {of.freedoms} are needed, of {', '.join(single)}"
                if of.freedoms
                else "the mechanism has no freedom that a motor could move"
            )
        count = len(self.motors)
        if count > of.freedoms:
            raise ScenarioError(
                f"{count} motors are too many for {of.freedoms} freedoms; name {of.freedoms} of "
                f"{names}"
            )
        if of.governed < count:
            raise ScenarioError(
                f"{count} motors govern {of.governed} freedoms: {names} are coupled by loops"
            )

    def dexterity(self, q: ArrayLike, frame: str = "") -> Dexterity:
        """Distance of a pose from singular ones.

        Args:
            q: (q) positions, all loops closed.
            frame: name of the frame whose motion counts; "": none.
        """
        moves = self.frame_jacobian(frame, q) if frame else None
        rank = len(self.free_parts(frame)) if frame else 0
        positions = np.asarray(q, dtype=float)
        return dexterity(self._solver, self.mobility, positions, self.motor_columns, moves, rank)

    @cached_property
    def home(self) -> Floats:
        """Positions (q) nearest to those of the file with which all loops are closed.

        Raises:
            UnsolvedPose: loops that cannot be closed; names the one that stays open the most.
        """
        pose = self.solve()
        most = max((max(gap.length / self.size, gap.angle) for gap in pose.gaps), default=0.0)
        if is_rounded(self._solver, pose.q) or 0.0 < most < _ROUNDED_GAP:
            # Some loops follow from others, but for the rounding of the file's numbers.
            self._solver.tolerance = ROUNDED
            pose = self.solve()
        return _insist(pose, "the loops cannot be closed")

    @property
    def is_rounded(self) -> bool:
        """Whether numbers of the file are rounded so that loops contradict each other a little."""
        return self._solver.tolerance is ROUNDED

    @property
    def nothing(self) -> float:
        """Share of the largest singular value below which one is none [-]."""
        return self._solver.tolerance.nothing

    def positions(self, joints: Mapping[str, float], near: ArrayLike | None = None) -> Floats:
        """Positions (q) with those of some joints replaced; loops are not closed."""
        start = self.plant.GetPositions(self.plant.CreateDefaultContext())
        q = np.array(start if near is None else near, dtype=float)
        for name, value in joints.items():
            q[self._single(name).position_start()] = value
        return q

    def motor_positions(self, q: ArrayLike) -> Floats:
        """Positions of the motors' joints (..., motors) [m, rad] in positions (..., q)."""
        return np.asarray(q, dtype=float)[..., self._motor_places]

    def pose(self, frame: str, q: ArrayLike) -> RigidTransform:
        """Pose of a frame in the world."""
        self._at(q)
        return self.frame(frame).CalcPoseInWorld(self._context)

    def residual(self, q: ArrayLike) -> Floats:
        """Residuals of all loops [m, rad]."""
        self._at(q)
        return self._solver.residual(self.equations)

    def gaps(self, q: ArrayLike) -> tuple[Gap, ...]:
        """Gaps of all loops."""
        self._at(q)
        return self._solver.gaps(self.equations)

    def beyond_limits(self, q: ArrayLike) -> dict[str, float]:
        """Joints beyond their limits, by name, with how far [m, rad]."""
        beyond = self._solver.beyond_limits(np.asarray(q, dtype=float))
        return {self._names[index]: far for index, far in beyond.items()}

    def is_within_limits(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Whether no joint is beyond its limits, in positions (..., q)."""
        return self._solver.is_within_limits(np.asarray(q, dtype=float))

    def moved(self, q: ArrayLike, change: ArrayLike) -> Floats:
        """Positions (q) after velocities (v) have acted for a unit of time; loops may open."""
        return self._solver.moved(np.asarray(q, dtype=float), np.asarray(change, dtype=float))

    def closed(self, q: ArrayLike) -> Floats | None:
        """Positions (q) with all loops closed by the smallest step; None if Newton fails."""
        solved = self._solver.newton(self.equations, np.asarray(q, dtype=float))
        return solved if self._solver.judge(self.equations, solved).is_closed else None

    def free_parts(self, frame: str) -> tuple[int, ...]:
        """Parts of a frame's pose that the motors can set, each for itself, at home.

        Returns:
            As many places in x, y, z, roll, pitch, yaw as the frame has freedoms; where there is
            a choice, the first ones that move well. Parts that also move without a motor, such as
            the roll of a rod between two ball joints, are left out.
        """
        if frame not in self._parts:
            moves = self.frame_jacobian(frame, self.home)
            scale = np.where(self.is_length[self.motor_columns], self.size, 1.0)
            moves = np.vstack((moves[3:] / self.size, moves[:3])) * scale
            moves[self.idle_parts(frame)] = 0.0
            self._parts[frame] = independent_rows(moves, self.nothing, _FAVOURED)
        return self._parts[frame]

    def idle_parts(self, frame: str) -> NDArray[np.bool_]:
        """Parts of a frame's pose (6) that can move at home while all motors stand."""
        motors = np.eye(self.plant.num_velocities())[self.motor_columns]
        held = np.vstack((self.loop_jacobian(self.home), motors))
        world, q_dot = self.plant.world_frame(), null_space(held, self.nothing)
        spatial = self.plant.CalcJacobianSpatialVelocity(
            self._context, _V, self.frame(frame), np.zeros(3), world, world
        )
        moves = spatial @ q_dot
        sizes = np.vstack((moves[3:] / self.size, moves[:3]))
        return np.asarray((np.abs(sizes) > _IDLE).any(axis=1))

    def solve(
        self,
        targets: Sequence[FrameTarget] = (),
        fixed: Mapping[str, float] | None = None,
        near: ArrayLike | None = None,
    ) -> Pose:
        """Closes all loops, near a pose and within limits where that can be.

        Args:
            targets: targets of frames.
            fixed: positions of joints of one freedom that are to stay [m, rad].
            near: positions (q) to begin with; None: those of the file.

        Returns:
            The pose; where it is not closed, the one that misses least.
        """
        solver, start = self._solver, self.positions(fixed or {}, near)
        columns = self._columns([self._single(name) for name in fixed or {}])
        equations = (*self.equations, *targets)
        pose = solver.judge(equations, solver.newton(equations, start, columns))
        if pose.is_closed and not pose.beyond:
            return pose
        within = solver.by_program(targets, start, columns)
        other = solver.judge(equations, within)
        if other.is_closed and (not pose.is_closed or not other.beyond):
            return other
        if pose.is_closed:
            return pose
        scattered = solver.scattered(equations, start, columns)
        for each in scattered:
            if not each.beyond:
                return each
            bounded = solver.judge(equations, solver.by_program(targets, each.q, columns))
            if bounded.is_closed and not bounded.beyond:
                return bounded
        if scattered:
            return scattered[0]
        return solver.judge(equations, solver.least(equations, pose.q, columns))

    def inverse(self, frame: str, goal: ArrayLike, near: ArrayLike | None = None) -> Floats:
        """Positions (q) with which a frame is at a pose, or has a part of one.

        The way from the pose of `near` is gone in steps, so that loops stay assembled as they are.

        Args:
            frame: name of the frame, or of its link.
            goal: (6) x, y, z [m] and roll, pitch, yaw [rad]; NaN leaves one open. (3): x, y, z.
            near: positions (q) to begin with, closed; None: `home`.

        Raises:
            UnsolvedPose: the frame cannot get there.
        """
        q = np.array(self.home if near is None else near, dtype=float)
        aim, part, solver = _whole_goal(goal), self.frame(frame), self._solver
        begin, way = self._way(part, q, aim)
        far = float(np.abs(way / self._scale_of_pose).max())
        if far > _FARTHEST:
            raise UnsolvedPose(f"{frame} cannot get there: it is {far:.3g} times its size away")
        count = max(1, math.ceil(far / _LONGEST_WAY))
        for i in range(1, count + 1):
            between = np.where(np.isfinite(aim), begin + way * (i / count), np.nan)
            target = FrameTarget(part, aim if i == count else between)
            q = solver.newton((*self.equations, target), q)
        pose = solver.judge((*self.equations, target), q)
        if not pose.is_closed:
            pose = self.solve([target], near=self.home if near is None else near)
        return _insist(pose, f"{frame} cannot get there")

    def nearby(self, frame: str, goal: ArrayLike, near: ArrayLike) -> Floats | None:
        """Positions (q) with which a frame is at a pose next to one, by Newton's method alone.

        Args:
            frame: name of the frame, or of its link.
            goal: pose or parts of one, as `inverse` takes it.
            near: positions (q) next to them, closed.

        Returns:
            None where the method does not get there; limits are not looked at.
        """
        equations = *self.equations, FrameTarget(self.frame(frame), _whole_goal(goal))
        q = self._solver.newton(equations, np.asarray(near, dtype=float))
        return q if self._solver.judge(equations, q).is_closed else None

    def inverse_rows(
        self, frame: str, goals: ArrayLike, near: ArrayLike | None = None
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Positions with which a frame is at each of many poses.

        All goals leave the same parts open. Freedoms that are left over may be other ones than
        those of `inverse`.

        Args:
            frame: name of the frame, or of its link.
            goals: (n, 6) or (n, 3), as for `inverse`.
            near: (q) or (n, q) positions to begin with, closed; None: `home`.

        Returns:
            Positions (n, q), and whether all loops are closed and the target is met (n).
        """
        places = np.asarray(goals, dtype=float)
        aims = np.full((len(places), 6), np.nan)
        aims[:, : places.shape[1]] = places
        start = np.array(self.home if near is None else near, dtype=float)
        q = np.array(np.broadcast_to(start, (len(aims), self.plant.num_positions())))
        part = self.frame(frame)
        is_open = np.isnan(aims[:1]).ravel() if len(aims) else np.ones(6, dtype=bool)
        first = start if start.ndim == 1 else start[0]
        key = frame, is_open.tobytes()
        if key not in self._of_rows:
            target = FrameTarget(part, np.where(is_open, np.nan, 0.0))
            columns = range(self.plant.num_velocities())
            self._of_rows[key] = self._row_solver([*self.equations, target], columns)
        solver = self._of_rows[key]
        if start.ndim == 1:
            begin, way = self._way(part, first, aims)
        else:
            begin = solver.target_of(q)
            way = np.where(np.isfinite(aims), aims - begin, 0.0)
            way[:, 3:] = np.remainder(way[:, 3:] + np.pi, 2.0 * np.pi) - np.pi
        far = float(np.abs(way / self._scale_of_pose).max(initial=0.0))
        count = min(_MOST_STEPS, max(1, math.ceil(far / _LONGEST_WAY)))
        is_closed = np.zeros(len(aims), dtype=bool)
        for i in range(1, count + 1):
            between = aims if i == count else begin + way * (i / count)
            q, is_closed = solver.solve(q, between)
        return q, is_closed

    def forward(self, motors: ArrayLike, near: ArrayLike | None = None) -> Floats:
        """Positions (q) with which the motors are at positions, assembled as `near` is.

        The motors go there along a straight line in steps; a step that leaves the branch that it
        began on is made shorter.

        Args:
            motors: (motors) positions of the motors' joints [m, rad].
            near: positions (q) to begin with, closed; None: `home`.

        Raises:
            ScenarioError: another number of motors.
            UnsolvedPose: the loops cannot follow, or the way crosses a singular position.
        """
        q = np.array(self.home if near is None else near, dtype=float)
        begin, end = self.motor_positions(q), np.asarray(motors, dtype=float)
        if end.shape != begin.shape:
            raise ScenarioError(f"there are {len(begin)} motors, not {end.size}")
        scale = np.where(self.is_length[self.motor_columns], self.size, 1.0)
        length = max(float(np.abs((end - begin) / scale).max(initial=0.0)), _SHORTEST_WAY)
        if length > _FARTHEST:
            raise UnsolvedPose(f"the motors cannot go there: it is {length:.3g} times too far")
        columns = self._columns(self.motors)
        share, step = 0.0, min(1.0, _LONGEST_WAY / length)
        while share < 1.0:
            next_share = min(1.0, share + step)
            ahead = self._follow(q, begin + next_share * (end - begin), columns)
            if ahead is not None:
                q, share, step = ahead, next_share, 1.5 * step
                continue
            step *= 0.5
            if step * length < _SHORTEST_WAY:
                at = zip(self.motors, begin + share * (end - begin), strict=True)
                where = ", ".join(f"{self.name(joint)} = {value:.6g}" for joint, value in at)
                raise UnsolvedPose(
                    f"the motors cannot go there: their way ends near a singular position, at "
                    f"{where}"
                )
        return q

    def forward_rows(
        self, motors: ArrayLike, near: ArrayLike | None = None
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Positions with which the motors are at each of many positions.

        Args:
            motors: (n, motors) positions of the motors' joints [m, rad].
            near: (q) or (n, q) positions to begin with, closed; None: `home`.

        Returns:
            Positions (n, q), and whether all loops are closed (n).
        """
        ends = np.asarray(motors, dtype=float)
        start = np.array(self.home if near is None else near, dtype=float)
        q = np.array(np.broadcast_to(start, (len(ends), self.plant.num_positions())))
        key = ("", b"")
        if key not in self._of_rows:
            columns = self._columns(self.motors).tolist()
            self._of_rows[key] = self._row_solver(self.equations, columns)
        solver, begin = self._of_rows[key], q[:, self._motor_places]
        scale = np.where(self.is_length[self.motor_columns], self.size, 1.0)
        far = float(np.abs((ends - begin) / scale).max(initial=0.0))
        count = min(_MOST_STEPS, max(1, math.ceil(far / _LONGEST_WAY)))
        is_closed = np.zeros(len(ends), dtype=bool)
        for i in range(1, count + 1):
            q[:, self._motor_places] = ends if i == count else begin + (ends - begin) * (i / count)
            q, is_closed = solver.solve(q)
        return q, is_closed

    def velocity_map(self, q: ArrayLike) -> Floats:
        """Velocities of the plant by those of the motors (v, motors), with all loops closed.

        Freedoms that no motor governs, such as the spin of a rod between two ball joints, stay as
        they are as far as loops let them.
        """
        matrix = self.loop_jacobian(q)
        motors = np.eye(matrix.shape[1])[self.motor_columns]
        goal = np.zeros((len(matrix) + len(motors), len(motors)))
        goal[len(matrix) :] = np.eye(len(motors))
        whole = np.vstack((matrix, motors))
        return np.asarray(np.linalg.lstsq(whole, goal, rcond=self.nothing)[0])

    def loop_jacobian(self, q: ArrayLike) -> Floats:
        """Rates of the loops' residuals by velocities (equations, v)."""
        self._at(q)
        return self._solver.jacobian(self.equations)

    def frame_jacobian(self, frame: str, q: ArrayLike) -> Floats:
        """Angular and linear velocity of a frame by velocities of the motors (6, motors)."""
        rates, world = self.velocity_map(q), self.plant.world_frame()
        spatial = self.plant.CalcJacobianSpatialVelocity(
            self._context, _V, self.frame(frame), np.zeros(3), world, world
        )
        return np.asarray(spatial @ rates)

    def _at(self, q: ArrayLike) -> None:
        self.plant.SetPositions(self._context, np.asarray(q, dtype=float))

    def _single(self, name: str) -> Joint:
        joint = self.joint(name)
        if joint.num_positions() != 1:
            raise ScenarioError(
                f"the {joint.type_name()} joint {name} has more than one position to set"
            )
        return joint

    def _columns(self, fixed: Sequence[Joint]) -> NDArray[np.intp]:
        """Velocities that are free."""
        stay = {joint.velocity_start() for joint in fixed}
        free = [i for i in range(self.plant.num_velocities()) if i not in stay]
        return np.array(free, dtype=np.intp)

    @property
    def _scale_of_pose(self) -> Floats:
        return np.repeat((self.size, 1.0), 3)

    def _way(self, part: Frame, q: Floats, aims: Floats) -> tuple[Floats, Floats]:
        """Pose of a frame (6), and ways from there to targets (..., 6)."""
        self._at(q)
        begin = pose_vector(part.CalcPoseInWorld(self._context))
        way = np.where(np.isfinite(aims), aims - begin, 0.0)
        way[..., 3:] = np.remainder(way[..., 3:] + np.pi, 2.0 * np.pi) - np.pi
        return begin, way

    def _follow(self, q: Floats, motors: Floats, columns: NDArray[np.intp]) -> Floats | None:
        """Positions with the motors a step further; None where they leave the branch."""
        change = self.velocity_map(q) @ (motors - self.motor_positions(q))
        ahead = self.moved(q, change)
        ahead[self._motor_places] = motors
        solved = self._solver.newton(self.equations, ahead, columns)
        if not self._solver.judge(self.equations, solved).is_closed:
            return None
        # The corrector goes a small part of the way that the predictor went.
        scale = np.where(self.is_length, self.size, 1.0)
        went = float(np.abs(change / scale).max(initial=0.0))
        corrected = float(np.abs(self._solver.way(ahead, solved) / scale).max(initial=0.0))
        if corrected > 0.5 * went + ROUNDING:
            return None
        return None if self._may_cross(q, solved, columns) else solved

    def _may_cross(self, q: Floats, ahead: Floats, columns: NDArray[np.intp]) -> bool:
        """Whether a singular position may be between two poses.

        From a matrix A to A (I + X) on a straight line, none has less rank while |X| < 1.
        """
        before, after = (scaled_jacobian(self._solver, pose)[:, columns] for pose in (q, ahead))
        left, values, _ = np.linalg.svd(before, full_matrices=False)
        rank = min(self.mobility.rank, len(columns))
        if not rank or values[rank - 1] <= self.nothing * values[0]:
            return False  # singular to begin with: no branch is left
        change = (left[:, :rank] / values[:rank]).T @ (after - before)
        return bool(np.linalg.norm(change) >= 1.0)

    @cached_property
    def _tree(self) -> Tree:
        return Tree(self.plant, joints_of(self.plant))

    def _row_solver(self, equations: Sequence[Equation], columns: Sequence[int]) -> RowSolver:
        # Home may be singular; what is next to it is not.
        pose, *_ = poses_near(self._solver, self.home)
        solver = self._solver
        options = self.is_length, self.size, solver.tolerance
        return RowSolver(self._tree, equations, columns, pose, *options)


def _whole_goal(goal: ArrayLike) -> Floats:
    """A target (6), of which positions alone may be given."""
    aim = np.full(6, np.nan)
    aim[: np.size(goal)] = np.ravel(goal)
    return aim


def _insist(pose: Pose, message: str) -> Floats:
    if pose.gaps:
        raise UnsolvedPose(f"{message}: missed {pose.gaps[0]}", pose.gaps)
    return pose.q
