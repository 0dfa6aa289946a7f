"""Extensions that a posture needs, and the postures that the stroke allows."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.batching import columns, stack
from parapod.systems.elementwise import Elementwise, nan_without_warning
from parapod.systems.errors import UnreachablePosture
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
    dot,
    normal_of,
    to_platform,
)

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
    else:
        size = int(np.prod(shape))
        rows = np.empty((size, LEG_COUNT))
        for start in range(0, size, _CHUNK):
            part = slice(start, start + _CHUNK)
            chunk = ([c[part] if np.ndim(c) else c for c in block] for block in (y, n, delta))
            for leg, column in enumerate(_inverse(geometry, *chunk)):
                rows[part, leg] = column
        extension = rows.reshape(*shape, LEG_COUNT)
    return _within_stroke(geometry, extension, on_unreachable)


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
