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

from parapod.systems.batching import of_width
from parapod.systems.elementwise import Elementwise, nan_without_warning, sin_cos
from parapod.systems.errors import UnreachablePosture
from parapod.systems.levelling_platform.geometry import ARM_BASE, LegGeometry, PlatformGeometry
from parapod.systems.levelling_platform.leg import (
    extension_on_plane,
    foot_motion,
    foot_to_centre,
)
from parapod.systems.levelling_platform.legs_to_posture import forward_kinematics
from parapod.systems.levelling_platform.plane import (
    Vector3,
    attitude_seeing,
    dot,
    normal_of,
    plus,
    scaled,
    to_platform,
    to_world,
)
from parapod.systems.levelling_platform.posture_to_legs import inverse_kinematics, posture_jacobian

# Index of the leg on whose support point frame {B} has its origin: the right back one.
SUPPORT_LEG = 1


@dataclass(frozen=True)
class ArmGeometry:
    """The arm on the platform, taken as rigid.

    Attributes:
        offset: from the platform's centre F to the arm's base, which is on the turntable's
            axis [m].
        length: of the arm [m], section 4.
        lean: of the arm from upright, about the turntable's y axis [rad].
        turn: of the turntable about the platform's z axis; at zero the arm leans towards
            +x [rad].
    """

    offset: tuple[float, float, float] = ARM_BASE
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


@dataclass(frozen=True)
class Workspace:
    """Where the tip of an arm can be on some ground; NaN stands for what cannot be reached.

    Attributes:
        geometry: the platform.
        arm: the arm.
        ground: (..., 2) roll and pitch of the ground [rad].
    """

    geometry: PlatformGeometry
    arm: ArmGeometry
    ground: ArrayLike = (0.0, 0.0)

    @nan_without_warning
    def tip_position(self, posture: ArrayLike) -> NDArray[np.float64]:
        """Tip of the arm in frame {B} (..., 3) [m], Eq. (13), for a posture.

        Args:
            posture: (..., 3) roll, pitch, height [rad, rad, m].
        """
        roll, pitch, height = _split(posture, 3, "posture")
        return self._tip(self._support_extension(roll, pitch, height), (roll, pitch))

    @nan_without_warning
    def tip_of_extensions(self, extension: ArrayLike) -> NDArray[np.float64]:
        """Tip of the arm in frame {B} (..., 3) [m], Eq. (13), for the extensions of active legs.

        Args:
            extension: (..., 3) of legs 1..3, or (..., 4) of which the last does not count [m].
        """
        active = np.asarray(extension, dtype=float)[..., :3]
        four = np.concatenate([active, active[..., 2:]], axis=-1)
        posture = forward_kinematics(self.geometry, four, self.ground, legs=(0, 1, 2))
        return self._tip(active[..., SUPPORT_LEG], (posture[..., 0], posture[..., 1]))

    @nan_without_warning
    def tip_jacobian(self, posture: ArrayLike) -> NDArray[np.float64]:
        """Derivative of the tip by the posture (..., 3, 3) [m/rad, m/rad, -].

        Its determinant turns volumes of postures into m^3.

        Args:
            posture: (..., 3) roll, pitch, height [rad, rad, m].
        """
        roll, pitch, height = _split(posture, 3, "posture")
        extension = self._support_extension(roll, pitch, height)
        foot, slope = foot_motion(self._support, extension)
        rates = posture_jacobian(self.geometry, posture, self.ground)[..., SUPPORT_LEG, :]
        w = plus(foot, self.arm.p_FT)
        # R_y' R_x w and R_y R_x' w, seen by the world: rotations about y and about the turned x.
        x, y, z = to_world(w, roll, pitch)
        by_roll = to_world((0.0, -w[2], w[1]), roll, pitch)
        by_pitch = (z, 0.0 * y, -x)
        along = to_world(slope, roll, pitch)
        columns = []
        for i, turned in enumerate((by_roll, by_pitch, (0.0 * x, 0.0 * x, 0.0 * x))):
            moved = plus(turned, scaled(along, rates[..., i]))
            columns.append(_join(to_platform(moved, *self._inclination)))
        return np.stack(columns, axis=-1)

    @nan_without_warning
    def extensions_reaching(
        self, point: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Posture that puts the tip at a point, and the extensions it needs, in stroke or not.

        Args:
            point: (..., 3) in frame {B} [m].

        Returns:
            (..., 3) posture [rad, rad, m] and (..., 4) extensions [m].
        """
        x, y, z = _split(point, 3, "point")
        leg, q = self._support, self.arm.p_FT
        t = to_world((x, y, z - leg.foot_radius), *self._inclination)
        # P_2 is p_MF less a side s of fixed length, so |P_2 + q| = |t| is linear in s, as the
        # condition of a foot on a plane with the normal u = p_MF + q.
        u = plus(leg.p_MF, q)
        across = dot(u, leg.p_MF) - 0.5 * (dot(u, u) + leg.l_4**2 - dot(t, t))
        foot = foot_to_centre(leg, extension_on_plane(leg, u, across))
        roll, pitch = attitude_seeing(plus(foot, q), t)
        g = self._ground_normal(roll, pitch)
        height = dot(g, foot)
        extension = [extension_on_plane(leg, g, height) for leg in self.geometry.legs]
        return _join((roll, pitch, height + leg.foot_radius)), _join(extension)

    def stroke_left(self, point: ArrayLike) -> NDArray[np.float64]:
        """Stroke that the tightest leg has left with the tip at a point (...) [m].

        Negative out of reach; minus infinity where no extension would do.

        Args:
            point: (..., 3) in frame {B} [m].
        """
        _, d = self.extensions_reaching(point)
        low, high = self.geometry.extension_min, self.geometry.extension_max
        left = np.minimum(d - low, high - d).min(axis=-1)
        return np.where(np.isnan(left), -math.inf, left)

    def reaches(self, point: ArrayLike) -> NDArray[np.bool_]:
        """Whether the tip can be at a point (...): exact membership; False for NaN.

        Args:
            point: (..., 3) in frame {B} [m].
        """
        return self.stroke_left(point) >= 0.0

    def posture_reaching(self, point: ArrayLike) -> NDArray[np.float64]:
        """Posture (..., 3) [rad, rad, m] that puts the tip at a point that the legs can reach.

        Args:
            point: (..., 3) in frame {B} [m].

        Raises:
            UnreachablePosture: a leg would leave its stroke; names the worst leg.
            ValueError: wrong shapes.
        """
        posture, extension = self.extensions_reaching(point)
        lost = np.isnan(extension[..., SUPPORT_LEG])
        if lost.any():
            index = tuple(int(i) for i in np.argwhere(lost)[0])
            stroke = self.geometry.extension_min, self.geometry.extension_max
            raise UnreachablePosture(SUPPORT_LEG + 1, math.nan, stroke, index or None)
        inverse_kinematics(self.geometry, posture, self.ground)
        return posture

    @property
    def _support(self) -> LegGeometry:
        return self.geometry.legs[SUPPORT_LEG]

    @property
    def _inclination(self) -> tuple[NDArray[np.float64], ...]:
        return _split(self.ground, 2, "ground")

    def _ground_normal(self, roll: Elementwise, pitch: Elementwise) -> Vector3:
        """The ground's normal in the frame of a platform of that attitude."""
        return to_platform(normal_of(*self._inclination), roll, pitch)

    def _support_extension(
        self, roll: Elementwise, pitch: Elementwise, height: Elementwise
    ) -> Elementwise:
        g = self._ground_normal(roll, pitch)
        return extension_on_plane(self._support, g, height - self._support.foot_radius)

    def _tip(
        self, extension: Elementwise, attitude: tuple[Elementwise, Elementwise]
    ) -> NDArray[np.float64]:
        """Tip for leg 2's extension and the platform's attitude."""
        w = plus(foot_to_centre(self._support, extension), self.arm.p_FT)
        x, y, z = to_platform(to_world(w, *attitude), *self._inclination)
        return _join((x, y, z + self._support.foot_radius))


def _split(value: ArrayLike, width: int, name: str) -> tuple[NDArray[np.float64], ...]:
    """Components of (..., width); batches keep their shape, for the arm's turn may be one too."""
    array = np.asarray(of_width(value, width, name), dtype=float)
    return tuple(array[..., i] for i in range(width))


def _join(columns: "tuple[Elementwise, ...] | list[Elementwise]") -> NDArray[np.float64]:
    return np.stack(np.broadcast_arrays(*columns), axis=-1)
