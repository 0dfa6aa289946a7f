"""Equations that poses of a mechanism fulfil: its loops are closed, a frame is at its target.

Residuals are in m and rad, and their Jacobians by Drake's velocities v. Each is evaluated by
Drake, for one pose at a time; `rows.py` has the same for many.
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, JacobianWrtVariable, Joint
from pydrake.systems.framework import Context

from parapod.systems.core.errors import ParapodError
from parapod.systems.physics.loops import Ball, Coupling, Distance, Loop, Weld, loop_name

type Floats = NDArray[np.float64]

_V = JacobianWrtVariable.kV
_ORIGIN = np.zeros((3, 1))


class Equation(ABC):
    """Equations of one loop, or of one target.

    Attributes:
        name: name for people.
        is_angle: for each equation, whether its residual is an angle [rad]; else a length [m].
    """

    name: str
    is_angle: tuple[bool, ...]

    @property
    def size(self) -> int:
        """Number of equations."""
        return len(self.is_angle)

    @abstractmethod
    def residual(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Residuals (size) [m, rad], zero where the equations are fulfilled."""

    @abstractmethod
    def jacobian(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Rates of the residuals by velocities (size, v), exact where they are zero."""


class BallEquation(Equation):
    """A point of one body is a point of another (3)."""

    def __init__(self, loop: Ball):
        self.name, self.is_angle = loop_name(loop), (False,) * 3
        self.loop = loop
        self._frames = loop.body.body_frame(), loop.other.body_frame()
        self._point = np.asarray(loop.point, dtype=float)
        self._other = np.asarray(loop.other_point, dtype=float).reshape(3, 1)

    def residual(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Place of the other body's point from the body's, in the frame of the body."""
        one, other = self._frames
        place = plant.CalcPointsPositions(context, other, self._other, one)
        return np.asarray(place)[:, 0] - self._point

    def jacobian(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Rates of that."""
        one, other = self._frames
        return np.asarray(
            plant.CalcJacobianTranslationalVelocity(context, _V, other, self._other, one, one)
        )


class DistanceEquation(Equation):
    """Two points are in a distance of each other (1)."""

    def __init__(self, loop: Distance):
        self.name, self.is_angle = loop_name(loop), (False,)
        self.loop = loop
        self._between = BallEquation(
            Ball(loop.body, loop.point, loop.other, loop.other_point, loop.name)
        )

    def residual(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Distance of the points beyond the rod's length."""
        gap = self._between.residual(plant, context)
        return np.array([np.linalg.norm(gap) - self.loop.distance])

    def jacobian(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Rate of that."""
        gap = self._between.residual(plant, context)
        along = gap / max(float(np.linalg.norm(gap)), 1e-12)
        return (along @ self._between.jacobian(plant, context))[None]


class WeldEquation(Equation):
    """A frame of one body is a frame of another (6): their rotation, then their origins."""

    def __init__(self, loop: Weld):
        self.name, self.is_angle = loop_name(loop), (True,) * 3 + (False,) * 3
        self.loop = loop
        self._frames = loop.body.body_frame(), loop.other.body_frame()
        self._X_PA, self._X_BQ = loop.frame.inverse(), loop.other_frame
        self._R_PA = self._X_PA.rotation().matrix()
        self._point = loop.other_frame.translation().reshape(3, 1)

    def residual(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Rotation vector and origin of the other frame in the one."""
        X_AB = plant.CalcRelativeTransform(context, *self._frames)
        X_PQ = self._X_PA.multiply(X_AB).multiply(self._X_BQ)
        return np.concatenate((rotation_vector(X_PQ.rotation()), X_PQ.translation()))

    def jacobian(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Rates of these."""
        one, other = self._frames
        spatial = plant.CalcJacobianSpatialVelocity(
            context, _V, other, self._point[:, 0], one, one
        )
        turned: Floats = np.vstack((self._R_PA @ spatial[:3], self._R_PA @ spatial[3:]))
        return turned


class CouplingEquation(Equation):
    """A joint's position is a multiple of another's (1)."""

    def __init__(self, loop: Coupling):
        self.loop = loop
        self.name, self.is_angle = loop_name(loop), (_is_angle(loop.joint),)

    def residual(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Position of the joint beyond the one that its leader demands."""
        q, loop = plant.GetPositions(context), self.loop
        own, leader = (q[joint.position_start()] for joint in (loop.joint, loop.leader))
        return np.array([own - loop.ratio * leader - loop.offset])

    def jacobian(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Rate of that."""
        rates = np.zeros((1, plant.num_velocities()))
        rates[0, self.loop.joint.velocity_start()] = 1.0
        rates[0, self.loop.leader.velocity_start()] -= self.loop.ratio
        return rates


class FrameTarget(Equation):
    """A frame has a position, and an orientation, or parts of these, in the world.

    Attributes:
        goal: (6) x, y, z [m], roll, pitch, yaw [rad] of `RollPitchYaw`; NaN leaves one open.
    """

    def __init__(self, frame: Frame, goal: ArrayLike):
        self.name, self.frame = frame.name(), frame
        self.goal = np.array(goal, dtype=float)
        is_set = np.isfinite(self.goal)
        self._places, angles = np.flatnonzero(is_set[:3]), np.flatnonzero(is_set[3:])
        # Three angles are taken as one rotation, which has no singular position.
        self._angles, self._is_whole = angles, len(angles) == 3
        self._R_GW = RotationMatrix()
        if self._is_whole:
            self._R_GW = RollPitchYaw(*self.goal[3:].tolist()).ToRotationMatrix().inverse()
        self.is_angle = (False,) * len(self._places) + (True,) * len(angles)

    @property
    def goal_rotation(self) -> RotationMatrix:
        """Orientation of the target, where it has all three angles."""
        return self._R_GW.inverse()

    def residual(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Position and angles beyond the target."""
        X_WF = self.frame.CalcPoseInWorld(context)
        gap = X_WF.translation() - self.goal[:3]
        if self._is_whole:
            turn = rotation_vector(self._R_GW.multiply(X_WF.rotation()))
        elif len(self._angles):
            beyond = RollPitchYaw(X_WF.rotation()).vector() - self.goal[3:]
            turn = np.remainder(beyond[self._angles] + np.pi, 2.0 * np.pi) - np.pi
        else:
            turn = np.zeros(0)
        return np.concatenate((gap[self._places], turn))

    def jacobian(self, plant: MultibodyPlant, context: Context) -> Floats:
        """Rates of these."""
        world = plant.world_frame()
        spatial = plant.CalcJacobianSpatialVelocity(
            context, _V, self.frame, np.zeros(3), world, world
        )
        turning = spatial[:3]
        if self._is_whole:
            turn = self._R_GW.matrix() @ turning
        elif len(self._angles):
            rpy = RollPitchYaw(self.frame.CalcPoseInWorld(context).rotation())
            turn = (_rates_by_velocity(rpy) @ turning)[self._angles]
        else:
            turn = turning[:0]
        return np.vstack((spatial[3:][self._places], turn))


@dataclass(frozen=True)
class Gap:
    """Miss of an equation.

    Attributes:
        name: name of the loop or of the frame.
        length: distance that it misses [m].
        angle: angle that it misses [rad].
    """

    name: str
    length: float
    angle: float

    def __str__(self) -> str:
        parts = []
        if self.length > 0.0:
            parts.append(f"{1e3 * self.length:.4g} mm")
        if self.angle > 0.0:
            parts.append(f"{np.degrees(self.angle):.4g} deg")
        return f"{self.name} by {' and '.join(parts) or 'nothing'}"


class UnsolvedPose(ParapodError):
    """A pose that the mechanism cannot take.

    Attributes:
        gaps: loops and targets that are missed, and by how much.
    """

    def __init__(self, message: str, gaps: Sequence[Gap] = ()):
        self.gaps = tuple(gaps)
        super().__init__(message)


def gap_of(equation: Equation, residual: Floats) -> Gap:
    """Miss of an equation with a residual."""
    is_angle = np.array(equation.is_angle, dtype=bool)
    length, angle = (float(np.linalg.norm(residual[which])) for which in (~is_angle, is_angle))
    return Gap(equation.name, length, angle)


def equations_of(loops: Sequence[Loop]) -> tuple[Equation, ...]:
    """The equations of loops; those of equal names get names of their own."""
    equations = [_equation_of(loop) for loop in loops]
    counts = Counter(equation.name for equation in equations)
    for equation, loop in zip(equations, loops, strict=True):
        if counts[equation.name] > 1 and not isinstance(loop, Coupling):
            equation.name = f"{loop.body.scoped_name()} - {loop.other.scoped_name()}"
    used_names: set[str] = set()
    for equation in equations:
        tries = (equation.name, *(f"{equation.name} ({i})" for i in range(2, len(loops) + 1)))
        equation.name = next(name for name in tries if name not in used_names)
        used_names.add(equation.name)
    return tuple(equations)


def _equation_of(loop: Loop) -> Equation:
    if isinstance(loop, Ball):
        return BallEquation(loop)
    if isinstance(loop, Weld):
        return WeldEquation(loop)
    if isinstance(loop, Distance):
        return DistanceEquation(loop)
    return CouplingEquation(loop)


def rotation_vector(rotation: RotationMatrix) -> Floats:
    """Axis of a rotation times its angle (3) [rad]."""
    turn = rotation.ToAngleAxis()
    angle = turn.angle()
    if angle > np.pi:
        angle -= 2.0 * np.pi
    return np.asarray(angle * turn.axis())


def pose_vector(pose: RigidTransform) -> Floats:
    """Position and roll, pitch, yaw of a pose (6) [m, rad]."""
    return np.concatenate((pose.translation(), RollPitchYaw(pose.rotation()).vector()))


def part_rates(plant: MultibodyPlant, frame: Frame, q: ArrayLike) -> Floats:
    """Rates of x, y, z, roll, pitch, yaw of a frame by velocities (6, v), at positions (q)."""
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, np.asarray(q, dtype=float))
    world = plant.world_frame()
    spatial = plant.CalcJacobianSpatialVelocity(context, _V, frame, np.zeros(3), world, world)
    rpy = RollPitchYaw(frame.CalcPoseInWorld(context).rotation())
    return np.vstack((spatial[3:], _rates_by_velocity(rpy) @ spatial[:3]))


def _rates_by_velocity(rpy: RollPitchYaw) -> Floats:
    """Matrix (3, 3) from an angular velocity along the world's axes to rates of the angles.

    Raises:
        UnsolvedPose: a pitch of about 90 deg, where there is none.
    """
    try:
        columns: list[Any] = [
            rpy.CalcRpyDtFromAngularVelocityInParent(np.array(axis)) for axis in np.eye(3)
        ]
    except RuntimeError:
        reason = "a frame is pitched by about 90 deg, where roll and yaw are one"
        raise UnsolvedPose(reason) from None
    return np.column_stack(columns)


def _is_angle(joint: Joint) -> bool:
    return joint.type_name() == "revolute"
