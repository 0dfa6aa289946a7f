"""Ways of platform and feet from rest to rest, within limits of speed."""

import math
from dataclasses import dataclass

import numpy as np

from parapod.systems.core.elementwise import Elementwise, greatest, least
from parapod.systems.core.motion_laws import quintic
from parapod.systems.core.rows import values_of
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.platform_mode import displacement, moved, moved_alone

# Largest speed and acceleration of a quintic from rest to rest, by way and duration [-].
_SPEED, _ACCELERATION = 1.875, 10.0 / math.sqrt(3.0)
# Shares of a swing's duration: in which the foot rises, and from and to which it goes across.
_RISING, _ACROSS = 0.35, (0.2, 0.8)
_QUICKEST = 0.05  # [s]


@dataclass(frozen=True)
class Speeds:
    """Limits of speed.

    Attributes:
        rapid: speed of the platform between operations [m/s].
        turn: rate of its rotation [rad/s].
        feed: speed of the drill in the material [m/s].
        swing: mean speed of a foot [m/s].
        acceleration: acceleration of platform and feet [m/s^2].
        leg: largest rate of a leg's length [m/s].
    """

    rapid: float = 0.05
    turn: float = 0.2
    feed: float = 0.003
    swing: float = 0.03
    acceleration: float = 0.25
    leg: float = 0.15


def duration_of(start: Array, end: Array, speeds: Speeds, speed: float) -> float:
    """Duration of a way of the platform within the limits [s].

    Args:
        start: pose (6) [m, rad].
        end: pose (6).
        speeds: limits.
        speed: limit of the translation [m/s].
    """
    by = displacement(start, end)
    angle, way = float(np.linalg.norm(by[:3])), float(np.linalg.norm(by[3:]))
    return max(
        _QUICKEST,
        _SPEED * way / speed,
        _SPEED * angle / speeds.turn,
        math.sqrt(_ACCELERATION * way / speeds.acceleration),
    )


def platform_at(start: Array, by: Array, share: Elementwise) -> Array:
    """Pose (6) on a straight way, turning about one axis, at a share of the time.

    Args:
        start: pose (6) where it begins, or one of each row (rows, 6) [m, rad].
        by: `displacement` (6) to where it ends, of each row too.
        share: share of the duration that has passed.
    """
    within = least(greatest(share, 0.0), 1.0)
    return _advanced(start, by, quintic(np.array(values_of(within)))[0])


def _advanced(start: Array, by: Array, progress: Array) -> Array:
    way = progress[..., np.newaxis] * by
    return moved(start, way) if start.ndim == 1 else moved_alone(start, way)


def swing_duration(start: Array, end: Array, lift: float, speeds: Speeds) -> float:
    """Duration of a foot's swing within the limits [s].

    Args:
        start: pose (6) of the foot [m, rad].
        end: pose (6).
        lift: height of the swing [m].
        speeds: limits.
    """
    by = displacement(start, end)
    across = _ACROSS[1] - _ACROSS[0]
    ways = (
        (float(np.linalg.norm(by[3:])), across),
        (lift, _RISING),
        (float(np.linalg.norm(by[:3])) * speeds.swing / speeds.turn, across),
    )
    # The foot already goes across while it still slows down on its way up.
    hardest = max(math.hypot(*(way / share**2 for way, share in ways[:2])), ways[2][0] / across**2)
    return max(
        *(_SPEED * way / speeds.swing / share for way, share in ways),
        math.sqrt(_ACCELERATION * hardest / speeds.acceleration),
        _QUICKEST,
    )


def foot_at(start: Array, end: Array, by: Array, lift: float, share: Elementwise) -> Array:
    """Pose (6) of a swinging foot at a share of the time: up, across, down.

    It leaves its foothold along that one's third axis, and comes down along the other's.

    Args:
        start: pose (6) of the foot where it begins, or one of each row (rows, 6) [m, rad].
        end: pose (6) where it ends, of each row too.
        by: `displacement` (6) from one to the other.
        lift: height of the swing [m].
        share: share of the duration that has passed.
    """
    begin, finish = _ACROSS
    across = np.clip(values_of((share - begin) / (finish - begin)), 0.0, 1.0)
    up = np.clip(values_of(least(share, 1.0 - share) / _RISING), 0.0, 1.0)
    (advance, raised), *_ = quintic(np.stack((across, up)))
    pose = _advanced(start, by, advance)
    advance, raised = advance[..., np.newaxis], raised[..., np.newaxis]
    out = (1.0 - advance) * _third_axis(start) + advance * _third_axis(end)
    pose[..., :3] += lift * raised * out
    return pose


def _third_axis(pose: Array) -> Array:
    angles = np.moveaxis(pose[..., 3:], -1, 0)
    (s_r, s_p, s_y), (c_r, c_p, c_y) = np.sin(angles), np.cos(angles)
    axis = (c_y * s_p * c_r + s_y * s_r, s_y * s_p * c_r - c_y * s_r, c_p * c_r)
    return np.stack(axis, axis=-1)
