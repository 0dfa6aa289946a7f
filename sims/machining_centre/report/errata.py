"""Misprints in the machining centres' paper, and the computations that show them."""

import numpy as np
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from parapod.sims.report.chapter import Check, Erratum, Numbers
from parapod.systems.machining_centre.branch import branch_forward, branch_joints
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import jacobian, leg_lengths, moved
from parapod.systems.machining_centre.printed import (
    CUBE,
    MEANS,
    REACHABLE_PERCENT,
    printed_jacobian,
    printed_joints,
)
from parapod.systems.machining_centre.swing import LockSet, lock_conditions
from parapod.systems.machining_centre.workspace import cell_centres, survey
from parapod.systems.machining_centre.wrench import wrench_indices

_TRIPOD = CentreGeometry(3)
_STEP = 1e-6  # step of central differences [m, rad]
_EXACT = 1e-9
# Poses away from every symmetry: x, y, z [m], roll, pitch, yaw [rad].
_POSES = np.hstack(
    (
        np.random.default_rng(0).uniform((-0.05, -0.05, 0.45), (0.05, 0.05, 0.53), (400, 3)),
        np.random.default_rng(1).uniform(-0.3, 0.3, (400, 3)),
    )
)


def _return_error(equation: int | str) -> tuple[float, float]:
    """Largest error of the pose, by the chain from joints with a misprint in [mm, rad]."""
    joints = np.tile(branch_joints(_TRIPOD, _POSES)[:, :1], (1, 3, 1))
    for row, pose in zip(joints[:, 0], _POSES, strict=True):
        row[:] = printed_joints(_TRIPOD, pose, equation)
    error = np.abs(branch_forward(_TRIPOD, joints)[:, 0] - _POSES)
    return 1e3 * float(error[:, :3].max()), float(error[:, 3:].max())


def _right_return() -> float:
    joints = branch_joints(_TRIPOD, _POSES)
    return float(np.abs(branch_forward(_TRIPOD, joints) - _POSES[:, None]).max())


def _projections(_: Numbers) -> Check:
    error = _right_return()
    return Check(
        f"With a scalar times a vector in the place of the cross product the chain leads back to "
        f"the pose within {error:.0e} m and rad, over {len(_POSES)} poses; a cross product of a "
        "number and a vector there is none.",
        error < _EXACT,
    )


def _direction(_: Numbers) -> Check:
    length, angle = _return_error("v_c")
    return Check(
        f"With v_c from B_O the chain leads to a pose that is up to {length:.0f} mm and "
        f"{angle:.2f} rad away; with v_c from P_O to the right one.",
        length > 10.0,
    )


def _normal_4(_: Numbers) -> Check:
    length, angle = _return_error(4)
    return Check(
        f"With the normal as printed, which is shorter than 1 unless u and l_c are perpendicular, "
        f"the pose is off by up to {length:.1f} mm and {angle:.3f} rad.",
        length > 0.5 or angle > 0.05,
    )


def _normal_8(_: Numbers) -> Check:
    right = branch_joints(_TRIPOD, _POSES)[:, 0, 1]
    off = np.abs([printed_joints(_TRIPOD, pose, 8)[1] for pose in _POSES] - right)
    rms = float(np.sqrt(np.mean(off**2)))
    return Check(
        f"z_a x v_3 is normal to the plane of z_a and its projection, and u is so at symmetric "
        f"poses alone: with u as printed q_2 is off by up to {off.max():.3f} rad, {rms:.3f} rad "
        "rms.",
        float(off.max()) > 0.01,
    )


def _rotation(_: Numbers) -> Check:
    pose = np.array((0.0, 0.0, 0.5, 0.1, 0.2, 0.3))
    there = leg_lengths(_TRIPOD, pose)
    turned_back = Rotation.from_euler("xyz", pose[3:]).inv().as_euler("xyz")
    back = leg_lengths(_TRIPOD, np.concatenate((pose[:3], turned_back)))
    off = 1e3 * float(np.abs(there - back).max())
    return Check(
        "The text has R = R_z R_y R_x once from the world to the platform and once back. From the "
        f"platform to the world it is, else (.1, .2, .3) rad give lengths that are up to "
        f"{off:.0f} mm others.",
        off > 10.0,
    )


def _twist_names(_: Numbers) -> Check:
    pose = _POSES[0]
    rows = jacobian(_TRIPOD, pose)
    twist = np.array((0.1, -0.2, 0.3, 0.05, 0.02, -0.04))
    ahead, behind = (leg_lengths(_TRIPOD, moved(pose, s * _STEP * twist)) for s in (1.0, -1.0))
    rates = (ahead - behind) / (2.0 * _STEP)
    right = float(np.abs(rows @ twist - rates).max())
    swapped = float(np.abs(rows @ np.roll(twist, 3) - rates).max())
    return Check(
        f"With omega first, as Eq. (12) has it, J V gives the legs' rates within {right:.0e} m/s; "
        f"with the text's 'linear and angular' it is off by {1e3 * swapped:.0f} mm/s.",
        right < 1e-8 < swapped,
    )


def _twist_point(_: Numbers) -> Check:
    pose, omega = _POSES[0], np.array((0.3, -0.2, 0.5))
    v = np.array((0.1, 0.2, -0.1))
    right = jacobian(_TRIPOD, pose) @ (*omega, *v)
    printed = printed_jacobian(_TRIPOD, pose)
    at_origin = printed @ (*omega, *(v - np.cross(omega, pose[:3])))
    mixed = float(np.abs(printed @ (*omega, *v) - right).max())
    same = float(np.abs(at_origin - right).max())
    return Check(
        f"Moments about B_O belong to the velocity of the platform's point at B_O: then the "
        f"rates agree within {same:.0e} m/s. With that of P_O they are off by "
        f"{1e3 * mixed:.0f} mm/s.",
        same < 1e-12 and mixed > 0.01,
    )


def _rows(_: Numbers) -> Check:
    rows = printed_jacobian(_TRIPOD, _POSES[0])
    as_printed = rows[[0, 1, 3, 3, 5]]
    smallest = float(np.linalg.svd(as_printed, compute_uv=False)[-1])
    return Check(
        f"The row of the left leg of limb 2 is printed with the right leg's direction, and the "
        f"left leg of limb 3 is missing: {len(as_printed)} rows, two of them equal (smallest "
        f"singular value {smallest:.0e}), hold no platform; the six rows have rank "
        f"{np.linalg.matrix_rank(rows)}.",
        smallest < 1e-12 and np.linalg.matrix_rank(rows) == 6,
    )


def _weights(_: Numbers) -> Check:
    largest = float(wrench_indices(_TRIPOD, _POSES[0]).w_max)
    scaled = largest * _TRIPOD.legs
    return Check(
        f"H with W_q^-1 is for f~ within 1: the same wrenches as J^T f, w_Max = {largest:.3f}. "
        f"With f~ within 1/n as Eq. (26) has it w_Max were {scaled:.2f}, of forces whose sum "
        "is 1.",
        scaled > 1.0 > largest,
    )


def _box(_: Numbers) -> Check:
    cell = 0.02
    above = survey(_TRIPOD, cell_centres(CUBE, 0.75, cell)).percent(0.0)
    around = survey(_TRIPOD, cell_centres(CUBE, 0.5, cell)).percent(0.0)
    printed = REACHABLE_PERCENT[3][0]
    return Check(
        f"Of a box whose bottom is 500 mm above the feet {above:.1f} % can be reached, of one "
        f"whose middle is there {around:.1f} %; Table I has {printed} %.",
        abs(above - printed) > 10.0 and abs(around - printed) < 3.0,
    )


def _impossible(_: Numbers) -> Check:
    cells = cell_centres(CUBE, 0.5, 0.02)
    three, four = survey(_TRIPOD, cells), survey(CentreGeometry(4), cells)
    least, most = float(four.push.min()), float(three.indices.w_max.max())
    return Check(
        f"All legs of the quadruped together push with {least:.3f} or more wherever it reaches, "
        f"so no mean of w_Max is {MEANS[4][1]}; no w_Max of the tripod is above {most:.3f}, so "
        f"none is {MEANS[3][1]} on average.",
        least > MEANS[4][1] and most < MEANS[3][1],
    )


def _locks(_: Numbers) -> Check:
    home = np.array((0.0, 0.0, 0.48, 0.0, 0.0, 0.0))
    printed = lock_conditions(_TRIPOD, home, LockSet.printed(_TRIPOD, 1))
    other = lock_conditions(_TRIPOD, home, LockSet(1, ((2, 2), (3, 3))))
    return Check(
        f"Platform parallel to the ground, the six locked values change with five directions of "
        f"the platform alone (smallest singular value {float(printed.inverse):.0e}, of 1 rad or "
        f"100 mm): a foot's pose does not determine the platform's. With q_2 and q_3 locked it is "
        f"{float(other.inverse):.3f}.",
        float(printed.inverse) < 1e-9 and float(other.inverse) > 0.01,
    )


ERRATA = (
    Erratum(
        "Projections", "Eqs. (3), (6), (9)", "l - (l . u) x u", "l - (l . u) u", _projections
    ),
    Erratum(
        "Direction v_c", "above Eq. (2)", "direction of B_O P_C", "direction of P_O P_C",
        _direction,
    ),
    Erratum(
        "Normal of q_5", "Eq. (4)", "normal u x l_c", "u x l_c, of unit length", _normal_4
    ),
    Erratum("Normal of q_2", "Eq. (8)", "normal u", "unit vector of z_a x v_3", _normal_8),
    Erratum(
        "Name of the rotation", "below Eq. (5)", "pRb is from the world to the platform",
        "R_z R_y R_x is from the platform to the world", _rotation,
    ),
    Erratum(
        "Linear and angular", "below Eq. (12)", "omega_P and v_P are linear and angular velocity",
        "angular and linear", _twist_names,
    ),
    Erratum(
        "Point of the twist", "Eq. (18)", "moments about B_O, for v_P",
        "moments about P_O, or the velocity of the platform's point at B_O", _twist_point,
    ),
    Erratum(
        "Rows of the Jacobian", "Eq. (18)", "five rows, l_r2 in two of them",
        "six rows: L1, R1, L2, R2, L3, R3", _rows,
    ),
    Erratum(
        "Weighted forces", "Eqs. (24) to (27)", "H with W_q^-1, and f within 1/n",
        "either the one or the other", _weights,
    ),
    Erratum("Place of the box", "section VI-D", "500 mm above B_O",
            "its middle 500 mm above B_O", _box),
    Erratum("Means of w_Max", "Table II", "1.116 and .857", "neither can be", _impossible),
    Erratum(
        "Locked joints", "section V-C", "q_1 of both standing limbs determine the platform",
        "not where the platform is parallel to the ground", _locks,
    ),
)  # fmt: skip
