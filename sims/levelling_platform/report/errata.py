"""Misprints in the levelling platform's paper, and the computations that show them."""

import math

import numpy as np
from numpy.typing import NDArray

from parapod.sims.report.chapter import Check, Erratum, Numbers
from parapod.systems.actuators.pi_controller import PiControllerParams
from parapod.systems.levelling_platform.geometry import ARM_BASE, PlatformGeometry
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.printed import (
    derivative_of_z,
    gradient_u,
    gradient_y,
    omega,
    p_xz,
    printed_dz,
    z_angle,
)
from parapod.systems.levelling_platform.workspace import CENTRE

_PLATFORM = PlatformGeometry()
_LEGS = _PLATFORM.legs[:3]
# A posture away from every symmetry, on ground away from every symmetry.
_GROUND = (math.radians(2.0), math.radians(3.0))
_THETA, _PHI, _HEIGHT = math.radians(-1.0), math.radians(1.5), 0.48
_STEP = 1e-6  # step of central differences [rad, m]
_EXACT = 1e-9  # residual of an equation that holds, from rounding and differences


def _extension() -> list[float]:
    """Extensions of the three active legs in the posture above [m]."""
    return inverse_kinematics(_PLATFORM, [_PHI, _THETA, _HEIGHT], _GROUND)[:3].tolist()


def _direction() -> Check:
    stroke = (_PLATFORM.extension_min, _PLATFORM.extension_max)
    high, low = (p_xz(_LEGS[0], d)[1] + _PLATFORM.l_c3 for d in stroke)
    samples = [p_xz(_LEGS[0], d)[1] for d in np.linspace(*stroke, 301)]
    falls = bool((np.diff(samples) < 0.0).all())
    return Check(
        f"By Eq. (4) p_z falls all the way from .390 to .420 m: the platform's centre is "
        f"{1e3 * high:.0f} mm above the ground at .390 m and {1e3 * low:.0f} mm at .420 m; the "
        f"workspace's printed centre is at z_c = {1e3 * CENTRE[2]:.0f} mm, the low end.",
        falls and abs(low - CENTRE[2]) < 0.01 < high - CENTRE[2],
    )


def _second_component() -> Check:
    d = _extension()
    printed = np.abs(omega(_LEGS, d, _GROUND, _THETA, _PHI, _HEIGHT, as_printed=True)).max()
    meant = np.abs(omega(_LEGS, d, _GROUND, _THETA, _PHI, _HEIGHT)).max()
    return Check(
        f"Three feet on the ground must make Eq. (22) zero: as printed it leaves "
        f"{1e3 * printed:.0f} mm, with l_y {meant:.0e} m.",
        bool(printed > 1e-3 and meant < _EXACT),
    )


def _angle() -> Check:
    leg, d = _LEGS[0], 0.405
    gamma = z_angle(leg, d) - leg.alpha
    angle = math.pi - gamma - leg.alpha
    # The angle that Eq. (4) takes sine and cosine of, with the signs of the text above it.
    p_x = (leg.l_6 + leg.l_3) * math.cos(leg.alpha) + d * math.cos(angle)
    p_z = leg.l_7 + (leg.l_6 + leg.l_3) * math.sin(leg.alpha) - d * math.sin(angle)
    error = max(abs(a - b) for a, b in zip((p_x, p_z), p_xz(leg, d), strict=True))
    return Check(
        f"At d = 405 mm pi - gamma - alpha is an angle, {math.degrees(angle):.1f} deg, with which "
        f"Eq. (4) holds to {error:.0e} m; p_x and p_z are lengths.",
        error < _EXACT,
    )


def _characteristic_polynomial() -> Check:
    design = PiControllerParams()
    printed = np.roots([1.0, design.k_p, design.k_v * design.gain])
    meant = np.roots([1.0, design.k_v * design.gain, design.k_p * design.gain])
    return Check(
        f"With K = .01, K_v = 2000, K_p = 10000 of Eq. (32) the printed polynomial has its roots "
        f"at {printed[0].real:.0f} and {printed[1].real:.3f} /s, the corrected one both at "
        f"{meant[0].real:.3g} /s, which is -p.",
        bool(np.allclose(meant, -design.pole, atol=1e-5) and abs(printed[0]) > 1e3),
    )


def _sign_of_dz() -> Check:
    leg, d = _LEGS[0], 0.405
    slope = (z_angle(leg, d + _STEP) - z_angle(leg, d - _STEP)) / (2.0 * _STEP)
    args = (_LEGS, _extension(), _GROUND, _THETA, _PHI)
    differences = _gradient_by_d()
    good = np.abs(gradient_u(*args, printed_dz) - differences).max()
    bad = np.abs(gradient_u(*args, derivative_of_z) - differences).max()
    return Check(
        f"At d = 405 mm dz/dd is {slope:.3f} rad/m by differences, printed "
        f"{printed_dz(leg, d):.3f}. Eqs. (27), (28) agree with differences of Eq. (22) to "
        f"{good:.0e} with the printed sign, and miss them by {bad:.2g} with the derivative's.",
        bool(abs(slope + printed_dz(leg, d)) < 1e-6 and good < 1e-7 < bad),
    )


def _appendix() -> Check:
    args = (_LEGS, _extension(), _GROUND, _THETA, _PHI)
    differences = _gradient_by_y()
    printed = np.abs(gradient_y(*args, as_printed=True) - differences).max()
    meant = np.abs(gradient_y(*args) - differences).max()
    return Check(
        f"Against differences of Eq. (22): as printed the gradient by theta and phi is off by up "
        f"to {1e3 * printed:.2g} mm/rad, corrected by {1e3 * meant:.0e} mm/rad.",
        bool(meant < 1e-7 < printed),
    )


def _gradient_by_y() -> NDArray[np.float64]:
    """Gradient of Eq. (22) by theta, phi, h: central differences (3, 3)."""
    d, y = _extension(), np.array([_THETA, _PHI, _HEIGHT])

    def at(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return omega(_LEGS, d, _GROUND, *values.tolist())

    steps = _STEP * np.eye(3)
    return np.column_stack([(at(y + s) - at(y - s)) / (2.0 * _STEP) for s in steps])


def _gradient_by_d() -> NDArray[np.float64]:
    """Gradient of Eq. (22) by the three extensions: central differences (3, 3)."""
    d = np.array(_extension())

    def at(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return omega(_LEGS, values.tolist(), _GROUND, _THETA, _PHI, _HEIGHT)

    steps = _STEP * np.eye(3)
    return np.column_stack([(at(d + s) - at(d - s)) / (2.0 * _STEP) for s in steps])


def _arm_base(numbers: Numbers) -> Check:
    share = numbers("workspace", "inside_fraction")
    best = numbers("workspace", "inside_fraction_best")
    x, y, z = (1e3 * length for length in ARM_BASE)
    return Check(
        f"With the arm's base at ({x:g}, {y:g}, {z:g}) mm from F {100 * share:.1f} % of the "
        f"workspace are inside the eight surfaces, as printed (more than 97 %); no "
        f"base gives more than {100 * best:.1f} %.",
        0.97 <= share <= best + 1e-3,
    )


def _gain() -> Check:
    speed = PiControllerParams().gain * 10.0
    return Check(
        f"Read as (m/s)/V, 10 V make {speed:g} m/s; read as mm they would make "
        f"{1e3 * speed:g} um/s, and the stroke of 30 mm would take five minutes.",
        math.isclose(speed, 0.1),
    )


def _inside(numbers: Numbers) -> Check:
    share = numbers("workspace", "unreachable_fraction")
    return Check(
        f"{100 * share:.1f} % of what the eight surfaces enclose are out of reach: a leg would "
        "have to be longer or shorter than its stroke. Two decimals of the coefficients do not "
        "define the surfaces better.",
        share > 0.01,
    )


def _inclined(numbers: Numbers) -> Check:
    difference = numbers("workspace", "inclined_difference_mm")
    return Check(
        f"On ground of 3 and 5 deg the tip is up to {difference:.1f} mm from where Eq. (14) puts "
        "it with the same extensions: yaw is zero against gravity, and so not against the ground.",
        difference > 1.0,
    )


ERRATA = (
    Erratum(
        "E1",
        "section 2, Eqs. (2)-(4)",
        "the legs are extended to raise the wheels; .420 m is the maximum extension",
        "a longer actuator lowers the platform; .420 m is its lowest pose",
        lambda _: _direction(),
    ),
    Erratum(
        "E2",
        "Eqs. (23), (24)",
        "l_x in the second components",
        "l_y",
        lambda _: _second_component(),
    ),
    Erratum("E3", "Eq. (3)", "p_i", "φ_i, the angle", lambda _: _angle()),
    Erratum(
        "E4",
        "Eq. (21)",
        "s² + K_p s + K_v K",
        "s² + K_v K s + K_p K = s² + 2ps + p², as Eq. (32) has it",
        lambda _: _characteristic_polynomial(),
    ),
    Erratum(
        "E5",
        "Eq. (29)",
        "dz, to be read as dz/dd",
        "-dz/dd; so read, Eqs. (27) and (28) hold",
        lambda _: _sign_of_dz(),
    ),
    Erratum(
        "E6",
        "Appendix A",
        "“values of ∇_u Ω” twice; c_1 cos θ cos θ; -c_2 cos θ",
        "∇_y Ω the second time; c_1 cos θ cos ϕ; -c_2 cos ϕ",
        lambda _: _appendix(),
    ),
    Erratum(
        "E7",
        "Eq. (13)",
        "lost in print; L = 2.02 m is called the distance between F and the arm's base",
        "the tip is F + R (o + (0, 0, L)), where o is the arm's base; fitted to the surfaces",
        _arm_base,
    ),
    Erratum("E8", "Eq. (18)", "G = .01/s", "K = .01 (m/s)/V", lambda _: _gain()),
    Erratum(
        "E9",
        "section 4",
        "the eight conditions define a workspace inside the real one",
        "they also enclose points out of reach",
        _inside,
    ),
    Erratum(
        "E10",
        "Eq. (14)",
        "on inclined ground the workspace is that of flat ground, rotated",
        "nearly: each point turns about the ground's normal too",
        _inclined,
    ),
)
