"""How the branches are where a walk begins."""

import numpy as np
from numpy.typing import NDArray

from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.walk import Walk


def starting_lengths(geometry: ChairGeometry, walk: Walk) -> NDArray[np.float64]:
    """Lengths (4, 3) of the branches with which a walk begins [m]."""
    motion = walk.motion(geometry, 0.0)
    return chair_inverse(
        geometry, motion.body.position, np.eye(3), motion.feet.position, motion.references
    )
