"""How a platform comes to rest on legs that do not stand in one plane."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.legs_to_posture import forward_kinematics
from parapod.systems.levelling_platform.plane import (
    Vector3,
    dot,
    minus,
    normal_of,
    normal_through,
    scaled,
    to_platform,
    upwards,
)

# A foot that is deeper than this is not on the ground but in it [m].
_TOUCHING = 1e-9


def resting_posture(
    geometry: PlatformGeometry,
    extension: ArrayLike,
    ground: ArrayLike,
    foot_offsets: ArrayLike = (0.0, 0.0, 0.0, 0.0),
) -> NDArray[np.float64]:
    """Posture of a rigid platform at rest on the three legs that carry it.

    Four legs of any lengths do not stand in one plane: one foot is in the air, an end of the
    shorter diagonal. Of its two ends it is the one on the far side of the weight, which is taken
    to act at the centre F.

    Args:
        geometry: the platform.
        extension: (4) actuator extensions [m].
        ground: (2) roll and pitch of the ground [rad].
        foot_offsets: (4) how far each foot stands above the ground's plane [m].

    Returns:
        (3) roll, pitch [rad], height [m].
    """
    d = np.asarray(extension, dtype=float).tolist()
    o = np.asarray(foot_offsets, dtype=float).tolist()
    normal = normal_of(*np.asarray(ground, dtype=float).tolist())
    feet = [foot_to_centre(leg, d[i]) for i, leg in enumerate(geometry.legs)]
    best, posture = -np.inf, np.full(3, np.nan)
    for lifted in range(LEG_COUNT):
        legs = [(lifted + k) % LEG_COUNT for k in (1, 2, 3)]
        standing = forward_kinematics(geometry, extension, ground, legs, foot_offsets)
        roll, pitch, height = standing.tolist()
        g = to_platform(normal, roll, pitch)
        sunk = dot(g, feet[lifted]) + o[lifted] - (height - geometry.foot_radius)
        down = scaled(upwards(roll, pitch), -1.0)
        share = _share_of_middle(feet[legs[0]], feet[legs[1]], feet[legs[2]], down)
        if sunk <= _TOUCHING and share > best:
            best, posture = share, standing
    return posture


def _share_of_middle(a: Vector3, b: Vector3, c: Vector3, down: Vector3) -> float:
    """Share of a weight at F that the second of three feet carries.

    Args:
        a: vector from the first foot to F; b and c likewise.
        b: in the middle between a and c.
        c: see a.
        down: direction of gravity, in the frame of the others.
    """
    normal, _ = normal_through(a, b, c)
    # Feet are at minus these vectors; F's weight meets their plane at `fall` times `down`.
    fall = -dot(normal, a) / dot(normal, down)
    x, y = a[0] + fall * down[0], a[1] + fall * down[1]
    side, edge = minus(b, a), minus(c, a)
    share: float = (edge[1] * x - edge[0] * y) / (edge[0] * side[1] - edge[1] * side[0])
    return share
