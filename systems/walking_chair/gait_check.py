"""Whether the chair's actuators can do a gait."""

from dataclasses import replace

import numpy as np

from parapod.systems.walking_chair.branch_limits import check_speeds, check_strokes
from parapod.systems.walking_chair.gait import TrotGait
from parapod.systems.walking_chair.gait_motion import gait_branches
from parapod.systems.walking_chair.geometry import ChairGeometry

# What the paper gives for each actuator [m/s].
SPEED_LIMIT = 0.080
# Times looked at in each phase; what is between them exceeds them by 0.3 um at most.
_TIMES = 1001


def check_gait(geometry: ChairGeometry, gait: TrotGait, speed_limit: float = SPEED_LIMIT) -> None:
    """Refuses a gait that takes a branch out of its stroke or beyond a speed.

    All cycles are alike, so the first is looked at.

    Args:
        geometry: the chair.
        gait: the gait.
        speed_limit: largest speed of each actuator [m/s].

    Raises:
        StrokeExceeded: names the branch and the time of the largest excess.
        SpeedExceeded: names the branch and the time of the largest speed.
    """
    one = replace(gait, cycles=1)
    time = np.linspace(0.0, one.duration, len(one.phases) * (_TIMES - 1) + 1)
    motion = gait_branches(geometry, one, time)
    check_strokes(geometry.leg, motion.length, time)
    check_speeds(motion.velocity, speed_limit, time)
