"""Kinematics of the walking chair: batched, exact, free of Drake.

Conventions, everywhere in parapod:

* branches 1, 2, 3 of each leg are UP, UPS, UPS; lengths are between their joints' centres [m].
* legs in the paper's order 1..4; all branches of the chair are arrays (..., 4, 3).
* point = place of a foot's reference corner E_1, E_2 or E_3 in the leg's frame {A1} [m].
* up = (l_11, alpha, beta): length and angles of the UP branch [m, rad, rad].
* world: x to the right, y ahead, z up; z = 0 is the plane of the corners E of feet on the ground.

Leading dimensions are batch dimensions and broadcast. What no leg can reach and no lengths can
assemble is NaN; strokes and speeds are refused by `check_strokes`, `check_speeds`, `check_gait`.

This module is the front door for users; inside the package what it offers is imported from where
it is defined.
"""

from parapod.systems.walking_chair.chair import (
    chair_inverse,
    chair_motion,
    feet_in_legs,
    foot_corners,
    standing_feet,
)
from parapod.systems.walking_chair.checks import (
    SpeedExceeded,
    StrokeExceeded,
    check_gait,
    check_speeds,
    check_strokes,
    stroke_excess,
)
from parapod.systems.walking_chair.gait import (
    GaitMotion,
    TrotGait,
    gait_branches,
    gait_motion,
    gait_references,
)
from parapod.systems.walking_chair.geometry import (
    BRANCHES,
    ChairGeometry,
    LegGeometry,
    LegPlacement,
    branch_names,
)
from parapod.systems.walking_chair.leg import (
    LegPosture,
    branch_lengths,
    corner_numbers,
    leg_corners,
    leg_forward,
    leg_inverse,
    lowest_corner,
    up_branch,
    up_of_lengths,
)
from parapod.systems.walking_chair.rates import leg_jacobian, leg_jacobian_rate, leg_motion
from parapod.systems.walking_chair.trajectories import (
    BodyMotion,
    BranchMotion,
    FootCircle,
    FootTrajectory,
    Motion,
)

__all__ = [
    "BRANCHES",
    "BodyMotion",
    "BranchMotion",
    "ChairGeometry",
    "FootCircle",
    "FootTrajectory",
    "GaitMotion",
    "LegGeometry",
    "LegPlacement",
    "LegPosture",
    "Motion",
    "SpeedExceeded",
    "StrokeExceeded",
    "TrotGait",
    "branch_lengths",
    "branch_names",
    "chair_inverse",
    "chair_motion",
    "check_gait",
    "check_speeds",
    "check_strokes",
    "corner_numbers",
    "feet_in_legs",
    "foot_corners",
    "gait_branches",
    "gait_motion",
    "gait_references",
    "leg_corners",
    "leg_forward",
    "leg_inverse",
    "leg_jacobian",
    "leg_jacobian_rate",
    "leg_motion",
    "lowest_corner",
    "standing_feet",
    "stroke_excess",
    "up_branch",
    "up_of_lengths",
]
