"""Which corner of the foot a position speaks of: the paper's reference points E_1, E_2, E_3."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.batching import of_width
from parapod.systems.elementwise import nan_without_warning
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.up_branch import foot_rotation

CORNERS = ("E1", "E2", "E3")

# One of `CORNERS` or its number 1, 2, 3, or an array of either.
type Reference = ArrayLike


def corner_numbers(reference: Reference) -> NDArray[np.intp]:
    """Numbers 1, 2, 3 of the corners E_1, E_2, E_3.

    Args:
        reference: "E1", "E2", "E3" or their numbers 1, 2, 3: one, or an array (...).

    Returns:
        (...) numbers.

    Raises:
        ValueError: there is no such corner.
    """
    given = np.asarray(reference)
    if given.dtype == np.intp and ((given >= 1) & (given <= len(CORNERS))).all():
        return given
    numbers = np.zeros(given.shape, dtype=np.intp)
    for number, name in enumerate(CORNERS, start=1):
        numbers[given == (name if given.dtype.kind in "UO" else number)] = number
    unknown = (numbers == 0) | (given.dtype.kind == "b")
    if unknown.any():
        raise ValueError(
            f"reference must be one of {', '.join(CORNERS)} or its number 1, 2, 3, "
            f"not {given[unknown].tolist()[0]!r}"
        )
    return numbers


def reference_corner(geometry: LegGeometry, reference: Reference) -> NDArray[np.float64]:
    """(..., 3) places of the reference corners in the foot's frame {E1} [m], Eq. (3).

    Raises:
        ValueError: there is no such corner.
    """
    return geometry.corners[corner_numbers(reference) - 1]


@nan_without_warning
def lowest_corner(
    geometry: LegGeometry, up: ArrayLike, leg_rotation: ArrayLike | None = None
) -> NDArray[np.intp]:
    """The corner to be given as reference, so that none is below the ground while it is on it.

    A foot beside its hinge is inclined. With a level body and alpha = 0 the rule is: E_1 for
    beta < 0; E_2 (or E_3, as low) for beta > 0. The tilt's sign is the same whichever corner is
    the reference, so the rule may be asked with any. The paper does not say what it uses; with
    E_1 for all legs the other corners of two feet go 14.55 mm into the ground.

    Args:
        geometry: the leg.
        up: (..., 3) coordinates of the UP branch [m, rad, rad], of which the angles count.
        leg_rotation: (..., 3, 3) rotation of {A1} in the world; None for upright.

    Returns:
        (...) numbers 1, 2, 3; 1 for a foot that is flat.
    """
    rotation = foot_rotation(of_width(up, 3, "up"))
    if leg_rotation is not None:
        rotation = np.asarray(leg_rotation) @ rotation
    heights = np.einsum("...j,kj->...k", rotation[..., 2, :], geometry.corners)
    return np.argmin(heights, axis=-1) + 1
