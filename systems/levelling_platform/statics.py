"""Statics of the platform at rest on the feet that carry it, in closed form."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from parapod.systems.levelling_platform.geometry import ARM_BASE, LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.leg import foot_motion
from parapod.systems.levelling_platform.plane import (
    Vector3,
    attitude_derivatives,
    attitude_seeing,
    cross,
    dot,
    dot4,
    minus,
    mismatch,
    normal_of,
    normal_over,
    normal_through,
    plus,
    scaled,
    upwards,
)


@dataclass(frozen=True)
class KinematicPlatformParams:
    """What the quasi-static plant weighs and how much it gives way.

    Attributes:
        mass: platform without the arm [kg] (section 5.2).
        centre_of_mass: of the platform without the arm, from F [m] (assumption).
        arm_mass: arm with its camera [kg] (section 7).
        arm_base: base of the arm, from F [m] (fitted to the paper's workspace).
        arm_centre: distance of the arm's centre of mass from its base [m].
        foot_stiffness: stiffness of one foot with its leg [N/m]; decides how the load is shared
            by four legs whose feet do not lie in one plane exactly (assumption).
        wheel_stiffness: of one wheel, likewise [N/m] (assumption).
        gravity: [m/s^2].
    """

    mass: float = 50.0
    centre_of_mass: tuple[float, float, float] = (0.0, 0.0, -0.13)
    arm_mass: float = 1.0
    arm_base: tuple[float, float, float] = ARM_BASE
    arm_centre: float = 1.747
    foot_stiffness: float = 2.0e6
    wheel_stiffness: float = 2.0e6
    gravity: float = 9.81

    def centre_with(self, on_arm: Vector3) -> Vector3:
        """Centre of mass of platform and arm, where the arm's own is at `on_arm`, from F [m]."""
        share = self.arm_mass / (self.mass + self.arm_mass)
        return plus(scaled(self.centre_of_mass, 1.0 - share), scaled(on_arm, share))


class Stance(NamedTuple):
    """Everything that follows from four extensions, their rates, the ground and the arm."""

    posture: Sequence[float]
    attitude: Sequence[float]
    angular_velocity: Sequence[float]
    specific_force: Sequence[float]
    contact_force: Sequence[float]
    load_force: Sequence[float]
    foot_height: Sequence[float]
    normal: Sequence[float]  # of the ground, in the platform's frame


def stand(
    geometry: PlatformGeometry,
    params: KinematicPlatformParams,
    extension: list[float],
    velocity: list[float],
    ground: list[float],
    arm: list[float],
    foot_offsets: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
) -> Stance:
    """The platform at rest on its feet.

    Args:
        geometry: the platform.
        params: what it weighs and how much it gives way.
        extension: (4) of the actuators [m].
        velocity: (4) their rates [m/s].
        ground: (2) roll and pitch of the ground [rad].
        arm: (2) angles of turntable and arm [rad].
        foot_offsets: (4) how far each foot stands above the ground's plane [m].
    """
    motions = [foot_motion(leg, d) for leg, d in zip(geometry.legs, extension, strict=True)]
    feet, slopes = [foot for foot, _ in motions], [slope for _, slope in motions]
    if any(foot_offsets):
        # Along the normal, so that the force of a foot keeps its line.
        g = normal_over(feet[:3], foot_offsets[:3])
        feet = [plus(foot, scaled(g, o)) for foot, o in zip(feet, foot_offsets, strict=True)]
    n = normal_of(*ground)
    shares, normal_weight = _carry(params, feet, n, arm, geometry.foot_radius)
    contact = [normal_weight * share for share in shares]
    sunk = [
        (x, y, z - f / params.foot_stiffness) for (x, y, z), f in zip(feet, contact, strict=True)
    ]
    carrying = sorted(range(LEG_COUNT), key=contact.__getitem__)[1:]
    points = [sunk[i] for i in carrying]
    g, g_rate = _moving_normal(points, [scaled(slopes[i], velocity[i]) for i in carrying])
    height = dot(g, points[0]) + geometry.foot_radius
    roll, pitch = attitude_seeing(g, n)
    roll_rate, pitch_rate = attitude_rate(n, g, g_rate, roll, pitch)
    cos_roll, sin_roll = math.cos(roll), math.sin(roll)
    return Stance(
        posture=[roll, pitch, height],
        attitude=[roll, pitch, 0.0],
        angular_velocity=[roll_rate, pitch_rate * cos_roll, -pitch_rate * sin_roll],
        specific_force=scaled(upwards(roll, pitch), params.gravity),
        contact_force=contact,
        load_force=[f * dot(g, slope) for f, slope in zip(contact, slopes, strict=True)],
        foot_height=[max(0.0, dot(g, minus(points[0], foot))) for foot in sunk],
        normal=g,
    )


def _moving_normal(points: list[Vector3], rates: list[Vector3]) -> tuple[Vector3, Vector3]:
    """Unit normal of the plane through three moving points, pointing up, and its rate."""
    p, q, r = points
    p_rate, q_rate, r_rate = rates
    normal, length = normal_through(p, q, r)
    g = scaled(normal, 1.0 / length)
    normal_rate = plus(
        cross(minus(p_rate, q_rate), minus(p, r)), cross(minus(p, q), minus(p_rate, r_rate))
    )
    stretch = dot(g, normal_rate)
    return g, scaled(minus(normal_rate, scaled(g, stretch)), 1.0 / length)


def _carry(
    params: KinematicPlatformParams,
    feet: list[Vector3],
    n: Vector3,
    arm: list[float],
    radius: float,
) -> tuple[list[float], float]:
    """Shares of the weight carried by the four feet, and the weight normal to the ground [N]."""
    weight = (params.mass + params.arm_mass) * params.gravity
    weights, excess = mismatch(feet)
    squared = dot4(weights, weights)
    gap = excess / squared
    flat = [(x, y, z - w * gap) for (x, y, z), w in zip(feet, weights, strict=True)]
    centre, upright = _pressure_point(params, arm, (flat[0], flat[1], flat[2]), n, radius)
    # Any balanced shares plus a multiple of the dependency balance too; springs that give by
    # force / stiffness are balanced where (weights . force) = stiffness * excess.
    three = _barycentric(feet, (0, 1, 2), centre)
    along = (params.foot_stiffness * excess / weight - dot4(weights, three)) / squared
    shares = [s + w * along for s, w in zip(three, weights, strict=True)]
    if min(shares) >= 0.0:
        return shares, weight * upright
    # One end of the shorter diagonal lifts: the one on the far side of the centre of mass.
    lifted = min(range(LEG_COUNT), key=shares.__getitem__)
    results = []
    for leg in (lifted, (lifted + 2) % LEG_COUNT):
        a, b, c = (i for i in range(LEG_COUNT) if i != leg)
        centre, upright = _pressure_point(params, arm, (feet[a], feet[b], feet[c]), n, radius)
        results.append((_barycentric(feet, (a, b, c), centre), weight * upright))
    return max(results, key=lambda result: min(result[0]))


def _barycentric(
    feet: list[Vector3], legs: tuple[int, ...], centre: tuple[float, float]
) -> list[float]:
    """Shares of three legs that balance the weight at `centre`; the fourth gets zero."""
    (xa, ya, _), (xb, yb, _), (xc, yc, _) = (feet[i] for i in legs)
    # Feet stand at minus the vectors to F.
    x, y = -centre[0], -centre[1]
    area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
    b = ((x - xa) * (yc - ya) - (xc - xa) * (y - ya)) / area
    c = ((xb - xa) * (y - ya) - (x - xa) * (yb - ya)) / area
    shares = [0.0] * LEG_COUNT
    for leg, share in zip(legs, (1.0 - b - c, b, c), strict=True):
        shares[leg] = share
    return shares


def _pressure_point(
    params: KinematicPlatformParams,
    arm: list[float],
    feet: tuple[Vector3, Vector3, Vector3],
    n: Vector3,
    radius: float,
) -> tuple[tuple[float, float], float]:
    """Where the line of gravity through the centre of mass meets the ground under three feet.

    The ground is below the feet's centres by their radius; the point is told as if seen along
    the ground's normal from the plane of the centres.

    Returns:
        That point (x, y) in the platform's frame [m], and the cosine between the ground's normal
        and the vertical.
    """
    com = centre_of_mass(params, arm)
    normal, length = normal_through(*feet)
    g = scaled(normal, 1.0 / length)
    up = upwards(*attitude_seeing(g, n))
    # A foot is at -P from F, so the plane is g . x = -g . P.
    upright = dot(g, up)
    fall = (dot(g, plus(feet[0], com)) + radius) / upright
    return (
        com[0] - fall * up[0] + radius * g[0],
        com[1] - fall * up[1] + radius * g[1],
    ), upright


def centre_of_mass(params: KinematicPlatformParams, arm: list[float]) -> Vector3:
    """Centre of mass of platform and arm at angles (2) of turntable and arm [rad], from F [m]."""
    turn, swing = arm
    reach = params.arm_centre * math.sin(swing)
    on_arm = (
        params.arm_base[0] + reach * math.cos(turn),
        params.arm_base[1] + reach * math.sin(turn),
        params.arm_base[2] + params.arm_centre * math.cos(swing),
    )
    return params.centre_with(on_arm)


def attitude_rate(
    n: Vector3, g: Vector3, g_rate: Vector3, roll: float, pitch: float
) -> tuple[float, float]:
    """Rates of roll and pitch that turn the ground's normal by g_rate in the platform's frame."""
    _, by_pitch = attitude_derivatives(n, g, roll, pitch)
    pitch_rate = g_rate[0] / by_pitch[0]
    rest_y, rest_z = g_rate[1] - pitch_rate * by_pitch[1], g_rate[2] - pitch_rate * by_pitch[2]
    return (rest_y * g[2] - rest_z * g[1]) / (g[1] * g[1] + g[2] * g[2]), pitch_rate
