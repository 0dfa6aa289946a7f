"""Kinematics of the terrain simulator: batched, closed form, free of Drake.

Conventions:

* pose = x, z, phi of the plate's middle O' in the base frame; phi > 0 is front end down [m, rad].
* sliders = places a_1, a_2, a_3 along the rail [m].
* twist = rates of x, z and phi; load = force F_x, F_z and moment M_y = r_z F_x - r_x F_z at O', as
  it acts on the plate [N, N m].

Leading dimensions are batch dimensions and broadcast. The functions work on floats, arrays and
AutoDiffXd alike (`parapod.systems.core.elementwise`).
"""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import columns, stack
from parapod.systems.core.elementwise import (
    Elementwise,
    atan2,
    nan_without_warning,
    quotient,
    sin_cos,
    sqrt,
)
from parapod.systems.core.errors import ParapodError, UnreachablePosture
from parapod.systems.terrain_simulator.geometry import BenchGeometry

__all__ = [
    "LIMITS",
    "BenchGeometry",
    "Singularity",
    "UnreachablePlate",
    "forward_kinematics",
    "inverse_jacobian",
    "inverse_kinematics",
    "jacobian",
    "margins",
    "places_and_margins",
    "singularity",
    "slider_accelerations",
    "slider_forces",
    "slider_places",
    "slider_rates",
]

type Assembly = Literal["upper", "lower"]

# Limits of a pose, in the order of `margins`.
LIMITS = (
    "height of P",
    "height of T",
    "reach of P",
    "reach of T",
    "line P T A_3",
    "gap of A_1 and A_2",
    "gap of A_2 and A_3",
    "rear end of slider 1",
    "rear end of slider 2",
    "rear end of slider 3",
    "front end of slider 1",
    "front end of slider 2",
    "front end of slider 3",
)
_LINE = LIMITS.index("line P T A_3")


class UnreachablePlate(UnreachablePosture):
    """A pose of the plate that the sliders cannot take.

    Attributes:
        limit: the limit that it breaks, of `LIMITS`.
        missing: amount by which the limit is exceeded [m; - for the line P T A_3].
        index: index of the first offending pose in a batch, or None for a single one.
    """

    def __init__(self, limit: str, missing: float, index: tuple[int, ...] | None, words: str):
        self.limit, self.missing, self.index = limit, missing, index
        where = "" if index is None else f"pose {list(index)}: "
        ParapodError.__init__(self, where + words)


class Singularity(NamedTuple):
    """Distances from singularities, without dimension; each is 0 in one of them.

    Attributes:
        sin_mu: sine of the transmission angle at T between T P and T A_3: at 0 P, T and A_3 are in
            line, and the plate turns whatever the sliders do. Negative: past that line.
        height: z_P / l_1: at 0 A_1, P and A_2 are in line, and P falls.
        spread: s_1 / l_1, half the distance of A_1 and A_2: at 0 they coincide, and nothing holds
            P along the rail.
        lean: s_3 / l_3, the way from A_3 to T along the rail: at 0 the strut stands upright, and a
            slider that moves does not move the plate.
        determinant: det J [rad/m], s_1 s_3 / (2 z_P l_3 l_4 sin mu) with the branch's sign.
    """

    sin_mu: NDArray[np.float64]
    height: NDArray[np.float64]
    spread: NDArray[np.float64]
    lean: NDArray[np.float64]
    determinant: NDArray[np.float64]


class _Shape(NamedTuple):
    """The mechanism at a pose; lengths along the rail count from O'."""

    to_p: tuple[Elementwise, Elementwise]  # from O' to P, in the base frame
    to_t: tuple[Elementwise, Elementwise]
    height_p: Elementwise
    height_t: Elementwise
    s_1: Elementwise  # from A_1 to P along the rail, and from P to A_2
    u_3: Elementwise  # from A_3 to T along the rail
    moment: Elementwise  # (T - A_3) x (T - P): -l_3 l_4 sin mu


@nan_without_warning
def inverse_kinematics(geometry: BenchGeometry, pose: ArrayLike) -> NDArray[np.float64]:
    """Places of the sliders at poses of the plate.

    Args:
        geometry: the bench.
        pose: (..., 3) x, z, phi [m, m, rad].

    Returns:
        (..., 3) a_1, a_2, a_3 [m].

    Raises:
        UnreachablePlate: a slider, gap or height is outside its limits, or the plate would have
            to pass the line P T A_3; names the first limit of the first pose.
        ValueError: wrong shape.
    """
    (pose_columns,), shape = columns((pose, 3, "pose"))
    now = _shape(geometry, pose_columns)
    places = _places(geometry, pose_columns[0], now)
    if not all(np.all(root >= 0.0) for root in _left(geometry, places, now)):
        _refuse(geometry, np.asarray(pose, dtype=float))
    return stack(places, shape)


@nan_without_warning
def slider_places(geometry: BenchGeometry, pose: ArrayLike) -> NDArray[np.float64]:
    """The same whatever the limits; NaN where a link is too short."""
    (pose_columns,), shape = columns((pose, 3, "pose"))
    return stack(_places(geometry, pose_columns[0], _shape(geometry, pose_columns)), shape)


@nan_without_warning
def forward_kinematics(
    geometry: BenchGeometry, sliders: ArrayLike, assembly: Assembly = "upper"
) -> NDArray[np.float64]:
    """Pose of the plate, Eqs. (2) and (3) with the argument of their arc cosine mended.

    Args:
        geometry: the bench.
        sliders: (..., 3) a_1, a_2, a_3 [m].
        assembly: "upper" with T above the line from P to A_3, as both benches work; "lower" is
            the other way to assemble the same links.

    Returns:
        (..., 3) x, z, phi [m, m, rad].

    Raises:
        UnreachablePlate: the links cannot be joined: A_2 is behind A_1, or pivots are too far
            from each other.
        ValueError: wrong shape, or another assembly.
    """
    if assembly not in ("upper", "lower"):
        raise ValueError(f"assembly must be 'upper' or 'lower', not {assembly!r}")
    ((a_1, a_2, a_3),), shape = columns((sliders, 3, "sliders"))
    # NaN where A_2 is behind A_1: that pair of links is mirrored, and the plate has no pose.
    s_1 = sqrt(0.5 * (a_2 - a_1)) ** 2
    x_P, z_P = 0.5 * (a_1 + a_2), sqrt(geometry.link**2 - s_1 * s_1)
    along = a_3 - x_P
    squared = along * along + z_P * z_P
    # l_4 l_3 D times cosine and sine of the angle at P: exact where the three are nearly in line.
    cosine = geometry.lever**2 + squared - geometry.strut**2
    sine = sqrt(4.0 * geometry.lever**2 * squared - cosine * cosine)
    psi = atan2(sine, cosine)
    theta = atan2(z_P, along) + (psi if assembly == "lower" else -psi)
    s, c = sin_cos(theta)
    # O' in the frame of P T.
    x = geometry.lever - geometry.p_OT[0] * np.cos(geometry.offset)
    z = geometry.p_OT[0] * np.sin(geometry.offset)
    pose = stack([x_P + c * x + s * z, z_P - s * x + c * z, theta + geometry.offset], shape)
    is_lost = (pose != pose).astype(bool).any(axis=-1)
    if is_lost.any():
        index = tuple(int(i) for i in np.argwhere(is_lost)[0]) if shape else ()
        sliders_mm = ", ".join(f"{1e3 * a:.1f}" for a in np.asarray(sliders, dtype=float)[index])
        raise UnreachablePlate(
            "reach of P",
            np.nan,
            index or None,
            f"with the sliders at {sliders_mm} mm the links cannot be joined",
        )
    return pose


@nan_without_warning
def jacobian(geometry: BenchGeometry, pose: ArrayLike) -> NDArray[np.float64]:
    """Derivative of the pose by the sliders, Eq. (4): (..., 3, 3) [-; rad/m].

    Finite where a leg stands upright or A_1 and A_2 coincide; infinite or NaN where P, T and A_3
    or A_1, P and A_2 are in line.

    Args:
        geometry: the bench.
        pose: (..., 3) x, z, phi [m, m, rad].
    """
    (pose_columns,), shape = columns((pose, 3, "pose"))
    now = _shape(geometry, pose_columns)
    rise = quotient(0.5 * now.s_1, now.height_p)
    # Motion of P and rate of phi, a slider a row.
    motions = (
        (0.5, rise, quotient(0.5 * now.u_3 + now.height_t * rise, -now.moment)),
        (0.5, -rise, quotient(0.5 * now.u_3 - now.height_t * rise, -now.moment)),
        (0.0, 0.0, quotient(now.u_3, now.moment)),
    )
    x, z = now.to_p
    entries = [along - z * turn for along, _, turn in motions]
    entries += [up + x * turn for _, up, turn in motions]
    entries += [turn for _, _, turn in motions]
    return stack(entries, shape).reshape(*shape, 3, 3)


@nan_without_warning
def slider_rates(
    geometry: BenchGeometry, pose: ArrayLike, twist: ArrayLike
) -> NDArray[np.float64]:
    """Speeds of the sliders (..., 3) [m/s] for a motion of the plate.

    Infinite where A_1 and A_2 coincide or the strut stands upright, unless nothing has to move.

    Args:
        geometry: the bench.
        pose: (..., 3) x, z, phi [m, m, rad].
        twist: (..., 3) rates of x, z, phi [m/s, m/s, rad/s].
    """
    (pose_columns, (dx, dz, dphi)), shape = columns((pose, 3, "pose"), (twist, 3, "twist"))
    now = _shape(geometry, pose_columns)
    pivots = (
        (now.to_p, now.height_p, now.s_1),
        (now.to_p, now.height_p, -now.s_1),
        (now.to_t, now.height_t, now.u_3),
    )
    return stack(
        [
            dx + z_C * dphi + quotient(height, along) * (dz - x_C * dphi)
            for (x_C, z_C), height, along in pivots
        ],
        shape,
    )


@nan_without_warning
def inverse_jacobian(geometry: BenchGeometry, pose: ArrayLike) -> NDArray[np.float64]:
    """Derivative of the sliders by the pose (..., 3, 3) [-; m/rad]: a row a slider.

    Infinite or NaN where A_1 and A_2 coincide or the strut stands upright.

    Args:
        geometry: the bench.
        pose: (..., 3) x, z, phi [m, m, rad].
    """
    (pose_columns,), shape = columns((pose, 3, "pose"))
    now = _shape(geometry, pose_columns)
    first, third = quotient(now.height_p, now.s_1), quotient(now.height_t, now.u_3)
    entries = []
    for (x_C, z_C), slope in ((now.to_p, first), (now.to_p, -first), (now.to_t, third)):
        entries += [1.0, slope, z_C - slope * x_C]
    return stack(entries, shape).reshape(*shape, 3, 3)


@nan_without_warning
def slider_accelerations(
    geometry: BenchGeometry, pose: ArrayLike, twist: ArrayLike, twist_rate: ArrayLike
) -> NDArray[np.float64]:
    """Accelerations of the sliders (..., 3) [m/s^2]: the rates of `slider_rates` on a path.

    NaN or infinite where a link is too short or a leg stands upright.

    Args:
        geometry: the bench.
        pose: (..., 3) x, z, phi [m, m, rad].
        twist: (..., 3) their rates [m/s, m/s, rad/s].
        twist_rate: (..., 3) the rates of these [m/s^2, m/s^2, rad/s^2].
    """
    ((_, z, phi), (_, dz, dphi), (ddx, ddz, ddphi)), shape = columns(
        (pose, 3, "pose"), (twist, 3, "twist"), (twist_rate, 3, "twist_rate")
    )
    s, c = sin_cos(phi)
    sliders = (
        (geometry.p_OP, geometry.link, -1.0),
        (geometry.p_OP, geometry.link, 1.0),
        (geometry.p_OT, geometry.strut, geometry.branch),
    )
    accelerations = []
    for (x_C, z_C), length, ahead in sliders:
        r_x, r_z = c * x_C + s * z_C, c * z_C - s * x_C
        height, up = z + r_z, dz - r_x * dphi
        ddheight = ddz - r_x * ddphi - r_z * dphi * dphi
        # The link's length along the rail, sqrt(length^2 - height^2), and its rates.
        reach = sqrt(length**2 - height * height)
        rate = quotient(-height * up, reach)
        ddreach = quotient(-(up * up + height * ddheight + rate * rate), reach)
        accelerations.append(ddx + r_z * ddphi - r_x * dphi * dphi + ahead * ddreach)
    return stack(accelerations, shape)


def slider_forces(
    geometry: BenchGeometry, pose: ArrayLike, load: ArrayLike
) -> NDArray[np.float64]:
    """Forces of the sliders (..., 3) [N] that hold a load on the plate at rest: -J^T W.

    Their sum is -F_x. Weight and friction of the links are not in it.

    Args:
        geometry: the bench.
        pose: (..., 3) x, z, phi [m, m, rad].
        load: (..., 3) F_x, F_z, M_y on the plate at O' [N, N, N m].
    """
    ((f_x, f_z, m_y),), shape = columns((load, 3, "load"))
    J = jacobian(geometry, pose)
    wrench = stack([f_x, f_z, m_y], shape)
    return -np.einsum("...ij,...i->...j", J, wrench)


@nan_without_warning
def singularity(geometry: BenchGeometry, pose: ArrayLike) -> Singularity:
    """Distances of poses from all four singularities.

    Args:
        geometry: the bench.
        pose: (..., 3) x, z, phi [m, m, rad].

    Returns:
        Arrays (...); NaN where a link is too short.
    """
    (pose_columns,), shape = columns((pose, 3, "pose"))
    now = _shape(geometry, pose_columns)
    result = stack(
        [
            _sin_mu(geometry, now),
            now.height_p / geometry.link,
            now.s_1 / geometry.link,
            -geometry.branch * now.u_3 / geometry.strut,
            quotient(-0.5 * now.u_3 * now.s_1, now.height_p * now.moment),
        ],
        shape,
    )
    return Singularity(*np.moveaxis(result, -1, 0))


def margins(geometry: BenchGeometry, pose: ArrayLike) -> NDArray[np.float64]:
    """Distances to all limits (..., 13) [m; sin mu for the line P T A_3]: negative beyond them.

    Args:
        geometry: the bench.
        pose: (..., 3) x, z, phi [m, m, rad].

    Returns:
        In the order of `LIMITS`; NaN where a link is too short, infinite where there is no limit.
    """
    return places_and_margins(geometry, pose)[1]


@nan_without_warning
def places_and_margins(
    geometry: BenchGeometry, pose: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`slider_places` and `margins` of the same poses."""
    (pose_columns,), shape = columns((pose, 3, "pose"))
    now = _shape(geometry, pose_columns)
    places = _places(geometry, pose_columns[0], now)
    return stack(places, shape), stack(_left(geometry, places, now), shape)


def _shape(geometry: BenchGeometry, pose: list[Elementwise]) -> _Shape:
    _, z, phi = pose
    s, c = sin_cos(phi)
    (x_P, y_P), (x_T, y_T) = geometry.p_OP, geometry.p_OT
    r_P = c * x_P + s * y_P, c * y_P - s * x_P
    r_T = c * x_T + s * y_T, c * y_T - s * x_T
    z_P, z_T = z + r_P[1], z + r_T[1]
    s_1 = sqrt(geometry.link**2 - z_P * z_P)
    u_3 = -geometry.branch * sqrt(geometry.strut**2 - z_T * z_T)
    moment = u_3 * (r_T[1] - r_P[1]) - z_T * (r_T[0] - r_P[0])
    return _Shape(r_P, r_T, z_P, z_T, s_1, u_3, moment)


def _places(geometry: BenchGeometry, x: Elementwise, now: _Shape) -> list[Elementwise]:
    x_P = x + now.to_p[0]
    return [x_P - now.s_1, x_P + now.s_1, x + now.to_t[0] - now.u_3]


def _sin_mu(geometry: BenchGeometry, now: _Shape) -> Elementwise:
    return now.moment * (-1.0 / (geometry.strut * geometry.lever))


def _left(geometry: BenchGeometry, places: list[Elementwise], now: _Shape) -> list[Elementwise]:
    """Distances to all limits, in the order of `LIMITS`."""
    apart = np.inf if geometry.strut_gap is None else places[2] - places[1] - geometry.strut_gap
    return [
        now.height_p - geometry.floor,
        now.height_t - geometry.floor,
        geometry.link - now.height_p,
        geometry.strut - now.height_t,
        _sin_mu(geometry, now),
        2.0 * now.s_1 - geometry.gap,
        apart,
        *(place - geometry.slider_min for place in places),
        *(geometry.slider_max - place for place in places),
    ]


def _refuse(geometry: BenchGeometry, pose: NDArray[np.float64]) -> None:
    """Names the first limit that the first offending pose breaks."""
    room = margins(geometry, pose)
    *index, _ = map(int, np.argwhere(~(room >= 0.0))[0])
    where = tuple(index)
    # A link that is too short leaves NaN behind: what it is short of comes before it.
    which = int(np.argmax(room[where] < 0.0))
    limit, missing = LIMITS[which], -float(room[(*where, which)])
    by = f"{1e3 * missing:.2f} mm"
    if not np.isfinite(pose[where]).all():
        words = "the pose has numbers that are not finite"
    elif which == _LINE:
        words = f"P, T and A_3 would pass the line that they make (sin mu = {-missing:.3f})"
    elif limit.startswith("height"):
        least = 1e3 * geometry.floor
        words = f"pivot {limit[-1]} would be {by} below its least height of {least:.1f} mm"
    elif limit.startswith("reach"):
        words = f"pivot {limit[-1]} would be {by} higher than its links are long"
    elif limit.startswith("gap"):
        least = 1e3 * (geometry.gap if "A_1" in limit else geometry.strut_gap or 0.0)
        words = f"{limit[7:]} would be {by} closer than {least:.1f} mm"
    else:
        slider = int(limit[-1])
        place = 1e3 * slider_places(geometry, pose)[(*where, slider - 1)]
        rail = f"{1e3 * geometry.slider_min:.1f}..{1e3 * geometry.slider_max:.1f} mm"
        words = f"slider {slider} would be at {place:.2f} mm, {by} beyond its rail {rail}"
    raise UnreachablePlate(limit, missing, where or None, words)
