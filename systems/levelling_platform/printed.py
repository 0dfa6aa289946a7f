"""The equations that the levelling platform's paper prints, one leg and one posture at a time.

Nothing simulates with them: they stand beside the closed forms of
`parapod.systems.levelling_platform.kinematics`, in tests and in the report. Where the paper has a
misprint, an argument says which reading is wanted, and the corrected one is the default.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from parapod.systems.levelling_platform.geometry import LegGeometry

type _Legs = Sequence[LegGeometry]
type _Values = Sequence[float]
type _Slope = Callable[[LegGeometry, float], float]


def z_angle(leg: LegGeometry, d: float) -> float:
    """First line of Eq. (29): inclination of the actuator [rad]."""
    return leg.alpha + math.acos((d**2 + leg.l_3**2 - leg.l_4**2) / (2.0 * d * leg.l_3))


def printed_dz(leg: LegGeometry, d: float) -> float:
    """Second line of Eq. (29) as printed, which is minus the derivative of `z_angle` [rad/m]."""
    root = math.sqrt(4.0 * d**2 * leg.l_3**2 - (d**2 + leg.l_3**2 - leg.l_4**2) ** 2)
    return (d**2 - (leg.l_3**2 - leg.l_4**2)) / root / d


def derivative_of_z(leg: LegGeometry, d: float) -> float:
    """Derivative for which a reader takes `printed_dz` [rad/m]."""
    return -printed_dz(leg, d)


def p_xz(leg: LegGeometry, d: float) -> tuple[float, float]:
    """Eq. (4): p_x and p_z of the hip above the foot, in the leg's frame [m]."""
    z = z_angle(leg, d)
    return (
        (leg.l_6 + leg.l_3) * math.cos(leg.alpha) - d * math.cos(z),
        leg.l_7 + (leg.l_6 + leg.l_3) * math.sin(leg.alpha) - d * math.sin(z),
    )


def u_f(leg: LegGeometry, d: float, *, as_printed: bool = False) -> NDArray[np.float64]:
    """Eq. (24): from the foot to the platform's centre F (3) [m].

    Args:
        leg: the leg.
        d: its extension [m].
        as_printed: l_x instead of l_y in the second component.
    """
    p_x, p_z = p_xz(leg, d)
    across = leg.l_x if as_printed else leg.l_y
    return np.array(
        [leg.l_x + p_x * math.cos(leg.beta), across + p_x * math.sin(leg.beta), leg.l_z + p_z]
    )


def u_mn(
    leg_m: LegGeometry, leg_n: LegGeometry, d_m: float, d_n: float, *, as_printed: bool = False
) -> NDArray[np.float64]:
    """Eq. (23): difference of two feet's vectors to F (3) [m]."""
    return u_f(leg_m, d_m, as_printed=as_printed) - u_f(leg_n, d_n, as_printed=as_printed)


def c_123(ground: _Values) -> tuple[float, float, float]:
    """Below Eq. (9): c_1, c_2, c_3, the ground's normal.

    Args:
        ground: roll and pitch [rad].
    """
    phi_0, theta_0 = ground
    return (
        math.sin(theta_0) * math.cos(phi_0),
        -math.sin(phi_0),
        math.cos(theta_0) * math.cos(phi_0),
    )


def g_123(c: _Values, theta: float, phi: float) -> NDArray[np.float64]:
    """Below Eq. (12): g_1, g_2, g_3, the ground's normal in the platform's frame (3)."""
    c_1, c_2, c_3 = c
    st, ct, sp, cp = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    return np.array(
        [
            c_1 * ct - c_3 * st,
            c_1 * st * sp + c_2 * cp + c_3 * ct * sp,
            c_1 * st * cp - c_2 * sp + c_3 * ct * cp,
        ]
    )


def _rows(legs: _Legs, d: _Values, *, as_printed: bool = False) -> NDArray[np.float64]:
    """The vectors U of Eq. (22) (3, 3)."""
    one, two, three = legs
    return np.array(
        [
            u_mn(one, two, d[0], d[1], as_printed=as_printed),
            u_mn(one, three, d[0], d[2], as_printed=as_printed),
            u_f(one, d[0], as_printed=as_printed),
        ]
    )


def omega(
    legs: _Legs,
    d: _Values,
    ground: _Values,
    theta: float,
    phi: float,
    h: float,
    *,
    as_printed: bool = False,
) -> NDArray[np.float64]:
    """Eq. (22), Eqs. (10) to (12) in one: zero (3) if three feet stand on the ground [m].

    Args:
        legs: three legs.
        d: their extensions [m].
        ground: roll and pitch [rad].
        theta: pitch of the platform [rad].
        phi: roll of the platform [rad].
        h: height of F above the ground [m].
        as_printed: true for the printed form with the misprint of Eqs. (23) and (24).
    """
    g = g_123(c_123(ground), theta, phi)
    return _rows(legs, d, as_printed=as_printed) @ g - np.array([0.0, 0.0, h])


def gradient_y(
    legs: _Legs,
    d: _Values,
    ground: _Values,
    theta: float,
    phi: float,
    *,
    as_printed: bool = False,
) -> NDArray[np.float64]:
    """Second part of Appendix A: gradient of Omega by theta, phi and h (3, 3).

    Args:
        legs: three legs.
        d: their extensions [m].
        ground: roll and pitch [rad].
        theta: pitch of the platform [rad].
        phi: roll of the platform [rad].
        as_printed: c_1 cos(theta) cos(theta) and -c_2 cos(theta), where cos(phi) is meant.
    """
    c_1, c_2, c_3 = c_123(ground)
    st, ct, sp, cp = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    meant = ct if as_printed else cp
    by_theta = [
        -c_1 * st - c_3 * ct,
        c_1 * ct * sp - c_3 * st * sp,
        c_1 * ct * meant - c_3 * st * cp,
    ]
    by_phi = [
        0.0,
        c_1 * st * cp - c_2 * sp + c_3 * ct * cp,
        -c_1 * st * sp - c_2 * meant - c_3 * ct * sp,
    ]
    u = _rows(legs, d)
    return np.column_stack([u @ by_theta, u @ by_phi, [0.0, 0.0, -1.0]])


def gradient_u(
    legs: _Legs,
    d: _Values,
    ground: _Values,
    theta: float,
    phi: float,
    dz: _Slope = printed_dz,
) -> NDArray[np.float64]:
    """Eqs. (27) and (28) and the first part of Appendix A: gradient of Omega by d (3, 3).

    Args:
        legs: three legs.
        d: their extensions [m].
        ground: roll and pitch [rad].
        theta: pitch of the platform [rad].
        phi: roll of the platform [rad].
        dz: the equations' dz.
    """
    g_1, g_2, g_3 = g_123(c_123(ground), theta, phi)

    def slope(leg: LegGeometry, d_i: float) -> float:
        z = z_angle(leg, d_i)
        sideways = math.cos(z) + d_i * math.sin(z) * dz(leg, d_i)
        upwards = math.sin(z) - d_i * math.cos(z) * dz(leg, d_i)
        return (
            g_1 * math.cos(leg.beta) * sideways
            + g_2 * math.sin(leg.beta) * sideways
            + g_3 * upwards
        )

    one, two, three = (slope(leg, d_i) for leg, d_i in zip(legs, d, strict=True))
    return np.array([[-one, two, 0.0], [-one, 0.0, three], [-one, 0.0, 0.0]])
