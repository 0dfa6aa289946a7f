"""Serial arm on a platform: pose and Jacobian of its tip, its centre of mass, its dynamics.

Elementwise functions (floats in a tick, arrays in a batch) on vectors that are tuples of
components. Frames follow Denavit and Hartenberg's idea with any axes: link i moves with joint i,
whose frame stands in link i - 1, or in the platform, at a fixed place. The dynamics are the
recursive Newton-Euler equations, in the frames of the links.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from parapod.systems.core.elementwise import Elementwise, sin_cos
from parapod.systems.core.triples import Vector3, cross, dot, minus, plus, scaled

type Rotation = tuple[Vector3, Vector3, Vector3]

_ORIGIN = (0.0, 0.0, 0.0)
_SAME = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
# Times that the weight is worked out where the joints are then: each leaves about a thousandth of
# what the usual drive gives way.
_YIELDS = 2
# Length of an axis that differs from 1 by more is a mistake [-].
_UNIT = 1e-9


@dataclass(frozen=True)
class ArmLink:
    """Body of a link, about the axes of its frame.

    Attributes:
        mass: [kg].
        centre: centre of mass in the link's frame [m].
        inertia: moments and products xx, yy, zz, xy, xz, yz about the centre of mass [kg m^2].
    """

    mass: float = 0.0
    centre: Vector3 = _ORIGIN
    inertia: tuple[float, float, float, float, float, float] = (0.0,) * 6


@dataclass(frozen=True)
class ArmJoint:
    """Joint that moves a link against the one before it.

    Attributes:
        name: its name.
        place: origin of its frame in the frame of the link before it [m]; for the first joint,
            from the platform's centre F.
        rotation: rows of the matrix that turns vectors of its frame to those of the link before
            it, where the joint is at zero.
        axis: unit vector about which it turns, or along which it slides, in its frame.
        kind: "revolute" or "prismatic".
        lower: smallest position [rad or m].
        upper: largest position [rad or m].
        compliance: way that it gives behind its drive, by the drive's effort [rad/(N m) or m/N].
    """

    name: str
    place: Vector3 = _ORIGIN
    rotation: Rotation = _SAME
    axis: Vector3 = (0.0, 0.0, 1.0)
    kind: Literal["revolute", "prismatic"] = "revolute"
    lower: float = -math.inf
    upper: float = math.inf
    compliance: float = 0.0

    def __post_init__(self) -> None:
        if abs(dot(self.axis, self.axis) - 1.0) > _UNIT:
            raise ValueError(f"the axis of joint {self.name!r} must have length 1")

    @property
    def unit(self) -> str:
        """Unit of its positions."""
        return "rad" if self.kind == "revolute" else "m"

    def shown(self, position: float) -> str:
        """A position for people, in degrees or millimetres."""
        if self.kind == "revolute":
            return f"{math.degrees(position):.0f} deg"
        return f"{1e3 * position:.0f} mm"

    @cached_property
    def _terms(self) -> tuple[tuple[float, float, float], ...]:
        """Elements of the rotation, row by row: constant, by the sine, by 1 - cosine."""
        rotation: NDArray[np.float64] = np.array(self.rotation)
        x, y, z = self.axis
        turning = rotation @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        bending = turning @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        columns = (part.ravel().tolist() for part in (rotation, turning, bending))
        return tuple(zip(*columns, strict=True))

    def rotation_at(self, position: Elementwise) -> Rotation:
        """Rows of the matrix that turns vectors of its link to those of the link before it."""
        if self.kind != "revolute":
            return self.rotation
        sine, _ = sin_cos(position)
        half, _ = sin_cos(0.5 * position)
        versine = 2.0 * half * half
        a, b, c, d, e, f, g, h, i = [p + q * sine + r * versine for p, q, r in self._terms]
        return (a, b, c), (d, e, f), (g, h, i)

    def origin_at(self, position: Elementwise) -> Vector3:
        """Origin of the frame of its link in that of the link before it [m]."""
        if self.kind == "revolute":
            return self.place
        return plus(self.place, rotated(self.rotation, scaled(self.axis, position)))


class LinkPose(NamedTuple):
    """Pose of a link, or of the tip, in the platform's frame.

    Attributes:
        place: origin from the platform's centre F [m].
        rotation: rows of the matrix that turns vectors of its frame to the platform's.
    """

    place: Vector3
    rotation: Rotation


class ArmReaction(NamedTuple):
    """Efforts of an arm's drives and its wrench on the platform.

    Attributes:
        force: force of the arm on the platform, in the platform's frame [N].
        moment: its moment about the platform's centre F [N m].
        efforts: efforts (n) of the joints' drives, positive along the joints [N m or N].
    """

    force: Vector3
    moment: Vector3
    efforts: tuple[Elementwise, ...]


@dataclass(frozen=True)
class SerialArm:
    """Chain of n joints and links on a platform; without joints there is no arm.

    Positions, rates and accelerations of the joints are sequences (n), each element a number or
    an array of a batch; so are the results' components.

    Attributes:
        joints: its joints, from the platform to the tip.
        links: its links, each moved by the joint of the same index.
        tip_place: place of the tip in the last link's frame; without joints, from F [m].
        tip_rotation: rows of the matrix that turns vectors of the tip's frame to the last link's.

    Raises:
        ValueError: other than one link a joint.
    """

    joints: tuple[ArmJoint, ...] = ()
    links: tuple[ArmLink, ...] = ()
    tip_place: Vector3 = _ORIGIN
    tip_rotation: Rotation = _SAME

    def __post_init__(self) -> None:
        if len(self.joints) != len(self.links):
            raise ValueError(f"{len(self.joints)} joints must move as many links")

    @property
    def count(self) -> int:
        """Number n of its joints."""
        return len(self.joints)

    @cached_property
    def mass(self) -> float:
        """Mass of its links [kg]."""
        return sum(link.mass for link in self.links)

    def leaning(self, lean: Elementwise, turn: Elementwise = 0.0) -> tuple[Elementwise, ...]:
        """Positions (n) of the joints of an arm that leans, as a rod on a turntable does.

        The first joint turns it and the second one, or the only one, makes it lean; others stay.

        Args:
            lean: position of the joint that makes it lean [rad or m].
            turn: position of the joint before it [rad or m].
        """
        return (turn, lean, *(0.0,) * (self.count - 2)) if self.count > 1 else (lean,) * self.count

    def first_moment(self, position: Sequence[Elementwise]) -> Vector3:
        """Mass times centre of mass from the platform's centre F, in its frame [kg m].

        Args:
            position: positions (n) of the joints [rad or m].
        """
        mass, moment = 0.0, _ORIGIN
        for joint, link, q in zip(
            reversed(self.joints), reversed(self.links), reversed(position), strict=True
        ):
            mass += link.mass
            moment = plus(moment, scaled(link.centre, link.mass))
            moment = rotated(joint.rotation_at(q), moment)
            moment = plus(moment, scaled(joint.origin_at(q), mass))
        return moment

    def centre_of_mass(self, position: Sequence[Elementwise]) -> Vector3:
        """Centre of mass of an arm that has mass, from the platform's centre F [m].

        Args:
            position: positions (n) of the joints [rad or m].
        """
        return scaled(self.first_moment(position), 1.0 / self.mass)

    def link_poses(self, position: Sequence[Elementwise]) -> list[LinkPose]:
        """Poses (n) of the links in the platform's frame.

        Args:
            position: positions (n) of the joints [rad or m].
        """
        poses: list[LinkPose] = []
        place, rotation = _ORIGIN, _SAME
        for joint, q in zip(self.joints, position, strict=True):
            place = plus(place, rotated(rotation, joint.origin_at(q)))
            rotation = _product(rotation, joint.rotation_at(q))
            poses.append(LinkPose(place, rotation))
        return poses

    def tip_pose(self, position: Sequence[Elementwise]) -> LinkPose:
        """Pose of the tip in the platform's frame.

        Args:
            position: positions (n) of the joints [rad or m].
        """
        return self._tip([LinkPose(_ORIGIN, _SAME), *self.link_poses(position)][-1])

    def _tip(self, link: LinkPose) -> LinkPose:
        """Pose of the tip, the last link's being known."""
        rotation = _product(link.rotation, self.tip_rotation)
        return LinkPose(plus(link.place, rotated(link.rotation, self.tip_place)), rotation)

    def tip_jacobian(self, position: Sequence[Elementwise]) -> tuple[tuple[Elementwise, ...], ...]:
        """Jacobian (6 x n) of the tip's angular, then translational velocity, by rows.

        In the platform's frame [-, m] for joints that turn, [-, -] for those that slide.

        Args:
            position: positions (n) of the joints [rad or m].
        """
        _, columns = self.tip_motion(position)
        return tuple(zip(*columns, strict=True)) or ((),) * 6

    def tip_motion(
        self, position: Sequence[Elementwise]
    ) -> tuple[LinkPose, list[tuple[Elementwise, ...]]]:
        """Pose of the tip, and the columns (n) of its Jacobian (6), see `tip_jacobian`.

        Args:
            position: positions (n) of the joints [rad or m].
        """
        poses = self.link_poses(position)
        tip = self._tip(poses[-1] if poses else LinkPose(_ORIGIN, _SAME))
        columns = []
        for joint, pose in zip(self.joints, poses, strict=True):
            axis = rotated(pose.rotation, joint.axis)
            if joint.kind == "revolute":
                columns.append((*axis, *cross(axis, minus(tip.place, pose.place))))
            else:
                columns.append((*_ORIGIN, *axis))
        return tip, columns

    def bearing(self, payload: float) -> Self:
        """The arm with a mass more at its tip.

        Args:
            payload: the mass [kg].
        """
        if not payload or not self.links:
            return self
        *others, last = self.links
        mass = last.mass + payload
        centre = plus(scaled(last.centre, last.mass), scaled(self.tip_place, payload))
        x, y, z = minus(self.tip_place, last.centre)
        share = last.mass * payload / mass
        steiner = y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z
        xx, yy, zz, xy, xz, yz = (
            own + share * by for own, by in zip(last.inertia, steiner, strict=True)
        )
        heavier = ArmLink(mass, scaled(centre, 1.0 / mass), (xx, yy, zz, xy, xz, yz))
        return replace(self, links=(*others, heavier))

    def holding_efforts(
        self, position: Sequence[Elementwise], gravity: Vector3
    ) -> tuple[Elementwise, ...]:
        """Efforts (n) of drives that hold the arm at rest, positive along the joints [N m or N].

        Those of `reaction`, in two fifths of its time: the inverse kinematics ask for them often.

        Args:
            position: positions (n) of the joints [rad or m].
            gravity: acceleration of free fall in the platform's frame [m/s^2].
        """
        moved = list(zip(self.joints, position, strict=True))
        rotations = [joint.rotation_at(q) for joint, q in moved]
        pulls, pull = [], gravity
        for rotation in rotations:
            pull = turned_back(rotation, pull)
            pulls.append(pull)
        mass, moment = 0.0, _ORIGIN
        efforts: list[Elementwise] = []
        for i in reversed(range(self.count)):
            link, (joint, q) = self.links[i], moved[i]
            mass += link.mass
            moment = plus(moment, scaled(link.centre, link.mass))
            is_turning = joint.kind == "revolute"
            load = cross(moment, pulls[i]) if is_turning else scaled(pulls[i], mass)
            efforts.append(-dot(joint.axis, load))
            moment = plus(rotated(rotations[i], moment), scaled(joint.origin_at(q), mass))
        return tuple(reversed(efforts))

    @property
    def stiff(self) -> Self:
        """The arm with drives that do not give way."""
        joints = (replace(joint, compliance=0.0) for joint in self.joints)
        return replace(self, joints=tuple(joints))

    def yielded(
        self, position: Sequence[Elementwise], gravity: Vector3
    ) -> tuple[Elementwise, ...]:
        """Positions (n) of the joints at rest behind drives that give way [rad or m].

        Args:
            position: positions (n) of the drives [rad or m].
            gravity: acceleration of free fall in the platform's frame [m/s^2].
        """
        behind = tuple(position)
        if not any(joint.compliance for joint in self.joints):
            return behind
        for _ in range(_YIELDS):
            efforts = self.holding_efforts(behind, gravity)
            parts = zip(position, self.joints, efforts, strict=True)
            behind = tuple(q - joint.compliance * effort for q, joint, effort in parts)
        return behind

    def reaction(
        self,
        position: Sequence[Elementwise],
        rate: Sequence[Elementwise],
        acceleration: Sequence[Elementwise],
        gravity: Vector3,
    ) -> ArmReaction:
        """Wrench of the moving arm on a platform at rest, and efforts of its drives.

        Args:
            position: positions (n) of the joints [rad or m].
            rate: [rad/s or m/s].
            acceleration: [rad/s^2 or m/s^2].
            gravity: acceleration of free fall in the platform's frame [m/s^2].
        """
        moved = list(zip(self.joints, position, strict=True))
        rotations = [joint.rotation_at(q) for joint, q in moved]
        origins = [joint.origin_at(q) for joint, q in moved]
        spin, bend = _ORIGIN, _ORIGIN
        pull = scaled(gravity, -1.0)  # acceleration of the frame's origin, gravity included
        loads = []
        for joint, link, rotation, origin, v, a in zip(
            self.joints, self.links, rotations, origins, rate, acceleration, strict=True
        ):
            pull = turned_back(rotation, plus(pull, _rigid(spin, bend, origin)))
            spin, bend = turned_back(rotation, spin), turned_back(rotation, bend)
            along = scaled(joint.axis, v)
            if joint.kind == "revolute":
                bend = plus(bend, plus(scaled(joint.axis, a), cross(spin, along)))
                spin = plus(spin, along)
            else:
                coriolis = scaled(cross(spin, along), 2.0)
                pull = plus(pull, plus(scaled(joint.axis, a), coriolis))
            force = scaled(plus(pull, _rigid(spin, bend, link.centre)), link.mass)
            turning = plus(
                _by_inertia(link.inertia, bend), cross(spin, _by_inertia(link.inertia, spin))
            )
            loads.append((force, plus(turning, cross(link.centre, force))))
        force, moment = _ORIGIN, _ORIGIN
        efforts: list[Elementwise] = []
        for joint, rotation, origin, load in reversed(
            list(zip(self.joints, rotations, origins, loads, strict=True))
        ):
            force, moment = plus(force, load[0]), plus(moment, load[1])
            efforts.append(dot(joint.axis, moment if joint.kind == "revolute" else force))
            force, moment = rotated(rotation, force), rotated(rotation, moment)
            moment = plus(moment, cross(origin, force))
        return ArmReaction(scaled(force, -1.0), scaled(moment, -1.0), tuple(reversed(efforts)))


def _rigid(spin: Vector3, bend: Vector3, point: Vector3) -> Vector3:
    """Acceleration of a point of a body against its origin."""
    return plus(cross(bend, point), cross(spin, cross(spin, point)))


def _by_inertia(inertia: tuple[float, ...], vector: Vector3) -> Vector3:
    xx, yy, zz, xy, xz, yz = inertia
    x, y, z = vector
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


def rotated(rotation: Rotation, vector: Vector3) -> Vector3:
    """A vector turned by a rotation, which is given by its rows."""
    if rotation is _SAME or vector is _ORIGIN:
        return vector
    (a, b, c), (d, e, f), (g, h, i) = rotation
    x, y, z = vector
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def turned_back(rotation: Rotation, vector: Vector3) -> Vector3:
    """A vector turned by the inverse of a rotation, which is given by its rows."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    x, y, z = vector
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


def _product(a: Rotation, b: Rotation) -> Rotation:
    if a is _SAME or b is _SAME:
        return b if a is _SAME else a
    (p, q, r), (s, t, u), (v, w, x) = b
    first, second, third = (
        (c * p + d * s + e * v, c * q + d * t + e * w, c * r + d * u + e * x) for c, d, e in a
    )
    return first, second, third
