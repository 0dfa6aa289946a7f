"""Where a trotting gait has the body and the feet at any time, and what the branches do."""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.walking_chair import gait as phases
from parapod.systems.walking_chair.chair import chair_motion, standing_feet
from parapod.systems.walking_chair.gait import TrotGait
from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.leg import up_branch
from parapod.systems.walking_chair.motion import BodyMotion, BranchMotion, Motion
from parapod.systems.walking_chair.motion_laws import MOTION_LAWS
from parapod.systems.walking_chair.references import lowest_corner
from parapod.systems.walking_chair.vectors import Array


class GaitMotion(NamedTuple):
    """A gait at times (...).

    Attributes:
        body: motion of the body in the world, arrays (..., 3); it does not turn.
        feet: motion of the feet's reference corners in the world, arrays (..., 4, 3).
        references: (..., 4) numbers 1, 2, 3 of these corners.
        support: (..., 4) whether each foot is on the ground for good; False throughout its swing.
    """

    body: BodyMotion
    feet: Motion
    references: NDArray[np.intp]
    support: NDArray[np.bool_]


def gait_branches(
    geometry: ChairGeometry,
    gait: TrotGait,
    time: ArrayLike,
    side: Literal["right", "left"] = "right",
) -> BranchMotion:
    """Lengths, velocities and accelerations of all twelve branches in a gait.

    Args:
        geometry: the chair.
        gait: the gait.
        time: (...) since the gait began [s].
        side: as for `gait_motion`.

    Returns:
        Arrays (..., 4, 3); NaN where a leg cannot reach. Strokes and speeds are not looked at
        (`check_gait`).

    Raises:
        ValueError: a time that is not finite, or an unknown side.
    """
    motion = gait_motion(geometry, gait, time, side)
    return chair_motion(geometry, motion.body, motion.feet, motion.references)


def gait_motion(
    geometry: ChairGeometry,
    gait: TrotGait,
    time: ArrayLike,
    side: Literal["right", "left"] = "right",
) -> GaitMotion:
    """Motion of the body and the feet in a gait, Eqs. (40)-(45).

    Args:
        geometry: the chair.
        gait: the gait.
        time: (...) since the gait began [s]; before and after it the chair rests.
        side: which of two phases a time between them belongs to: "right" for the one that
            begins, "left" for the one that ends. It matters to what jumps there: with the law
            "linear" the body's velocity, and always which feet support.

    Raises:
        ValueError: a time that is not finite, or an unknown side.
    """
    index, share = gait.locate(time, side)
    references = gait_references(geometry, gait)
    feet, swings = _feet(geometry, gait, index, share, references)
    return GaitMotion(
        _body(geometry, gait, index, share),
        feet,
        np.broadcast_to(references, swings.shape),
        ~swings,
    )


def gait_references(geometry: ChairGeometry, gait: TrotGait) -> NDArray[np.intp]:
    """Reference corner of each foot, the same throughout the gait.

    The feet that swing first are up to a step ahead of their hinges and never behind, the others
    up to a step behind and never ahead; so each leg's foot leans to one side alone, and the
    corner that is lowest at the end of the step is lowest all the time.

    Returns:
        (4,) numbers 1, 2, 3 of the corners.
    """
    offset = np.zeros((LEG_COUNT, 3))
    for pair, sign in zip(gait.pairs, (1.0, -1.0), strict=True):
        offset[list(pair), 1] = sign * gait.signed_step
    below = np.array((0.0, 0.0, -(geometry.leg.retracted_height + gait.lift)))
    points = np.einsum("lij,li->lj", geometry.R_SA, offset) + below
    return lowest_corner(geometry.leg, up_branch(geometry.leg, points), geometry.R_SA)


def _done_and_doing(
    gait: TrotGait, index: NDArray[np.intp], name: str
) -> tuple[Array, NDArray[np.bool_]]:
    """How many phases of a name are over at phases `index`, and whether they are one."""
    # At rest before the first phase and after the last one.
    is_one = np.array([phase == name for phase in (phases.REST, *gait.phases, phases.REST)])
    before = np.concatenate([[0], np.cumsum(is_one)[:-1]])
    return before[index + 1].astype(np.float64), is_one[index + 1]


def _body(
    geometry: ChairGeometry, gait: TrotGait, index: NDArray[np.intp], share: Array
) -> BodyMotion:
    """Eq. (45), with any law."""
    T = gait.phase_duration
    law = [d / T**order for order, d in enumerate(MOTION_LAWS[gait.body_law](share))]
    motions = [np.zeros((*share.shape, 3)) for _ in law]
    for name, axis, way in (
        (phases.LIFT, 2, gait.lift),
        (phases.SHIFT, 1, gait.signed_step),
        (phases.LOWER, 2, -gait.lift),
    ):
        done, doing = _done_and_doing(gait, index, name)
        motions[0][..., axis] += way * done
        for motion, part in zip(motions, law, strict=True):
            motion[..., axis] += way * np.where(doing, part, 0.0)
    position, velocity, acceleration = motions
    position += (*gait.start, geometry.leg.retracted_height)
    return BodyMotion(position, velocity=velocity, acceleration=acceleration)


def _feet(
    geometry: ChairGeometry,
    gait: TrotGait,
    index: NDArray[np.intp],
    share: Array,
    references: NDArray[np.intp],
) -> tuple[Motion, NDArray[np.bool_]]:
    """Motion of the reference corners, and which feet swing."""
    swing = gait.swing.motion(share * gait.phase_duration)
    motion = Motion(*(np.zeros((*share.shape, LEG_COUNT, 3)) for _ in swing))
    swings = np.zeros((*share.shape, LEG_COUNT), dtype=np.bool_)
    for pair, name in zip(gait.pairs, (phases.FIRST_SWING, phases.SECOND_SWING), strict=True):
        done, doing = _done_and_doing(gait, index, name)
        for leg in pair:
            swings[..., leg] = doing
            motion.position[..., leg, 1] += gait.signed_step * done
            for total, part in zip(motion, swing, strict=True):
                total[..., leg, :] += np.where(doing[..., np.newaxis], part, 0.0)
    start = (*gait.start, geometry.leg.retracted_height)
    motion.position[...] += standing_feet(geometry, start, references)
    return motion, swings
