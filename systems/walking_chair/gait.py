"""The trotting gait: its phases, the motion of body and feet, and walks made of gaits."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.core.motion_laws import MOTION_LAWS
from parapod.systems.core.vectors import Array
from parapod.systems.walking_chair import gait as phases
from parapod.systems.walking_chair.chair import chair_inverse, chair_motion, standing_feet
from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.leg import lowest_corner, up_branch
from parapod.systems.walking_chair.trajectories import (
    BodyMotion,
    BranchMotion,
    FootTrajectory,
    Motion,
)

# Indices 0..3 of the pairs that swing first and second.
ORDERS = {"13-24": ((0, 2), (1, 3)), "24-13": ((1, 3), (0, 2))}
DIRECTIONS = {"forward": 1.0, "back": -1.0}
SIDES = ("right", "left")

LIFT, FIRST_SWING, SHIFT, SECOND_SWING, LOWER, REST = (
    "lift",
    "first swing",
    "shift",
    "second swing",
    "lower",
    "rest",
)


@dataclass(frozen=True)
class TrotGait:
    """Trot with flat feet: one pair of legs steps, the body follows, the other pair steps.

    A cycle is these three phases and moves body and feet by one step, after which every leg hangs
    straight again, so that cycles follow each other without a pause. Before the first cycle the
    body is lifted, after the last one it is lowered; these only adjust the height (the paper's
    Figure 16 (a) and (e)). All phases last equally long, and both legs of a pair swing together.

    Attributes:
        order: "13-24" for legs 1 and 3 first, "24-13" for legs 2 and 4 first.
        cycles: number of cycles.
        direction: "forward" (along y) or "back".
        lift: lift of the body above the retracted height H_0, z_s [m].
        step: length of the step S_0, and the body's way in a cycle [m].
        swing_height: height of the feet's swing H [m].
        phase_duration: duration of each phase, T_m [s].
        body_law: law of the body's motion within a phase, by its name in `MOTION_LAWS`; "linear"
            is Eq. (45).
        start: x and y of the body's centre S in the world at the start [m].
    """

    order: str = "13-24"
    cycles: int = 1
    direction: str = "forward"
    lift: float = 0.1147
    step: float = 0.1027
    swing_height: float = 0.100
    phase_duration: float = 5.0
    body_law: str = "linear"
    start: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, admissible in (
            ("order", ORDERS),
            ("direction", DIRECTIONS),
            ("body_law", MOTION_LAWS),
        ):
            if getattr(self, name) not in admissible:
                allowed = ", ".join(admissible)
                raise ValueError(f"{name} must be one of {allowed}, not {getattr(self, name)!r}")
        if not (isinstance(self.cycles, int) and self.cycles >= 1):
            raise ValueError(f"cycles must be a whole number from 1 on, not {self.cycles!r}")
        for name in ("lift", "step", "swing_height", "phase_duration"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, not {value!r}")
        if len(self.start) != 2 or not all(map(math.isfinite, self.start)):
            raise ValueError(f"start must be two finite numbers, not {self.start!r}")

    @cached_property
    def phases(self) -> tuple[str, ...]:
        """Names of the phases, one after another."""
        return (LIFT, *(FIRST_SWING, SHIFT, SECOND_SWING) * self.cycles, LOWER)

    @property
    def duration(self) -> float:
        """Duration of the whole gait [s]."""
        return len(self.phases) * self.phase_duration

    @property
    def signed_step(self) -> float:
        """Way of body and feet in a cycle along y [m]; negative for going back."""
        return DIRECTIONS[self.direction] * self.step

    @property
    def end(self) -> tuple[float, float]:
        """Place of the body's centre S at the end: x and y in the world [m]."""
        x, y = self.start
        return x, y + self.cycles * self.signed_step

    def reversed(self) -> "TrotGait":
        """The same number of cycles in the other direction, from where this one ends."""
        (other,) = set(DIRECTIONS) - {self.direction}
        return replace(self, direction=other, start=self.end)

    @property
    def swing(self) -> FootTrajectory:
        """Swing with which a foot makes its step."""
        return FootTrajectory(self.signed_step, self.swing_height, self.phase_duration)

    @property
    def pairs(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Indices 0..3 of the legs that swing first and second."""
        return ORDERS[self.order]

    @cached_property
    def standing(self) -> tuple[tuple[bool, ...], ...]:
        """Stance of the feet in each phase, (phases, 4)."""
        swings = {FIRST_SWING: self.pairs[0], SECOND_SWING: self.pairs[1]}
        return tuple(
            tuple(leg not in swings.get(phase, ()) for leg in range(LEG_COUNT))
            for phase in self.phases
        )

    def phase_at(self, time: float, side: Literal["right", "left"] = "right") -> int:
        """Index of the phase at a time, the first one before and the last one after the gait.

        Args:
            time: since the gait began [s].
            side: see `locate`.
        """
        return min(max(int(self.locate(time, side)[0]), 0), len(self.phases) - 1)

    def locate(
        self, time: ArrayLike, side: Literal["right", "left"] = "right"
    ) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Phase into which each time falls, and the share of it that has passed.

        Args:
            time: (...) since the gait began [s].
            side: to which phase a time between two belongs: "right" for the one that begins,
                "left" for the one that ends.

        Returns:
            (...) indices of the phases, -1 before the first and `len(phases)` after the last; and
            (...) share of the phase that has passed, in [0, 1].

        Raises:
            ValueError: a time that is not finite, or an unknown side.
        """
        if side not in SIDES:
            raise ValueError(f"side must be one of {', '.join(SIDES)}, not {side!r}")
        times = np.asarray(time, dtype=np.float64)
        if not np.isfinite(times).all():
            raise ValueError("times must be finite")
        ends = self.phase_duration * np.arange(len(self.phases) + 1)
        index = np.searchsorted(ends, times, side=side) - 1
        share = (times - ends[np.maximum(index, 0)]) / self.phase_duration
        return index, np.clip(share, 0.0, 1.0)


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
        side: see `gait_motion`.

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
        side: the one of two phases to which a time between them belongs: "right" for the one that
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
    """Number of phases of a name that are over at phases `index`, and whether they are one."""
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
        progress, doing = _done_and_doing(gait, index, name)
        motions[0][..., axis] += way * progress
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
        progress, doing = _done_and_doing(gait, index, name)
        for leg in pair:
            swings[..., leg] = doing
            motion.position[..., leg, 1] += gait.signed_step * progress
            for total, part in zip(motion, swing, strict=True):
                total[..., leg, :] += np.where(doing[..., np.newaxis], part, 0.0)
    start = (*gait.start, geometry.leg.retracted_height)
    motion.position[...] += standing_feet(geometry, start, references)
    return motion, swings


type Side = Literal["right", "left"]


@dataclass(frozen=True)
class Walk:
    """One gait after another; each begins where the one before ends, at rest on four feet.

    Attributes:
        gaits: in order.
    """

    gaits: tuple[TrotGait, ...] = (TrotGait(),)

    def __post_init__(self) -> None:
        if not self.gaits:
            raise ValueError("a walk needs a gait")
        for earlier, later in pairwise(self.gaits):
            if not np.allclose(later.start, earlier.end, rtol=0.0, atol=1e-9):
                raise ValueError(
                    f"a gait that starts at {later.start} cannot follow one that ends at "
                    f"{earlier.end}"
                )

    @cached_property
    def _begins(self) -> tuple[float, ...]:
        """Times at which each gait begins, and at which the last one ends [s]."""
        return tuple(accumulate((gait.duration for gait in self.gaits), initial=0.0))

    @property
    def duration(self) -> float:
        """Duration of all gaits [s]."""
        return self._begins[-1]

    @cached_property
    def phases(self) -> tuple[str, ...]:
        """Names of all phases, one after another."""
        return tuple(phase for gait in self.gaits for phase in gait.phases)

    @cached_property
    def standing(self) -> tuple[tuple[bool, ...], ...]:
        """Stance of the feet in each phase, (phases, 4)."""
        return tuple(row for gait in self.gaits for row in gait.standing)

    @cached_property
    def ends(self) -> tuple[float, ...]:
        """Times at which the phases end [s]."""
        durations = [gait.phase_duration for gait in self.gaits for _ in gait.phases]
        return tuple(accumulate(durations))

    def phase_at(self, time: float, side: Side = "right") -> int:
        """Index of the phase at a time, the first one before and the last one after the walk.

        Args:
            time: since the walk began [s].
            side: see `TrotGait.locate`.
        """
        k = self._gait_at(time, side)
        before = sum(len(gait.phases) for gait in self.gaits[:k])
        return before + self.gaits[k].phase_at(time - self._begins[k], side)

    def motion(self, geometry: ChairGeometry, time: float, side: Side = "right") -> GaitMotion:
        """Motion of body and feet at a time; see `gait_motion`.

        Args:
            geometry: the chair.
            time: since the walk began [s].
            side: see `gait_motion`.
        """
        k = self._gait_at(time, side)
        return gait_motion(geometry, self.gaits[k], time - self._begins[k], side)

    def motions(self, geometry: ChairGeometry, times: NDArray[np.float64]) -> GaitMotion:
        """Motion of body and feet at times (n), all at once; see `gait_motion`."""
        each = np.array([self._gait_at(time, "right") for time in times.tolist()])
        parts = [
            gait_motion(geometry, self.gaits[k], times[each == k] - self._begins[k])
            for k in np.unique(each).tolist()
        ]
        return joined(parts)

    def _gait_at(self, time: float, side: Side) -> int:
        over = [end <= time if side == "right" else end < time for end in self._begins[1:-1]]
        return sum(over)


def joined(parts: Sequence[GaitMotion]) -> GaitMotion:
    """Parts of a motion, one after another, as one."""
    body, feet, references, support = zip(*parts, strict=True)
    return GaitMotion(
        BodyMotion(
            np.concatenate([part.position for part in body]),
            velocity=np.concatenate([part.velocity for part in body]),
            acceleration=np.concatenate([part.acceleration for part in body]),
        ),
        Motion(*(np.concatenate(arrays) for arrays in zip(*feet, strict=True))),
        np.concatenate(references),
        np.concatenate(support),
    )


def there_and_back(gait: TrotGait) -> Walk:
    """A gait, and the same the other way."""
    return Walk((gait, gait.reversed()))


def starting_lengths(geometry: ChairGeometry, walk: Walk) -> NDArray[np.float64]:
    """Lengths (4, 3) of the branches with which a walk begins [m]."""
    motion = walk.motion(geometry, 0.0)
    return chair_inverse(
        geometry, motion.body.position, np.eye(3), motion.feet.position, motion.references
    )
