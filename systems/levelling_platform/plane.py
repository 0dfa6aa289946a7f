"""Planes through feet, and the attitude of a platform that stands on one.

Elementwise functions (floats, arrays, AutoDiffXd) on vectors that are tuples of components.
"""

from collections.abc import Sequence

from parapod.systems.core.elementwise import Elementwise, asin, atan2, quotient, sin_cos, sqrt
from parapod.systems.core.triples import Vector3, cross, dot, minus


def dot4(a: Sequence[Elementwise], b: Sequence[Elementwise]) -> Elementwise:
    """Scalar product of two rows of four numbers, one a leg."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


def normal_through(p: Vector3, q: Vector3, r: Vector3) -> tuple[Vector3, Elementwise]:
    """Normal (not normalised) of the plane through three points, and its length.

    The length has the sign that makes normal / length point up, whatever the points' order.
    """
    normal = cross(minus(p, q), minus(p, r))
    return normal, sqrt(dot(normal, normal)) * (normal[2] / abs(normal[2]))


def normal_over(points: Sequence[Vector3], offsets: Sequence[Elementwise]) -> Vector3:
    """Unit normal g, pointing up, for which g . P + offset is the same for three points P."""
    p, q, r = points
    u, v = minus(p, q), minus(p, r)
    normal, length = normal_through(p, q, r)
    along_u, along_v = offsets[1] - offsets[0], offsets[2] - offsets[0]
    a, b = cross(v, normal), cross(normal, u)
    squared = length * length
    leaning = tuple((along_u * a[i] + along_v * b[i]) / squared for i in range(3))
    upright = sqrt(1.0 - dot(leaning, leaning)) / length
    return (
        leaning[0] + upright * normal[0],
        leaning[1] + upright * normal[1],
        leaning[2] + upright * normal[2],
    )


def raised(
    points: Sequence[Vector3], offsets: Sequence[Elementwise], legs: Sequence[int] = (0, 1, 2)
) -> list[Vector3]:
    """Vectors from feet to F for which the feet would be in one plane instead of above it.

    A foot that stands higher is a leg that is longer by as much along the plane's normal g, and
    g . P grows by an offset when z does by offset / g_z.

    Args:
        points: vectors from the feet to F (4).
        offsets: heights of the feet above the plane (4).
        legs: indices of the three feet that say where the plane is.
    """
    upright = normal_over([points[i] for i in legs], [offsets[i] for i in legs])[2]
    return [(x, y, z + o / upright) for (x, y, z), o in zip(points, offsets, strict=True)]


def mismatch(points: Sequence[Vector3]) -> tuple[tuple[Elementwise, ...], Elementwise]:
    """Distance of four points from lying in one plane.

    Four points (x_i, y_i) have exactly one affine dependency: weights w with
    sum w = sum w x = sum w y = 0, the signed areas of the triangles opposite to them. The points
    lie in one plane when w . z = 0, and z - w (w . z) / (w . w) is the plane of least squares.

    Returns:
        The weights w (positive for points 1 and 3, negative for 2 and 4 when the points go
        round) [m^2], and w . z [m^3].
    """
    (x1, y1, z1), (x2, y2, z2), (x3, y3, z3), (x4, y4, z4) = points

    def twice_area(
        xa: Elementwise,
        ya: Elementwise,
        xb: Elementwise,
        yb: Elementwise,
        xc: Elementwise,
        yc: Elementwise,
    ) -> Elementwise:
        return (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)

    weights = (
        twice_area(x2, y2, x3, y3, x4, y4),
        -twice_area(x1, y1, x3, y3, x4, y4),
        twice_area(x1, y1, x2, y2, x4, y4),
        -twice_area(x1, y1, x2, y2, x3, y3),
    )
    return weights, dot4(weights, (z1, z2, z3, z4))


def normal_of(roll: Elementwise, pitch: Elementwise) -> Vector3:
    """Normal of a plane inclined by roll and pitch: (c_1, c_2, c_3) of Eq. (9)."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(roll), sin_cos(pitch)
    return sin_pitch * cos_roll, -sin_roll, cos_pitch * cos_roll


def to_platform(n: Vector3, roll: Elementwise, pitch: Elementwise) -> Vector3:
    """A vector of the world seen by a platform of that attitude: g of Eqs. (10)-(12) for n."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(roll), sin_cos(pitch)
    m_z = n[0] * sin_pitch + n[2] * cos_pitch
    return (
        n[0] * cos_pitch - n[2] * sin_pitch,
        n[1] * cos_roll + m_z * sin_roll,
        m_z * cos_roll - n[1] * sin_roll,
    )


def upwards(roll: Elementwise, pitch: Elementwise) -> Vector3:
    """The world's vertical seen by a platform of that attitude: `to_platform` of (0, 0, 1)."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(roll), sin_cos(pitch)
    return -sin_pitch, cos_pitch * sin_roll, cos_pitch * cos_roll


def to_world(g: Vector3, roll: Elementwise, pitch: Elementwise) -> Vector3:
    """A vector of the platform seen by the world: R_y(pitch) R_x(roll) g."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(roll), sin_cos(pitch)
    m_z = sin_roll * g[1] + cos_roll * g[2]
    return (
        cos_pitch * g[0] + sin_pitch * m_z,
        cos_roll * g[1] - sin_roll * g[2],
        cos_pitch * m_z - sin_pitch * g[0],
    )


def about_vertical(vector: Vector3, yaw: Elementwise) -> Vector3:
    """A vector of the world turned about its vertical."""
    sine, cosine = sin_cos(yaw)
    x, y, z = vector
    return cosine * x - sine * y, sine * x + cosine * y, z


def attitude_seeing(g: Vector3, n: Vector3) -> tuple[Elementwise, Elementwise]:
    """Roll and pitch of the platform that sees the world's vector n as g."""
    roll = atan2(g[1], g[2]) - asin(quotient(n[1], sqrt(g[1] * g[1] + g[2] * g[2])))
    sin_roll, cos_roll = sin_cos(roll)
    m_z = g[1] * sin_roll + g[2] * cos_roll
    return roll, atan2(n[0] * m_z - n[2] * g[0], n[0] * g[0] + n[2] * m_z)


def attitude_derivatives(
    n: Vector3, g: Vector3, roll: Elementwise, pitch: Elementwise
) -> tuple[Vector3, Vector3]:
    """Derivatives of `to_platform` by roll and by pitch, at its value g."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(roll), sin_cos(pitch)
    m_x_rate = -n[0] * sin_pitch - n[2] * cos_pitch
    m_z_rate = n[0] * cos_pitch - n[2] * sin_pitch
    return (0.0 * g[0], g[2], -g[1]), (m_x_rate, sin_roll * m_z_rate, cos_roll * m_z_rate)


def seen_moving(
    n: Vector3,
    roll: Elementwise,
    pitch: Elementwise,
    roll_rate: Elementwise,
    pitch_rate: Elementwise,
) -> tuple[Vector3, Vector3]:
    """`to_platform` for a platform that turns, and its rate [1/s]."""
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(roll), sin_cos(pitch)
    n_1, n_2, n_3 = n
    g_1 = n_1 * cos_pitch - n_3 * sin_pitch
    m_z = n_1 * sin_pitch + n_3 * cos_pitch
    g_2, g_3 = n_2 * cos_roll + m_z * sin_roll, m_z * cos_roll - n_2 * sin_roll
    m_z_rate = pitch_rate * g_1
    return (g_1, g_2, g_3), (
        -pitch_rate * m_z,
        roll_rate * g_3 + sin_roll * m_z_rate,
        cos_roll * m_z_rate - roll_rate * g_2,
    )


def upwards_seeing(g: Vector3, n: Vector3) -> Vector3:
    """The world's vertical seen by the platform that sees the vector n as g.

    `upwards` of the angles of `attitude_seeing`, without the angles.
    """
    g_1, g_2, g_3 = g
    across = sqrt(g_2 * g_2 + g_3 * g_3)
    share = quotient(n[1], across)
    sine, cosine, upright = g_2 / across, g_3 / across, sqrt(1.0 - share * share)
    sin_roll, cos_roll = sine * upright - cosine * share, cosine * upright + sine * share
    m_z = across * upright
    # Pitch turns (g_1, m_z) to (n_1, n_3).
    by_sine, by_cosine = n[0] * m_z - n[2] * g_1, n[0] * g_1 + n[2] * m_z
    length = sqrt(by_sine * by_sine + by_cosine * by_cosine)
    cos_pitch = by_cosine / length
    return -by_sine / length, cos_pitch * sin_roll, cos_pitch * cos_roll
