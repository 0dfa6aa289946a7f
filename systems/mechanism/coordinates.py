"""Coordinates in which a mechanism is led: parts of the pose of one of its links."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from pydrake.multibody.tree import Joint

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.quoting import did_you_mean, quoted
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.mobility import independent_rows
from parapod.systems.physics.loops import Coupling

# Parts of a pose, as `pose_vector` has them.
PARTS = ("x", "y", "z", "roll", "pitch", "yaw")
_LENGTHS = 3  # number of lengths among them, which come first


def part_unit(part: int) -> tuple[str, float]:
    """Unit of a part of a pose for people, and its factor."""
    return ("mm", 1e3) if part < _LENGTHS else ("deg", math.degrees(1.0))


def joint_unit(mechanism: Mechanism, joint: Joint) -> tuple[str, float]:
    """Unit of a joint's position for people, and its factor."""
    is_length = mechanism.is_length[joint.velocity_start()]
    return ("mm", 1e3) if is_length else ("deg", math.degrees(1.0))


def last_link(mechanism: Mechanism) -> str:
    """The link that motors govern most freely, and of these the one on which most loops end."""
    ends = Counter(
        int(end.index())
        for loop in mechanism.loops
        if not isinstance(loop, Coupling)
        for end in (loop.body, loop.other)
    )
    plant, best, name = mechanism.plant, (-1, -1, 0.0), ""
    instance = mechanism.joints[0].child_body().model_instance()
    for body in (plant.get_body(i) for i in plant.GetBodyIndices(instance)):
        freedoms = len(mechanism.free_parts(body.name()))
        ended = sum(ends[int(other.index())] for other in plant.GetBodiesWeldedTo(body))
        score = freedoms, ended, body.default_mass()
        if score > best:
            best, name = score, body.name()
    return name


def free_coordinates(
    mechanism: Mechanism, frame: str, names: Sequence[str] = ()
) -> tuple[int, ...]:
    """Parts of a frame's pose in which it is led, by their places in `PARTS`.

    Args:
        mechanism: the mechanism.
        frame: name of the frame.
        names: their names; empty: those that the motors can set.

    Raises:
        ScenarioError: a name that no part has, or parts that the motors cannot set each for
            itself.
    """
    if not names:
        return mechanism.free_parts(frame)
    for name in names:
        if name not in PARTS:
            hint = did_you_mean(name, PARTS)
            raise ScenarioError(f"{quoted(name)} is not one of {', '.join(PARTS)}{hint}")
    parts = tuple(sorted(PARTS.index(name) for name in set(names)))
    usual = mechanism.free_parts(frame)
    moves = mechanism.frame_jacobian(frame, mechanism.home)
    scale = np.where(mechanism.is_length[mechanism.motor_columns], mechanism.size, 1.0)
    moves = np.vstack((moves[3:] / mechanism.size, moves[:3])) * scale
    moves[mechanism.idle_parts(frame)] = 0.0
    free = independent_rows(moves[list(parts)], mechanism.nothing)
    if len(free) < len(parts) or len(parts) != len(usual):
        raise ScenarioError(
            f"the motors cannot set {', '.join(PARTS[part] for part in parts)} of {frame} each "
            f"for itself: it has {len(usual)} freedoms, such as "
            f"{', '.join(PARTS[part] for part in usual)}"
        )
    return parts
