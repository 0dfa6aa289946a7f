"""Volume and faces of the workspace.

Four extensions within their stroke, tied by one condition (the feet lie in a plane), make a
curved octahedron: eight faces, on each of which one leg is at one end of its stroke.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.legs_to_posture import forward_kinematics
from parapod.systems.levelling_platform.posture_to_legs import (
    height_range,
    inverse_kinematics,
    passive_extension,
    posture_jacobian,
)
from parapod.systems.levelling_platform.workspace import ArmGeometry, Workspace

_LEVEL = (0.0, 0.0)
# By how much the grid of attitudes is larger than the rhombus of those that can be taken, whose
# sides are slightly curved.
_RIM = 1.05


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
    cell = area * np.repeat(step[:, 0], resolution)
    active = posture_jacobian(geometry, posture, _LEVEL, extension)[:, :3]
    return PostureGrid(posture, extension, cell, cell * np.abs(np.linalg.det(active)))


def tips_and_volumes(
    geometry: PlatformGeometry, arm: ArmGeometry, grid: PostureGrid
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the tip is in each posture, and the part of the workspace that it stands for.

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


def _attitudes(geometry: PlatformGeometry, resolution: int) -> tuple[NDArray[np.float64], float]:
    """Midpoints (n, 2) of a grid over the attitudes that can be taken, and a cell's area.

    These attitudes make a rhombus whose corners are pure roll and pure pitch, each with two
    legs at one end and two at the other end of the stroke.
    """
    a, b = geometry.extension_min, geometry.extension_max
    corners = forward_kinematics(
        geometry, [(b, a, a, b), (a, b, b, a), (a, a, b, b), (b, b, a, a)], _LEVEL
    )
    roll, pitch = _RIM * np.abs(corners[:, :2]).max(axis=0)
    u = (2.0 * np.arange(resolution) + 1.0) / resolution - 1.0
    u, v = (c.ravel() for c in np.meshgrid(u, u))
    area = 2.0 * roll * pitch / resolution**2
    return np.stack([0.5 * roll * (u + v), 0.5 * pitch * (u - v)], axis=-1), area


def face(
    geometry: PlatformGeometry, leg: int, is_long: bool, resolution: int
) -> NDArray[np.float64]:
    """Extensions on one of the workspace's eight faces, the same on any ground.

    The leg stays at one end of its stroke. One neighbour goes from that end to the other, one
    row after the other; the other neighbour goes as far as it can before the leg opposite,
    which follows, comes to its own other end. So the face is a triangle, whose last row has
    shrunk to a corner.

    Args:
        geometry: the platform.
        leg: index 0..3 of the leg that is at an end.
        is_long: whether it is the long end (that leg's corner of the platform is lowest).
        resolution: points along an edge.

    Returns:
        (resolution, resolution, 4) [m].
    """
    low, high = geometry.extension_min, geometry.extension_max
    here, there = (high, low) if is_long else (low, high)
    before, opposite, after = ((leg + i) % LEG_COUNT for i in (3, 2, 1))
    share = np.linspace(0.0, 1.0, resolution)
    extension = np.full((resolution, resolution, LEG_COUNT), here)
    extension[..., before] = (here + share * (there - here))[:, np.newaxis]
    extension[..., opposite] = there
    furthest = np.clip(_fourth(geometry, extension[:, 0], (leg, before, opposite)), low, high)
    extension[..., after] = here + share * (furthest - here)[:, np.newaxis]
    extension[..., opposite] = _fourth(geometry, extension, (leg, before, after))
    return extension


def faces(
    geometry: PlatformGeometry, resolution: int
) -> dict[tuple[int, bool], NDArray[np.float64]]:
    """`face` by leg's index and whether it is at the long end."""
    return {
        (leg, is_long): face(geometry, leg, is_long, resolution)
        for is_long in (False, True)
        for leg in range(LEG_COUNT)
    }


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
