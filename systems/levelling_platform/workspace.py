"""Where the tip of the arm can be: section 4 of the paper, exact and in closed form.

Points are in frame {B}: its origin is the support point of the right back leg (leg 2), its axes
are those of the ground, so that on level ground they are the world's. The tip is

    t = R_GW R (P_2 + q) + (0, 0, r),

Eq. (13): P_2 is the vector from foot 2 to F, which depends on that leg's extension alone, and q
the vector from F to the tip, which is fixed in the platform; r is the roller's radius, R_GW turns
from gravity's axes to the ground's. Hence |t| gives the extension of leg 2, the direction of t
then gives roll and pitch, and these the other legs: no iteration. Leading dimensions are batch
dimensions and broadcast.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.elementwise import Elementwise, sin_cos
from parapod.systems.errors import UnreachablePosture
from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    posture_jacobian,
)
from parapod.systems.levelling_platform.leg import (
    extension_on_plane,
    foot_motion,
    foot_to_centre,
)
from parapod.systems.levelling_platform.plane import (
    Vector3,
    attitude_seeing,
    dot,
    normal_of,
    to_platform,
    to_world,
)

# Index of the leg on whose support point frame {B} has its origin: the right back one.
SUPPORT_LEG = 1
_LEVEL = (0.0, 0.0)

# What cannot be built or reached is NaN here by contract.
_nan_without_warning = np.errstate(invalid="ignore", divide="ignore")


@dataclass(frozen=True)
class ArmGeometry:
    """The arm on the platform, taken as rigid.

    Attributes:
        offset: from the platform's centre F to the arm's base, which is on the turntable's
            axis [m]. Not printed (Eq. (13) is lost): what fits the printed surfaces best.
        length: of the arm [m], section 4.
        lean: of the arm from upright, about the turntable's y axis [rad].
        turn: of the turntable about the platform's z axis; at zero the arm leans towards
            +x [rad].
    """

    offset: tuple[float, float, float] = (0.010, 0.020, 0.145)
    length: float = 2.02
    lean: float = 0.0
    turn: Elementwise = 0.0

    @property
    def p_FT(self) -> Vector3:
        """Vector from F to the tip, in the platform's frame [m]."""
        return self.point_at(1.0)

    def point_at(self, share: float) -> Vector3:
        """Vector from F to the point at that share of the arm's length, likewise [m]."""
        (sin_turn, cos_turn), (sin_lean, cos_lean) = sin_cos(self.turn), sin_cos(self.lean)
        x, y, z = self.offset
        length = share * self.length
        sideways = length * sin_lean
        return x + sideways * cos_turn, y + sideways * sin_turn, z + length * cos_lean


@_nan_without_warning
def tip_position(
    geometry: PlatformGeometry, arm: ArmGeometry, posture: ArrayLike, ground: ArrayLike = _LEVEL
) -> NDArray[np.float64]:
    """Tip of the arm in frame {B}, Eq. (13), for a posture.

    Args:
        geometry: the platform.
        arm: the arm.
        posture: (..., 3) roll, pitch, height [rad, rad, m].
        ground: (..., 2) roll and pitch of the ground [rad].

    Returns:
        (..., 3) [m]; NaN where leg 2 cannot reach the ground.
    """
    roll, pitch, height = _split(posture, 3, "posture")
    n = normal_of(*_split(ground, 2, "ground"))
    g = to_platform(n, roll, pitch)
    leg = geometry.legs[SUPPORT_LEG]
    extension = extension_on_plane(leg, g, height - leg.foot_radius)
    return _tip(geometry, arm, extension, (roll, pitch), ground)


@_nan_without_warning
def tip_of_extensions(
    geometry: PlatformGeometry, arm: ArmGeometry, extension: ArrayLike, ground: ArrayLike = _LEVEL
) -> NDArray[np.float64]:
    """Tip of the arm in frame {B}, Eq. (13), for the extensions of the active legs.

    Args:
        geometry: the platform.
        arm: the arm.
        extension: (..., 3) of legs 1..3, or (..., 4) of which the last does not count [m].
        ground: (..., 2) roll and pitch of the ground [rad].

    Returns:
        (..., 3) [m]; NaN where an extension cannot be built.
    """
    active = np.asarray(extension, dtype=float)[..., :3]
    four = np.concatenate([active, active[..., 2:]], axis=-1)
    posture = forward_kinematics(geometry, four, ground, legs=(0, 1, 2))
    attitude = posture[..., 0], posture[..., 1]
    return _tip(geometry, arm, active[..., SUPPORT_LEG], attitude, ground)


@_nan_without_warning
def tip_jacobian(
    geometry: PlatformGeometry, arm: ArmGeometry, posture: ArrayLike, ground: ArrayLike = _LEVEL
) -> NDArray[np.float64]:
    """Derivative of the tip by the posture; the determinant turns volumes of postures into m^3.

    Args:
        geometry: the platform.
        arm: the arm.
        posture: (..., 3) roll, pitch, height [rad, rad, m].
        ground: (..., 2) roll and pitch of the ground [rad].

    Returns:
        (..., 3, 3) matrix d(tip) / d(roll, pitch, height) [m/rad, m/rad, -].
    """
    roll, pitch, height = _split(posture, 3, "posture")
    inclination = _split(ground, 2, "ground")
    g = to_platform(normal_of(*inclination), roll, pitch)
    leg = geometry.legs[SUPPORT_LEG]
    foot, slope = foot_motion(leg, extension_on_plane(leg, g, height - leg.foot_radius))
    rates = posture_jacobian(geometry, posture, ground)[..., SUPPORT_LEG, :]
    w = tuple(p + q for p, q in zip(foot, arm.p_FT, strict=True))
    # R_y' R_x w and R_y R_x' w, seen by the world: rotations about y and about the turned x.
    x, y, z = to_world(w, roll, pitch)
    by_roll = to_world((0.0, -w[2], w[1]), roll, pitch)
    by_pitch = (z, 0.0 * y, -x)
    along = to_world(slope, roll, pitch)
    columns = []
    for i, turned in enumerate((by_roll, by_pitch, (0.0 * x, 0.0 * x, 0.0 * x))):
        moved = tuple(a + b * rates[..., i] for a, b in zip(turned, along, strict=True))
        columns.append(_join(to_platform(moved, *inclination)))
    return np.stack(columns, axis=-1)


@_nan_without_warning
def extensions_reaching(
    geometry: PlatformGeometry, arm: ArmGeometry, point: ArrayLike, ground: ArrayLike = _LEVEL
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Posture that puts the tip at a point, and the extensions it needs, within stroke or not.

    Args:
        geometry: the platform.
        arm: the arm.
        point: (..., 3) in frame {B} [m].
        ground: (..., 2) roll and pitch of the ground [rad].

    Returns:
        (..., 3) posture [rad, rad, m] and (..., 4) extensions [m]; NaN where there are none.
    """
    x, y, z = _split(point, 3, "point")
    inclination = _split(ground, 2, "ground")
    leg = geometry.legs[SUPPORT_LEG]
    t = to_world((x, y, z - leg.foot_radius), *inclination)
    q = arm.p_FT
    # P_2 is p_MF less a side s of fixed length, so |P_2 + q| = |t| is linear in s, as the
    # condition of a foot on a plane with the normal u = p_MF + q.
    u = tuple(p + q for p, q in zip(leg.p_MF, q, strict=True))
    across = dot(u, leg.p_MF) - 0.5 * (dot(u, u) + leg.l_4**2 - dot(t, t))
    foot = foot_to_centre(leg, extension_on_plane(leg, u, across))
    w = tuple(p + q for p, q in zip(foot, q, strict=True))
    roll, pitch = attitude_seeing(w, t)
    g = to_platform(normal_of(*inclination), roll, pitch)
    height = dot(g, foot)
    extension = [extension_on_plane(leg, g, height) for leg in geometry.legs]
    return _join((roll, pitch, height + leg.foot_radius)), _join(extension)


def stroke_left(
    geometry: PlatformGeometry, arm: ArmGeometry, point: ArrayLike, ground: ArrayLike = _LEVEL
) -> NDArray[np.float64]:
    """Stroke that the tightest leg has left with the tip at a point; negative out of reach.

    Args:
        geometry: the platform.
        arm: the arm.
        point: (..., 3) in frame {B} [m].
        ground: (..., 2) roll and pitch of the ground [rad].

    Returns:
        (...) [m]; minus infinity where no extension would do.
    """
    _, d = extensions_reaching(geometry, arm, point, ground)
    left = np.minimum(d - geometry.extension_min, geometry.extension_max - d).min(axis=-1)
    return np.where(np.isnan(left), -math.inf, left)


def reaches(
    geometry: PlatformGeometry, arm: ArmGeometry, point: ArrayLike, ground: ArrayLike = _LEVEL
) -> NDArray[np.bool_]:
    """Whether the tip can be at a point: exact membership in the workspace.

    Args:
        geometry: the platform.
        arm: the arm.
        point: (..., 3) in frame {B} [m].
        ground: (..., 2) roll and pitch of the ground [rad].

    Returns:
        (...); False for NaN.
    """
    return stroke_left(geometry, arm, point, ground) >= 0.0


def posture_reaching(
    geometry: PlatformGeometry, arm: ArmGeometry, point: ArrayLike, ground: ArrayLike = _LEVEL
) -> NDArray[np.float64]:
    """Posture that puts the tip at a point that the legs can reach.

    Args:
        geometry: the platform.
        arm: the arm.
        point: (..., 3) in frame {B} [m].
        ground: (..., 2) roll and pitch of the ground [rad].

    Returns:
        (..., 3) posture [rad, rad, m].

    Raises:
        UnreachablePosture: a leg would leave its stroke; names the worst leg.
        ValueError: wrong shapes.
    """
    posture, extension = extensions_reaching(geometry, arm, point, ground)
    lost = np.isnan(extension[..., SUPPORT_LEG])
    if lost.any():
        index = tuple(int(i) for i in np.argwhere(lost)[0])
        stroke = geometry.extension_min, geometry.extension_max
        raise UnreachablePosture(SUPPORT_LEG + 1, math.nan, stroke, index or None)
    inverse_kinematics(geometry, posture, ground)
    return posture


def _tip(
    geometry: PlatformGeometry,
    arm: ArmGeometry,
    extension: Elementwise,
    attitude: tuple[Elementwise, Elementwise],
    ground: ArrayLike,
) -> NDArray[np.float64]:
    leg = geometry.legs[SUPPORT_LEG]
    foot = foot_to_centre(leg, extension)
    w = tuple(p + q for p, q in zip(foot, arm.p_FT, strict=True))
    x, y, z = to_platform(to_world(w, *attitude), *_split(ground, 2, "ground"))
    return _join((x, y, z + leg.foot_radius))


def _split(value: ArrayLike, width: int, name: str) -> tuple[NDArray[np.float64], ...]:
    array = np.asarray(value, dtype=float)
    if array.ndim == 0 or array.shape[-1] != width:
        raise ValueError(f"{name} must have shape (..., {width}), not {array.shape}")
    return tuple(array[..., i] for i in range(width))


def _join(columns: "tuple[Elementwise, ...] | list[Elementwise]") -> NDArray[np.float64]:
    return np.stack(np.broadcast_arrays(*columns), axis=-1)
