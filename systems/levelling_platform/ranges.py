"""Ranges of the platform in closed form: ground that it levels, tilts, steps, rates, stiffness."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize.elementwise import find_root  # type: ignore[import-untyped]

from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import height_range
from parapod.systems.levelling_platform.leg import foot_to_centre

_LEVEL = (0.0, 0.0)
# Largest angle that is looked at [rad].
_STEEP = math.radians(60.0)
# Error of an angle [rad].
_FOUND = 1e-9


def ground_of(inclination: ArrayLike, azimuth: ArrayLike) -> NDArray[np.float64]:
    """Roll and pitch (..., 2) of ground that rises by an angle against a direction [rad].

    Args:
        inclination: (...) angle of its normal from the vertical [rad].
        azimuth: (...) direction in which the normal leans, from x against the clock [rad].
    """
    theta, along = np.asarray(inclination, dtype=float), np.asarray(azimuth, dtype=float)
    across = np.sin(theta)
    roll = -np.arcsin(across * np.sin(along))
    pitch = np.arctan2(across * np.cos(along), np.cos(theta))
    return np.stack(np.broadcast_arrays(roll, pitch), axis=-1)


def level_range(geometry: PlatformGeometry, azimuth: ArrayLike) -> NDArray[np.float64]:
    """Largest inclination (...) of ground on which the platform can stand level [rad].

    Closed form: level, every leg reaches heights n . P + r between its ends, n the ground's
    normal, P from its foot to F and r its roller's radius. The range ends where the highest place
    of one leg meets the lowest one of another, which is one linear trigonometric equation.

    Args:
        geometry: the platform.
        azimuth: (...) direction in which the ground's normal leans, from x against the clock
            [rad].
    """
    along = np.asarray(azimuth, dtype=float)[..., np.newaxis, np.newaxis]
    high, low = (
        np.array([foot_to_centre(leg, getattr(leg, end)) for leg in geometry.legs])
        for end in ("extension_min", "extension_max")
    )
    radius = np.array([leg.foot_radius for leg in geometry.legs])
    x, y, z = np.moveaxis(high[:, np.newaxis] - low, -1, 0)  # by the leg above and that below
    # a sin theta + z cos theta + c is their room, of which the first zero ends it.
    a, c = x * np.cos(along) + y * np.sin(along), radius[:, np.newaxis] - radius
    with np.errstate(invalid="ignore"):
        end = np.arctan2(a, z) + np.arccos(np.clip(-c / np.hypot(a, z), -1.0, 1.0))
    first = np.where(z + c > 0.0, end, 0.0).min(axis=(-1, -2))
    return np.clip(np.nan_to_num(first, nan=0.0), 0.0, _STEEP)


def tilt_range(
    geometry: PlatformGeometry, azimuth: ArrayLike, height: float | None = None
) -> NDArray[np.float64]:
    """Largest inclination (...) of the platform on level ground [rad].

    Args:
        geometry: the platform.
        azimuth: (...) direction in which its z axis leans, from x against the clock [rad].
        height: height that it has to keep [m]; None: whichever lets it lean furthest.
    """

    def spare(theta: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
        heights = height_range(geometry, ground_of(theta, along), _LEVEL)
        if height is None:
            return _spare(heights)
        low, high = heights[..., 0], heights[..., 1]
        return np.nan_to_num(np.minimum(height - low, high - height), nan=-1.0)

    return _last(spare, azimuth)


def highest_step(geometry: PlatformGeometry) -> float:
    """Height of the highest step under any one foot on which the platform can stand level [m]."""
    alone = [
        height_range(_only(geometry, leg), _LEVEL, _LEVEL).tolist() for leg in range(LEG_COUNT)
    ]
    steps = []
    for leg, (lowest, _) in enumerate(alone):
        highest = min(high for other, (_, high) in enumerate(alone) if other != leg)
        steps.append(highest - lowest)
    return min(steps)


def foot_stiffness_matrix(feet: NDArray[np.float64], foot_stiffness: float) -> NDArray[np.float64]:
    """Stiffness (3, 3) of the platform on its feet against roll, pitch and height.

    Feet give along the vertical alone; they are taken to stand where they are.

    Args:
        feet: (4, 2) places of the feet about the platform's centre [m].
        foot_stiffness: stiffness of one foot with its leg [N/m].

    Returns:
        Moments about x and y and vertical force by roll, pitch [rad] and height [m].
    """
    # A small roll lifts what is at y > 0, a small pitch what is at x < 0.
    lifts = np.column_stack([feet[:, 1], -feet[:, 0], np.ones(len(feet))])
    return foot_stiffness * lifts.T @ lifts


def _last(
    spare: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
    azimuth: ArrayLike,
) -> NDArray[np.float64]:
    """Largest angles (...) at which something is left, by azimuth [rad]."""
    along = np.asarray(azimuth, dtype=float)
    start, end = np.zeros_like(along), np.full_like(along, _STEEP)
    root = find_root(spare, (start, end), args=(along,), tolerances={"xatol": _FOUND}).x
    root = np.where(spare(end, along) >= 0.0, _STEEP, root)
    return np.where(spare(start, along) <= 0.0, 0.0, root)


def _only(geometry: PlatformGeometry, leg: int) -> PlatformGeometry:
    """A platform whose legs all are like one."""
    return replace(geometry, own_legs=(geometry.legs[leg],) * LEG_COUNT, deviations=())


def _spare(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Range of heights that is left; negative where there is none."""
    return np.nan_to_num(heights[..., 1] - heights[..., 0], nan=-1.0)
