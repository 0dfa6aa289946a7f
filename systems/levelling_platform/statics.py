"""Statics of the platform at rest: on its feet, on wheels, on some of both, on uneven legs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.arm.serial_arm import ArmJoint, ArmLink, SerialArm
from parapod.systems.core.elementwise import (
    Elementwise,
    both,
    copysign,
    either,
    first_least,
    greatest,
    is_finite,
    least,
    negated,
    sin_cos,
    sqrt,
    total,
    where,
)
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.remembered import Remembered
from parapod.systems.core.triples import Vector3, cross, dot, minus, plus, scaled
from parapod.systems.levelling_platform.geometry import (
    ARM_BASE,
    LEG_COUNT,
    LegGeometry,
    PlatformGeometry,
)
from parapod.systems.levelling_platform.kinematics import forward_kinematics
from parapod.systems.levelling_platform.leg import foot_motion, foot_to_centre
from parapod.systems.levelling_platform.plane import (
    attitude_seeing,
    mismatch,
    normal_of,
    normal_over,
    normal_through,
    to_platform,
    upwards,
    upwards_seeing,
)
from parapod.systems.levelling_platform.wheels import WheelGeometry


def rod_arm(
    base: Vector3 = ARM_BASE,
    mass: float = 1.0,
    centre: float = 1.747,
    inertia: float = 0.2929,
    length: float = 2.02,
) -> SerialArm:
    """Rod on a turntable without mass: the paper's arm.

    It stands upright at zero; the turntable turns it about z, its joint swings it about y.

    Args:
        base: place of both joints, from the platform's centre F [m] (fitted to the workspace).
        mass: rod with its camera [kg] (section 7).
        centre: distance of its centre of mass from the base [m].
        inertia: moment of inertia across it, about its centre of mass [kg m^2].
        length: distance of its tip from the base [m] (section 4).
    """
    return SerialArm(
        joints=(ArmJoint("turntable", base), ArmJoint("arm", axis=(0.0, 1.0, 0.0))),
        links=(
            ArmLink(),
            ArmLink(mass, (0.0, 0.0, centre), (inertia, inertia, 0.0, 0.0, 0.0, 0.0)),
        ),
        tip_place=(0.0, 0.0, length),
    )


PAPER_ARM = rod_arm()


@dataclass(frozen=True)
class KinematicPlatformParams:
    """Masses and compliances of the quasi-static plant.

    Attributes:
        mass: platform without the arm's links [kg] (section 5.2).
        centre_of_mass: centre of mass of the platform without them, from F [m] (assumption).
        arm: the arm.
        foot_stiffness: stiffness of one foot with its leg [N/m]; decides how the load is shared
            by four legs whose feet do not lie in one plane exactly (assumption).
        wheel_stiffness: stiffness of one wheel [N/m] (assumption).
        gravity: [m/s^2].
    """

    mass: float = 50.0
    centre_of_mass: tuple[float, float, float] = (0.0, 0.0, -0.13)
    arm: SerialArm = PAPER_ARM
    foot_stiffness: float = 2.0e6
    wheel_stiffness: float = 2.0e6
    gravity: float = GRAVITY

    @property
    def total(self) -> float:
        """Mass of platform and arm [kg]."""
        return self.mass + self.arm.mass

    def centre_with(self, arm: Sequence[Elementwise]) -> Vector3:
        """Centre of mass of platform and arm, from F [m].

        Args:
            arm: positions (n) of the arm's joints [rad or m].
        """
        if not self.arm.mass:
            return self.centre_of_mass
        moment = plus(scaled(self.centre_of_mass, self.mass), self.arm.first_moment(arm))
        return scaled(moment, 1.0 / self.total)


_ABSURD = 1e7  # force or moment that no platform bears [N, N m]


class Load(NamedTuple):
    """Wrench of something on the platform, in the platform's frame.

    Attributes:
        moment: moment about the platform's centre F (3) [N m].
        force: its force (3) [N].
    """

    moment: Vector3
    force: Vector3


class _Burden(NamedTuple):
    """Platform and arm, and what acts on them besides."""

    centre: Vector3  # of mass, from F [m]
    weight: float  # [N]
    load: Load | None

    def pressure(self, g: Vector3, h: float, up: Vector3) -> tuple[Vector3, float]:
        """Point of the plane g . x = -h on which all of it presses, and its normal force [N].

        That is where no moment along the plane is left.

        Args:
            g: unit normal of the plane.
            h: height of F above it [m].
            up: vertical.
        """
        if self.load is None:
            upright = dot(g, up)
            fall = (h + dot(g, self.centre)) / upright
            return minus(self.centre, scaled(up, fall)), self.weight * upright
        down = scaled(up, -self.weight)
        force = plus(down, self.load.force)
        moment = plus(cross(self.centre, down), self.load.moment)
        normal = dot(g, force)
        largest = reduce(greatest, map(abs, (*force, *moment)))
        if not (normal < 0.0 and largest < _ABSURD):  # it is lifted off, or crushed
            return (math.nan, math.nan, math.nan), math.nan
        return scaled(minus(cross(g, moment), scaled(force, h)), 1.0 / normal), -normal


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
    load: Load | None = None,
    foot_rates: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
) -> Stance:
    """The platform at rest on its feet.

    Args:
        geometry: the platform.
        params: masses and compliances.
        extension: (4) of the actuators [m].
        velocity: (4) their rates [m/s].
        ground: (2) roll and pitch of the ground [rad].
        arm: (n) positions of the arm's joints [rad or m].
        foot_offsets: (4) how far each foot stands above the ground's plane [m].
        load: load on the platform besides its weight and the arm's; None for none.
        foot_rates: (4) rates of the offsets [m/s].
    """
    feet, slopes = _feet_of(geometry.legs, list(extension))
    g: Vector3 = (0.0, 0.0, 1.0)
    if any(foot_offsets) or any(foot_rates):
        # Along the normal, so that the force of a foot keeps its line.
        g = normal_over(feet[:3], foot_offsets[:3])
        feet = [plus(foot, scaled(g, o)) for foot, o in zip(feet, foot_offsets, strict=True)]
    n = normal_of(*ground)
    burden = _burden(params, arm, load)
    shares, normal_weight = _carry(params, feet, n, burden, geometry.foot_radius)
    contact = [normal_weight * share for share in shares]
    give = normal_weight / params.foot_stiffness
    sunk = [(x, y, z - give * share) for (x, y, z), share in zip(feet, shares, strict=True)]
    rates = [scaled(slope, v) for slope, v in zip(slopes, velocity, strict=True)]
    if any(foot_rates):
        rates = [plus(v, scaled(g, rate)) for v, rate in zip(rates, foot_rates, strict=True)]
    is_least = first_least(contact)
    points = _others(is_least, sunk)
    g, g_rate = _moving_normal(points, _others(is_least, rates))
    height = dot(g, points[0])
    roll, pitch, turning, up = _attitude(n, g, g_rate)
    return Stance(
        [roll, pitch, height + geometry.foot_radius],
        [roll, pitch, 0.0],
        turning,
        scaled(up, params.gravity),
        contact,
        [f * dot(g, slope) for f, slope in zip(contact, slopes, strict=True)],
        [_raised(height - dot(g, foot)) for foot in sunk],
        g,
    )


def _motions(
    legs: Sequence[LegGeometry], extension: list[float]
) -> tuple[list[Vector3], list[Vector3]]:
    """Vectors (4) from the feet to F, and their derivatives by the extensions."""
    motions = [foot_motion(leg, d) for leg, d in zip(legs, extension, strict=True)]
    return [foot for foot, _ in motions], [slope for _, slope in motions]


# A platform on which an arm vibrates is loaded anew at every step, on legs that stand.
_feet_of = Remembered(_motions)


def _raised(height: float) -> float:
    """Height of a foot above the ground [m]: zero where it carries, NaN where nothing is known."""
    return where(height <= 0.0, 0.0, height)


def _others(is_least: Sequence[Any], vectors: list[Vector3]) -> list[Vector3]:
    """Vectors of the three legs that are not the one which carries least."""
    (x_1, y_1, z_1), (x_2, y_2, z_2), (x_3, y_3, z_3), (x_4, y_4, z_4) = vectors
    is_first, is_second, _, is_fourth = is_least
    of_first_two = either(is_first, is_second)
    return [
        (where(is_first, x_2, x_1), where(is_first, y_2, y_1), where(is_first, z_2, z_1)),
        (
            where(of_first_two, x_3, x_2),
            where(of_first_two, y_3, y_2),
            where(of_first_two, z_3, z_2),
        ),
        (where(is_fourth, x_3, x_4), where(is_fourth, y_3, y_4), where(is_fourth, z_3, z_4)),
    ]


# The other three legs of each.
_OTHERS = tuple(tuple(i for i in range(LEG_COUNT) if i != leg) for leg in range(LEG_COUNT))


def _moving_normal(points: list[Vector3], rates: list[Vector3]) -> tuple[Vector3, Vector3]:
    """Unit normal of the plane through three moving points, pointing up, and its rate."""
    (p_1, p_2, p_3), (q_1, q_2, q_3), (r_1, r_2, r_3) = points
    u_1, u_2, u_3 = p_1 - q_1, p_2 - q_2, p_3 - q_3
    v_1, v_2, v_3 = p_1 - r_1, p_2 - r_2, p_3 - r_3
    n_1, n_2, n_3 = u_2 * v_3 - u_3 * v_2, u_3 * v_1 - u_1 * v_3, u_1 * v_2 - u_2 * v_1
    by_length = copysign(1.0 / sqrt(n_1 * n_1 + n_2 * n_2 + n_3 * n_3), n_3)
    g_1, g_2, g_3 = g = n_1 * by_length, n_2 * by_length, n_3 * by_length
    (p_1, p_2, p_3), (q_1, q_2, q_3), (r_1, r_2, r_3) = rates
    q_1, q_2, q_3 = p_1 - q_1, p_2 - q_2, p_3 - q_3
    r_1, r_2, r_3 = p_1 - r_1, p_2 - r_2, p_3 - r_3
    # Derivative of u x v, without what only stretches it.
    n_1 = q_2 * v_3 - q_3 * v_2 + u_2 * r_3 - u_3 * r_2
    n_2 = q_3 * v_1 - q_1 * v_3 + u_3 * r_1 - u_1 * r_3
    n_3 = q_1 * v_2 - q_2 * v_1 + u_1 * r_2 - u_2 * r_1
    stretch = g_1 * n_1 + g_2 * n_2 + g_3 * n_3
    return g, (
        (n_1 - stretch * g_1) * by_length,
        (n_2 - stretch * g_2) * by_length,
        (n_3 - stretch * g_3) * by_length,
    )


def _carry(
    params: KinematicPlatformParams,
    feet: list[Vector3],
    n: Vector3,
    burden: _Burden,
    radius: float,
) -> tuple[list[float], float]:
    """Shares of the burden carried by the four feet, and its force normal to the ground [N]."""
    weights, excess = mismatch(feet)
    w_1, w_2, w_3, w_4 = weights
    squared = w_1 * w_1 + w_2 * w_2 + w_3 * w_3 + w_4 * w_4
    gap = excess / squared
    (x_1, y_1, z_1), (x_2, y_2, z_2), (x_3, y_3, z_3), _ = feet
    flat = (x_1, y_1, z_1 - w_1 * gap), (x_2, y_2, z_2 - w_2 * gap), (x_3, y_3, z_3 - w_3 * gap)
    x, y, normal_force = _pressure_point(burden, *flat, n, radius)
    # Any balanced shares plus a multiple of the dependency balance too; springs that give by
    # force / stiffness are balanced where (weights . force) = stiffness * excess.
    three = _barycentric(feet, (0, 1, 2), x, y)
    s_1, s_2, s_3, _ = three
    balance = w_1 * s_1 + w_2 * s_2 + w_3 * s_3
    along = (params.foot_stiffness * excess / burden.weight - balance) / squared
    shares = [s_1 + w_1 * along, s_2 + w_2 * along, s_3 + w_3 * along, w_4 * along]
    if reduce(least, shares) >= 0.0:
        return shares, normal_force
    # One end of the shorter diagonal lifts: the one on the far side of the centre of mass.
    lifted = min(range(LEG_COUNT), key=shares.__getitem__)
    results = []
    for leg in (lifted, (lifted + 2) % LEG_COUNT):
        legs = _OTHERS[leg]
        a, b, c = (feet[i] for i in legs)
        x, y, normal_force = _pressure_point(burden, a, b, c, n, radius)
        results.append((_barycentric(feet, legs, x, y), normal_force))
    return max(results, key=lambda result: min(result[0]))


def _barycentric(feet: list[Vector3], legs: tuple[int, ...], x: float, y: float) -> list[float]:
    """Shares of three legs that balance the weight at (x, y); the fourth gets zero."""
    first, second, third = legs
    (xa, ya, _), (xb, yb, _), (xc, yc, _) = feet[first], feet[second], feet[third]
    # Feet stand at minus the vectors to F.
    x, y = -x - xa, -y - ya
    xb, yb, xc, yc = xb - xa, yb - ya, xc - xa, yc - ya
    area = xb * yc - xc * yb
    shares = [0.0] * LEG_COUNT
    shares[second] = b = (x * yc - xc * y) / area
    shares[third] = c = (xb * y - x * yb) / area
    shares[first] = 1.0 - b - c
    return shares


_centre_of = Remembered(KinematicPlatformParams.centre_with)


def _burden(params: KinematicPlatformParams, arm: Sequence[float], load: Load | None) -> _Burden:
    return _Burden(_centre_of(params, list(arm)), params.total * params.gravity, load)


def _pressure_point(
    burden: _Burden, p: Vector3, q: Vector3, r: Vector3, n: Vector3, radius: float
) -> tuple[float, float, float]:
    """Point on which the burden presses on the ground under three feet.

    The ground is below the feet's centres by their radius; the point is given as if seen along
    the ground's normal from the plane of the centres.

    Returns:
        That point (x, y) in the platform's frame [m], and the force normal to the ground [N].
    """
    normal, length = normal_through(p, q, r)
    g = scaled(normal, 1.0 / length)
    # A foot is at -P from F, so the plane of their centres is g . x = -g . P.
    point, normal_force = burden.pressure(g, dot(g, p) + radius, upwards_seeing(g, n))
    return point[0] + radius * g[0], point[1] + radius * g[1], normal_force


def _attitude(
    n: Vector3, g: Vector3, g_rate: Vector3
) -> tuple[float, float, list[float], Vector3]:
    """Attitude of a platform that sees the ground's normal n as g, which moves.

    Returns:
        Roll and pitch [rad], the angular velocity in the platform's frame (3) [rad/s], and the
        world's vertical seen by the platform.
    """
    n_1, _, n_3 = n
    _, g_2, g_3 = g
    roll, pitch = attitude_seeing(g, n)
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = sin_cos(roll), sin_cos(pitch)
    # The pitch's rate follows from its part of g's change, the roll's from the rest.
    pitch_rate = -g_rate[0] / (n_1 * sin_pitch + n_3 * cos_pitch)
    by_pitch = pitch_rate * (n_1 * cos_pitch - n_3 * sin_pitch)
    rest_2, rest_3 = g_rate[1] - sin_roll * by_pitch, g_rate[2] - cos_roll * by_pitch
    roll_rate = (rest_2 * g_3 - rest_3 * g_2) / (g_2 * g_2 + g_3 * g_3)
    turning = [roll_rate, pitch_rate * cos_roll, -pitch_rate * sin_roll]
    return roll, pitch, turning, (-sin_pitch, cos_pitch * sin_roll, cos_pitch * cos_roll)


_MOST_STEPS = 60
_BALANCED = 1e-7  # forces and moments that may be left [N, N m]
_ROUNDED = 1e-15  # and what rounding leaves, in all springs' ways [m]
_PRESSED = 3e-4  # [m]
_FARTHEST = 0.2  # largest turn of the plane in one step [rad]
_UPRIGHT = math.cos(math.radians(30.0))  # beyond, against the ground, it has tipped over
# Regularisation: keeps the system solvable while nothing carries load [N/m].
_SOFT = 1e-3


class _Support(NamedTuple):
    """Something round that may stand on the ground."""

    centre: Vector3  # from F, in the platform's frame [m]
    rate: Vector3  # of the centre [m/s]
    reach: float  # of the centre above the ground's plane when it just touches [m]
    stiffness: float  # [N/m]
    rising: float = 0.0  # rate of the reach [m/s]


def stand_on_feet_and_wheels(
    geometry: PlatformGeometry,
    wheels: WheelGeometry,
    params: KinematicPlatformParams,
    extension: list[float],
    velocity: list[float],
    ground: list[float],
    arm: list[float],
    foot_offsets: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    load: Load | None = None,
    foot_rates: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
) -> Stance:
    """The platform at rest on feet and wheels, each a spring that can only push.

    While the feet hold the wheels clear of the ground this is `stand`, in closed form. One that
    tips over, and leans by more than 30 deg against the ground, stands nowhere: all is NaN.

    Args:
        geometry: the platform.
        wheels: its wheels, on the ground's plane.
        params: masses and compliances.
        extension: (4) of the actuators [m].
        velocity: (4) their rates [m/s].
        ground: (2) roll and pitch of the ground [rad].
        arm: (n) positions of the arm's joints [rad or m].
        foot_offsets: (4) how far each foot stands above the ground's plane [m].
        load: load on the platform besides its weight and the arm's; None for none.
        foot_rates: (4) rates of the offsets [m/s].
    """
    state = extension, velocity, ground, arm, foot_offsets, load, foot_rates
    stance = stand(geometry, params, *state)
    carries = reduce(least, stance.contact_force) >= 0.0
    if either(
        negated(is_finite(stance.posture[2])), both(carries, _clearance(wheels, stance) > 0.0)
    ):
        return stance
    feet, slopes = _feet_of(geometry.legs, list(extension))
    supports = [
        _Support(
            tuple(-x for x in foot),
            tuple(-v * slope_i for slope_i in slope),
            geometry.foot_radius + offset,
            params.foot_stiffness,
            rising,
        )
        for foot, slope, v, offset, rising in zip(
            feet, slopes, velocity, foot_offsets, foot_rates, strict=True
        )
    ] + [
        _Support(axle, (0.0, 0.0, 0.0), wheels.radius, params.wheel_stiffness)
        for axle in wheels.axles
    ]
    n = normal_of(*ground)
    burden = _burden(params, arm, load)
    footing = _balance(supports, burden, n, wheels.standing_height)
    if footing is None:
        three, four = [math.nan] * 3, [math.nan] * LEG_COUNT
        return Stance(three, three, three, three, four, four, four, three)
    return _stance(params, supports, footing, n, slopes)


def _clearance(wheels: WheelGeometry, stance: Stance) -> float:
    """Clearance of the lowest wheel [m]; below zero where the feet do not hold it up."""
    x, y, z = stance.normal
    # The wheels stand symmetrically, and one of them is on each side.
    lowest = wheels.height * z - wheels.half_base * abs(x) - wheels.half_track * abs(y)
    return stance.posture[2] + lowest - wheels.radius


class _Footing(NamedTuple):
    """Supports on the ground's plane g . x = -h, and the imbalance there."""

    g: Vector3  # the plane's normal in the platform's frame
    h: float  # height of F above it [m]
    points: list[Vector3]  # x and y of where each support meets it, and 1
    depths: list[float]  # of the supports in the ground, below zero above it [m]
    forces: list[float]  # [N]
    left: Vector3  # sum of (forces minus load) times (x, y, 1) [N m, N m, N]


def _balance(
    supports: list[_Support], burden: _Burden, n: Vector3, height: float
) -> _Footing | None:
    """The plane on which forces and moments balance; None where the platform tips over.

    Newton's method, exact once it is known who carries. Springs that can only push have a convex
    energy, and each step goes to where it is least along its way: so a foot that carries at first,
    this comes to an end.
    """
    stiffness = [s.stiffness for s in supports]
    enough = _BALANCED + _ROUNDED * sum(stiffness)
    # All wheels carry at first.
    footing = _footing(supports, (0.0, 0.0, 1.0), height - _PRESSED, burden, n)
    for _ in range(_MOST_STEPS):
        if max(map(abs, footing.left)) < enough:
            return footing
        carrying = [k if f > 0.0 else 0.0 for k, f in zip(stiffness, footing.forces, strict=True)]
        step = _solved(footing.points, carrying, footing.left)
        by_x, by_y, by_z = step
        rises = [-(by_x * x + by_y * y + by_z) for x, y, _ in footing.points]
        share = _share(footing, rises, stiffness, -dot(footing.left, step))
        shortened = scaled(step, min(share, _FARTHEST / max(map(abs, step))))
        g, h = _moved(footing, shortened)
        if not g[2] > _UPRIGHT:
            return None
        footing = _footing(supports, g, h, burden, n)
    return None


def _footing(
    supports: list[_Support], g: Vector3, h: float, burden: _Burden, n: Vector3
) -> _Footing:
    point, load = burden.pressure(g, h, upwards(*attitude_seeing(g, n)))
    left_x, left_y = -load * point[0], -load * point[1]
    points, depths, forces = [], [], []
    gx, gy, gz = g
    for (x, y, z), _, reach, stiffness, _ in supports:
        above = h + gx * x + gy * y + gz * z
        depth = reach - above
        force = stiffness * depth if depth > 0.0 else 0.0
        x, y = x - above * gx, y - above * gy
        left_x, left_y, load = left_x + force * x, left_y + force * y, load - force
        points.append((x, y, 1.0))
        depths.append(depth)
        forces.append(force)
    return _Footing(g, h, points, depths, forces, (left_x, left_y, -load))


def _solved(points: list[Vector3], stiffness: list[float], right: Vector3) -> Vector3:
    """Solution v of (sum of stiffness point point^T) v = right, by Cholesky's method."""
    xx = yy = zz = _SOFT
    xy = xz = yz = 0.0
    for (x, y, _), k in zip(points, stiffness, strict=True):
        if k:
            kx, ky = k * x, k * y
            xx, xy, xz, yy, yz, zz = (
                xx + kx * x,
                xy + kx * y,
                xz + kx,
                yy + ky * y,
                yz + ky,
                zz + k,
            )
    a, b, c = right
    # From the corner that is never small.
    p, q = xz / zz, yz / zz
    xx, xy, yy = xx - p * xz, xy - p * yz, yy - q * yz
    a, b = a - p * c, b - q * c
    r = xy / xx
    v_y = (b - r * a) / (yy - r * xy)
    v_x = (a - xy * v_y) / xx
    return v_x, v_y, c / zz - p * v_x - q * v_y


def _share(footing: _Footing, rises: list[float], stiffness: list[float], slope: float) -> float:
    """Share of a step at which the springs' energy is least; infinite if it falls for ever.

    Args:
        footing: stance in which the step begins.
        rises: change of the supports' depths over the whole step [m].
        stiffness: stiffness of the supports [N/m].
        slope: slope of the energy at the beginning, by the share; below zero [J].
    """
    springs = list(zip(footing.depths, rises, stiffness, strict=True))
    if all((depth > 0.0) == (depth + rise > 0.0) for depth, rise, _ in springs):
        return 1.0
    # The slope is linear between instants at which a support begins or ceases to carry.
    changes = sorted((-d / rise, k * rise * abs(rise)) for d, rise, k in springs if d * rise < 0.0)
    curvature = total(k * rise * rise for d, rise, k in springs if d > 0.0 or d == 0.0 < rise)
    begin = 0.0
    for end, change in changes:
        after = slope + curvature * (end - begin)
        if after >= 0.0:
            break
        begin, slope, curvature = end, after, curvature + change
    else:
        # Without what rounding has left of those that have ceased.
        curvature = total(k * rise * rise for _, rise, k in springs if rise > 0.0)
    return begin - slope / curvature if curvature else math.inf


def _moved(footing: _Footing, step: Vector3) -> tuple[Vector3, float]:
    """The plane that a step leads to: it adds -(x, y, 1) . step to the depth at (x, y)."""
    gx, gy, gz = footing.g
    gx, gy = gx + step[0], gy + step[1]
    length = math.sqrt(gx * gx + gy * gy + gz * gz)
    return (gx / length, gy / length, gz / length), (footing.h + step[2]) / length


def _stance(
    params: KinematicPlatformParams,
    supports: list[_Support],
    footing: _Footing,
    n: Vector3,
    slopes: list[Vector3],
) -> Stance:
    g, h, forces = footing.g, footing.h, footing.forces
    roll, pitch, turning, up = _attitude(n, g, _normal_rate(supports, footing))
    return Stance(
        posture=[roll, pitch, h],
        attitude=[roll, pitch, 0.0],
        angular_velocity=turning,
        specific_force=scaled(up, params.gravity),
        contact_force=forces[:LEG_COUNT],
        load_force=[f * dot(g, slope) for f, slope in zip(forces, slopes, strict=False)],
        foot_height=[_raised(-depth) for depth in footing.depths[:LEG_COUNT]],
        normal=g,
    )


def _normal_rate(supports: list[_Support], footing: _Footing) -> Vector3:
    """Rate of the ground's normal in the platform's frame while the feet move."""
    g = footing.g
    carrying = [s.stiffness if f else 0.0 for s, f in zip(supports, footing.forces, strict=True)]
    right = (0.0, 0.0, 0.0)
    for s, k, point in zip(supports, carrying, footing.points, strict=True):
        if k:
            right = plus(right, scaled(point, k * (s.rising - dot(g, s.rate))))
    if not any(right):
        return right
    x, y, _ = _solved(footing.points, carrying, right)
    along = g[0] * x + g[1] * y
    return x - along * g[0], y - along * g[1], -along * g[2]


# A foot that is deeper than this is not on the ground but in it [m].
_TOUCHING = 1e-9


def resting_posture(
    geometry: PlatformGeometry,
    extension: ArrayLike,
    ground: ArrayLike,
    foot_offsets: ArrayLike = (0.0, 0.0, 0.0, 0.0),
) -> NDArray[np.float64]:
    """Posture of a rigid platform at rest on the three legs that carry it.

    Four legs of any lengths do not stand in one plane: one foot is in the air, an end of the
    shorter diagonal. Of its two ends it is the one on the far side of the weight, which is taken
    to act at the centre F.

    Args:
        geometry: the platform.
        extension: (4) actuator extensions [m].
        ground: (2) roll and pitch of the ground [rad].
        foot_offsets: (4) how far each foot stands above the ground's plane [m].

    Returns:
        (3) roll, pitch [rad], height [m].
    """
    d = np.asarray(extension, dtype=float).tolist()
    o = np.asarray(foot_offsets, dtype=float).tolist()
    normal = normal_of(*np.asarray(ground, dtype=float).tolist())
    feet = [foot_to_centre(leg, d[i]) for i, leg in enumerate(geometry.legs)]
    best, posture = -np.inf, np.full(3, np.nan)
    for lifted in range(LEG_COUNT):
        legs = [(lifted + k) % LEG_COUNT for k in (1, 2, 3)]
        standing = forward_kinematics(geometry, extension, ground, legs, foot_offsets)
        roll, pitch, height = standing.tolist()
        g = to_platform(normal, roll, pitch)
        sunk = dot(g, feet[lifted]) + o[lifted] - (height - geometry.foot_radius)
        down = scaled(upwards(roll, pitch), -1.0)
        share = _share_of_middle(feet[legs[0]], feet[legs[1]], feet[legs[2]], down)
        if sunk <= _TOUCHING and share > best:
            best, posture = share, standing
    return posture


def _share_of_middle(a: Vector3, b: Vector3, c: Vector3, down: Vector3) -> float:
    """Share of a weight at F that the second of three feet carries.

    Args:
        a: vector from the first foot to F; b and c from the second and third.
        b: in the middle between a and c.
        c: see a.
        down: direction of gravity, in the frame of the others.
    """
    normal, _ = normal_through(a, b, c)
    # Feet are at minus these vectors; F's weight meets their plane at `fall` times `down`.
    fall = -dot(normal, a) / dot(normal, down)
    x, y = a[0] + fall * down[0], a[1] + fall * down[1]
    side, edge = minus(b, a), minus(c, a)
    share: float = (edge[1] * x - edge[0] * y) / (edge[0] * side[1] - edge[1] * side[0])
    return share
