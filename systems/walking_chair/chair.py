"""The whole chair: branches of all four legs for motions of the body and the feet.

The world's axes are parallel to the body's at rest: x to the right, y ahead, z up. Its plane z = 0
is the plane of the corners E of flat feet on the ground; the soles are the lower platforms'
thickness t_2 below, which is left out everywhere. The body's centre S is in the plane of the upper
platforms' faces, H_0 above it with retracted legs.

Leading dimensions are batch dimensions and broadcast; feet come as (..., 4, 3), legs in the
paper's order 1..4.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.batching import of_width
from parapod.systems.core.elementwise import nan_without_warning
from parapod.systems.core.vectors import Array, cross
from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.leg import (
    Reference,
    corner_numbers,
    leg_corners,
    leg_inverse,
    up_of_lengths,
)
from parapod.systems.walking_chair.rates import leg_motion
from parapod.systems.walking_chair.trajectories import BodyMotion, BranchMotion, Motion


def chair_inverse(
    geometry: ChairGeometry,
    body_position: ArrayLike,
    body_rotation: ArrayLike,
    feet: ArrayLike,
    references: Reference,
) -> NDArray[np.float64]:
    """Lengths of all branches for a pose of the body and places of the feet, Eqs. (29)-(31).

    Args:
        geometry: the chair.
        body_position: (..., 3) of S in the world [m].
        body_rotation: (..., 3, 3) of {S} in the world.
        feet: (..., 4, 3) places of the reference corners in the world [m].
        references: corner of each foot, "E1", "E2", "E3" or 1, 2, 3: (..., 4) or one.

    Returns:
        (..., 4, 3) lengths [m]; NaN where a leg cannot reach.

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    points = feet_in_legs(geometry, body_position, body_rotation, feet)
    return leg_inverse(geometry.leg, points, _per_leg(references))


def feet_in_legs(
    geometry: ChairGeometry, body_position: ArrayLike, body_rotation: ArrayLike, feet: ArrayLike
) -> NDArray[np.float64]:
    """Places in the world seen by each leg: Eq. (31).

    Args:
        geometry: the chair.
        body_position: (..., 3) of S in the world [m].
        body_rotation: (..., 3, 3) of {S} in the world.
        feet: (..., 4, 3) in the world [m].

    Returns:
        (..., 4, 3) in the legs' frames {A1} [m].

    Raises:
        ValueError: wrong shapes.
    """
    from_body = _of_feet(feet, "feet") - of_width(body_position, 3, "body_position")[..., None, :]
    R_SW = np.swapaxes(_rotation(body_rotation), -1, -2)
    in_body = np.einsum("...ij,...lj->...li", R_SW, from_body)
    return _into_legs(geometry, in_body - geometry.p_SA)


@nan_without_warning
def chair_motion(
    geometry: ChairGeometry, body: BodyMotion, feet: Motion, references: Reference
) -> BranchMotion:
    """Lengths, velocities and accelerations of all branches, Eqs. (31)-(36).

    Eqs. (33) and (35) are misprinted in the body's rotation. With r the vector from S to the foot,
    w and e the body's angular velocity and acceleration, all in the world, the foot moves in its
    leg's frame with

        v = R^-1 (v_F - v_S - w x r)
        a = R^-1 (a_F - a_S - e x r - w x (w x r) - 2 w x (v_F - v_S - w x r)).

    Args:
        geometry: the chair.
        body: motion of {S} in the world, arrays (..., 3).
        feet: motion of the reference corners in the world, arrays (..., 4, 3).
        references: corner of each foot, "E1", "E2", "E3" or 1, 2, 3: (..., 4) or one.

    Returns:
        Arrays (..., 4, 3); NaN where a leg cannot reach.

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    motion = _motion_in_legs(geometry, body, feet)
    return leg_motion(geometry.leg, motion, _per_leg(references))


def _motion_in_legs(geometry: ChairGeometry, body: BodyMotion, feet: Motion) -> Motion:
    """Motion of the feet in their legs' frames."""
    R_SW = np.swapaxes(_rotation(body.rotation), -1, -2)
    w = of_width(body.angular_velocity, 3, "angular_velocity")[..., None, :]
    r = _relative(feet.position, body.position, "position")
    velocity = _relative(feet.velocity, body.velocity, "velocity") - cross(w, r)
    e = of_width(body.angular_acceleration, 3, "angular_acceleration")[..., None, :]
    acceleration = _relative(feet.acceleration, body.acceleration, "acceleration")
    acceleration = acceleration - cross(e, r) - cross(w, cross(w, r))
    acceleration = acceleration - 2.0 * cross(w, velocity)
    in_body = [np.einsum("...ij,...lj->...li", R_SW, v) for v in (velocity, acceleration)]
    points = feet_in_legs(geometry, body.position, body.rotation, feet.position)
    return Motion(points, *(_into_legs(geometry, vectors) for vectors in in_body))


def foot_corners(
    geometry: ChairGeometry, body_position: ArrayLike, body_rotation: ArrayLike, lengths: ArrayLike
) -> NDArray[np.float64]:
    """Corners of all feet, given the lengths of the branches.

    Args:
        geometry: the chair.
        body_position: (..., 3) of S in the world [m].
        body_rotation: (..., 3, 3) of {S} in the world.
        lengths: (..., 4, 3) of the branches [m].

    Returns:
        (..., 4, 3, 3) corners E_1, E_2, E_3 (rows) of each foot in the world [m]; NaN for a leg
        that cannot be assembled.

    Raises:
        ValueError: wrong shapes.
    """
    in_body = corners_in_body(geometry, up_of_lengths(geometry.leg, _of_feet(lengths, "lengths")))
    R_WS = _rotation(body_rotation)
    position = of_width(body_position, 3, "body_position")[..., None, None, :]
    return np.einsum("...ij,...lkj->...lki", R_WS, in_body) + position


def corners_in_body(geometry: ChairGeometry, up: Array) -> Array:
    """Corners (..., 4, 3, 3) of all feet from S in {S} [m], see `foot_corners`.

    Args:
        geometry: the chair.
        up: (..., 4, 3) coordinates of the UP branches [m, rad, rad].
    """
    corners = np.einsum("lij,...lkj->...lki", geometry.R_SA, leg_corners(geometry.leg, up))
    return corners + geometry.p_SA[:, None, :]


def standing_feet(
    geometry: ChairGeometry, body_position: ArrayLike, references: Reference
) -> NDArray[np.float64]:
    """Reference corners of feet that stand flat on the ground, each below its hinge.

    Args:
        geometry: the chair, with a body that is level and looks ahead.
        body_position: (..., 3) of S in the world [m].
        references: corner of each foot: (..., 4) or one.

    Returns:
        (..., 4, 3) in the world [m].

    Raises:
        ValueError: wrong shapes, or an unknown corner.
    """
    corners = geometry.leg.corners[_per_leg(references) - 1]
    offsets = geometry.p_SA + np.einsum("lij,...lj->...li", geometry.R_SA, corners)
    feet = offsets + of_width(body_position, 3, "body_position")[..., None, :]
    feet[..., 2] = 0.0
    return feet


def _into_legs(geometry: ChairGeometry, vectors: Array) -> Array:
    """Vectors (..., 4, 3) along the body's axes, along the legs' axes."""
    return np.einsum("lij,...li->...lj", geometry.R_SA, vectors)


def _relative(feet: ArrayLike, body: ArrayLike, name: str) -> Array:
    return _of_feet(feet, f"feet {name}") - of_width(body, 3, f"body {name}")[..., None, :]


def _of_feet(value: ArrayLike, name: str) -> Array:
    array = of_width(value, 3, name)
    if array.ndim < 2 or array.shape[-2] != LEG_COUNT:
        raise ValueError(f"{name} must have shape (..., {LEG_COUNT}, 3), not {array.shape}")
    return array


def _rotation(value: ArrayLike) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim < 2 or array.shape[-2:] != (3, 3):
        raise ValueError(f"body_rotation must have shape (..., 3, 3), not {array.shape}")
    return array


def _per_leg(references: Reference) -> NDArray[np.intp]:
    numbers = corner_numbers(references)
    if numbers.ndim == 0:
        return np.broadcast_to(numbers, (LEG_COUNT,))
    if numbers.shape[-1] != LEG_COUNT:
        raise ValueError(f"references must have shape (..., {LEG_COUNT}), not {numbers.shape}")
    return numbers
