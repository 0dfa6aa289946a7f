"""Workspace of the arm's tip: section 4 of the paper, exact and in closed form.

Points are in frame {B}: its origin is the support point of the right back leg (leg 2), its axes
are those of the ground, so that on level ground they are the world's. The tip is

    t = R_GW R (P_2 + q) + (0, 0, r),

Eq. (13): P_2 is the vector from foot 2 to F, which depends on that leg's extension alone, and q
the vector from F to the tip, which is fixed in the platform; r is the roller's radius, R_GW turns
from gravity's axes to the ground's. Hence |t| gives the extension of leg 2, the direction of t
then gives roll and pitch, and these the other legs: no iteration. Leading dimensions are batch
dimensions and broadcast.

Volume and faces: four extensions within their stroke, tied by one condition (the feet lie in a
plane), make a curved octahedron with eight faces; on each of them one leg is at one end of its
stroke. The paper prints its own eight surfaces (section 4, Fig. 12).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import of_width
from parapod.systems.core.elementwise import Elementwise, nan_without_warning, sin_cos
from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.core.triples import Vector3, dot, plus, scaled
from parapod.systems.levelling_platform.geometry import (
    ARM_BASE,
    LEG_COUNT,
    LegGeometry,
    PlatformGeometry,
)
from parapod.systems.levelling_platform.kinematics import (
    forward_kinematics,
    height_range,
    inverse_kinematics,
    passive_extension,
    posture_jacobian,
)
from parapod.systems.levelling_platform.leg import (
    extension_on_plane,
    foot_motion,
    foot_to_centre,
)
from parapod.systems.levelling_platform.plane import (
    attitude_seeing,
    normal_of,
    to_platform,
    to_world,
)

# Index of the leg on whose support point frame {B} has its origin: the right back one.
SUPPORT_LEG = 1


@dataclass(frozen=True)
class ArmGeometry:
    """The arm on the platform, taken as rigid.

    Attributes:
        offset: from the platform's centre F to the arm's base, which is on the turntable's
            axis [m].
        length: length of the arm [m], section 4.
        lean: lean of the arm from upright, about the turntable's y axis [rad].
        turn: turn of the turntable about the platform's z axis; at zero the arm leans towards
            +x [rad].
    """

    offset: tuple[float, float, float] = ARM_BASE
    length: float = 2.02
    lean: float = 0.0
    turn: Elementwise = 0.0

    @property
    def p_FT(self) -> Vector3:
        """Vector from F to the tip, in the platform's frame [m]."""
        (sin_turn, cos_turn), (sin_lean, cos_lean) = sin_cos(self.turn), sin_cos(self.lean)
        x, y, z = self.offset
        sideways = self.length * sin_lean
        return x + sideways * cos_turn, y + sideways * sin_turn, z + self.length * cos_lean


@dataclass(frozen=True)
class Workspace:
    """Workspace of the tip of an arm on some ground; NaN stands for what cannot be reached.

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
        for i, rotation in enumerate((by_roll, by_pitch, (0.0 * x, 0.0 * x, 0.0 * x))):
            translation = plus(rotation, scaled(along, rates[..., i]))
            columns.append(_join(to_platform(translation, *self._inclination)))
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
        stroke = np.minimum(d - low, high - d).min(axis=-1)
        return np.where(np.isnan(stroke), -math.inf, stroke)

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
        is_unreachable = np.isnan(extension[..., SUPPORT_LEG])
        if is_unreachable.any():
            index = tuple(int(i) for i in np.argwhere(is_unreachable)[0])
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


# (x_c, y_c, z_c) in frame {B} [m].
CENTRE = np.array([0.736, 0.567, 0.386])

# Coefficients of z^2, x^2, y^2, z, x, y and 1 about the centre, and the sign that the sum has
# inside, in the order of print. (The first one's y_o is taken for y_c.)
_TABLE = np.array(
    [
        (1.0, -0.11, -0.10, -5.02, 0.17, 0.13, 6.18, -1.0),
        (1.0, 0.85, 0.80, 0.00, -1.22, 0.94, -4.70, 1.0),
        (1.0, 0.87, 0.96, 0.00, 1.25, -1.00, -4.70, 1.0),
        (1.0, 1.00, 1.00, 0.77, 1.13, 1.47, -6.37, 1.0),
        (1.0, 0.49, 0.49, -1.89, 0.74, 0.57, -1.07, -1.0),
        (1.0, 0.85, 1.01, 0.00, 1.26, -0.96, -5.50, -1.0),
        (1.0, 0.37, 0.32, -2.63, -0.56, 0.43, 0.66, -1.0),
        (1.0, 0.80, 0.88, 0.00, -1.31, -0.99, -5.50, -1.0),
    ]
)
COEFFICIENTS, SIGNS = _TABLE[:, :-1], _TABLE[:, -1]
# Corners of a box that holds the region that they enclose [m].
BOX = np.array([(0.40, 0.13, 2.50), (1.10, 1.03, 2.78)])
SURFACE_COUNT = len(SIGNS)


def surface_terms(point: ArrayLike) -> NDArray[np.float64]:
    """z^2, x^2, y^2, z, x, y and 1 about the surfaces' centre.

    Args:
        point: (..., 3) in frame {B} [m].

    Returns:
        (..., 7).
    """
    x, y, z = np.moveaxis(of_width(point, 3, "point") - CENTRE, -1, 0)
    return np.stack([z * z, x * x, y * y, z, x, y, np.ones_like(x)], axis=-1)


def margins_of_terms(
    terms: ArrayLike, coefficients: NDArray[np.float64] = COEFFICIENTS
) -> NDArray[np.float64]:
    """Margin of a point inside each surface, by the value of its equation.

    Args:
        terms: (..., 7) of the point, as `surface_terms` gives them.
        coefficients: (8, 7) of the terms; others than the printed ones tell what their rounding
            does.

    Returns:
        (..., 8) [m^2]; positive inside.
    """
    return of_width(terms, 7, "terms") @ (coefficients * SIGNS[:, np.newaxis]).T


def surface_margins(point: ArrayLike) -> NDArray[np.float64]:
    """`margins_of_terms` of a point, for the printed surfaces.

    Args:
        point: (..., 3) in frame {B} [m].

    Returns:
        (..., 8) [m^2]; positive inside.
    """
    return margins_of_terms(surface_terms(point))


def inside_surfaces(point: ArrayLike) -> NDArray[np.bool_]:
    """Test a point against each of the eight printed conditions.

    Args:
        point: (..., 3) in frame {B} [m].

    Returns:
        (..., 8); False for NaN.
    """
    return surface_margins(point) > 0.0


def enclosed_points(resolution: int) -> tuple[NDArray[np.float64], float]:
    """Midpoints of the cells that the eight surfaces enclose, and a cell's volume.

    Args:
        resolution: cells along each side of a box that holds what they enclose.

    Returns:
        (n, 3) in frame {B} [m] and the volume [m^3].
    """
    share = (np.arange(resolution) + 0.5) / resolution
    low, high = BOX
    axes = [a + share * (b - a) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    is_inside = inside_surfaces(points).all(axis=-1)
    return points[is_inside], float(np.prod((high - low) / resolution))


_LEVEL = (0.0, 0.0)
# Ratio of the size of the grid of attitudes to that of the quadrilateral of admissible ones, whose
# sides are slightly curved, and points along the edge of a face by which its corners are found.
_RIM, _CORNERS = 1.05, 9


@dataclass(frozen=True)
class PostureGrid:
    """Postures on level ground that fill all that the stroke allows, and what each stands for.

    Attributes:
        posture: (n, 3) roll, pitch, height [rad, rad, m].
        extension: (n, 4) [m].
        cell: (n) of the space of postures [rad^2 m].
        count: (n) of the box of extensions of legs 1..3 [m^3]: the weights of counting points
            that are uniform in the extensions.
    """

    posture: NDArray[np.float64]
    extension: NDArray[np.float64]
    cell: NDArray[np.float64]
    count: NDArray[np.float64]


def posture_grid(geometry: PlatformGeometry, resolution: int) -> PostureGrid:
    """Midpoints of a grid of all postures that the stroke allows on level ground.

    The heights that an attitude allows are known in closed form, so the grid ends at the
    workspace's boundary, and the error of a volume falls with the square of the resolution.

    Args:
        geometry: the platform.
        resolution: cells in each of three dimensions.
    """
    attitude, area = _attitudes(geometry, resolution)
    low, high = np.moveaxis(height_range(geometry, attitude, _LEVEL), -1, 0)
    fits = high > low
    step = (high - low)[fits, np.newaxis] / resolution
    height = low[fits, np.newaxis] + step * (np.arange(resolution) + 0.5)
    attitudes = np.repeat(attitude[fits], resolution, axis=0)
    posture = np.concatenate([attitudes, height.reshape(-1, 1)], axis=1)
    extension = inverse_kinematics(geometry, posture, _LEVEL)
    cell = np.repeat(area[fits] * step[:, 0], resolution)
    active = posture_jacobian(geometry, posture, _LEVEL, extension)[:, :3]
    return PostureGrid(posture, extension, cell, cell * np.abs(np.linalg.det(active)))


def tips_and_volumes(
    geometry: PlatformGeometry, arm: ArmGeometry, grid: PostureGrid
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Tip in each posture, and the part of the workspace that it stands for.

    Args:
        geometry: the platform.
        arm: the arm.
        grid: the postures.

    Returns:
        (n, 3) in frame {B} [m] and (n) [m^3].
    """
    workspace = Workspace(geometry, arm)
    scale = np.abs(np.linalg.det(workspace.tip_jacobian(grid.posture)))
    return workspace.tip_position(grid.posture), grid.cell * scale


def _attitudes(
    geometry: PlatformGeometry, resolution: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Midpoints (n, 2) of a grid over the attitudes that can be taken, and their cells' areas (n).

    These attitudes make a quadrilateral with slightly curved sides. With legs that are alike it is
    a rhombus whose corners are pure roll and pure pitch, each with two legs at one end and two at
    the other end of the stroke.
    """
    attitude = forward_kinematics(geometry, boundary(geometry, _CORNERS), _LEVEL)[:, :2]
    ends = (attitude[:, 0].argmax(), attitude[:, 1].argmax())
    starts = (attitude[:, 0].argmin(), attitude[:, 1].argmin())
    corners = attitude[[*ends, *starts]]  # against the clock
    middle = corners.mean(axis=0)
    # The corners lie at (u, v) = (1, 1), (-1, 1), (-1, -1), (1, -1) of a bilinear map.
    a, b, c, d = _RIM * (corners - middle)
    along_u, along_v = a - b - c + d, a + b - c - d
    twist = a - b + c - d
    u = (2.0 * np.arange(resolution) + 1.0) / resolution - 1.0
    u, v = (x.ravel()[:, np.newaxis] for x in np.meshgrid(u, u))
    sides = np.stack([along_u + twist * v, along_v + twist * u], axis=-1)
    area = np.abs(np.linalg.det(sides)) / (2.0 * resolution) ** 2
    return middle + 0.25 * (along_u * u + along_v * v + twist * u * v), area


def face(
    geometry: PlatformGeometry, leg: int, is_long: bool, resolution: int
) -> NDArray[np.float64]:
    """Extensions on one of the workspace's faces, the same on any ground.

    The leg stays at one end of its stroke. One neighbour goes from that end to the other, one
    row after the other, as far as the remaining legs can follow; the other neighbour goes as far
    as it can before the leg opposite, which follows, comes to an end of its own. With legs that
    are alike the face is a triangle, whose last row has shrunk to a corner.

    Args:
        geometry: the platform.
        leg: index 0..3 of the leg that is at an end.
        is_long: true at the long end (that leg's corner of the platform is lowest).
        resolution: points along an edge.

    Returns:
        (resolution, resolution, 4) [m]; not finite where the leg comes to that end in no posture.
    """
    low, high = geometry.extension_min, geometry.extension_max
    here, there = (high, low) if is_long else (low, high)
    before, opposite, after = ((leg + i) % LEG_COUNT for i in (3, 2, 1))
    share = np.linspace(0.0, 1.0, resolution)[:, np.newaxis]

    def between(extension: NDArray[np.float64], which: int, other: int) -> NDArray[np.float64]:
        """Ends of a neighbour's way, by those of the leg opposite [m]."""
        ends = extension.copy()
        ends[..., opposite] = (here, there)
        ends[..., which] = _fourth(geometry, ends, (leg, opposite, other))
        first, last = (np.nan_to_num(ends[..., i, which], nan=(here, there)[i]) for i in (0, 1))
        first, last = np.clip(first, low, high), np.clip(last, low, high)
        is_empty = (last - first) * (there - here) < 0.0
        return np.where(is_empty, math.nan, np.stack([first, last]))

    ends = np.full((2, LEG_COUNT), here)
    ends[:, after] = (there, here)
    first, last = between(ends, before, after)
    extension = np.full((resolution, resolution, LEG_COUNT), here)
    extension[..., before] = first + share * (last - first)
    first, last = between(extension[:, [0, 0]], after, before)
    extension[..., after] = first[:, np.newaxis] + share.T * (last - first)[:, np.newaxis]
    extension[..., opposite] = _fourth(geometry, extension, (leg, before, after))
    return extension


def faces(
    geometry: PlatformGeometry, resolution: int
) -> dict[tuple[int, bool], NDArray[np.float64]]:
    """`face` by leg's index and whether it is at the long end, of the faces that there are."""
    every = {
        (leg, is_long): face(geometry, leg, is_long, resolution)
        for is_long in (False, True)
        for leg in range(LEG_COUNT)
    }
    return {key: extension for key, extension in every.items() if np.isfinite(extension).all()}


def boundary(geometry: PlatformGeometry, resolution: int) -> NDArray[np.float64]:
    """Extensions (n, 4) on all `faces` [m]."""
    return np.concatenate([e.reshape(-1, LEG_COUNT) for e in faces(geometry, resolution).values()])


def _fourth(
    geometry: PlatformGeometry, extension: NDArray[np.float64], legs: tuple[int, int, int]
) -> NDArray[np.float64]:
    """Extension of the leg that follows the three others (index) of four extensions."""
    posture = forward_kinematics(geometry, extension, _LEVEL, legs=legs)
    return passive_extension(
        geometry, extension[..., list(legs)], _LEVEL, posture[..., :2], legs=legs
    )
