"""Tables of the machining centres' paper, and equations as they stand there.

Nothing simulates with them: they stand beside the corrected ones, in tests and in the report.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]

from parapod.systems.machining_centre.branch import branch_joints
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.platform_mode import jacobian

type Vector = NDArray[np.float64]

# Thresholds of w_MinMax in Table I, and the one of Table II's means.
THRESHOLDS = (0.0, 0.08, 0.1, 0.12)
MEANS_ABOVE = 0.08
# Table I: percentage of reachable points at each threshold, by the number of limbs.
REACHABLE_PERCENT = {3: (16.31, 13.60, 9.49, 3.18), 4: (16.04, 14.22, 10.93, 4.58)}
# Table II: means of w_MinMax, w_Max and eta_w.
MEANS = {3: (0.109, 1.116, 10.455), 4: (0.113, 0.857, 7.746)}
# Section VI-D: the tested cube [m]. Its height is printed as 500 mm above the base.
CUBE = (1.0, 1.0, 0.5)
CUBE_HEIGHT = 0.5


def printed_jacobian(geometry: CentreGeometry, pose: Vector) -> Vector:
    """Eq. (18): moments of the legs' directions at their feet about the world's origin (2n, 6)."""
    rows = jacobian(geometry, pose)
    feet = np.repeat(geometry.footholds[:, :3], 2, axis=0)
    rows[:, :3] = np.cross(feet, rows[:, 3:])
    return rows


def printed_joints(geometry: CentreGeometry, pose: Vector, equation: int | str) -> Vector:
    """Joint values (6) of limb 1 with one misprint in, at home footholds.

    Args:
        geometry: the centre.
        pose: (6) of the platform [m, rad].
        equation: 4: its normal without unit length; 8: with the normal u; "v_c": the direction
            from the world's origin, in the place of that from P_O.

    Raises:
        ValueError: another equation.
    """
    if equation not in (4, 8, "v_c"):
        raise ValueError(f'equation must be 4, 8 or "v_c", not {equation!r}')
    joints: Vector = branch_joints(geometry, pose)[0].copy()
    R = Rotation.from_euler("xyz", pose[3:]).as_matrix()
    u = R @ _unit(geometry.pivots[1] - geometry.pivots[0])
    middle = pose[:3] + R @ geometry.middles[0]
    line, z_a = _unit(middle - geometry.footholds[0, :3]), np.array((0.0, 0.0, 1.0))
    v_3 = _unit(np.cross(u, line))
    if equation == 4:
        joints[4] = 0.5 * math.pi - _angle(u, line, np.cross(u, line))
    elif equation == 8:
        z_2 = _unit(z_a - (z_a @ v_3) * v_3)
        joints[1] = _angle(z_2, z_a, u)
    else:
        across = _unit(line - (line @ u) * u)
        joints[5] = 0.5 * math.pi - _angle(across, _unit(middle), u)
    return joints


def _unit(vector: Vector) -> Vector:
    return vector / np.linalg.norm(vector)


def _angle(first: Vector, second: Vector, normal: Vector) -> float:
    return math.atan2(float(normal @ np.cross(first, second)), float(first @ second))
