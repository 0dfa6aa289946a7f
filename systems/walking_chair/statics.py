"""Forces of the walking chair at rest: between corners of the feet, branches and body.

Legs are taken as massless here. The force of the ground on corner j of a foot is f_j; a branch
then holds with

    tau = -sum_j G_j^T f_j,    G_j = dE_j / dl,

positive where it pushes its ends apart. All vectors are along the body's axes.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.batching import of_width
from parapod.systems.walking_chair.geometry import ChairGeometry, LegGeometry
from parapod.systems.walking_chair.leg import leg_corners
from parapod.systems.walking_chair.leg_forward import up_of_lengths
from parapod.systems.walking_chair.leg_rates import leg_jacobian
from parapod.systems.walking_chair.vectors import inverse

_CORNERS = np.array((1, 2, 3))


def corner_jacobians(geometry: LegGeometry, up: ArrayLike) -> NDArray[np.float64]:
    """Derivatives G_j of the foot's corners by the branches' lengths.

    Args:
        geometry: the leg.
        up: (..., 3) coordinates of the UP branch [m, rad, rad].

    Returns:
        (..., 3, 3, 3): corner, axis of {A1}, branch.
    """
    corners = leg_corners(geometry, up)
    return inverse(leg_jacobian(geometry, corners, _CORNERS))


def force_map(geometry: ChairGeometry, lengths: ArrayLike) -> NDArray[np.float64]:
    """What forces of the ground on the corners do to the branches.

    Args:
        geometry: the chair.
        lengths: (4, 3) of the branches [m].

    Returns:
        (12, 12, 3): branch force tau [N] by corner and axis of {S} of a force of the ground [N];
        NaN for legs that cannot be assembled.
    """
    up = up_of_lengths(geometry.leg, of_width(lengths, 3, "lengths"))
    by_leg = np.einsum("lai,lcib->lbca", geometry.R_SA, corner_jacobians(geometry.leg, up))
    whole = np.zeros((4, 3, 4, 3, 3))
    for leg in range(len(by_leg)):
        whole[leg, :, leg] = -by_leg[leg]
    return whole.reshape(12, 12, 3)
