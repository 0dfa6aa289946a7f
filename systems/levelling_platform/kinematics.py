"""Kinematics of the levelling platform in closed form, both ways, without iteration.

Inverse: extensions for a posture, and the postures that the stroke allows. Forward: posture and
ground from the four extensions. Every foot that stands satisfies

    g . P_i = height, Eqs. (9)-(12),

where g is the ground's normal in the platform's frame and P_i the vector from the foot to F.
Leading dimensions are batch dimensions and broadcast.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import columns, stack
from parapod.systems.core.elementwise import Elementwise, asin, atan2, nan_without_warning
from parapod.systems.core.errors import UnreachablePosture
from parapod.systems.core.triples import Vector3, dot
from parapod.systems.levelling_platform.geometry import (
    LEG_COUNT,
    PlatformGeometry,
    three_legs,
)
from parapod.systems.levelling_platform.leg import (
    extension_on_plane,
    extension_rate_on_plane,
    foot_to_centre,
)
from parapod.systems.levelling_platform.plane import (
    attitude_derivatives,
    attitude_seeing,
    dot4,
    mismatch,
    normal_of,
    normal_through,
    raised,
    to_platform,
    to_world,
)

__all__ = [
    "PlatformGeometry",
    "estimate_ground",
    "forward_kinematics",
    "height_range",
    "inverse_kinematics",
    "passive_extension",
    "posture_jacobian",
    "unevenness",
]

# Rows of a batch that are worked on at a time, so that temporaries stay in the cache.
_CHUNK = 4096
# A posture that forward kinematics made of an extension at the stroke's end must be reachable.
_STROKE_TOLERANCE = 1e-9


@nan_without_warning
def inverse_kinematics(
    geometry: PlatformGeometry,
    posture: ArrayLike,
    ground: ArrayLike,
    foot_offsets: ArrayLike | None = None,
    on_unreachable: Literal["raise", "nan"] = "raise",
) -> NDArray[np.float64]:
    """Extensions that put all four feet on the ground in a posture: Eq. (26) integrated exactly.

    Args:
        geometry: the platform.
        posture: (..., 3) roll, pitch, height [rad, rad, m].
        ground: (..., 2) roll and pitch of the ground [rad].
        foot_offsets: (..., 4) heights of the feet above the ground's plane [m]; None for zero.
        on_unreachable: "raise", or "nan" to mark unreachable postures of a batch: all four
            extensions of such a posture are NaN.

    Returns:
        (..., 4) extensions [m].

    Raises:
        UnreachablePosture: a leg would leave its stroke; names the worst leg.
        ValueError: wrong shapes, or an unknown `on_unreachable`.
    """
    if on_unreachable not in ("raise", "nan"):
        raise ValueError(f'on_unreachable must be "raise" or "nan", not {on_unreachable!r}')
    offsets = (0.0,) * LEG_COUNT if foot_offsets is None else foot_offsets
    (y, n, delta), shape = columns(
        (posture, 3, "posture"), (ground, 2, "ground"), (offsets, 4, "foot_offsets")
    )
    if not shape:
        extension = stack(_inverse(geometry, y, n, delta), shape)
        return _within_stroke(geometry, extension, on_unreachable)
    size = int(np.prod(shape))
    rows, are_all_inside = np.empty((size, LEG_COUNT)), True
    for start in range(0, size, _CHUNK):
        part = slice(start, start + _CHUNK)
        chunk = ([c[part] if np.ndim(c) else c for c in block] for block in (y, n, delta))
        legs = _inverse(geometry, *chunk)
        for leg, column in enumerate(legs):
            rows[part, leg] = column
        # Now, while they are in the cache.
        are_all_inside = are_all_inside and _are_inside_stroke(geometry, legs)
    extension = rows.reshape(*shape, LEG_COUNT)
    return extension if are_all_inside else _within_stroke(geometry, extension, on_unreachable)


def _inverse(
    geometry: PlatformGeometry,
    posture: Sequence[Elementwise],
    ground: Sequence[Elementwise],
    offsets: Sequence[Elementwise],
) -> tuple[Elementwise, ...]:
    roll, pitch, height = posture
    g = to_platform(normal_of(*ground), roll, pitch)
    return tuple(
        extension_on_plane(leg, g, height - offset - leg.foot_radius)
        for leg, offset in zip(geometry.legs, offsets, strict=True)
    )


def _are_inside_stroke(geometry: PlatformGeometry, legs: Sequence[NDArray[np.float64]]) -> bool:
    """Whether no extension of a batch leaves its stroke or is NaN; of four columns."""
    low, high = geometry.extension_min, geometry.extension_max
    return all(
        low - leg.min() <= _STROKE_TOLERANCE and leg.max() - high <= _STROKE_TOLERANCE
        for leg in legs
    )


def _within_stroke(
    geometry: PlatformGeometry, extension: NDArray[np.float64], on_unreachable: str
) -> NDArray[np.float64]:
    """The extensions, or what `on_unreachable` asks for where one leaves its stroke."""
    low, high = geometry.extension_min, geometry.extension_max
    missing = np.maximum(low - extension, extension - high)
    bad = ~(missing <= _STROKE_TOLERANCE)  # NaN is bad
    if not bad.any():
        return extension
    if on_unreachable == "nan":
        extension[bad.any(axis=-1)] = np.nan
        return extension
    first = tuple(int(i) for i in np.argwhere(bad.any(axis=-1))[0])
    worst = int(np.argmax(np.where(np.isnan(missing[first]), np.inf, missing[first])))
    raise UnreachablePosture(
        worst + 1, float(extension[first][worst]), (low, high), first if first else None
    )


@nan_without_warning
def passive_extension(
    geometry: PlatformGeometry,
    extension: ArrayLike,
    ground: ArrayLike,
    attitude: ArrayLike,
    legs: Sequence[int] = (0, 1, 2),
) -> NDArray[np.float64]:
    """Extension that keeps the remaining leg's foot on the ground, Eqs. (30)-(31).

    Args:
        geometry: the platform.
        extension: (..., 3) extensions of the three active legs, in the order of `legs` [m].
        ground: (..., 2) roll and pitch of the ground [rad].
        attitude: (..., 2) roll and pitch of the platform [rad].
        legs: indices 0..3 of the three active legs; the first one gives the height, as i_1 in
            Eq. (31).

    Returns:
        (...) extension of the passive leg [m]; NaN where it cannot reach the ground.
    """
    active = three_legs(legs)
    (d, n, a), shape = columns(
        (extension, 3, "extension"), (ground, 2, "ground"), (attitude, 2, "attitude")
    )
    g = to_platform(normal_of(*n), a[0], a[1])
    height = dot(g, foot_to_centre(geometry.legs[active[0]], d[0]))
    (passive,) = set(range(LEG_COUNT)) - set(active)
    column = extension_on_plane(geometry.legs[passive], g, height)
    return np.reshape(np.asarray(column), shape)


@nan_without_warning
def posture_jacobian(
    geometry: PlatformGeometry,
    posture: ArrayLike,
    ground: ArrayLike,
    extension: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Derivative of the extensions by the posture: rows are legs, Eq. (26) for all four at once.

    Args:
        geometry: the platform.
        posture: (..., 3) roll, pitch, height [rad, rad, m].
        ground: (..., 2) roll and pitch of the ground [rad].
        extension: (..., 4) extensions at which the derivative is taken [m]; None for those of
            the posture (NaN rows where a leg cannot reach the ground).

    Returns:
        (..., 4, 3) matrix d(extension) / d(roll, pitch, height) [m/rad, m/rad, -].
    """
    blocks = [(posture, 3, "posture"), (ground, 2, "ground")]
    if extension is not None:
        blocks.append((extension, 4, "extension"))
    (y, n, *d), shape = columns(*blocks)
    n_world = normal_of(*n)
    g = to_platform(n_world, y[0], y[1])
    g_roll, g_pitch = attitude_derivatives(n_world, g, y[0], y[1])
    rates = ((g_roll, 0.0), (g_pitch, 0.0), ((0.0, 0.0, 0.0), 1.0))
    entries = []
    for i, leg in enumerate(geometry.legs):
        d_i = d[0][i] if d else extension_on_plane(leg, g, y[2] - leg.foot_radius)
        entries += [extension_rate_on_plane(leg, d_i, g, *rate) for rate in rates]
    return stack(entries, shape).reshape(*shape, LEG_COUNT, 3)


@nan_without_warning
def height_range(
    geometry: PlatformGeometry,
    attitude: ArrayLike,
    ground: ArrayLike,
    foot_offsets: ArrayLike = (0.0, 0.0, 0.0, 0.0),
) -> NDArray[np.float64]:
    """Heights that all four legs can reach at an attitude, in closed form.

    A longer actuator lowers the platform, so each leg's stroke is an interval of heights, and
    the platform's range is their intersection.

    Args:
        geometry: the platform.
        attitude: (..., 2) roll and pitch of the platform [rad].
        ground: (..., 2) roll and pitch of the ground [rad].
        foot_offsets: (..., 4) how far each foot stands above the ground's plane [m].

    Returns:
        (..., 2) smallest and largest height [m]; the first exceeds the second where no height
        can be reached at that attitude.
    """
    (a, n, o), shape = columns(
        (attitude, 2, "attitude"), (ground, 2, "ground"), (foot_offsets, 4, "foot_offsets")
    )
    g = to_platform(normal_of(*n), a[0], a[1])

    def heights(end: str) -> list[Elementwise]:
        return [
            dot(g, foot_to_centre(leg, getattr(leg, end))) + leg.foot_radius + offset
            for leg, offset in zip(geometry.legs, o, strict=True)
        ]

    low, high = heights("extension_max"), heights("extension_min")
    return stack((np.max(low, axis=0), np.min(high, axis=0)), shape)


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
    """Height of each foot above the plane of least squares through all four.

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
