"""Misprints in the terrain simulator's paper, and the computations that show them."""

import math
from dataclasses import replace

import numpy as np

from parapod.sims.report.chapter import Check, Erratum, Numbers
from parapod.sims.terrain_simulator.workspace import BENCHES, WAYS
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.kinematics import (
    jacobian,
    singularity,
    slider_places,
)
from parapod.systems.terrain_simulator.printed import BELT, printed_theta
from parapod.systems.terrain_simulator.workspace import workspace

_PEDAL, _TREADMILL = (geometry for geometry, _ in BENCHES.values())
_STEEP = BENCHES["treadmill"][1]


def _poses() -> Array:
    """Poses (k, 3) of the pedal in the middle of its range [m, rad]."""
    random = np.random.default_rng(0)
    return random.uniform((0.4, 0.22, -0.4), (0.6, 0.31, 0.4), (2000, 3))


def _argument(_: Numbers) -> Check:
    pose = _poses()
    sliders = slider_places(_PEDAL, pose)
    off = printed_theta(_PEDAL, sliders, 1.0) + _PEDAL.offset - pose[:, 2]
    angle = np.abs(np.degrees(np.remainder(off, 2.0 * math.pi)) - 180.0)
    return Check(
        f"From sliders of {len(pose)} poses the printed sign '+' gives the plate turned by "
        f"180 deg within {angle.max():.0e} deg. With l_4^2 + D^2 - l_3^2 as argument '-' gives "
        "the pose, T above the line from P to A_3, and '+' the other assembly.",
        bool(angle.max() < 1e-6),
    )


def _in_line(_: Numbers) -> Check:
    flat = np.array((0.5, -_PEDAL.p_OP[1], 0.0))
    a_1, a_2, _a_3 = slider_places(_PEDAL, flat)
    height = float(singularity(_PEDAL, flat).height)
    return Check(
        f"A_1, P and A_2 are in line (z_P / l_1 = {height:.0e}) with a_1 = {a_1:.3f} and "
        f"a_2 = {a_2:.3f} m: a_2 - a_1 = {a_2 - a_1:.3f} m is 2 l_1 = {2.0 * _PEDAL.link:.3f} m, "
        f"a_1 + a_2 = {a_1 + a_2:.3f} m is not.",
        abs(a_2 - a_1 - 2.0 * _PEDAL.link) < 1e-12 and abs(a_1 + a_2 - 2.0 * _PEDAL.link) > 0.1,
    )


def _alone(_: Numbers) -> Check:
    # A hair off A_1 = A_2, where rounding has the last word.
    together = np.array((0.5, _PEDAL.link * (1.0 - 1e-14) - _PEDAL.p_OP[1], 0.0))
    tall = replace(_PEDAL, link=0.6)
    upright = np.array((0.5, _PEDAL.strut * (1.0 - 1e-14), 0.0))
    first, second = (
        abs(float(np.linalg.det(jacobian(*at)))) for at in ((_PEDAL, together), (tall, upright))
    )
    regular = abs(float(singularity(_PEDAL, (0.5, 0.28, 0.0)).determinant))
    leans = float(singularity(_PEDAL, together).lean)
    spreads = float(singularity(tall, upright).spread)
    return Check(
        f"With a_1 = a_2 alone (s_3 / l_3 = {leans:.2f}) |det J| is {first:.0e} rad/m, with an "
        f"upright strut alone (s_1 / l_1 = {spreads:.2f}) it is {second:.0e}; in the middle of "
        f"the workspace it is {regular:.1f}. Either is enough.",
        max(first, second) < 1e-5 * regular and leans > 0.1 and spreads > 0.1,
    )


def _plate(_: Numbers) -> Check:
    short = replace(_TREADMILL, plate=1e-9)
    (x, z), _T = short.p_OP, short.p_OT
    shift = max(
        abs(workspace(short, way * _STEEP).z_min - workspace(_TREADMILL, way * _STEEP).z_min)
        for way in WAYS.values()
    )
    return Check(
        f"With l_5 = 0 the belt between P and T, {1e3 * math.hypot(x, z):.0f} mm apart, has no "
        f"length, and the text has l_4 = l_5 and {1e3 * BELT:.0f} mm from drum to drum. The "
        f"workspaces of O' would be {1e3 * shift:.0f} mm higher or lower at +-14 deg.",
        shift > 0.05 and abs(math.hypot(x, z) - BELT) < 1e-6,
    )


def _gap(_: Numbers) -> Check:
    shared = replace(_TREADMILL, strut_gap=0.1)
    area = workspace(shared, _STEEP)
    whole = workspace(_TREADMILL, _STEEP)
    tall = 1e3 * (area.z_max - area.z_min)
    both = workspace(shared, (-_STEEP, _STEEP))
    return Check(
        f"With 100 mm between A_2 and A_3 too the treadmill at +14 deg keeps a strip of "
        f"{tall:.1f} mm, {100.0 * area.area / whole.area:.1f} % of its area, and no place at all "
        "for both +14 and -14 deg. The text has the stop between A_1 and A_2 alone.",
        tall < 2.0 and both.is_empty,
    )


def _specification(numbers: Numbers) -> Check:
    fitting = numbers("bench-workspace", "orientations_with_box")
    tall = numbers("bench-workspace", "least_height_mm")
    return Check(
        f"500 x 200 mm at once are possible in {fitting:.0f} of the six orientations of Fig. 6; "
        f"200 mm upwards, anywhere, not in all (least: {tall:.0f} mm).",
        fitting == 0.0 and tall < 200.0,
    )


ERRATA = (
    Erratum(
        "Angle of P T", "Eq. (3)", "arccos of l_3^2 - l_4^2 - D^2, '+' for T above",
        "arccos of l_4^2 + D^2 - l_3^2, '-' for T above", _argument,
    ),
    Erratum("A_1, A_2 and P in line", "section 4", "2 l_1 = a_1 + a_2", "2 l_1 = a_2 - a_1",
            _in_line),
    Erratum(
        "Inverse singularities", "section 4", "a_1 = a_2 and an upright strut",
        "either of the two", _alone,
    ),
    Erratum("Plate of the treadmill", "Table 2", "l_5 = 0", "l_5 = 0.6 m", _plate),
    Erratum(
        "Distance of the sliders", "Table 2", "minimum distance between sliders",
        "between A_1 and A_2; A_3 of the treadmill passes A_2", _gap,
    ),
    Erratum(
        "Table 2 fulfils Table 1", "section 4", "both ranges of motion",
        "500 mm along the rail; not both at once in any orientation", _specification,
    ),
)  # fmt: skip
