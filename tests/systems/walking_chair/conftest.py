import numpy as np
import pytest

from parapod.systems.walking_chair.chair import chair_motion, standing_feet
from parapod.systems.walking_chair.gait import gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.trajectories import Motion

CHAIR = ChairGeometry()


def _planned_for(reference, gait, times, side="right"):
    motion = gait_motion(CHAIR, gait, times, side)
    start = np.array((0.0, 0.0, CHAIR.leg.retracted_height))
    shift = standing_feet(CHAIR, start, reference) - standing_feet(CHAIR, start, motion.references)
    feet = Motion(motion.feet.position + shift, *motion.feet[1:])
    return motion, chair_motion(CHAIR, motion.body, feet, reference)


@pytest.fixture
def planned_for():
    """planned_for(corner, gait, times) plans a gait for that corner of every foot.

    Gives the gait's motion with its own corners, and the branches' with the one.
    """
    return _planned_for
