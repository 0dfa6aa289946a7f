"""A mechanism pulled at a point: it follows as far as its loops and limits let it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.multibody.tree import Frame, JacobianWrtVariable

from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.mobility import null_space

type Floats = NDArray[np.float64]

# Longest pull in one step, by the mechanism's size, and how much joints resist it [-].
_LONGEST, _RESISTANCE = 0.05, 1e-2


def pulled(
    mechanism: Mechanism, q: ArrayLike, frame: Frame, point: ArrayLike, way: ArrayLike
) -> Floats:
    """Positions (q) after a point has been pulled, all loops closed and no limit exceeded further.

    Joints move as little as the pull needs. Those that would leave their limits stay.

    Args:
        mechanism: the mechanism.
        q: (q) positions, all loops closed.
        frame: frame that has the point.
        point: (3) the point in the frame [m].
        way: (3) way that it is pulled, along the world's axes [m]; a part of it is gone.
    """
    start, pull = np.array(q, dtype=float), np.asarray(way, dtype=float)
    pull = pull * min(1.0, _LONGEST * mechanism.size / max(float(np.linalg.norm(pull)), 1e-12))
    plant, context = mechanism.plant, mechanism.plant.CreateDefaultContext()
    plant.SetPositions(context, start)
    world = plant.world_frame()
    place = np.asarray(point, dtype=float).reshape(3, 1)
    moves = plant.CalcJacobianTranslationalVelocity(
        context, JacobianWrtVariable.kV, frame, place, world, world
    )
    scale = np.where(mechanism.is_length, mechanism.size, 1.0)
    loops, beyond = mechanism.loop_jacobian(start) * scale, mechanism.beyond_limits(start)
    stay: list[int] = []
    for _ in mechanism.joints:
        held = np.eye(len(scale))[stay]
        free = null_space(np.vstack((loops, held)), mechanism.nothing)
        reach = moves @ (scale[:, None] * free)
        resistance = _RESISTANCE * mechanism.size * np.eye(free.shape[1])
        goal = np.concatenate((pull, np.zeros(free.shape[1])))
        step = np.linalg.lstsq(np.vstack((reach, resistance)), goal)[0]
        ahead = mechanism.closed(mechanism.moved(start, scale * (free @ step)))
        if ahead is None:
            return start
        worse = [
            joint.velocity_start()
            for joint in mechanism.joints
            if mechanism.beyond_limits(ahead).get(mechanism.name(joint), 0.0)
            > beyond.get(mechanism.name(joint), 0.0) + 1e-9
        ]
        if not set(worse) - {*stay}:
            return ahead if not worse else start
        stay += worse
    return start
