"""Quasi-static plant of the levelling platform: closed-form statics on the feet that carry."""

import functools
import math
import weakref
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.caching import declare_cached
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.inclined_ground import OnInclinedGround
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
    to_platform,
)
from parapod.systems.levelling_platform.platform_model import standing_pose
from parapod.systems.ports import read


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
        gravity: [m/s^2].
    """

    mass: float = 50.0
    centre_of_mass: tuple[float, float, float] = (0.0, 0.0, -0.13)
    arm_mass: float = 1.0
    arm_base: tuple[float, float, float] = (0.01, 0.02, 0.145)
    arm_centre: float = 1.747
    foot_stiffness: float = 2.0e6
    gravity: float = 9.81


class _Stance(NamedTuple):
    """Everything that follows from four extensions, their rates, the ground and the arm."""

    posture: Sequence[float]
    attitude: Sequence[float]
    angular_velocity: Sequence[float]
    specific_force: Sequence[float]
    contact_force: Sequence[float]
    load_force: Sequence[float]
    foot_height: Sequence[float]


class KinematicPlatform(OnInclinedGround):
    """The platform as a body at rest on the feet that carry it: no dynamics, no integration.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | 4 | m | actuator extensions |
    | in `velocity` | 4 | m/s | their rates |
    | in `arm_position` | 2 | rad | turntable and arm angle; unconnected: upright |
    | out `posture` | 3 | rad, rad, m | roll, pitch, height |
    | out `attitude` | 3 | rad | roll, pitch, yaw (zero) |
    | out `angular_velocity` | 3 | rad/s | of the platform, in its own frame |
    | out `specific_force` | 3 | m/s^2 | at rest: minus gravity, in the platform's frame |
    | out `contact_force` | 4 | N | of the ground on the feet, normal to the ground |
    | out `load_force` | 4 | N | force with which the actuators hold, positive to extend |
    | out `foot_height` | 4 | m | of the feet above the ground, zero where they carry |
    | out `base_pose` | 7 | -, m | quaternion (w, x, y, z) and position, above the origin |

    Four springs on a rigid ground share the load when the feet nearly lie in one plane; where
    one would have to pull, its foot lifts and the other three carry. Ideal friction: the feet
    stay where they stand sideways, and yaw is zero.

    State: none. Parameters (Context): the ground, see `OnInclinedGround`.

    Bad input: NaN where an extension cannot be built.
    """

    def __init__(
        self,
        geometry: PlatformGeometry = PlatformGeometry(),
        params: KinematicPlatformParams = KinematicPlatformParams(),
    ):
        super().__init__()
        self.set_name("kinematic_platform")
        self._geometry, self._params = geometry, params
        self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._velocity = self.DeclareVectorInputPort("velocity", LEG_COUNT)
        self._arm = self.DeclareVectorInputPort("arm_position", 2)
        self._stance = declare_cached(
            self,
            "stance",
            self._calc_stance,
            {
                self._extension.ticket(),
                self._velocity.ticket(),
                self._arm.ticket(),
                self.all_parameters_ticket(),
            },
        )
        for name, size in (
            ("posture", 3),
            ("attitude", 3),
            ("angular_velocity", 3),
            ("specific_force", 3),
            ("contact_force", 4),
            ("load_force", 4),
            ("foot_height", 4),
        ):
            calc = functools.partial(_copy_signal, weakref.ref(self), name)
            self.DeclareVectorOutputPort(name, size, calc, {self._stance.ticket})
        self.DeclareVectorOutputPort(
            "base_pose",
            7,
            self._calc_base_pose,
            {self._stance.ticket, self.all_parameters_ticket()},
        )

    def signal(self, context: Context, name: str) -> NDArray[np.float64]:
        """The signal of that name, from the one solution that all of them share."""
        return np.array(getattr(self._stance.of(self, context), name))

    def _calc_base_pose(self, context: Context, output: BasicVector) -> None:
        posture = self._stance.of(self, context).posture
        output.SetFromVector(standing_pose(posture, self._ground_of(context)))

    def _calc_stance(self, context: Context) -> _Stance:
        arm = read(self._arm, context) if self._arm.HasValue(context) else [0.0, 0.0]
        return stand(
            self._geometry,
            self._params,
            read(self._extension, context),
            read(self._velocity, context),
            self._ground_of(context),
            arm,
            self._offsets_of(context),
        )


def _copy_signal(
    platform: weakref.ref[KinematicPlatform], name: str, context: Context, output: BasicVector
) -> None:
    """Calculates one output port; knows the system weakly, as a port must not keep it alive."""
    system = platform()
    assert system is not None
    output.SetFromVector(system.signal(context, name))


def stand(
    geometry: PlatformGeometry,
    params: KinematicPlatformParams,
    extension: list[float],
    velocity: list[float],
    ground: list[float],
    arm: list[float],
    foot_offsets: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
) -> _Stance:
    """The platform at rest on its feet."""
    legs = geometry.legs
    motions = [foot_motion(leg, d) for leg, d in zip(legs, extension, strict=True)]
    feet = [foot for foot, _ in motions]
    if any(foot_offsets):
        # A foot that stands higher is a leg that is longer by as much, along the vertical.
        upright = normal_over(feet[:3], foot_offsets[:3])[2]
        feet = [
            (x, y, z + offset / upright)
            for (x, y, z), offset in zip(feet, foot_offsets, strict=True)
        ]
    slopes = [slope for _, slope in motions]
    n = normal_of(*ground)

    shares, normal_weight = _carry(params, feet, n, arm)
    contact = [normal_weight * share for share in shares]

    carrying = sorted(range(LEG_COUNT), key=contact.__getitem__)[1:]
    sunk = [
        (x, y, z - f / params.foot_stiffness) for (x, y, z), f in zip(feet, contact, strict=True)
    ]
    p, q, r = (sunk[i] for i in carrying)
    normal, length = normal_through(p, q, r)
    g = _scaled(normal, 1.0 / length)
    height = dot(g, p) + geometry.foot_radius
    roll, pitch = attitude_seeing(g, n)

    p_rate, q_rate, r_rate = (_scaled(slopes[i], velocity[i]) for i in carrying)
    normal_rate = _sum(
        cross(minus(p_rate, q_rate), minus(p, r)), cross(minus(p, q), minus(p_rate, r_rate))
    )
    stretch = dot(g, normal_rate)
    g_rate = _scaled(minus(normal_rate, _scaled(g, stretch)), 1.0 / length)
    roll_rate, pitch_rate = _attitude_rate(n, g, g_rate, roll, pitch)
    cos_roll, sin_roll = math.cos(roll), math.sin(roll)
    return _Stance(
        posture=[roll, pitch, height],
        attitude=[roll, pitch, 0.0],
        angular_velocity=[roll_rate, pitch_rate * cos_roll, -pitch_rate * sin_roll],
        specific_force=to_platform((0.0, 0.0, params.gravity), roll, pitch),
        contact_force=contact,
        load_force=[f * dot(g, slope) for f, slope in zip(contact, slopes, strict=True)],
        foot_height=[max(0.0, dot(g, minus(p, foot))) for foot in sunk],
    )


def _carry(
    params: KinematicPlatformParams, feet: list[Vector3], n: Vector3, arm: list[float]
) -> tuple[list[float], float]:
    """Shares of the weight carried by the four feet, and the weight normal to the ground [N]."""
    weight = (params.mass + params.arm_mass) * params.gravity
    weights, excess = mismatch(feet)
    squared = dot4(weights, weights)
    gap = excess / squared
    flat = [(x, y, z - w * gap) for (x, y, z), w in zip(feet, weights, strict=True)]
    centre, upright = _pressure_point(params, arm, (flat[0], flat[1], flat[2]), n)
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
        centre, upright = _pressure_point(params, arm, (feet[a], feet[b], feet[c]), n)
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
) -> tuple[tuple[float, float], float]:
    """Where the line of gravity through the centre of mass meets the plane of three feet.

    Returns:
        That point (x, y) in the platform's frame [m], and the cosine between the ground's normal
        and the vertical.
    """
    turn, swing = arm
    reach = params.arm_centre * math.sin(swing)
    tip = (
        params.arm_base[0] + reach * math.cos(turn),
        params.arm_base[1] + reach * math.sin(turn),
        params.arm_base[2] + params.arm_centre * math.cos(swing),
    )
    share = params.arm_mass / (params.mass + params.arm_mass)
    com = _sum(_scaled(params.centre_of_mass, 1.0 - share), _scaled(tip, share))
    normal, length = normal_through(*feet)
    g = _scaled(normal, 1.0 / length)
    down = to_platform((0.0, 0.0, -1.0), *attitude_seeing(g, n))
    # A foot is at -P from F, so the plane is g . x = -g . P.
    fall = -(dot(g, feet[0]) + dot(g, com)) / dot(g, down)
    return (com[0] + fall * down[0], com[1] + fall * down[1]), -dot(g, down)


def _attitude_rate(
    n: Vector3, g: Vector3, g_rate: Vector3, roll: float, pitch: float
) -> tuple[float, float]:
    """Rates of roll and pitch that turn the ground's normal by g_rate in the platform's frame."""
    _, by_pitch = attitude_derivatives(n, g, roll, pitch)
    pitch_rate = g_rate[0] / by_pitch[0]
    rest_y, rest_z = g_rate[1] - pitch_rate * by_pitch[1], g_rate[2] - pitch_rate * by_pitch[2]
    return (rest_y * g[2] - rest_z * g[1]) / (g[1] * g[1] + g[2] * g[2]), pitch_rate


def _scaled(a: Vector3, factor: float) -> Vector3:
    return a[0] * factor, a[1] * factor, a[2] * factor


def _sum(a: Vector3, b: Vector3) -> Vector3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
