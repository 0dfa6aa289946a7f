"""One leg in closed form: the branches' lengths that put a corner of the foot at a point.

Points are in the leg's frame {A1} (`LegGeometry`). Leading dimensions are batch dimensions and
broadcast. A point out of the leg's reach gives NaN; strokes are not looked at here but in
`parapod.systems.walking_chair.branch_limits`.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.batching import of_width
from parapod.systems.elementwise import nan_without_warning
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.references import Reference, reference_corner
from parapod.systems.walking_chair.up_branch import (
    UpPose,
    carried,
    pose_of_corner,
    up_of_corner,
)


@nan_without_warning
def up_branch(
    geometry: LegGeometry, point: ArrayLike, reference: Reference = "E1"
) -> NDArray[np.float64]:
    """Coordinates of the UP branch with a corner of the foot at a point, Eqs. (10), (14)-(19).

    Args:
        geometry: the leg.
        point: (..., 3) place of the reference corner in {A1} [m].
        reference: which corner, "E1", "E2" or "E3" (or 1, 2, 3); one, or an array (...).

    Returns:
        (..., 3) l_11 [m], alpha, beta [rad]; NaN where the leg cannot reach.

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    from_joint = of_width(point, 3, "point") - geometry.upper_joints[0]
    return up_of_corner(geometry, from_joint, reference_corner(geometry, reference))


@nan_without_warning
def branch_lengths(geometry: LegGeometry, up: ArrayLike) -> NDArray[np.float64]:
    """Lengths of the branches that belong to coordinates of the UP branch, Eqs. (11) and (12).

    Args:
        geometry: the leg.
        up: (..., 3) l_11 [m], alpha, beta [rad].

    Returns:
        (..., 3) l_11, l_12, l_13 between the joints' centres [m].
    """
    coordinates = of_width(up, 3, "up")
    sine, cosine = np.sin(coordinates[..., 1:]), np.cos(coordinates[..., 1:])
    pose = UpPose(coordinates[..., 0], sine[..., 0], cosine[..., 0], sine[..., 1], cosine[..., 1])
    return _lengths(geometry, pose)


def _lengths(geometry: LegGeometry, pose: UpPose) -> NDArray[np.float64]:
    """(..., 3) lengths of all branches with the UP branch in a pose [m], Eqs. (11) and (12)."""
    length, s_a, c_a, s_b, c_b = pose
    x, y, z = geometry.lower_joints[2].tolist()
    hinge_x, hinge_y, _ = (geometry.upper_joints[2] - geometry.upper_joints[0]).tolist()
    below = z - geometry.x2 - length
    # The ball joints are mirrored in x: what they share, along the foot's axes and then A1's.
    depth = s_b * y + c_b * below
    ahead = c_b * y - s_b * below - hinge_y
    middle_x, middle_z = s_a * depth, c_a * depth
    aside, down = c_a * x - hinge_x, s_a * x
    squares = ahead * ahead
    lengths = np.empty((*np.shape(length), 3))
    lengths[..., 0] = length
    lengths[..., 1] = np.sqrt((middle_x - aside) ** 2 + squares + (middle_z + down) ** 2)
    lengths[..., 2] = np.sqrt((middle_x + aside) ** 2 + squares + (middle_z - down) ** 2)
    return lengths


def ups_vectors(geometry: LegGeometry, up: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 2, 3) vectors of the two UPS branches from their upper joints, in {A1} [m]."""
    ends = carried(geometry, up[..., np.newaxis, :], geometry.lower_joints[1:])
    return ends - (geometry.upper_joints[1:] - geometry.upper_joints[0])


@nan_without_warning
def leg_inverse(
    geometry: LegGeometry, point: ArrayLike, reference: Reference = "E1"
) -> NDArray[np.float64]:
    """Lengths of the branches that put a corner of the foot at a point, Eqs. (10)-(19).

    Args:
        geometry: the leg.
        point: (..., 3) place of the reference corner in {A1} [m].
        reference: which corner, "E1", "E2" or "E3" (or 1, 2, 3); one, or an array (...).

    Returns:
        (..., 3) lengths l_11, l_12, l_13 of the branches UP, UPS, UPS [m]; NaN where the leg
        cannot reach.

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    from_joint = of_width(point, 3, "point") - geometry.upper_joints[0]
    corner = reference_corner(geometry, reference)
    return _lengths(geometry, pose_of_corner(geometry, from_joint, corner))


@nan_without_warning
def leg_corners(geometry: LegGeometry, up: ArrayLike) -> NDArray[np.float64]:
    """Corners of the foot at coordinates of the UP branch, Eqs. (8) and (13).

    Args:
        geometry: the leg.
        up: (..., 3) l_11 [m], alpha, beta [rad].

    Returns:
        (..., 3, 3) corners E_1, E_2, E_3 (rows) in {A1} [m].
    """
    coordinates = of_width(up, 3, "up")[..., np.newaxis, :]
    return carried(geometry, coordinates, geometry.corners) + geometry.upper_joints[0]
