"""The platform at rest on whatever carries it: feet, wheels or some of both."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.leg import foot_motion
from parapod.systems.levelling_platform.plane import (
    Vector3,
    attitude_seeing,
    dot,
    normal_of,
    plus,
    scaled,
    upwards,
)
from parapod.systems.levelling_platform.statics import (
    KinematicPlatformParams,
    Stance,
    attitude_rate,
    centre_of_mass,
    stand,
)
from parapod.systems.levelling_platform.wheels import WheelGeometry

_MOST_STEPS = 60
_BALANCED = 1e-7  # forces and moments that may be left [N, N m]
_ROUNDED = 1e-15  # and what rounding leaves, in all springs' ways [m]
_PRESSED = 3e-4  # [m]
_FARTHEST = 0.2  # that one step may turn the plane [rad]
_UPRIGHT = math.cos(math.radians(30.0))  # beyond, against the ground, it has tipped over
# As if everything hung from a spring that hardly pulls: for an instant nothing may carry [N/m].
_SOFT = 1e-3


class _Support(NamedTuple):
    """Something round that may stand on the ground."""

    centre: Vector3  # from F, in the platform's frame [m]
    rate: Vector3  # of the centre [m/s]
    reach: float  # of the centre above the ground's plane when it just touches [m]
    stiffness: float  # [N/m]


def stand_on_feet_and_wheels(
    geometry: PlatformGeometry,
    wheels: WheelGeometry,
    params: KinematicPlatformParams,
    extension: list[float],
    velocity: list[float],
    ground: list[float],
    arm: list[float],
    foot_offsets: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
) -> Stance:
    """The platform at rest on feet and wheels, each a spring that can only push.

    While the feet hold the wheels clear of the ground this is `stand`, in closed form. One that
    tips over, and leans by more than 30 deg against the ground, stands nowhere: all is NaN.

    Args:
        geometry: the platform.
        wheels: its wheels, on the ground's plane.
        params: what it weighs and how much it gives way.
        extension: (4) of the actuators [m].
        velocity: (4) their rates [m/s].
        ground: (2) roll and pitch of the ground [rad].
        arm: (2) angles of turntable and arm [rad].
        foot_offsets: (4) how far each foot stands above the ground's plane [m].
    """
    stance = stand(geometry, params, extension, velocity, ground, arm, foot_offsets)
    if not math.isfinite(stance.posture[2]) or (
        min(stance.contact_force) >= 0.0 and _clearance(wheels, stance) > 0.0
    ):
        return stance
    motions = [foot_motion(leg, d) for leg, d in zip(geometry.legs, extension, strict=True)]
    supports = [
        _Support(
            tuple(-x for x in foot),
            tuple(-v * slope_i for slope_i in slope),
            geometry.foot_radius + offset,
            params.foot_stiffness,
        )
        for (foot, slope), v, offset in zip(motions, velocity, foot_offsets, strict=True)
    ] + [
        _Support(axle, (0.0, 0.0, 0.0), wheels.radius, params.wheel_stiffness)
        for axle in wheels.axles
    ]
    n = normal_of(*ground)
    com = centre_of_mass(params, arm)
    weight = (params.mass + params.arm_mass) * params.gravity
    footing = _balance(supports, com, weight, n, wheels.standing_height)
    if footing is None:
        three, four = [math.nan] * 3, [math.nan] * LEG_COUNT
        return Stance(three, three, three, three, four, four, four, three)
    return _stance(params, supports, footing, n, [slope for _, slope in motions])


def _clearance(wheels: WheelGeometry, stance: Stance) -> float:
    """Of the lowest wheel above the ground [m]; below zero where the feet do not hold it up."""
    x, y, z = stance.normal
    # The wheels stand symmetrically, and one of them is on each side.
    lowest = wheels.height * z - wheels.half_base * abs(x) - wheels.half_track * abs(y)
    return stance.posture[2] + lowest - wheels.radius


class _Footing(NamedTuple):
    """Supports on the ground's plane g . x = -h, and what is not in balance there."""

    g: Vector3  # the plane's normal in the platform's frame
    h: float  # height of F above it [m]
    points: list[Vector3]  # x and y of where each support meets it, and 1
    depths: list[float]  # of the supports in the ground, below zero above it [m]
    forces: list[float]  # [N]
    left: Vector3  # sum of (forces minus load) times (x, y, 1) [N m, N m, N]


def _balance(
    supports: list[_Support], com: Vector3, weight: float, n: Vector3, height: float
) -> _Footing | None:
    """The plane on which forces and moments balance; None where the platform tips over.

    Newton's method, exact once it is known who carries. Springs that can only push have a convex
    energy, and each step goes to where it is least along its way: so whoever carries at first,
    this comes to an end.
    """
    stiffness = [s.stiffness for s in supports]
    enough = _BALANCED + _ROUNDED * sum(stiffness)
    # All wheels carry at first.
    footing = _footing(supports, (0.0, 0.0, 1.0), height - _PRESSED, com, weight, n)
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
        footing = _footing(supports, g, h, com, weight, n)
    return None


def _footing(
    supports: list[_Support], g: Vector3, h: float, com: Vector3, weight: float, n: Vector3
) -> _Footing:
    down = scaled(upwards(*attitude_seeing(g, n)), -1.0)
    upright = -dot(g, down)
    # Gravity's line through the centre of mass meets the plane here.
    fall = (h + dot(g, com)) / upright
    load = weight * upright
    left_x, left_y = -load * (com[0] + fall * down[0]), -load * (com[1] + fall * down[1])
    points, depths, forces = [], [], []
    gx, gy, gz = g
    for (x, y, z), _, reach, stiffness in supports:
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
        footing: where the step begins.
        rises: what the whole step adds to the supports' depths [m].
        stiffness: of the supports [N/m].
        slope: of the energy at the beginning, by the share; below zero [J].
    """
    springs = list(zip(footing.depths, rises, stiffness, strict=True))
    if all((depth > 0.0) == (depth + rise > 0.0) for depth, rise, _ in springs):
        return 1.0
    # The slope is linear between instants at which a support begins or ceases to carry.
    changes = sorted((-d / rise, k * rise * abs(rise)) for d, rise, k in springs if d * rise < 0.0)
    curvature = sum(k * rise * rise for d, rise, k in springs if d > 0.0 or d == 0.0 < rise)
    begin = 0.0
    for end, change in changes:
        after = slope + curvature * (end - begin)
        if after >= 0.0:
            break
        begin, slope, curvature = end, after, curvature + change
    else:
        # Without what rounding has left of those that have ceased.
        curvature = sum(k * rise * rise for _, rise, k in springs if rise > 0.0)
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
    roll, pitch = attitude_seeing(g, n)
    roll_rate, pitch_rate = attitude_rate(n, g, _normal_rate(supports, footing), roll, pitch)
    return Stance(
        posture=[roll, pitch, h],
        attitude=[roll, pitch, 0.0],
        angular_velocity=[
            roll_rate,
            pitch_rate * math.cos(roll),
            -pitch_rate * math.sin(roll),
        ],
        specific_force=scaled(upwards(roll, pitch), params.gravity),
        contact_force=forces[:LEG_COUNT],
        load_force=[f * dot(g, slope) for f, slope in zip(forces, slopes, strict=False)],
        foot_height=[max(0.0, -depth) for depth in footing.depths[:LEG_COUNT]],
        normal=g,
    )


def _normal_rate(supports: list[_Support], footing: _Footing) -> Vector3:
    """Rate of the ground's normal in the platform's frame while the feet move."""
    g = footing.g
    carrying = [s.stiffness if f else 0.0 for s, f in zip(supports, footing.forces, strict=True)]
    right = (0.0, 0.0, 0.0)
    for s, k, point in zip(supports, carrying, footing.points, strict=True):
        if k:
            right = plus(right, scaled(point, -k * dot(g, s.rate)))
    if not any(right):
        return right
    x, y, _ = _solved(footing.points, carrying, right)
    along = g[0] * x + g[1] * y
    return x - along * g[0], y - along * g[1], -along * g[2]
