"""Loops and couplings of a plant, which Drake's Python bindings take but do not return."""

from dataclasses import dataclass

from numpy.typing import ArrayLike
from pydrake.multibody.tree import Joint, RigidBody


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball joint that closes a loop: a point of one body is a point of another.

    Attributes:
        body: one body.
        point: the point (3) in its frame [m].
        other: the other body.
        other_point: the point (3) in the other's frame [m].
    """

    body: RigidBody
    point: ArrayLike
    other: RigidBody
    other_point: ArrayLike


@dataclass(frozen=True)
class Coupling:
    """A joint whose position is a multiple of another's.

    Attributes:
        joint: the joint.
        leader: the other joint.
        ratio: position of the joint by the leader's.
    """

    joint: Joint
    leader: Joint
    ratio: float
