"""One leg in closed form: a parallelogram whose diagonal is the linear actuator.

In the leg's plane (x and z of frame D) the hip is E, the short side of the parallelogram is
l_3 e_a with e_a = (cos alpha, sin alpha), and the long side is l_4 (cos psi, sin psi). Their
sum is the diagonal EK, whose length is the actuator's extension d. The coupler never turns
relative to the platform, so the foot repeats the motion of the long side's end. The working
branch has psi between 90 and 270 degrees.

All functions work elementwise on floats, arrays and AutoDiffXd
(`parapod.systems.core.elementwise`).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from parapod.systems.core import quaternions
from parapod.systems.core.elementwise import Elementwise, atan2, sqrt, total
from parapod.systems.core.triples import Vector3, dot, minus, plus, scaled
from parapod.systems.levelling_platform.geometry import LegGeometry
from parapod.systems.levelling_platform.plane import about_vertical, to_world

# Horizontal components of a place.
type Point = tuple[Elementwise, Elementwise]


def long_side(leg: LegGeometry, extension: Elementwise) -> tuple[Elementwise, Elementwise]:
    """Components of the long side l_4 (cos psi, sin psi) in the leg's plane [m].

    NaN where the triangle cannot close.
    """
    return _side_motion(leg, extension)[:2]


def _side_motion(
    leg: LegGeometry, extension: Elementwise
) -> tuple[Elementwise, Elementwise, Elementwise]:
    """`long_side` (2) and `swing_rate`.

    Eq. (2) without trigonometric calls: d cos gamma = (d^2 + l_3^2 - l_4^2) / (2 l_3), and the
    diagonal is d (cos z, sin z) with z = alpha + gamma. The rate is that of d^2 = l_3^2 + l_4^2 +
    2 l_3 l_4 cos(psi - alpha), where l_4 sin(psi - alpha) is d sin gamma.
    """
    ca, sa, l_3, _, difference, _ = leg.constants
    along = (extension * extension + difference) * (0.5 / l_3)
    across = sqrt(extension * extension - along * along)
    side = along - l_3
    return side * ca - across * sa, side * sa + across * ca, -extension / (l_3 * across)


def swing_angle(leg: LegGeometry, extension: Elementwise) -> Elementwise:
    """Angle psi of the long side in the leg's plane [rad], in (0, 2 pi) on the working branch."""
    return swing_motion(leg, extension)[0]


def swing_motion(leg: LegGeometry, extension: Elementwise) -> tuple[Elementwise, Elementwise]:
    """`swing_angle` and `swing_rate` in one go."""
    x, z, rate = _side_motion(leg, extension)
    # Measured from -x, so that the branch cut of atan2 is far from the working range.
    return atan2(-z, -x) + math.pi, rate


def swing_rate(leg: LegGeometry, extension: Elementwise) -> Elementwise:
    """Transmission ratio dpsi/dd of the swing angle to the extension [rad/m]; negative."""
    return _side_motion(leg, extension)[2]


def diagonal_angle(leg: LegGeometry, extension: Elementwise) -> Elementwise:
    """Angle z = alpha + gamma of the actuator in the leg's plane [rad], Eq. (29)."""
    x, z = long_side(leg, extension)
    ca, sa = leg.e_a
    return atan2(-z - leg.l_3 * sa, -x - leg.l_3 * ca) + math.pi


def foot_to_centre(leg: LegGeometry, extension: Elementwise) -> Vector3:
    """Vector P_C^F from the foot to the platform's centre F, in the platform's frame [m].

    Eqs. (4), (6) and (8). With a roller at the foot the point is the roller's centre.
    """
    x, z = long_side(leg, extension)
    cb, sb = leg.e_b
    c_x, c_y, c_z = leg.p_MF
    return c_x - cb * x, c_y - sb * x, c_z - z


class FeetPose(NamedTuple):
    """Place and heading of a platform over the feet on which it stands.

    Attributes:
        along: vector along the ground from the middle of the feet to F, in the world [m].
        yaw: heading against that of a platform with legs of one length on the same feet [rad].
    """

    along: Vector3
    yaw: Elementwise

    def pose(self, posture: Sequence[Elementwise], normal: Vector3) -> tuple[Elementwise, ...]:
        """Quaternion (w, x, y, z) and place (7) of the platform, from the middle of the feet.

        Args:
            posture: its roll, pitch and height [rad, rad, m].
            normal: the ground's normal in the world.
        """
        roll, pitch, height = posture
        place = about_vertical(plus(self.along, scaled(normal, height)), self.yaw)
        return (*quaternions.of_angles(roll, pitch, self.yaw), *place)


def footprint(legs: Sequence[LegGeometry], ground: tuple[float, float]) -> list[Point]:
    """Places (4) of the feet about their middle, of a platform with legs of one length [m].

    Horizontal components, of legs in mid-stroke, seen by a world in which the platform has no yaw.

    Args:
        legs: the legs (4).
        ground: roll and pitch of the ground [rad].
    """
    middles = [0.5 * (leg.extension_min + leg.extension_max) for leg in legs]
    vectors = [to_world(vector, *ground) for vector in _feet_below(legs, middles)]
    x, y = (total(part) / len(legs) for part in list(zip(*vectors, strict=True))[:2])
    return [(x - f_x, y - f_y) for f_x, f_y, _ in vectors]


def pose_on_feet(
    legs: Sequence[LegGeometry],
    extension: Sequence[Elementwise],
    attitude: tuple[Elementwise, Elementwise],
    normal: Vector3,
    print_of_feet: Sequence[Point],
) -> FeetPose:
    """Place and heading over feet that give way to the legs evenly, as if friction were alike.

    Legs of different lengths spread their feet unevenly, for each swings in a plane of its own:
    the feet slip, and the platform turns by what leaves them nearest to where they were (least
    squares; on 2 and 3 deg of ground the paper's platform turns by .06 deg when it levels itself).

    Args:
        legs: the legs (4).
        extension: their extensions (4) [m].
        attitude: roll and pitch of the platform [rad].
        normal: the ground's normal in the world.
        print_of_feet: the `footprint` on this ground.
    """
    parts = list(zip(*_feet_below(legs, extension), strict=True))

    def weighted(weights: Sequence[Elementwise]) -> Vector3:
        a, b, c, d = weights
        x, y, z = (a * p + b * q + c * r + d * s for p, q, r, s in parts)
        return to_world((x, y, z), *attitude)

    # Sums of the vectors, weighted by the places of the feet, which are about their middle.
    on_x, on_y = zip(*print_of_feet, strict=True)
    (x_x, y_x, _), (x_y, y_y, _) = weighted(on_x), weighted(on_y)
    middle = weighted((0.25,) * 4)
    along = minus(middle, scaled(normal, dot(normal, middle)))
    return FeetPose(along, (x_y - y_x) / (x_x + y_y))


def _feet_below(legs: Sequence[LegGeometry], extension: Sequence[Elementwise]) -> list[Vector3]:
    """Vectors from the feet to F, in the platform's frame.

    Feet are round, turn with the platform and roll by that: what stays is their lowest point, as
    the platform parallel to the ground has it.
    """
    vectors = []
    for leg, d in zip(legs, extension, strict=True):
        x, y, z = foot_to_centre(leg, d)
        vectors.append((x, y, z + leg.foot_radius))
    return vectors


def foot_motion(leg: LegGeometry, extension: Elementwise) -> tuple[Vector3, Vector3]:
    """`foot_to_centre` and `foot_to_centre_rate` in one go."""
    x, z, psi_rate = _side_motion(leg, extension)
    cb, sb = leg.e_b
    c_x, c_y, c_z = leg.p_MF
    sideways = z * psi_rate
    return (c_x - cb * x, c_y - sb * x, c_z - z), (cb * sideways, sb * sideways, -x * psi_rate)


def foot_to_centre_rate(leg: LegGeometry, extension: Elementwise) -> Vector3:
    """Derivative of `foot_to_centre` with respect to the extension, d P_C^F / dd [-].

    Eqs. (27)-(29), where what is printed as dz is -dz/dd. It grows without bound towards the dead
    points d = l_4 +- l_3, where the parallelogram is flat.
    """
    return foot_motion(leg, extension)[1]


def extension_on_plane(leg: LegGeometry, g: Vector3, height: Elementwise) -> Elementwise:
    """Extension that puts the foot on the plane g . P = height, eqs. (26) and (31) solved [m].

    With a = (g_1 cos beta + g_2 sin beta, g_3) the condition is a . l_4 (cos psi, sin psi) = b,
    a single linear trigonometric equation; of its two roots the working branch is taken. NaN
    where the foot cannot reach the plane. No trigonometric function is called.

    Args:
        leg: the leg.
        g: the plane's unit normal in the platform's frame.
        height: distance of F above the plane through the foot (or the roller's centre) [m].
    """
    g_1, g_2, g_3 = g
    ca, sa = leg.e_a
    cb, sb = leg.e_b
    c_x, c_y, c_z = leg.p_MF
    a_1 = g_1 * cb + g_2 * sb
    b = g_1 * c_x + g_2 * c_y + g_3 * c_z - height
    a_squared = a_1 * a_1 + g_3 * g_3
    root = sqrt((leg.l_4 * leg.l_4) * a_squared - b * b)
    # The long side projected on e_a, times |a|^2.
    projection = b * (ca * a_1 + sa * g_3) + root * (sa * a_1 - ca * g_3)
    return sqrt((leg.l_3 * leg.l_3 + leg.l_4 * leg.l_4) + (2.0 * leg.l_3) * projection / a_squared)


def extension_rate_on_plane(
    leg: LegGeometry,
    extension: Elementwise,
    g: Vector3,
    g_rate: Vector3,
    height_rate: Elementwise,
) -> Elementwise:
    """Rate of the extension that keeps the foot on a moving plane: Eq. (25) for one leg.

    Args:
        leg: the leg.
        extension: its extension [m].
        g: the plane's unit normal in the platform's frame.
        g_rate: its rate [1/s].
        height_rate: rate of the height of F above the plane [m/s].

    Returns:
        The extension's rate [m/s].
    """
    foot, slope = foot_motion(leg, extension)
    return (height_rate - dot(g_rate, foot)) / dot(g, slope)


def extension_on_moving_plane(
    leg: LegGeometry,
    g: Vector3,
    g_rate: Vector3,
    height: Elementwise,
    height_rate: Elementwise,
) -> tuple[Elementwise, Elementwise]:
    """`extension_on_plane` and `extension_rate_on_plane` in one go.

    The long side solves the first, and everything in the second follows from it: with it,
    g . dP/dd is the root of the first times dpsi/dd.

    Args:
        leg: the leg.
        g: the plane's unit normal in the platform's frame.
        g_rate: its rate [1/s].
        height: distance of F above the plane through the foot (or the roller's centre) [m].
        height_rate: its rate [m/s].

    Returns:
        The extension [m] and its rate [m/s].
    """
    ca, sa, l_3, l_4_squared, _, total = leg.constants
    cb, sb = leg.e_b
    c_x, c_y, c_z = leg.p_MF
    g_1, g_2, g_3 = g
    w_1, w_2, w_3 = g_rate
    a_1 = g_1 * cb + g_2 * sb
    b = g_1 * c_x + g_2 * c_y + g_3 * c_z - height
    a_squared = a_1 * a_1 + g_3 * g_3
    root = sqrt(l_4_squared * a_squared - b * b)
    x = (b * a_1 - root * g_3) / a_squared
    z = (b * g_3 + root * a_1) / a_squared
    extension = sqrt(total + (2.0 * l_3) * (ca * x + sa * z))
    psi_rate = -extension / (l_3 * (z * ca - x * sa))
    by_turning = w_1 * (c_x - cb * x) + w_2 * (c_y - sb * x) + w_3 * (c_z - z)
    return extension, (height_rate - by_turning) / (root * psi_rate)
