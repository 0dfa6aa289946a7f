"""Branches and feet of the walking chair throughout a walk, sampled for numbers and figures."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from parapod.systems.walking_chair.chair import foot_corners
from parapod.systems.walking_chair.gait import (
    FIRST_SWING,
    SECOND_SWING,
    Side,
    TrotGait,
    Walk,
    gait_branches,
    gait_motion,
)
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.trajectories import BranchMotion

type Floats = NDArray[np.float64]

# Samples of a phase, both of its ends among them: what is between them exceeds them by 0.3 um.
_SAMPLES = 1001


@dataclass(frozen=True)
class SampledWalk:
    """A walk at times of which each instant between two phases is there twice, from either side.

    Attributes:
        geometry: the chair.
        walk: the gaits.
        time: (n) [s].
        phase: (n) index of the phase.
        body: (n, 3) S in the world [m].
        branches: arrays (n, 4, 3).
        velocity_steps: (k, 4, 3) by which velocities jump where phases begin and end [m/s].
        acceleration_steps: (k, 4, 3) likewise [m/s^2].
    """

    geometry: ChairGeometry
    walk: Walk
    time: Floats
    phase: NDArray[np.intp]
    body: Floats
    branches: BranchMotion
    velocity_steps: Floats
    acceleration_steps: Floats

    @cached_property
    def corners(self) -> Floats:
        """(n, 4, 3, 3) corners of the feet in the world, from the lengths alone [m]."""
        return foot_corners(self.geometry, self.body, np.eye(3), self.branches.length)

    def during(self, *names: str) -> NDArray[np.bool_]:
        """(n) times of the phases of these names."""
        indices = [i for i, name in enumerate(self.walk.phases) if name in names]
        return np.isin(self.phase, indices)

    @property
    def swings(self) -> NDArray[np.bool_]:
        """(n) times at which feet swing."""
        return self.during(FIRST_SWING, SECOND_SWING)


def sample_walk(geometry: ChairGeometry, walk: Walk) -> SampledWalk:
    """Samples all phases of a walk."""
    parts = [_sample_gait(geometry, gait) for gait in walk.gaits]
    begins = np.cumsum([0.0, *(gait.duration for gait in walk.gaits)])
    phases = np.cumsum([0, *(len(gait.phases) for gait in walk.gaits)])
    return SampledWalk(
        geometry,
        walk,
        np.concatenate([part.time + begin for part, begin in zip(parts, begins, strict=False)]),
        np.concatenate([part.phase + first for part, first in zip(parts, phases, strict=False)]),
        np.concatenate([part.body for part in parts]),
        _joined([part.branches for part in parts]),
        np.concatenate([part.velocity_steps for part in parts]),
        np.concatenate([part.acceleration_steps for part in parts]),
    )


def _sample_gait(geometry: ChairGeometry, gait: TrotGait) -> SampledWalk:
    ends = gait.phase_duration * np.arange(len(gait.phases) + 1)
    times, bodies, branches = [], [], []
    for begin, end in pairwise(ends):
        inside = np.linspace(begin, end, _SAMPLES)
        parts: tuple[tuple[Floats, Side], ...] = ((inside[:-1], "right"), (inside[-1:], "left"))
        for time, side in parts:
            times.append(time)
            bodies.append(gait_motion(geometry, gait, time, side).body.position)
            branches.append(gait_branches(geometry, gait, time, side))
    after, before = (gait_branches(geometry, gait, ends, side) for side in ("right", "left"))
    return SampledWalk(
        geometry,
        Walk((gait,)),
        np.concatenate(times),
        np.repeat(np.arange(len(gait.phases)), _SAMPLES),
        np.concatenate(bodies),
        _joined(branches),
        after.velocity - before.velocity,
        after.acceleration - before.acceleration,
    )


def _joined(parts: list[BranchMotion]) -> BranchMotion:
    return BranchMotion(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
