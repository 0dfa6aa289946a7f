"""Kinematics and forces of a mechanism as systems, which stand where a machine's own would.

The pose that is solved for is the one next to the pose before, which the Context has: so a
mechanism stays assembled as it is, and two simulations do not disturb each other.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import declare_cached, read_array, read_or_zeros
from parapod.systems.mechanism.equations import UnsolvedPose, part_rates, pose_vector
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.statics import motor_forces

type Floats = NDArray[np.float64]


# Number beyond which none means anything [m, rad, N, N m, and their rates].
_LARGEST = 1e9


def _is_sane(*vectors: Floats) -> bool:
    """Whether all numbers are finite, and none is absurd."""
    return all(bool((np.abs(vector) <= _LARGEST).all()) for vector in vectors)


class _Posed(LeafSystem):
    """A mechanism whose pose is solved from that of the sample before."""

    def __init__(
        self,
        mechanism: Mechanism,
        name: str,
        port: str,
        size: int,
        period: float,
        begin: ArrayLike | None = None,
    ):
        super().__init__()
        self.set_name(name)
        self.mechanism = mechanism
        self._goal = self.DeclareVectorInputPort(port, size)
        q = mechanism.home if begin is None else np.asarray(begin, dtype=float)
        self._state = self.DeclareDiscreteState(q)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)
        tickets = {self._goal.ticket(), self.discrete_state_ticket(self._state)}
        self._pose = declare_cached(self, "pose", self._solve_at, tickets)

    def begin(self, context: Context, q: ArrayLike) -> None:
        """Has poses be solved next to this one (q), all loops closed."""
        context.get_mutable_discrete_state_vector().SetFromVector(np.asarray(q, dtype=float))

    def _solve_at(self, context: Context) -> Floats:
        """Positions (q); NaN of a pose that is not closed."""
        near = context.get_discrete_state_vector().value()
        goal = read_array(self._goal, context)
        if not _is_sane(goal):
            return np.full(len(near), np.nan)
        try:
            return self._solved(goal, near)
        except UnsolvedPose:
            return np.full(len(near), np.nan)

    def _solved(self, goal: Floats, near: Floats) -> Floats:
        """Positions (q) next to others."""
        raise NotImplementedError

    def _update(self, context: Context, discrete_state: Any) -> None:
        q = self._pose.value(self, context)
        if np.isfinite(q).all():
            discrete_state.set_value(q)

    def _copy_positions(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._pose.value(self, context))


class MechanismInverse(_Posed):
    """Motors of a mechanism for a desired pose of a frame, or parts of one.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pose_desired_state` | 2k | m, rad and rates | parts of the frame's pose, their rates |
    | out `motor_desired_state` | 2n | m or rad and rates | positions of the motors, their rates |
    | out `positions` | q | m, rad | positions of all joints of the mechanism's plant |

    State: discrete, positions of all joints at the sample before.

    Bad input: NaN for all motors where the frame cannot get there, or is asked for NaN.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        frame: str,
        parts: tuple[int, ...] | None = None,
        period: float = 0.01,
        begin: ArrayLike | None = None,
    ):
        """Takes a mechanism.

        Args:
            mechanism: the mechanism.
            frame: name of the frame.
            parts: parts of its pose that are desired, by their places in x, y, z, roll, pitch,
                yaw; None: those that the motors can set.
            period: time between two samples [s].
            begin: (q) positions next to which the first pose is solved, all loops closed; None:
                those at home.

        Raises:
            ScenarioError: motors that do not fit the mechanism, or an unknown frame.
        """
        mechanism.check_motors()
        self.frame, self.parts = frame, parts or mechanism.free_parts(frame)
        count, motors = len(self.parts), len(mechanism.motors)
        super().__init__(
            mechanism, "mechanism_inverse", "pose_desired_state", 2 * count, period, begin
        )
        tickets = {self._goal.ticket(), self.discrete_state_ticket(self._state)}
        self.DeclareVectorOutputPort("motor_desired_state", 2 * motors, self._calc_motors, tickets)
        self.DeclareVectorOutputPort(
            "positions", mechanism.plant.num_positions(), self._copy_positions, tickets
        )

    def _solved(self, goal: Floats, near: Floats) -> Floats:
        pose = np.full(6, np.nan)
        pose[list(self.parts)] = goal[: len(self.parts)]
        return self.mechanism.inverse(self.frame, pose, near)

    def _calc_motors(self, context: Context, output: BasicVector) -> None:
        mechanism, q = self.mechanism, self._pose.value(self, context)
        if not np.isfinite(q).all():
            output.SetFromVector(np.full(2 * len(mechanism.motors), np.nan))
            return
        rates = read_array(self._goal, context)[len(self.parts) :]
        try:
            moves = part_rates(mechanism.plant, mechanism.frame(self.frame), q)
        except UnsolvedPose:
            output.SetFromVector(np.full(2 * len(mechanism.motors), np.nan))
            return
        by_motors = (moves @ mechanism.velocity_map(q))[list(self.parts)]
        speeds = np.linalg.lstsq(by_motors, rates)[0]
        output.SetFromVector(np.concatenate((mechanism.motor_positions(q), speeds)))


class MechanismForward(_Posed):
    """Pose of a frame of a mechanism for positions of its motors.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | n | m or rad | positions of the motors |
    | in `velocity` | n | m/s or rad/s | their velocities; unconnected: 0 |
    | out `pose` | 6 | m, rad | x, y, z, roll, pitch, yaw of the frame |
    | out `pose_rate` | 6 | m/s, rad/s | their rates |
    | out `positions` | q | m, rad | positions of all joints of the mechanism's plant |

    State: discrete, positions of all joints at the sample before.

    Bad input: NaN where the loops cannot follow, or for motors at NaN.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        frame: str,
        period: float = 0.01,
        begin: ArrayLike | None = None,
    ):
        """Takes a mechanism.

        Args:
            mechanism: the mechanism.
            frame: name of the frame.
            period: time between two samples [s].
            begin: (q) positions next to which the first pose is solved, all loops closed; None:
                those at home.

        Raises:
            ScenarioError: motors that do not fit the mechanism, or an unknown frame.
        """
        mechanism.check_motors()
        self.frame = frame
        count = len(mechanism.motors)
        super().__init__(mechanism, "mechanism_forward", "position", count, period, begin)
        self._velocity = self.DeclareVectorInputPort("velocity", count)
        tickets = {self._goal.ticket(), self.discrete_state_ticket(self._state)}
        self._part = mechanism.frame(frame)
        self.DeclareVectorOutputPort("pose", 6, self._calc_pose, tickets)
        self.DeclareVectorOutputPort(
            "pose_rate", 6, self._calc_rate, {*tickets, self._velocity.ticket()}
        )
        self.DeclareVectorOutputPort(
            "positions", mechanism.plant.num_positions(), self._copy_positions, tickets
        )

    def _solved(self, goal: Floats, near: Floats) -> Floats:
        return self.mechanism.forward(goal, near)

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        q = self._pose.value(self, context)
        is_solved = np.isfinite(q).all()
        pose = pose_vector(self.mechanism.pose(self.frame, q)) if is_solved else np.full(6, np.nan)
        output.SetFromVector(pose)

    def _calc_rate(self, context: Context, output: BasicVector) -> None:
        q = self._pose.value(self, context)
        if not np.isfinite(q).all():
            output.SetFromVector(np.full(6, np.nan))
            return
        mechanism = self.mechanism
        speeds = np.asarray(read_or_zeros(self._velocity, context), dtype=float)
        try:
            moves = part_rates(mechanism.plant, self._part, q)
        except UnsolvedPose:
            output.SetFromVector(np.full(6, np.nan))
            return
        output.SetFromVector(moves @ mechanism.velocity_map(q) @ speeds)


class MechanismForces(LeafSystem):
    """Forces with which motors hold or move a mechanism, against weight, springs and damping.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `positions` | q | m, rad | positions of all joints, as `MechanismForward` has them |
    | in `velocity` | n | m/s or rad/s | velocities of the motors; unconnected: 0 |
    | in `acceleration` | n | m/s^2 or rad/s^2 | their accelerations; unconnected: 0 |
    | in `wrench` | 6 | N m, N | torque and force on the frame, in the world; unconnected: 0 |
    | out `force` | n | N or N m | forces of the motors |

    State: none.

    Bad input: NaN for all motors where anything is not finite, or beyond 1e9.
    """

    def __init__(self, mechanism: Mechanism, frame: str):
        """Takes a mechanism.

        Args:
            mechanism: the mechanism.
            frame: name of the frame on which the wrench acts.

        Raises:
            ScenarioError: motors that do not fit the mechanism, or an unknown frame.
        """
        mechanism.check_motors()
        mechanism.frame(frame)
        super().__init__()
        self.set_name("mechanism_forces")
        self.mechanism, self.frame = mechanism, frame
        count = len(mechanism.motors)
        self._positions = self.DeclareVectorInputPort("positions", mechanism.plant.num_positions())
        self._velocity = self.DeclareVectorInputPort("velocity", count)
        self._acceleration = self.DeclareVectorInputPort("acceleration", count)
        self._wrench = self.DeclareVectorInputPort("wrench", 6)
        inputs = (self._positions, self._velocity, self._acceleration, self._wrench)
        self.DeclareVectorOutputPort(
            "force", count, self._calc_force, {port.ticket() for port in inputs}
        )

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        q = read_array(self._positions, context)
        velocity, acceleration, wrench = (
            np.asarray(read_or_zeros(port, context), dtype=float)
            for port in (self._velocity, self._acceleration, self._wrench)
        )
        if not _is_sane(q, velocity, acceleration, wrench):
            output.SetFromVector(np.full(len(velocity), np.nan))
            return
        held = motor_forces(self.mechanism, q, velocity, acceleration, {self.frame: wrench})
        output.SetFromVector(held.forces)
