"""An arm whose last link is a flexible rod, on a base that moves."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.rod_motion import NO_FORCE, ClampMotion, RodMotion, Tip
from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.core import quaternions
from parapod.systems.core.elementwise import sumprod
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import elements, read, read_or_zeros
from parapod.systems.core.remembered import Remembered
from parapod.systems.core.triples import Vector3, cross, minus, plus
from parapod.systems.core.vectors import Array, Axes

_UPWARDS = (0.0, 0.0, GRAVITY)  # specific force of what is at rest [m/s^2]
_STILL = (0.0, 0.0, 0.0)
# Quaternion (w, x, y, z) and place of a base at the world's origin.
_AT_ORIGIN = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_ABSURD = 1e12  # sum of squares of numbers that no base's motion has
# First group of the discrete state, and its numbers behind those of the modes: pose (7) and
# velocity (6) of the clamp at the last update, whether they are known (1), its motion and the
# force at the tip (12) in the last step, and whether the tip has its payload (1).
_RODS = 0
_POSE, _VELOCITY, _IS_KNOWN, _MOTION = slice(0, 7), slice(7, 13), 13, slice(14, 26)
_IS_LOADED = 26
type Force = Literal["wrench", "bending_force"]


class _Clamp(NamedTuple):
    """The rod's clamp on the arm's base, along the base's axes."""

    place: Vector3
    axes: Axes
    quaternion: quaternions.Quaternion
    columns: list[tuple[float, ...]]  # of its Jacobian (6), one a joint


class _Moved(NamedTuple):
    """The clamp a step after the last one."""

    axes: Axes  # of the arm's base
    clamp: _Clamp
    numbers: list[float]  # of the clamp, as the state has them
    motion: ClampMotion


class FlexibleArm(LeafSystem):
    """A rod that bends in two planes while platform and joints move its clamp.

    Use it behind any plant that has the same rod as a rigid body, and takes `bending_force`
    besides; or beside hardware, where it observes what no sensor on the rod measures.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `base_pose` | 7 | -, m | quaternion (w, x, y, z) and place of the arm's base |
    | in `base_velocity` | 6 | rad/s, m/s | its velocity, as far as `base_motion` says |
    | in `joint_state` | 2n | rad or m, and per s | positions and rates of the arm's joints |
    | in `payload` | 1 | kg | part of a payload's mass that the tip bears; unconnected: 0 |
    | out `tip_pose` | 7 | -, m | quaternion and place of the tip |
    | out `tip_velocity` | 6 | rad/s, m/s | its angular and linear velocity |
    | out `clamp_pose` | 7 | -, m | quaternion and place of the rod's clamp |
    | out `deflection` | 3 | m | tip from where a rigid rod has it, by the last link's axes |
    | out `modal_state` | 4m | - | coordinates in the planes of x and y, and their rates |
    | out `wrench` | 6 | N m, N | moment about the base and force of the rod, by the base's axes |
    | out `bending_force` | k | N m, N | generalized force of the bending, k = 6 + n |

    `forces` says which of the last two there are.

    The rod is clamped to the last link of an arm, along that link's z axis; without joints to the
    base itself. Poses and velocities are in the world's axes, where gravity is along -z. Angular
    velocities come before linear ones, and moments before forces, as in Drake. `bending_force`
    is what a rod that bends adds to a rigid one in the same motion: along the velocities of the
    base in the world, and along those of the joints.

    The step is that of `RodMotion`: exact for a motion of the clamp that is constant over it. It
    takes the mean acceleration of the step before, by the change of velocities or of poses. With
    velocities the rod is half a period ahead of an update, so that what it shows and what it does
    to a plant until the next one are those of the time between, without a delay; it goes this
    half as the clamp moved before, and is corrected once that motion is known.

    While `payload` is above zero all of the payload moves with the tip, and a force bears the rest
    of its weight: the rod has other modes then, into which its deflection is carried over.
    `modal_state` is in those of the rod without it.

    State: discrete, modal coordinates and their rates (4m), pose (7) and velocity (6) of the clamp
    at the last update, whether they are known (1), its motion and the force at the tip (12) in the
    last step, whether the tip has a payload (1); the forces that there are; updated every period.
    It begins at rest, sagging under its weight, on `base_pose` with the joints at `position`;
    without the former on the first pose that it is shown.

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
        forces: Sequence[Force] = ("wrench", "bending_force"),
        payload: float = 0.0,
        position: Sequence[float] = (),
    ):
        """Creates the system.

        Args:
            rod: the rod.
            period: length of a step [s].
            arm: the arm, to whose last link the rod is clamped; its links' masses do not count.
            base_pose: pose (7) of the base in a default context; None: unknown.
            base_motion: inputs that are read: the base's pose alone, or with its velocity.
            forces: outputs on a plant: each costs what it takes to work it out at every step.
            payload: mass of the payload that the tip may take [kg].
            position: positions (n) of the joints in a default context [rad or m]; empty: zero.

        Raises:
            ValueError: a rod that buckles under its own weight, or a mode above what the period
                carries.
        """
        super().__init__()
        self.set_name("flexible_arm")
        self.rod = rod
        self._period, self._size, self._payload = period, 4 * rod.modes, payload
        self._motion = self._loaded = RodMotion(rod, period)
        self._carried_over: list[Array] = []
        if payload > 0.0:
            loaded = replace(rod, tip_mass=rod.tip_mass + payload)
            self._loaded = RodMotion(loaded, period)
            self._carried_over = [
                np.asarray(np.kron(np.eye(4), one.coordinates_from(other)), dtype=float)
                for one, other in ((rod, loaded), (loaded, rod))
            ]
        self._count, self._has_velocity = arm.count, base_motion == "velocity"
        self._clamp = Remembered(functools.partial(_clamp_on, SerialArm(arm.joints, arm.links)))
        self._moved = functools.partial(_moved, self._clamp, period)
        self._force_names = tuple(forces)
        self._pose = self.DeclareVectorInputPort("base_pose", 7)
        self._velocity = self.DeclareVectorInputPort("base_velocity", 6)
        self._joints = self.DeclareVectorInputPort("joint_state", 2 * arm.count)
        self._mass = self.DeclareVectorInputPort("payload", 1)
        is_known = base_pose is not None
        pose = np.asarray(base_pose, dtype=float).tolist() if is_known else list(_AT_ORIGIN)
        joints = list(position) or [0.0] * arm.count
        groups = self._rest(pose, joints, is_known=is_known)
        state, *indices = (self.DeclareDiscreteState(np.array(group)) for group in groups)
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
        for name, index in zip(forces, indices, strict=True):
            self.DeclareStateOutputPort(name, index)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def set_rest(
        self,
        context: Context,
        base_pose: ArrayLike,
        position: Sequence[float] = (),
        modal_state: ArrayLike | None = None,
    ) -> None:
        """Puts the rod at rest, or as it bends, on a base at rest.

        Args:
            context: context of this system.
            base_pose: pose (7) of the base.
            position: positions (n) of the joints [rad or m]; empty: zero.
            modal_state: coordinates of the modes and their rates (4m); None: those at rest.
        """
        pose = np.asarray(base_pose, dtype=float).tolist()
        rest = self._rest(pose, list(position) or [0.0] * self._count, is_known=True)
        if modal_state is not None:
            rest[_RODS][: self._size] = np.asarray(modal_state, dtype=float).tolist()
        for index, group in enumerate(rest):
            context.SetDiscreteState(index, np.array(group))

    def _rest(self, pose: list[float], position: list[float], is_known: bool) -> list[list[float]]:
        """Groups of the state of a rod at rest."""
        axes, clamp = Axes.from_quaternion(pose[:4]), self._clamp(position)
        base = _at_rest(_placed(pose, axes, clamp), is_known)
        modal = self._motion.rest(base[_MOTION][:3])
        return [modal + base, *self._forces(self._motion, modal, _motion_in(base), axes, clamp)]

    def _forces(
        self,
        rod: RodMotion,
        modal: list[float],
        motion: ClampMotion,
        axes: Axes,
        clamp: _Clamp,
    ) -> list[list[float]]:
        """Numbers of the forces that there are."""
        if not self._force_names:
            return []
        moment, force = map(clamp.axes.in_world, rod.bending_wrench(modal, motion))
        if rod is not self._motion:
            # A plant's rigid rod has no payload.
            pairs = zip(rod.rigid_wrench(motion), self._motion.rigid_wrench(motion), strict=True)
            more_moment, more = (clamp.axes.in_world(minus(a, b)) for a, b in pairs)
            moment, force = plus(moment, more_moment), plus(force, more)
        about_base = plus(moment, cross(clamp.place, force))
        forces = []
        for name in self._force_names:
            if name == "wrench":
                stiff = self._motion.rigid_wrench(motion)
                rigid_moment, rigid = map(clamp.axes.in_world, stiff)
                rigid_moment = plus(rigid_moment, cross(clamp.place, rigid))
                forces.append([*plus(about_base, rigid_moment), *plus(force, rigid)])
            else:
                efforts = [sumprod(column, (*moment, *force)) for column in clamp.columns]
                forces.append([*axes.in_world(about_base), *axes.in_world(force), *efforts])
        return forces

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        state = elements(context.get_discrete_state(_RODS))
        modal, last = state[: self._size], state[self._size :]
        pose, joints = read(self._pose, context), read(self._joints, context)
        velocity = read(self._velocity, context) if self._has_velocity else []
        numbers = pose + joints + velocity
        is_sane = any(pose[:4]) and sumprod(numbers, numbers) < _ABSURD
        if not last[_IS_KNOWN] > 0.5:
            if is_sane:
                rest = self._rest(pose, joints[: self._count], is_known=True)
                for index, group in enumerate(rest):
                    discrete_state.set_value(index, np.array(group))
            return
        if is_sane:
            moved = self._moved(last, pose, joints, velocity)
        else:
            moved = self._resting(last, pose, joints)
        rod = self._rod(last)
        if self._has_velocity:
            modal = rod.corrected(modal, moved.motion, _motion_in(last))
        if self._payload:
            rod, modal, moved = self._with_payload(context, rod, modal, moved)
        modal = rod.step(modal, moved.motion)
        discrete_state.set_value(_RODS, np.array(modal + moved.numbers))
        forces = self._forces(rod, modal, moved.motion, moved.axes, moved.clamp)
        for index, force in enumerate(forces, start=_RODS + 1):
            if math.isfinite(sum(force)):
                discrete_state.set_value(index, np.array(force))

    def _rod(self, base: list[float]) -> RodMotion:
        """The rod, with the payload if the tip has it."""
        return self._loaded if base[_IS_LOADED] > 0.5 else self._motion

    def _with_payload(
        self, context: Context, rod: RodMotion, modal: list[float], moved: _Moved
    ) -> tuple[RodMotion, list[float], _Moved]:
        """Rod, modal coordinates and motion, with the payload if the tip has it now."""
        (borne,) = read_or_zeros(self._mass, context)
        is_loaded = borne > 0.0
        now = self._loaded if is_loaded else self._motion
        if now is not rod:
            modal = (self._carried_over[int(is_loaded)] @ np.array(modal)).tolist()
        numbers, motion = moved.numbers, moved.motion
        if is_loaded:
            lift = GRAVITY * max(self._payload - borne, 0.0)
            force = Axes.from_quaternion(numbers[:4]).components((0.0, 0.0, lift))
            numbers = [*numbers[: _MOTION.stop - 3], *force, 1.0]
            motion = motion._replace(tip_force=force if lift else NO_FORCE)
        return now, modal, moved._replace(numbers=numbers, motion=motion)

    def _resting(self, last: list[float], pose: list[float], joints: list[float]) -> _Moved:
        """A clamp that rests where it was, on a base of which no motion is known."""
        axes = Axes.from_quaternion(pose[:4] if any(pose[:4]) else _AT_ORIGIN[:4])
        numbers = _at_rest(last[_POSE])
        return _Moved(axes, self._clamp(joints[: self._count]), numbers, _motion_in(numbers))

    def _tip(self, context: Context) -> tuple[Tip, list[float], Vector3]:
        """Tip against a straight rod's, the clamp's pose now, and the tip's place from it."""
        tip = self._bent_tip(context)
        x, y, z = tip.place
        return tip, self._pose_now(context), (x, y, z + self.rod.length)

    def _bent_tip(self, context: Context) -> Tip:
        """Tip against a straight rod's."""
        state = elements(context.get_discrete_state(_RODS))
        modal, base = state[: self._size], state[self._size :]
        return self._rod(base).tip(modal, _motion_in(base))

    def _pose_now(self, context: Context) -> list[float]:
        """Pose (7) of the clamp."""
        pose, joints = read(self._pose, context), read(self._joints, context)
        return _placed(pose, Axes.from_quaternion(pose[:4]), self._clamp(joints[: self._count]))

    def _calc_tip_pose(self, context: Context, output: BasicVector) -> None:
        tip, (*quaternion, x, y, z), place = self._tip(context)
        turned = quaternions.product(quaternion, quaternions.of_turn(tip.turn))
        there = plus((x, y, z), Axes.from_quaternion(quaternion).in_world(place))
        output.SetFromVector(np.array([*turned, *there]))

    def _calc_tip_velocity(self, context: Context, output: BasicVector) -> None:
        tip, pose, place = self._tip(context)
        if self._has_velocity:
            base, joints = read(self._pose, context), read(self._joints, context)
            clamp, rates = self._clamp(joints[: self._count]), joints[self._count :]
            velocity = read(self._velocity, context)
            velocity = _velocity_at(Axes.from_quaternion(base[:4]), clamp, velocity, rates)
        else:
            velocity = elements(context.get_discrete_state(_RODS))[self._size :][_VELOCITY]
        axes = Axes.from_quaternion(pose[:4])
        w_x, w_y, w_z, v_x, v_y, v_z = velocity
        turning = w_x, w_y, w_z
        moving = plus(cross(turning, axes.in_world(place)), axes.in_world(tip.velocity))
        angular = plus(turning, axes.in_world(tip.turning))
        output.SetFromVector(np.array([*angular, *plus((v_x, v_y, v_z), moving)]))

    def _calc_clamp_pose(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._pose_now(context)))

    def _calc_deflection(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array(self._bent_tip(context).place))

    def _calc_modal_state(self, context: Context, output: BasicVector) -> None:
        state = elements(context.get_discrete_state(_RODS))
        modal = np.array(state[: self._size])
        if self._rod(state[self._size :]) is not self._motion:
            modal = self._carried_over[0] @ modal
        output.SetFromVector(modal)


def _clamp_on(arm: SerialArm, position: list[float]) -> _Clamp:
    """Clamp at the origin of an arm's last link."""
    (place, rotation), columns = arm.tip_motion(position)
    x, y, z = zip(*rotation, strict=True)
    axes = Axes(x, y, z)
    return _Clamp(place, axes, quaternions.of_axes(axes), columns)


def _placed(pose: Sequence[float], axes: Axes, clamp: _Clamp) -> list[float]:
    """Pose (7) of a clamp in the world on a base with these axes."""
    *quaternion, x, y, z = pose
    there = plus((x, y, z), axes.in_world(clamp.place))
    return [*quaternions.product(quaternion, clamp.quaternion), *there]


def _velocity_at(
    axes: Axes, clamp: _Clamp, velocity: list[float], rates: list[float]
) -> list[float]:
    """Velocity (6) of a clamp in the world."""
    w_x, w_y, w_z, v_x, v_y, v_z = velocity
    angular = w_x, w_y, w_z
    linear = plus((v_x, v_y, v_z), cross(angular, axes.in_world(clamp.place)))
    if any(rates):
        own = [sumprod(row, rates) for row in zip(*clamp.columns, strict=True)]
        angular = plus(angular, axes.in_world(own[:3]))
        linear = plus(linear, axes.in_world(own[3:]))
    return [*angular, *linear]


def _moved(
    clamp_on: Callable[[list[float]], _Clamp],
    period: float,
    last: list[float],
    base_pose: list[float],
    joints: list[float],
    base_velocity: list[float],
) -> _Moved:
    """The clamp a period after the last; without a velocity by the way since.

    Args:
        clamp_on: clamp by the joints' positions.
        period: [s].
        last: numbers of the clamp at the last update, as the state has them.
        base_pose: pose (7) of the base.
        joints: positions and rates (2n) of the joints.
        base_velocity: velocity (6) of the base; empty: unknown.
    """
    count = len(joints) // 2
    axes, clamp = Axes.from_quaternion(base_pose[:4]), clamp_on(joints[:count])
    pose = _placed(base_pose, axes, clamp)
    if base_velocity:
        velocity = _velocity_at(axes, clamp, base_velocity, joints[count:])
    else:
        x, y, z = last[4:7]
        turn = quaternions.turn_between(last[:4], pose[:4])
        way = pose[4] - x, pose[5] - y, pose[6] - z
        velocity = [change / period for change in (*turn, *way)]
    gained = zip(velocity, last[_VELOCITY], strict=True)
    spin_x, spin_y, spin_z, f_x, f_y, f_z = [(now - before) / period for now, before in gained]
    own = Axes.from_quaternion(pose[:4])
    motion = ClampMotion(
        own.components((f_x, f_y, f_z + GRAVITY)),
        own.components(velocity[:3]),
        own.components((spin_x, spin_y, spin_z)),
    )
    force, turning, spinning, _ = motion
    numbers = [*pose, *velocity, 1.0, *force, *turning, *spinning, *NO_FORCE, 0.0]
    return _Moved(axes, clamp, numbers, motion)


def _at_rest(clamp: list[float], is_known: bool = True) -> list[float]:
    """Numbers of a clamp that rests at a pose (7)."""
    force = Axes.from_quaternion(clamp[:4]).components(_UPWARDS)
    return [*clamp, *_STILL, *_STILL, float(is_known), *force, *_STILL, *_STILL, *NO_FORCE, 0.0]


def _motion_in(base: list[float]) -> ClampMotion:
    """Motion of the clamp in the last step."""
    f_x, f_y, f_z, w_x, w_y, w_z, a_x, a_y, a_z, *at_tip = base[_MOTION]
    p_x, p_y, p_z = at_tip
    tip_force = (p_x, p_y, p_z) if any(at_tip) else NO_FORCE
    return ClampMotion((f_x, f_y, f_z), (w_x, w_y, w_z), (a_x, a_y, a_z), tip_force)
