"""Gaits that follow each other, as one: forward and back, for instance."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from parapod.systems.walking_chair.gait import TrotGait
from parapod.systems.walking_chair.gait_motion import GaitMotion, gait_motion
from parapod.systems.walking_chair.geometry import ChairGeometry
from parapod.systems.walking_chair.motion import BodyMotion, Motion

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
        """When each gait begins, and when the last one ends [s]."""
        return tuple(accumulate((gait.duration for gait in self.gaits), initial=0.0))

    @property
    def duration(self) -> float:
        """Of all gaits [s]."""
        return self._begins[-1]

    @cached_property
    def phases(self) -> tuple[str, ...]:
        """Names of all phases, one after another."""
        return tuple(phase for gait in self.gaits for phase in gait.phases)

    @cached_property
    def standing(self) -> tuple[tuple[bool, ...], ...]:
        """Which feet stand in each phase, (phases, 4)."""
        return tuple(row for gait in self.gaits for row in gait.standing)

    @cached_property
    def ends(self) -> tuple[float, ...]:
        """When each phase ends [s]."""
        durations = [gait.phase_duration for gait in self.gaits for _ in gait.phases]
        return tuple(accumulate(durations))

    def phase_at(self, time: float, side: Side = "right") -> int:
        """Index of the phase at a time, the first one before and the last one after the walk.

        Args:
            time: since the walk began [s].
            side: as for `TrotGait.locate`.
        """
        k = self._gait_at(time, side)
        before = sum(len(gait.phases) for gait in self.gaits[:k])
        return before + self.gaits[k].phase_at(time - self._begins[k], side)

    def motion(self, geometry: ChairGeometry, time: float, side: Side = "right") -> GaitMotion:
        """Where body and feet are at a time; see `gait_motion`.

        Args:
            geometry: the chair.
            time: since the walk began [s].
            side: as for `gait_motion`.
        """
        k = self._gait_at(time, side)
        return gait_motion(geometry, self.gaits[k], time - self._begins[k], side)

    def motions(self, geometry: ChairGeometry, times: NDArray[np.float64]) -> GaitMotion:
        """Where body and feet are at times (n), all at once; see `gait_motion`."""
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
