"""A flexible rod on a base that moves: its tip, and its wrench on the base."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.rod_motion import ClampMotion, RodMotion, Tip
from parapod.systems.core import quaternions
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import elements, read
from parapod.systems.core.vectors import Axes

_UPWARDS = (0.0, 0.0, GRAVITY)  # specific force of what is at rest [m/s^2]
_ABSURD = 1e6  # sum of numbers that no base's motion has
_STILL = (0.0, 0.0, 0.0)
# Quaternion (w, x, y, z) and place of a base at the world's origin.
_AT_ORIGIN = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
# Numbers of the state behind those of the modes: pose (7) and velocity (6) of the base at the last
# update, whether they are known (1), and the motion of the clamp (9) in the last step.
_POSE, _VELOCITY, _IS_KNOWN, _MOTION = slice(0, 7), slice(7, 13), 13, slice(14, 23)


class FlexibleArm(LeafSystem):
    """A rod that bends in two planes while its base moves as something else moves it.

    Use it behind any plant that has the same rod as a rigid body, and takes `bending_wrench`
    besides; or beside hardware, where it observes what no sensor on the rod measures.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `base_pose` | 7 | -, m | quaternion (w, x, y, z) and place of the clamp, z along the rod |
    | in `base_velocity` | 6 | rad/s, m/s | its velocity, as far as `base_motion` says |
    | in `base_acceleration` | 6 | rad/s^2, m/s^2 | its acceleration, by `base_motion` too |
    | out `tip_pose` | 7 | -, m | quaternion and place of the tip |
    | out `tip_velocity` | 6 | rad/s, m/s | its angular and linear velocity |
    | out `wrench` | 6 | N m, N | moment about the clamp and force of the rod on its base |
    | out `bending_wrench` | 6 | N m, N | the same, less that of a rigid rod in the same motion |
    | out `deflection` | 3 | m | tip from where a rigid rod has it, along the base's axes |
    | out `modal_state` | 4n | - | coordinates in the planes of x and y, and their rates |

    Poses, velocities and wrenches are in the world's axes; angular velocities come before linear
    ones, and moments before forces, as in Drake; gravity is along -z. The step is that of
    `RodMotion`: exact for a motion of the base that is constant over it. It takes the acceleration
    at the step's beginning, or, where that is unknown, the mean one of the step before, by the
    change of velocities or of poses.

    State: discrete, modal coordinates and their rates (4n), pose (7) and velocity (6) of the base
    at the last update, whether they are known (1), motion of the clamp (9) in the last step;
    updated every period. It begins at rest, sagging under its weight, on `base_pose`; without one
    on the first pose that it is shown.

    Bad input: a pose, velocity or acceleration that is not finite, or absurd, keeps the motion of
    the step before; pose and velocity of the tip are not finite either.
    """

    def __init__(
        self,
        rod: FlexibleRod = FlexibleRod(),
        period: float = 1e-3,
        base_pose: ArrayLike | None = None,
        base_motion: Literal["pose", "velocity", "acceleration"] = "velocity",
    ):
        """Creates the system.

        Args:
            rod: the rod.
            period: length of a step [s].
            base_pose: pose (7) of the base in a default context; None: unknown.
            base_motion: last of the inputs that are read: the base's pose alone, or with its
                velocity, or with that and its acceleration.

        Raises:
            ValueError: a rod that buckles under its own weight, or a mode above what the period
                carries.
        """
        super().__init__()
        self.set_name("flexible_arm")
        self._motion, self._period, self._size = RodMotion(rod, period), period, 4 * rod.modes
        self._pose = self.DeclareVectorInputPort("base_pose", 7)
        self._velocity = self.DeclareVectorInputPort("base_velocity", 6)
        self._acceleration = self.DeclareVectorInputPort("base_acceleration", 6)
        self._has_velocity = base_motion != "pose"
        self._has_acceleration = base_motion == "acceleration"
        pose = _AT_ORIGIN if base_pose is None else np.asarray(base_pose, dtype=float).tolist()
        rest = self._rest(pose, is_known=base_pose is not None)
        state = self.discrete_state_ticket(self.DeclareDiscreteState(np.array(rest)))
        pose_now = {self._pose.ticket()}
        velocity_now = {self._velocity.ticket()} if self._has_velocity else set()
        for name, size, calc, tickets in (
            ("tip_pose", 7, self._calc_tip_pose, {state} | pose_now),
            ("tip_velocity", 6, self._calc_tip_velocity, {state} | pose_now | velocity_now),
            ("wrench", 6, self._calc_wrench, {state}),
            ("bending_wrench", 6, self._calc_bending_wrench, {state}),
            ("deflection", 3, self._calc_deflection, {state}),
            ("modal_state", self._size, self._calc_modal_state, {state}),
        ):
            self.DeclareVectorOutputPort(name, size, calc, tickets)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def set_rest(self, context: Context, base_pose: ArrayLike) -> None:
        """Puts the rod at rest on a base at rest.

        Args:
            context: context of this system.
            base_pose: pose (7) of the base.
        """
        pose = np.asarray(base_pose, dtype=float).tolist()
        context.SetDiscreteState(np.array(self._rest(pose, is_known=True)))

    def _rest(self, pose: Sequence[float], is_known: bool) -> list[float]:
        """State of a rod at rest."""
        force = Axes.from_quaternion(pose[:4]).components(_UPWARDS)
        modal = self._motion.rest(force)
        return [*modal, *pose, *_STILL, *_STILL, float(is_known), *force, *_STILL, *_STILL]

    def _update(self, context: Context, discrete_state: Any) -> None:
        state = elements(context.get_discrete_state_vector())
        modal, base = state[: self._size], state[self._size :]
        pose = read(self._pose, context)
        if not base[_IS_KNOWN] > 0.5:
            if _is_sane(pose):
                discrete_state.set_value(np.array(self._rest(pose, is_known=True)))
            return
        velocity = self._read_velocity(context, base, pose)
        if self._has_acceleration:
            acceleration = read(self._acceleration, context)
        else:
            pairs = zip(velocity, base[_VELOCITY], strict=True)
            acceleration = [(now - last) / self._period for now, last in pairs]
        if _is_sane(pose, velocity, acceleration):
            axes = Axes.from_quaternion(pose[:4])
            felt = [a + g for a, g in zip(acceleration[3:], _UPWARDS, strict=True)]
            parts = map(axes.components, (felt, velocity[:3], acceleration[:3]))
            base = [*pose, *velocity, 1.0, *(number for part in parts for number in part)]
        modal = self._motion.step(modal, _motion_in(base))
        discrete_state.set_value(np.array(modal + base))

    def _read_velocity(
        self, context: Context, base: list[float], pose: list[float]
    ) -> list[float]:
        """Velocity (6) of the base, by its port or by the change of its pose."""
        if self._has_velocity:
            return read(self._velocity, context)
        last = base[_POSE]
        turn = quaternions.turn_between(last[:4], pose[:4])
        way = [now - before for now, before in zip(pose[4:], last[4:], strict=True)]
        return [change / self._period for change in (*turn, *way)]

    def _tip(self, context: Context) -> tuple[Tip, list[float]]:
        """Tip against the clamp, and the numbers of the state behind those of the modes."""
        state = elements(context.get_discrete_state_vector())
        base = state[self._size :]
        return self._motion.tip(state[: self._size], _motion_in(base)), base

    def _calc_tip_pose(self, context: Context, output: BasicVector) -> None:
        tip, _ = self._tip(context)
        pose = read(self._pose, context)
        x, y, z = tip.place
        axes = Axes.from_quaternion(pose[:4])
        place = axes.in_world((x, y, z + self._motion.rod.length))
        turned = quaternions.product(pose[:4], quaternions.of_turn(tip.turn))
        output.SetFromVector(
            np.array([*turned, *(p + r for p, r in zip(pose[4:], place, strict=True))])
        )

    def _calc_tip_velocity(self, context: Context, output: BasicVector) -> None:
        tip, base = self._tip(context)
        pose = read(self._pose, context)
        velocity = read(self._velocity, context) if self._has_velocity else base[_VELOCITY]
        axes = Axes.from_quaternion(pose[:4])
        x, y, z = tip.place
        (r_x, r_y, r_z) = axes.in_world((x, y, z + self._motion.rod.length))
        w_x, w_y, w_z, *linear = velocity
        carried = (w_y * r_z - w_z * r_y, w_z * r_x - w_x * r_z, w_x * r_y - w_y * r_x)
        turning, moving = axes.in_world(tip.turning), axes.in_world(tip.velocity)
        angular = [a + b for a, b in zip((w_x, w_y, w_z), turning, strict=True)]
        linear = [a + b + c for a, b, c in zip(linear, carried, moving, strict=True)]
        output.SetFromVector(np.array(angular + linear))

    def _calc_deflection(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._tip(context)[0].place))

    def _calc_bending_wrench(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._wrench(context, is_whole=False)))

    def _calc_wrench(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._wrench(context, is_whole=True)))

    def _wrench(self, context: Context, is_whole: bool) -> list[float]:
        """Moment and force (6) in the world, with those of a rigid rod or without."""
        state = elements(context.get_discrete_state_vector())
        base = state[self._size :]
        axes, motion = Axes.from_quaternion(base[_POSE][:4]), _motion_in(base)
        wrench = self._motion.bending_wrench(state[: self._size], motion)
        parts = [axes.in_world(part) for part in wrench]
        if is_whole:
            rigid = [axes.in_world(part) for part in self._motion.rigid_wrench(motion)]
            return [a + b for i in range(2) for a, b in zip(parts[i], rigid[i], strict=True)]
        return [*parts[0], *parts[1]]

    def _calc_modal_state(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state_vector())
        output.SetFromVector(np.array(state[: self._size]))


def _is_sane(pose: list[float], *motions: list[float]) -> bool:
    """Whether a pose and its derivatives are finite, and not absurdly large."""
    numbers = (number for part in (pose, *motions) for number in part)
    return any(pose[:4]) and sum(map(abs, numbers)) < _ABSURD


def _motion_in(base: list[float]) -> ClampMotion:
    """Motion of the clamp in the last step."""
    f_x, f_y, f_z, w_x, w_y, w_z, a_x, a_y, a_z = base[_MOTION]
    return ClampMotion((f_x, f_y, f_z), (w_x, w_y, w_z), (a_x, a_y, a_z))
