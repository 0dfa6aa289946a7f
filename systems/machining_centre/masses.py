"""Masses of a centre: assumptions, those of the models in `parapod.urdf.machining_centre`."""

import numpy as np

from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry

PLATFORM = 10.2  # platform with spindle and tool [kg]
LIMB = 5.2  # mount, hinge, two legs, ankle, foot [kg]


def weight(geometry: CentreGeometry) -> Array:
    """Wrench (6) of the weight that the legs hold up, at P_O in the world [N m, N].

    Half of each limb counts: the other half is on its foot.
    """
    carried = PLATFORM + 0.5 * LIMB * geometry.limbs
    return np.array((0.0, 0.0, 0.0, 0.0, 0.0, -carried * GRAVITY))
