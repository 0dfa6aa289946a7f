"""What the four extensions tell: where the platform stands, and how the ground lies under it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.batching import columns, stack
from parapod.systems.elementwise import Elementwise, asin, atan2, nan_without_warning
from parapod.systems.levelling_platform.geometry import PlatformGeometry, three_legs
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.plane import (
    Vector3,
    attitude_seeing,
    dot,
    dot4,
    mismatch,
    normal_of,
    normal_through,
    raised,
    to_world,
)


@nan_without_warning
def forward_kinematics(
    geometry: PlatformGeometry,
    extension: ArrayLike,
    ground: ArrayLike,
    legs: Sequence[int] | None = None,
    foot_offsets: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Posture of the platform standing on its legs, Eqs. (10)-(12) in closed form.

    Args:
        geometry: the platform.
        extension: (..., 4) actuator extensions [m].
        ground: (..., 2) roll and pitch of the ground [rad].
        legs: indices 0..3 of the three legs that stand on the ground; None for the plane that
            fits all four feet best (least squares).
        foot_offsets: (..., 4) how far each foot stands above the ground's plane [m]; None for
            feet on it.

    Returns:
        (..., 3) posture [rad, rad, m]; NaN where an extension cannot be built.

    Raises:
        ValueError: wrong shapes, or legs that are not three different indices.
    """
    blocks = [(extension, 4, "extension"), (ground, 2, "ground")]
    if foot_offsets is not None:
        blocks.append((foot_offsets, 4, "foot_offsets"))
    (d, n, *offsets), shape = columns(*blocks)
    three = None if legs is None else three_legs(legs)
    g, height = _standing_plane(geometry, d, three, *offsets)
    return stack((*attitude_seeing(g, normal_of(*n)), height), shape)


@nan_without_warning
def estimate_ground(
    geometry: PlatformGeometry, extension: ArrayLike, attitude: ArrayLike
) -> NDArray[np.float64]:
    """Ground inclination from the measured extensions and attitude (section 6.2, closed form).

    Args:
        geometry: the platform.
        extension: (..., 4) actuator extensions with all feet on the ground [m].
        attitude: (..., 2) roll and pitch of the platform against gravity [rad].

    Returns:
        (..., 2) roll and pitch of the ground [rad].
    """
    (d, a), shape = columns((extension, 4, "extension"), (attitude, 2, "attitude"))
    g, _ = _standing_plane(geometry, d, None)
    c_1, c_2, c_3 = to_world(g, a[0], a[1])
    return stack((-asin(c_2), atan2(c_1, c_3)), shape)


@nan_without_warning
def unevenness(geometry: PlatformGeometry, extension: ArrayLike) -> NDArray[np.float64]:
    """How far each foot is above the plane of least squares through all four.

    With all feet in contact, these are the `foot_offsets` of uneven ground, however it and the
    platform are inclined, and of legs that are not built as drawn.

    Args:
        geometry: the platform.
        extension: (..., 4) actuator extensions [m].

    Returns:
        (..., 4) offsets [m]; NaN where an extension cannot be built.
    """
    (d,), shape = columns((extension, 4, "extension"))
    g, height = _standing_plane(geometry, d, None)
    feet = [foot_to_centre(leg, d[i]) for i, leg in enumerate(geometry.legs)]
    return stack([height - geometry.foot_radius - dot(g, foot) for foot in feet], shape)


def _standing_plane(
    geometry: PlatformGeometry,
    extension: Sequence[Elementwise],
    legs: tuple[int, ...] | None,
    offsets: Sequence[Elementwise] | None = None,
) -> tuple[Vector3, Elementwise]:
    """Unit normal of the ground in the platform's frame, and the height of F above it."""
    feet = [foot_to_centre(leg, extension[i]) for i, leg in enumerate(geometry.legs)]
    if offsets is not None:
        feet = raised(feet, offsets, legs or (0, 1, 2))
    if legs is None:
        weights, excess = mismatch(feet)
        scale = excess / dot4(weights, weights)
        feet = [(x, y, z - w * scale) for (x, y, z), w in zip(feet, weights, strict=True)]
        legs = (0, 1, 2)
    p, q, r = (feet[i] for i in legs)
    normal, length = normal_through(p, q, r)
    g = (normal[0] / length, normal[1] / length, normal[2] / length)
    return g, dot(g, p) + geometry.foot_radius
