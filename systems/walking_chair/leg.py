"""One leg in closed form: the UP branch, the inverse and the forward kinematics.

Points are in the leg's frame {A1} (`LegGeometry`). Leading dimensions are batch dimensions and
broadcast. A point out of the leg's reach gives NaN; strokes are checked in
`parapod.systems.walking_chair.checks`.

The UP branch alone decides the foot's position and inclination. Its coordinates are
up = (..., 3): length l_11 from U_11 to U_14 [m] and the angles alpha about the upper platform's
y axis and beta about the foot's x axis [rad], R = R_y(alpha) R_x(beta), Eq. (9). The branch runs
along the foot's -z axis (Eq. (6) prints it parallel to z; it is opposite), so a point fixed to
the foot at the place m of {E1} is at

    P = R (m - (l_11 + x_2) e_z)    from U_11, in {A1}.

Each universal joint turns within +-90 degrees (Table 1), which leaves one solution.

Forward: with h = l_11 + x_2 - x_3, K_i = (a^2 + b^2 + h^2 - l_1i^2) / 2, S and D their half sum
and half difference, rho (cos delta, sin delta) = (b cos 30, h) and psi = beta + delta, the lengths
of the UPS branches are two equations for the angles:

    a b sin^2 30 cos(alpha) + a cos 30 rho cos(psi) = S
    a sin 30 rho sin(alpha) sin(psi) = D

They are equivalent to a polynomial of degree 4 in cos(alpha), with a double root for a leg
without side swing (alpha = 0), where its solutions are poor. Newton's method from the straight leg
finds the assembly that the leg takes: out of 100 000 triples of lengths within the strokes
it found one wherever that polynomial has it, in 12 iterations at most.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import of_width
from parapod.systems.core.elementwise import nan_without_warning
from parapod.systems.core.vectors import Array, cross, times
from parapod.systems.walking_chair.geometry import LegGeometry

_Y_AXIS = np.array((0.0, 1.0, 0.0))


class UpPose(NamedTuple):
    """The UP branch with sines and cosines in the place of its angles, each (...).

    Attributes:
        length: l_11 [m].
        s_a: sine of alpha.
        c_a: cosine of alpha.
        s_b: sine of beta.
        c_b: cosine of beta.
    """

    length: Array
    s_a: Array
    c_a: Array
    s_b: Array
    c_b: Array


def pose_of_corner(geometry: LegGeometry, from_joint: Array, corner: Array) -> UpPose:
    """Pose of the UP branch that puts a corner of the foot at a place.

    Eqs. (10), (14), (16) and (18) for all three corners at once, with the roots that the legs
    take. With r^2 = t_m^2 + e_y^2, the corner (e_x, e_y) is `depth` = sqrt(r^2 - y^2) below the
    axis of alpha, seen along it, and x^2 + z^2 = depth^2 + e_x^2; so no angle is needed.

    Args:
        geometry: the leg.
        from_joint: (..., 3) the place from U_11, in {A1} [m].
        corner: (..., 3) the corner in {E1} [m].

    Returns:
        The pose; NaN where a joint would have to turn by 90 degrees or more, or the branch have
        no length.
    """
    x, y, z = from_joint[..., 0], from_joint[..., 1], from_joint[..., 2]
    e_x, e_y = corner[..., 0], corner[..., 1]
    across = e_x * e_x
    square = x * x + y * y + z * z - across
    t_m = np.sqrt(square - e_y * e_y)
    depth = np.sqrt(square - y * y)
    around = depth * depth + across
    c_b = (y * e_y + t_m * depth) / square
    c_a = (e_x * x - depth * z) / around
    length = t_m - geometry.x2
    ok = np.where((length > 0.0) & (c_a > 0.0) & (c_b > 0.0), 1.0, np.nan)
    s_a, s_b = -(depth * x + e_x * z) / around, (y * t_m - e_y * depth) / square
    return UpPose(length * ok, s_a, c_a, s_b, c_b)


def up_of_corner(geometry: LegGeometry, from_joint: Array, corner: Array) -> Array:
    """Coordinates of the UP branch that put a corner of the foot at a place.

    Args:
        geometry: the leg.
        from_joint: (..., 3) the place from U_11, in {A1} [m].
        corner: (..., 3) the corner in {E1} [m].

    Returns:
        (..., 3) l_11 [m], alpha, beta [rad], all NaN where `pose_of_corner` has no length.
    """
    pose = pose_of_corner(geometry, from_joint, corner)
    length = np.asarray(pose.length)
    up = np.empty((*length.shape, 3))
    nowhere = 0.0 * length
    up[..., 0] = length
    up[..., 1] = np.arctan2(pose.s_a, pose.c_a) + nowhere
    up[..., 2] = np.arctan2(pose.s_b, pose.c_b) + nowhere
    return up


def is_within_joints(up: Array) -> NDArray[np.bool_]:
    """(...) whether the branch has a length and its joint turns by less than 90 degrees."""
    return (up[..., 0] > 0.0) & (np.abs(up[..., 1:]) < 0.5 * math.pi).all(axis=-1)


def foot_rotation(up: Array) -> Array:
    """(..., 3, 3) rotation of the foot's frame {E1} in {A1}, Eq. (9)."""
    sine, cosine = np.sin(up[..., 1:]), np.cos(up[..., 1:])
    s_a, s_b, c_a, c_b = sine[..., 0], sine[..., 1], cosine[..., 0], cosine[..., 1]
    rotation = np.zeros((*up.shape[:-1], 3, 3))
    rotation[..., 0, 0], rotation[..., 2, 0] = c_a, -s_a
    rotation[..., 0, 1], rotation[..., 1, 1], rotation[..., 2, 1] = s_a * s_b, c_b, c_a * s_b
    rotation[..., 0, 2], rotation[..., 1, 2], rotation[..., 2, 2] = s_a * c_b, -s_b, c_a * c_b
    return rotation


def carried(geometry: LegGeometry, up: Array, places: Array) -> Array:
    """(..., 3) where the foot carries places (..., 3) of {E1}: from U_11, in {A1} [m]."""
    below = np.zeros((*up.shape[:-1], 3))
    below[..., 2] = up[..., 0] + geometry.x2
    return times(foot_rotation(up), places - below)


def carried_jacobian(up: Array, point: Array) -> Array:
    """Derivatives of `carried` by the coordinates of the UP branch.

    Args:
        up: (..., 3) coordinates.
        point: (..., 3) what `carried` gives for them [m].

    Returns:
        (..., 3, 3) columns by l_11 [-], alpha and beta [m/rad].
    """
    rotation = foot_rotation(up)
    by_alpha = cross(_Y_AXIS, point)
    by_beta = cross(rotation[..., 0], point)
    return _columns(-rotation[..., 2], by_alpha, by_beta)


def carried_jacobian_rate(up: Array, up_rate: Array, point: Array) -> Array:
    """Rate of `carried_jacobian` while the UP branch moves.

    Args:
        up: (..., 3) coordinates.
        up_rate: (..., 3) their rates [m/s, rad/s, rad/s].
        point: (..., 3) what `carried` gives for the coordinates [m].

    Returns:
        (..., 3, 3) rates of the columns [1/s], [m/rad/s].
    """
    rotation = foot_rotation(up)
    x_axis, z_axis = rotation[..., 0], rotation[..., 2]
    alpha_rate, beta_rate = up_rate[..., 1, np.newaxis], up_rate[..., 2, np.newaxis]
    angular_velocity = alpha_rate * _Y_AXIS + beta_rate * x_axis
    velocity = times(carried_jacobian(up, point), up_rate)
    # The foot's x axis turns with alpha alone.
    x_axis_rate = alpha_rate * cross(_Y_AXIS, x_axis)
    by_length = -cross(angular_velocity, z_axis)
    by_alpha = cross(_Y_AXIS, velocity)
    by_beta = cross(x_axis_rate, point) + cross(x_axis, velocity)
    return _columns(by_length, by_alpha, by_beta)


def _columns(by_length: Array, by_alpha: Array, by_beta: Array) -> Array:
    """Columns (..., 3) as a matrix; the first may be common to several points (..., n, 3)."""
    matrix = np.empty((*by_beta.shape, 3))
    matrix[..., 0], matrix[..., 1], matrix[..., 2] = by_length, by_alpha, by_beta
    return matrix


CORNERS = ("E1", "E2", "E3")

# One of `CORNERS` or its number 1, 2, 3, or an array of either.
type Reference = ArrayLike


def corner_numbers(reference: Reference) -> NDArray[np.intp]:
    """Numbers 1, 2, 3 of the corners E_1, E_2, E_3.

    Args:
        reference: "E1", "E2", "E3" or their numbers 1, 2, 3: one, or an array (...).

    Returns:
        (...) numbers.

    Raises:
        ValueError: there is no such corner.
    """
    given_numbers = np.asarray(reference)
    if (
        given_numbers.dtype.kind in "if"
        and ((given_numbers >= 1) & (given_numbers <= len(CORNERS))).all()
    ):
        whole = given_numbers.astype(np.intp, copy=False)
        if whole is given_numbers or (whole == given_numbers).all():
            return whole
    numbers = np.zeros(given_numbers.shape, dtype=np.intp)
    for number, name in enumerate(CORNERS, start=1):
        numbers[given_numbers == (name if given_numbers.dtype.kind in "UO" else number)] = number
    unknown = (numbers == 0) | (given_numbers.dtype.kind == "b")
    if unknown.any():
        raise ValueError(
            f"reference must be one of {', '.join(CORNERS)} or its number 1, 2, 3, "
            f"not {given_numbers[unknown].tolist()[0]!r}"
        )
    return numbers


def reference_corner(geometry: LegGeometry, reference: Reference) -> NDArray[np.float64]:
    """(..., 3) places of the reference corners in the foot's frame {E1} [m], Eq. (3).

    Raises:
        ValueError: there is no such corner.
    """
    return geometry.corners[corner_numbers(reference) - 1]


@nan_without_warning
def lowest_corner(
    geometry: LegGeometry, up: ArrayLike, leg_rotation: ArrayLike | None = None
) -> NDArray[np.intp]:
    """The corner to be given as reference, so that none is below the ground while it is on it.

    A foot beside its hinge is inclined. With a level body and alpha = 0 the rule is: E_1 for
    beta < 0; E_2 (or E_3, as low) for beta > 0. The tilt's sign is the same whichever corner is
    the reference, so the rule may be asked with any. The paper does not say what it uses; with
    E_1 for all legs the other corners of two feet go 14.55 mm into the ground.

    Args:
        geometry: the leg.
        up: (..., 3) coordinates of the UP branch [m, rad, rad], of which the angles count.
        leg_rotation: (..., 3, 3) rotation of {A1} in the world; None for upright.

    Returns:
        (...) numbers 1, 2, 3; 1 for a foot that is flat.
    """
    rotation = foot_rotation(of_width(up, 3, "up"))
    if leg_rotation is not None:
        rotation = np.asarray(leg_rotation) @ rotation
    heights = np.einsum("...j,kj->...k", rotation[..., 2, :], geometry.corners)
    return np.argmin(heights, axis=-1) + 1


@nan_without_warning
def up_branch(
    geometry: LegGeometry, point: ArrayLike, reference: Reference = "E1"
) -> NDArray[np.float64]:
    """Coordinates of the UP branch with a corner of the foot at a point, Eqs. (10), (14)-(19).

    Args:
        geometry: the leg.
        point: (..., 3) place of the reference corner in {A1} [m].
        reference: corner, "E1", "E2" or "E3" (or 1, 2, 3); one, or an array (...).

    Returns:
        (..., 3) l_11 [m], alpha, beta [rad]; NaN where the leg cannot reach.

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    from_joint = of_width(point, 3, "point") - geometry.upper_joints[0]
    return up_of_corner(geometry, from_joint, reference_corner(geometry, reference))


@nan_without_warning
def branch_lengths(geometry: LegGeometry, up: ArrayLike) -> NDArray[np.float64]:
    """Lengths of the branches that belong to coordinates of the UP branch, Eqs. (11) and (12).

    Args:
        geometry: the leg.
        up: (..., 3) l_11 [m], alpha, beta [rad].

    Returns:
        (..., 3) l_11, l_12, l_13 between the joints' centres [m].
    """
    coordinates = of_width(up, 3, "up")
    sine, cosine = np.sin(coordinates[..., 1:]), np.cos(coordinates[..., 1:])
    pose = UpPose(coordinates[..., 0], sine[..., 0], cosine[..., 0], sine[..., 1], cosine[..., 1])
    return _lengths(geometry, pose)


def _lengths(geometry: LegGeometry, pose: UpPose) -> NDArray[np.float64]:
    """(..., 3) lengths of all branches with the UP branch in a pose [m], Eqs. (11) and (12)."""
    length, s_a, c_a, s_b, c_b = pose
    x, y, z = geometry.lower_joints[2].tolist()
    hinge_x, hinge_y, _ = (geometry.upper_joints[2] - geometry.upper_joints[0]).tolist()
    below = z - geometry.x2 - length
    # The ball joints are mirrored in x: what they share, along the foot's axes and then A1's.
    depth = s_b * y + c_b * below
    ahead = c_b * y - s_b * below - hinge_y
    middle_x, middle_z = s_a * depth, c_a * depth
    aside, down = c_a * x - hinge_x, s_a * x
    squares = ahead * ahead
    lengths = np.empty((*np.shape(length), 3))
    lengths[..., 0] = length
    lengths[..., 1] = np.sqrt((middle_x - aside) ** 2 + squares + (middle_z + down) ** 2)
    lengths[..., 2] = np.sqrt((middle_x + aside) ** 2 + squares + (middle_z - down) ** 2)
    return lengths


def ups_vectors(geometry: LegGeometry, up: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 2, 3) vectors of the two UPS branches from their upper joints, in {A1} [m]."""
    ends = carried(geometry, up[..., np.newaxis, :], geometry.lower_joints[1:])
    return ends - (geometry.upper_joints[1:] - geometry.upper_joints[0])


@nan_without_warning
def leg_inverse(
    geometry: LegGeometry, point: ArrayLike, reference: Reference = "E1"
) -> NDArray[np.float64]:
    """Lengths of the branches that put a corner of the foot at a point, Eqs. (10)-(19).

    Args:
        geometry: the leg.
        point: (..., 3) place of the reference corner in {A1} [m].
        reference: corner, "E1", "E2" or "E3" (or 1, 2, 3); one, or an array (...).

    Returns:
        (..., 3) lengths l_11, l_12, l_13 of the branches UP, UPS, UPS [m]; NaN where the leg
        cannot reach.

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    from_joint = of_width(point, 3, "point") - geometry.upper_joints[0]
    corner = reference_corner(geometry, reference)
    return _lengths(geometry, pose_of_corner(geometry, from_joint, corner))


@nan_without_warning
def leg_corners(geometry: LegGeometry, up: ArrayLike) -> NDArray[np.float64]:
    """Corners of the foot at coordinates of the UP branch, Eqs. (8) and (13).

    Args:
        geometry: the leg.
        up: (..., 3) l_11 [m], alpha, beta [rad].

    Returns:
        (..., 3, 3) corners E_1, E_2, E_3 (rows) in {A1} [m].
    """
    coordinates = of_width(up, 3, "up")[..., np.newaxis, :]
    return carried(geometry, coordinates, geometry.corners) + geometry.upper_joints[0]


_ITERATIONS = 40
_LARGEST_STEP = 1.0  # [rad]
_SMALLEST_STEP = 1e-15  # [rad]
# Largest difference between the solution's lengths and the given ones [m].
_TOLERANCE = 1e-10


class LegPosture(NamedTuple):
    """Posture of a leg: its foot in the leg's frame {A1}.

    Attributes:
        point: (..., 3) corner E_1 [m].
        alpha: (...) angle of the UP branch and the foot about y [rad].
        beta: (...) their angle about the foot's x axis [rad].
    """

    point: NDArray[np.float64]
    alpha: NDArray[np.float64]
    beta: NDArray[np.float64]


def leg_forward(geometry: LegGeometry, lengths: ArrayLike) -> LegPosture:
    """Place of the foot, given the lengths of the branches.

    Args:
        geometry: the leg.
        lengths: (..., 3) l_11, l_12, l_13 of the branches UP, UPS, UPS [m].

    Returns:
        Corner E_1 and the foot's angles; NaN where the leg cannot be assembled, which is so for
        three out of ten triples of lengths within the strokes.

    Raises:
        ValueError: wrong shapes.
    """
    up = up_of_lengths(geometry, lengths)
    return LegPosture(leg_corners(geometry, up)[..., 0, :], up[..., 1], up[..., 2])


@nan_without_warning
def up_of_lengths(geometry: LegGeometry, lengths: ArrayLike) -> NDArray[np.float64]:
    """Coordinates of the UP branch, given the lengths of all three.

    Args:
        geometry: the leg.
        lengths: (..., 3) l_11, l_12, l_13 [m].

    Returns:
        (..., 3) l_11 [m], alpha, beta [rad]; NaN where the leg cannot be assembled.

    Raises:
        ValueError: wrong shapes.
    """
    arrays = of_width(lengths, 3, "lengths").astype(np.float64)
    alpha, beta = _newton(geometry, arrays)
    up = np.stack([arrays[..., 0], alpha, beta], axis=-1)
    error = np.abs(branch_lengths(geometry, up) - arrays).max(axis=-1)
    good = (error <= _TOLERANCE) & is_within_joints(up)
    return np.where(good[..., np.newaxis], up, np.nan)


def _newton(geometry: LegGeometry, lengths: Array) -> tuple[Array, Array]:
    """The angles alpha and beta, where the iteration converges."""
    s_30, c_30 = 0.5, 0.5 * np.sqrt(3.0)
    a, b = geometry.a, geometry.b
    l_11, l_12, l_13 = np.moveaxis(lengths, -1, 0)
    h = l_11 + geometry.x2 - geometry.x3
    half_sum = 0.5 * (a * a + b * b + h * h - 0.5 * (l_12 * l_12 + l_13 * l_13))
    half_difference = 0.25 * (l_13 - l_12) * (l_13 + l_12)
    rho, delta = np.hypot(b * c_30, h), np.arctan2(h, b * c_30)
    p, q, r = a * b * s_30 * s_30, a * c_30 * rho, a * s_30 * rho
    alpha, beta = np.zeros_like(l_11), np.zeros_like(l_11)
    # Legs of a row go on together, so that a batch has what each of its rows would have alone.
    row = -1 if l_11.ndim else None
    going_on = np.bool_(True)
    for _ in range(_ITERATIONS):
        s_a, c_a = np.sin(alpha), np.cos(alpha)
        s_p, c_p = np.sin(beta + delta), np.cos(beta + delta)
        f = p * c_a + q * c_p - half_sum
        g = r * s_a * s_p - half_difference
        f_a, f_b, g_a, g_b = -p * s_a, -q * s_p, r * c_a * s_p, r * s_a * c_p
        determinant = f_a * g_b - f_b * g_a
        step_a = (f_b * g - g_b * f) / determinant
        step_b = (g_a * f - f_a * g) / determinant
        size = np.maximum(np.abs(step_a), np.abs(step_b))
        scale = going_on * np.minimum(1.0, _LARGEST_STEP / np.maximum(size, _LARGEST_STEP))
        alpha, beta = alpha + scale * step_a, beta + scale * step_b
        going_on = going_on & (size > _SMALLEST_STEP).any(axis=row, keepdims=True)
        if not going_on.any():
            break
    return alpha, beta
