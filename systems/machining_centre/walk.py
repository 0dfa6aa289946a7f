"""Plan of a walk: which foot goes on next, from which pose, with which joints locked.

The paper shows one walk, and leaves to later how it is found. Here one foot after the other goes
to the place that is as much farther as all feet are to go; from a few poses of the platform above
the feet, and of all sets of locks, those with room to spare are taken.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.job import Job, Refused, Swing, Swung, try_swing
from parapod.systems.machining_centre.platform_mode import leg_lengths, within_stroke
from parapod.systems.machining_centre.posture import Posture
from parapod.systems.machining_centre.swing import LockSet, best_sets

# Where the platform begins a swing: how far ahead of the feet's middle, as a share of the foot's
# way, and how much higher or lower than usual, of the paper's centre [m].
_AHEAD, _HIGHER = (-0.5, -0.25, 0.0), (0.0, 0.03, -0.03, 0.06)
# Sets of locks that are tried at a pose, the best ones there, and swings that are then made.
_SETS = 4
# Postures on the way of a swing that is only tried.
_COARSE = 8
# A leg of the paper's centre this far from the ends of its stroke is far enough [m], and so is a
# swing that is led as well as this: what yields by a force sinks by its inverse [-].
_ROOM, _STIFF = 0.02, 0.1


class Footprint(NamedTuple):
    """Places of the feet on the panel, ways along and across and headings (n, 3) [m, rad]."""

    places: Array

    @classmethod
    def from_job(cls, job: Job, feet: Array) -> "Footprint":
        """That of feet (n, 6)."""
        places = job.panel.place(feet[:, :3])
        places[:, 2] = [job.panel.heading(foot) for foot in feet]
        return cls(places)


def plan_walk(
    geometry: CentreGeometry,
    job: Job,
    beginning: Posture,
    advance: tuple[float, float],
    steps: int,
    height: float,
    locked: Sequence[tuple[int, int]] | None = None,
) -> list[Swing]:
    """Swings that take all feet on by as much.

    Args:
        geometry: the centre.
        job: its panel, lift and limits are taken.
        beginning: platform and feet before.
        advance: ways along and across (2) that each foot goes on [m].
        steps: swings of each foot.
        height: height of the platform above the panel at the beginning of a swing [m].
        locked: joints of the standing limbs, (places after the loose limb, joint) each: 1 is the
            next limb, 2 the one after that; None: the best ones.

    Returns:
        The swings, in their order.

    Raises:
        Refused: no way is found; has the words about the nearest one.
    """
    footholds, now, swings = Footprint.from_job(job, beginning.feet).places, beginning, []
    for step in range(1, steps + 1):
        waiting = list(range(1, geometry.limbs + 1))
        while waiting:
            candidates: list[tuple[float, Swing, Swung]] = []
            refusals: list[str] = []
            for limb in waiting:
                along, across = footholds[limb - 1, :2] + step / steps * np.array(advance)
                goal = job.panel.foothold(along, across, job.panel.heading(now.feet[limb - 1]))
                try:
                    swing, swung = _best(geometry, job, now, limb, goal, height, locked)
                    candidates.append((_rating(geometry, swung), swing, swung))
                    if candidates[-1][0] >= 1.0:
                        break
                except Refused as error:
                    refusals.append(error.words)
            if not candidates:
                raise Refused(f"no walk is found, step {step} of {steps}: {refusals[0]}")
            _, swing, swung = max(candidates, key=lambda each: each[0])
            swings.append(replace(swing, way=swung.way))
            waiting.remove(swing.lock_set.limb)
            now = swung.end
    return swings


def _best(
    geometry: CentreGeometry,
    job: Job,
    now: Posture,
    limb: int,
    goal: Array,
    height: float,
    locked: Sequence[tuple[int, int]] | None,
) -> tuple[Swing, Swung]:
    """The first swing of a limb with room to spare, or the one with most of it."""
    best: tuple[Swing, Swung] | None = None
    rating = partial(_rating, geometry)
    refusal = Refused(f"limb {limb} finds no pose of the platform from which it could swing")
    for pose in _poses(geometry, job, now, limb, goal, height):
        for lock_set in _sets(geometry, pose, now.feet, limb, locked, job.least_sigma):
            swing = Swing(pose, lock_set, goal)
            try:
                swung = try_swing(geometry, job, swing, now.feet, _COARSE)
                if best is not None and rating(swung) <= rating(best[1]):
                    continue
                swung = try_swing(geometry, job, swing, now.feet)
            except Refused as error:
                refusal = error
                continue
            if best is None or rating(swung) > rating(best[1]):
                best = swing, swung
            if rating(swung) >= 1.0:
                return best
    if best is None:
        raise refusal
    return best


def _rating(geometry: CentreGeometry, swung: Swung) -> float:
    """Quality of a swing; 1 is good enough."""
    return min(swung.margin / (_ROOM * geometry.size), swung.sigma / _STIFF)


def _poses(
    geometry: CentreGeometry, job: Job, now: Posture, limb: int, goal: Array, height: float
) -> list[Array]:
    """Poses of the platform from which a limb might swing."""
    print_ = Footprint.from_job(job, now.feet).places
    middle = print_[:, :2].mean(axis=0)
    way = job.panel.place(goal[:3])[:2] - print_[limb - 1, :2]
    poses = []
    for higher in _HIGHER:
        for ahead in _AHEAD:
            along, across = middle + ahead * way
            above = height + higher * geometry.size
            pose = job.panel.frame(along, across, _heading(geometry, print_), above)
            if within_stroke(geometry, leg_lengths(geometry, pose, now.feet)).all():
                poses.append(pose)
    return poses


def _heading(geometry: CentreGeometry, places: Array) -> float:
    """Turn of the pattern whose feet are nearest to these places [rad]."""
    off = places[:, :2] - places[:, :2].mean(axis=0)
    rotation = np.sum((off[:, 0] + 1j * off[:, 1]) * np.exp(-1j * geometry.angles))
    return float(np.angle(rotation))


def _sets(
    geometry: CentreGeometry,
    pose: Array,
    feet: Array,
    limb: int,
    locked: Sequence[tuple[int, int]] | None,
    least: float,
) -> list[LockSet]:
    """Sets of locks with which a limb may swing from a pose, the best first."""
    if locked is not None:
        standing = tuple(
            sorted(((limb - 1 + after) % geometry.limbs + 1, joint) for after, joint in locked)
        )
        return [LockSet(limb, standing)]
    return best_sets(geometry, pose, feet, limb, least, _SETS)
