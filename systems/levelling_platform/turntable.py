"""Turntable in the arm's base (section 8 of the paper leaves it to future work).

It turns the arm about the platform's z axis. An upright arm stays where it is; a leaning one
sweeps a ring.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import of_width
from parapod.systems.core.triples import cross, dot, minus
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import upwards
from parapod.systems.levelling_platform.workspace import ArmGeometry, Workspace, boundary

# Turns at which the ring's extent is taken, and points along an edge of a face there.
_TURNS = 24
_EDGE = 7
# Ratio of the grid's size to that extent.
_RIM = 0.04
# Turns that are tried for a point, and steps by which the best one is refined.
_TRIED = 16
_REFINED = 12
# Halvings along a ray: 30 um are left.
_BISECTED = 14
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True)
class Ring:
    """A grid of cylindrical cells about the turntable's axis that holds the swept workspace.

    Attributes:
        axis: (2) x and y of the axis in frame {B}, of the level platform [m].
        radius: smallest and largest distance from it [m].
        height: smallest and largest z [m].
        spread: largest angle between the tip and the direction that the arm is turned to [rad].
    """

    axis: NDArray[np.float64]
    radius: tuple[float, float]
    height: tuple[float, float]
    spread: float

    def point(
        self, radius: NDArray[np.float64], azimuth: NDArray[np.float64], z: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Points (..., 3) in frame {B} [m] of these cylindrical coordinates [m, rad, m]."""
        x = self.axis[0] + radius * np.cos(azimuth)
        return np.stack([x, self.axis[1] + radius * np.sin(azimuth), z], axis=-1)


def swept_volume(geometry: PlatformGeometry, arm: ArmGeometry, resolution: int) -> float:
    """Volume of all points that the tip reaches on level ground when the turntable may turn.

    Counts the cells of a cylindrical grid whose midpoints are reached with some turn. Whether
    one is, is exact; the error is that of the cells.

    Args:
        geometry: the platform.
        arm: the arm; its own turn does not count.
        resolution: cells along radius and height; half as many go round.

    Returns:
        The volume [m^3].
    """
    ring = _ring(geometry, arm)
    share = (np.arange(resolution) + 0.5) / resolution
    turns = max(8, resolution // 2)
    radius = ring.radius[0] + share * np.ptp(ring.radius)
    height = ring.height[0] + share * np.ptp(ring.height)
    azimuth = 2.0 * math.pi * np.arange(turns) / turns
    r, a, z = (c.ravel() for c in np.meshgrid(radius, azimuth, height, indexing="ij"))
    is_reached = _stroke_left_in(geometry, arm, ring, ring.point(r, a, z)) >= 0.0
    area = np.ptp(ring.radius) * np.ptp(ring.height) / resolution**2
    return float(area * 2.0 * math.pi / turns * r[is_reached].sum())


def swept_surface(
    geometry: PlatformGeometry, arm: ArmGeometry, around: int, across: int
) -> NDArray[np.float64]:
    """Points on the boundary of what the tip reaches on level ground with a turning turntable.

    Args:
        geometry: the platform.
        arm: the arm, leaning so far that it sweeps a ring; its own turn does not count.
        around: directions from the axis; the last is the first again.
        across: rays from the middle of the ring's section; the last is the first again.

    Returns:
        (around, across, 3) in frame {B} [m].

    Raises:
        ValueError: the arm leans so little that it sweeps no ring but a disc.
    """
    ring = _ring(geometry, arm)
    if ring.radius[0] <= 0.0:
        raise ValueError(f"an arm that leans by {arm.lean:g} rad sweeps no ring")
    rays = np.linspace(-math.pi, math.pi, across)
    azimuths = np.linspace(0.0, 2.0 * math.pi, around)
    ray, azimuth = (angle.ravel() for angle in np.meshgrid(rays, azimuths))
    middle_r, middle_z = float(np.mean(ring.radius)), float(np.mean(ring.height))

    def point(length: NDArray[np.float64]) -> NDArray[np.float64]:
        r = middle_r + length * np.cos(ray)
        return ring.point(r, azimuth, middle_z + length * np.sin(ray))

    inside = np.zeros(ray.size)
    outside = np.full(ray.size, 0.5 * np.hypot(np.ptp(ring.radius), np.ptp(ring.height)))
    for _ in range(_BISECTED):
        length = 0.5 * (inside + outside)
        is_in = _stroke_left_in(geometry, arm, ring, point(length)) >= 0.0
        inside, outside = np.where(is_in, length, inside), np.where(is_in, outside, length)
    return point(inside).reshape(around, across, 3)


def _ring(geometry: PlatformGeometry, arm: ArmGeometry) -> Ring:
    """Ring in which the tip can be, from the faces of the workspaces of some turns."""
    middle = 0.5 * (geometry.extension_min + geometry.extension_max)
    axis = Workspace(geometry, replace(arm, lean=0.0)).tip_of_extensions((middle,) * 3)[:2]
    turn = 2.0 * math.pi * np.arange(_TURNS)[:, np.newaxis] / _TURNS
    workspace = Workspace(geometry, replace(arm, turn=turn))
    tip = workspace.tip_of_extensions(boundary(geometry, _EDGE)[np.newaxis])
    x, y = tip[..., 0] - axis[0], tip[..., 1] - axis[1]
    radius, height = np.hypot(x, y), tip[..., 2]
    away = np.abs((np.arctan2(y, x) - turn + math.pi) % (2.0 * math.pi) - math.pi).max()
    if away > 0.5 * math.pi:  # The axis is inside: every direction is possible.
        away, radius = math.pi, np.append(radius, 0.0)
    return Ring(axis, _widened(radius), _widened(height), float(away) * (1.0 + _RIM))


def _widened(values: NDArray[np.float64]) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    rim = _RIM * (high - low)
    return (low - rim if low > rim else 0.0), high + rim


def stroke_left_turning(
    geometry: PlatformGeometry, arm: ArmGeometry, point: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`Workspace.stroke_left` on level ground with the turn of the turntable that leaves most.

    Args:
        geometry: the platform.
        arm: the arm; its own turn does not count.
        point: (..., 3) in frame {B} [m].

    Returns:
        (...) [m]; negative where no turn brings the tip there.
    """
    stroke_left = _stroke_left_in(geometry, arm, _ring(geometry, arm), point.reshape(-1, 3))
    return stroke_left.reshape(point.shape[:-1])


def _stroke_left_in(
    geometry: PlatformGeometry, arm: ArmGeometry, ring: Ring, point: NDArray[np.float64]
) -> NDArray[np.float64]:
    """`stroke_left_turning` (n) of points (n, 3): a scan, then golden sections."""
    azimuth = np.arctan2(point[:, 1] - ring.axis[1], point[:, 0] - ring.axis[0])

    def left(turn: NDArray[np.float64]) -> NDArray[np.float64]:
        return Workspace(geometry, replace(arm, turn=turn)).stroke_left(point)

    step = 2.0 * ring.spread / _TRIED
    azimuths = np.array([azimuth - ring.spread + i * step for i in range(_TRIED + 1)])
    values = np.array([left(turn) for turn in azimuths])
    best = azimuths[values.argmax(axis=0), np.arange(len(point))]
    low, high = best - step, best + step
    for _ in range(_REFINED):
        inner = _GOLDEN * (high - low)
        a, b = high - inner, low + inner
        is_low = left(a) > left(b)
        low, high = np.where(is_low, low, a), np.where(is_low, b, high)
    return np.maximum(values.max(axis=0), left(0.5 * (low + high)))


def stability_margin(
    geometry: PlatformGeometry,
    extension: ArrayLike,
    attitude: ArrayLike,
    centre_of_mass: ArrayLike,
) -> NDArray[np.float64]:
    """Horizontal distance of the centre of mass from the nearest edge between neighbouring feet.

    Args:
        geometry: the platform.
        extension: (..., 4) [m].
        attitude: (..., 2) roll and pitch of the platform against gravity [rad].
        centre_of_mass: (..., 3) of the whole machine, from F in the platform's frame [m].

    Returns:
        (...) [m]; negative where the machine would tip over.
    """
    d = np.moveaxis(of_width(extension, LEG_COUNT, "extension"), -1, 0)
    a = np.moveaxis(of_width(attitude, 2, "attitude"), -1, 0)
    c = tuple(np.moveaxis(of_width(centre_of_mass, 3, "centre_of_mass"), -1, 0))
    up = upwards(a[0], a[1])
    to_centre = [foot_to_centre(leg, d[i]) for i, leg in enumerate(geometry.legs)]
    feet = [(-x, -y, -z) for x, y, z in to_centre]
    margins = []
    for i in range(LEG_COUNT):
        # Seen from above, legs 1 to 4 go round anticlockwise.
        foot, following = feet[i], feet[(i + 1) % LEG_COUNT]
        inward = cross(up, minus(following, foot))
        margins.append(dot(minus(c, foot), inward) / np.sqrt(dot(inward, inward)))
    return np.min(np.broadcast_arrays(*margins), axis=0)
