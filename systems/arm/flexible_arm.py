"""An arm whose last link is a flexible rod, on a base that moves."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.rod_motion import ClampMotion, RodMotion, Tip
from parapod.systems.arm.serial_arm import SerialArm, rotated
from parapod.systems.core import quaternions
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import elements, read
from parapod.systems.core.remembered import Remembered
from parapod.systems.core.triples import Vector3, cross, dot, minus, plus, scaled
from parapod.systems.core.vectors import Axes

_UPWARDS = (0.0, 0.0, GRAVITY)  # specific force of what is at rest [m/s^2]
_STILL = (0.0, 0.0, 0.0)
# Quaternion (w, x, y, z) and place of a base at the world's origin.
_AT_ORIGIN = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_ABSURD = 1e6  # sum of numbers that no base's motion has
# Groups of the discrete state, and numbers of the first behind those of the modes: pose (7) and
# velocity (6) of the clamp at the last update, whether they are known (1), and its motion (9) in
# the last step.
_RODS, _WRENCH, _BENDING = range(3)
_POSE, _VELOCITY, _IS_KNOWN, _MOTION = slice(0, 7), slice(7, 13), 13, slice(14, 23)


class FlexibleArm(LeafSystem):
    """A rod that bends in two planes while platform and joints move its clamp.

    Use it behind any plant that has the same rod as a rigid body, and takes `bending_force`
    besides; or beside hardware, where it observes what no sensor on the rod measures.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `base_pose` | 7 | -, m | quaternion (w, x, y, z) and place of the arm's base |
    | in `base_velocity` | 6 | rad/s, m/s | its velocity, as far as `base_motion` says |
    | in `joint_state` | 2n | rad or m, and per s | positions and rates of the arm's joints |
    | out `tip_pose` | 7 | -, m | quaternion and place of the tip |
    | out `tip_velocity` | 6 | rad/s, m/s | its angular and linear velocity |
    | out `clamp_pose` | 7 | -, m | quaternion and place of the rod's clamp |
    | out `deflection` | 3 | m | tip from where a rigid rod has it, by the last link's axes |
    | out `modal_state` | 4m | - | coordinates in the planes of x and y, and their rates |
    | out `wrench` | 6 | N m, N | moment about the base and force of the rod, by the base's axes |
    | out `bending_force` | k | N m, N | generalized force of the bending, k = 6 + n |

    The rod is clamped to the last link of an arm, along that link's z axis; without joints to the
    base itself. Poses and velocities are in the world's axes, where gravity is along -z. Angular
    velocities come before linear ones, and moments before forces, as in Drake. `bending_force`
    is what a rod that bends adds to a rigid one in the same motion: along the velocities of the
    base in the world, and along those of the joints.

    The step is that of `RodMotion`: exact for a motion of the clamp that is constant over it. It
    takes the mean acceleration of the step before, by the change of velocities or of poses.

    State: discrete, modal coordinates and their rates (4m), pose (7) and velocity (6) of the clamp
    at the last update, whether they are known (1), its motion (9) in the last step; `wrench` (6);
    `bending_force` (6 + n); updated every period. It begins at rest, sagging under its weight, on
    `base_pose` with the joints at zero; without one on the first pose that it is shown.

    Bad input: with a pose, velocity or joint that is not finite, or absurd, the clamp is taken to
    rest where it was; poses and velocity of clamp and of the tip are not finite either.
    """

    def __init__(
        self,
        rod: FlexibleRod = FlexibleRod(),
        period: float = 1e-3,
        arm: SerialArm = SerialArm(),
        base_pose: ArrayLike | None = None,
        base_motion: Literal["pose", "velocity"] = "velocity",
    ):
        """Creates the system.

        Args:
            rod: the rod.
            period: length of a step [s].
            arm: the arm, to whose last link the rod is clamped; its links' masses do not count.
            base_pose: pose (7) of the base in a default context; None: unknown.
            base_motion: inputs that are read: the base's pose alone, or with its velocity.

        Raises:
            ValueError: a rod that buckles under its own weight, or a mode above what the period
                carries.
        """
        super().__init__()
        self.set_name("flexible_arm")
        self.rod = rod
        self._motion, self._period, self._size = RodMotion(rod, period), period, 4 * rod.modes
        self._arm, self._has_velocity = arm, base_motion == "velocity"
        self._links = Remembered(arm.link_poses)
        self._pose = self.DeclareVectorInputPort("base_pose", 7)
        self._velocity = self.DeclareVectorInputPort("base_velocity", 6)
        self._joints = self.DeclareVectorInputPort("joint_state", 2 * arm.count)
        is_known = base_pose is not None
        pose = np.asarray(base_pose, dtype=float).tolist() if is_known else list(_AT_ORIGIN)
        groups = self._rest(pose, [0.0] * arm.count, is_known=is_known)
        state, *forces = (self.DeclareDiscreteState(np.array(group)) for group in groups)
        rods = {self.discrete_state_ticket(state)}
        now = rods | {self._pose.ticket(), self._joints.ticket()}
        moving = now | {self._velocity.ticket()} if self._has_velocity else now
        for name, size, calc, tickets in (
            ("tip_pose", 7, self._calc_tip_pose, now),
            ("tip_velocity", 6, self._calc_tip_velocity, moving),
            ("clamp_pose", 7, self._calc_clamp_pose, now),
            ("deflection", 3, self._calc_deflection, rods),
            ("modal_state", self._size, self._calc_modal_state, rods),
        ):
            self.DeclareVectorOutputPort(name, size, calc, tickets)
        # Copied in C++, as often as a plant steps.
        for name, index in zip(("wrench", "bending_force"), forces, strict=True):
            self.DeclareStateOutputPort(name, index)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def set_rest(
        self, context: Context, base_pose: ArrayLike, position: Sequence[float] = ()
    ) -> None:
        """Puts the rod at rest on a base at rest.

        Args:
            context: context of this system.
            base_pose: pose (7) of the base.
            position: positions (n) of the joints [rad or m]; empty: zero.
        """
        pose = np.asarray(base_pose, dtype=float).tolist()
        rest = self._rest(pose, list(position) or [0.0] * self._arm.count, is_known=True)
        for index, group in enumerate(rest):
            context.SetDiscreteState(index, np.array(group))

    def _rest(self, pose: list[float], position: list[float], is_known: bool) -> list[list[float]]:
        """Groups of the state of a rod at rest."""
        clamp = self._clamp_at(pose, position)
        force = Axes.from_quaternion(clamp[:4]).components(_UPWARDS)
        modal = self._motion.rest(force)
        base = [*clamp, *_STILL, *_STILL, float(is_known), *force, *_STILL, *_STILL]
        return [modal + base, *self._forces(modal, base, pose, position)]

    def _clamp_at(self, pose: Sequence[float], position: list[float]) -> list[float]:
        """Pose (7) of the clamp in the world."""
        if not self._arm.count:
            return list(pose)
        *quaternion, x, y, z = pose
        place, rotation = self._links(position)[-1]
        turned = quaternions.of_axes(list(zip(*rotation, strict=True)))
        there = Axes.from_quaternion(quaternion).in_world(place)
        return [*quaternions.product(quaternion, turned), *plus((x, y, z), there)]

    def _velocity_at(
        self, pose: list[float], velocity: list[float], joints: list[float]
    ) -> list[float]:
        """Velocity (6) of the clamp in the world."""
        count = self._arm.count
        if not count:
            return velocity
        axes, links = Axes.from_quaternion(pose[:4]), self._links(joints[:count])
        clamp = links[-1].place
        turning, moving = _STILL, _STILL
        for joint, link, rate in zip(self._arm.joints, links, joints[count:], strict=True):
            along = rotated(link.rotation, scaled(joint.axis, rate))
            if joint.kind == "revolute":
                turning = plus(turning, along)
                moving = plus(moving, cross(along, minus(clamp, link.place)))
            else:
                moving = plus(moving, along)
        w_x, w_y, w_z, v_x, v_y, v_z = velocity
        carried = cross((w_x, w_y, w_z), axes.in_world(clamp))
        angular = plus((w_x, w_y, w_z), axes.in_world(turning))
        linear = plus(plus((v_x, v_y, v_z), carried), axes.in_world(moving))
        return [*angular, *linear]

    def _forces(
        self, modal: list[float], base: list[float], pose: list[float], position: list[float]
    ) -> tuple[list[float], list[float]]:
        """Numbers of `wrench` and `bending_force`."""
        motion, links = _motion_in(base), self._links(position)
        bending = self._motion.bending_wrench(modal, motion)
        rigid = self._motion.rigid_wrench(motion)
        place = _STILL
        if links:
            place, rotation = links[-1]
            bending = rotated(rotation, bending[0]), rotated(rotation, bending[1])
            rigid = rotated(rotation, rigid[0]), rotated(rotation, rigid[1])
        moment, force = bending
        efforts = []
        for joint, link in zip(self._arm.joints, links, strict=True):
            axis = rotated(link.rotation, joint.axis)
            if joint.kind == "revolute":
                about = plus(moment, cross(minus(place, link.place), force))
                efforts.append(dot(axis, about))
            else:
                efforts.append(dot(axis, force))
        moment = plus(moment, cross(place, force))
        axes = Axes.from_quaternion(pose[:4])
        bent = [*axes.in_world(moment), *axes.in_world(force), *efforts]
        stiff = plus(rigid[0], cross(place, rigid[1]))
        return [*plus(moment, stiff), *plus(force, rigid[1])], bent

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        state = elements(context.get_discrete_state(_RODS))
        modal, base = state[: self._size], state[self._size :]
        pose, joints = read(self._pose, context), read(self._joints, context)
        position = joints[: self._arm.count]
        if not base[_IS_KNOWN] > 0.5:
            if _is_sane(pose, joints):
                rest = self._rest(pose, position, is_known=True)
                for index, group in enumerate(rest):
                    discrete_state.set_value(index, np.array(group))
            return
        velocity = read(self._velocity, context) if self._has_velocity else [0.0] * 6
        if _is_sane(pose, joints, velocity):
            clamp, h = self._clamp_at(pose, position), self._period
            if self._has_velocity:
                velocity = self._velocity_at(pose, velocity, joints)
            else:
                last = base[_POSE]
                turn = quaternions.turn_between(last[:4], clamp[:4])
                way = [now - before for now, before in zip(clamp[4:], last[4:], strict=True)]
                velocity = [change / h for change in (*turn, *way)]
            gained = zip(velocity, base[_VELOCITY], strict=True)
            spin_x, spin_y, spin_z, *felt = [(now - last) / h for now, last in gained]
            felt[2] += GRAVITY
            axes = Axes.from_quaternion(clamp[:4])
            parts = map(axes.components, (felt, velocity[:3], (spin_x, spin_y, spin_z)))
            base = [*clamp, *velocity, 1.0, *(number for part in parts for number in part)]
        else:
            clamp = base[_POSE]
            felt = list(Axes.from_quaternion(clamp[:4]).components(_UPWARDS))
            base = [*clamp, *_STILL, *_STILL, 1.0, *felt, *_STILL, *_STILL]
        modal = self._motion.step(modal, _motion_in(base))
        discrete_state.set_value(_RODS, np.array(modal + base))
        turned = pose if any(pose[:4]) else list(_AT_ORIGIN)
        for index, force in zip(
            (_WRENCH, _BENDING), self._forces(modal, base, turned, position), strict=True
        ):
            if all(map(math.isfinite, force)):
                discrete_state.set_value(index, np.array(force))

    def _tip(self, context: Context) -> tuple[Tip, Vector3, list[float]]:
        """Tip against a straight rod's, its place from the clamp, and the clamp's pose now."""
        state = elements(context.get_discrete_state(_RODS))
        tip = self._motion.tip(state[: self._size], _motion_in(state[self._size :]))
        position = read(self._joints, context)[: self._arm.count]
        x, y, z = tip.place
        place = x, y, z + self._motion.rod.length
        return tip, place, self._clamp_at(read(self._pose, context), position)

    def _calc_tip_pose(self, context: Context, output: BasicVector) -> None:
        tip, place, (*quaternion, x, y, z) = self._tip(context)
        turned = quaternions.product(quaternion, quaternions.of_turn(tip.turn))
        there = plus((x, y, z), Axes.from_quaternion(quaternion).in_world(place))
        output.SetFromVector(np.array([*turned, *there]))

    def _calc_tip_velocity(self, context: Context, output: BasicVector) -> None:
        tip, place, clamp = self._tip(context)
        if self._has_velocity:
            pose, velocity = read(self._pose, context), read(self._velocity, context)
            velocity = self._velocity_at(pose, velocity, read(self._joints, context))
        else:
            velocity = elements(context.get_discrete_state(_RODS))[self._size :][_VELOCITY]
        axes = Axes.from_quaternion(clamp[:4])
        w_x, w_y, w_z, v_x, v_y, v_z = velocity
        turning = w_x, w_y, w_z
        moving = plus(cross(turning, axes.in_world(place)), axes.in_world(tip.velocity))
        angular = plus(turning, axes.in_world(tip.turning))
        output.SetFromVector(np.array([*angular, *plus((v_x, v_y, v_z), moving)]))

    def _calc_clamp_pose(self, context: Context, output: BasicVector) -> None:
        position = read(self._joints, context)[: self._arm.count]
        output.SetFromVector(np.array(self._clamp_at(read(self._pose, context), position)))

    def _calc_deflection(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state(_RODS))
        tip = self._motion.tip(state[: self._size], _motion_in(state[self._size :]))
        output.SetFromVector(np.array(tip.place))

    def _calc_modal_state(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state(_RODS))
        output.SetFromVector(np.array(state[: self._size]))


def _is_sane(pose: list[float], *motions: list[float]) -> bool:
    """Check that a pose and its derivatives are finite, and not absurdly large."""
    numbers = (number for part in (pose, *motions) for number in part)
    return any(pose[:4]) and sum(map(abs, numbers)) < _ABSURD


def _motion_in(base: list[float]) -> ClampMotion:
    """Motion of the clamp in the last step."""
    f_x, f_y, f_z, w_x, w_y, w_z, a_x, a_y, a_z = base[_MOTION]
    return ClampMotion((f_x, f_y, f_z), (w_x, w_y, w_z), (a_x, a_y, a_z))
