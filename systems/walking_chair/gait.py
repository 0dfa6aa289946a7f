"""The trotting gait: which pair of legs swings when, and when the body moves."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from parapod.systems.walking_chair.foot_trajectory import FootTrajectory
from parapod.systems.walking_chair.geometry import LEG_COUNT
from parapod.systems.walking_chair.motion_laws import MOTION_LAWS

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
        cycles: how many.
        direction: "forward" (along y) or "back".
        lift: how far the body is lifted above the retracted height H_0, z_s [m].
        step: length of the step S_0, and the body's way in a cycle [m].
        swing_height: height of the feet's swing H [m].
        phase_duration: of each phase, T_m [s].
        body_law: how the body moves within a phase, by its name in `MOTION_LAWS`; "linear" is
            Eq. (45).
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
        """Of the whole gait [s]."""
        return len(self.phases) * self.phase_duration

    @property
    def signed_step(self) -> float:
        """Way of body and feet in a cycle along y [m]; negative for going back."""
        return DIRECTIONS[self.direction] * self.step

    @property
    def end(self) -> tuple[float, float]:
        """Where the body's centre S is at the end: x and y in the world [m]."""
        x, y = self.start
        return x, y + self.cycles * self.signed_step

    def reversed(self) -> "TrotGait":
        """The same number of cycles in the other direction, from where this one ends."""
        (other,) = set(DIRECTIONS) - {self.direction}
        return replace(self, direction=other, start=self.end)

    @property
    def swing(self) -> FootTrajectory:
        """How a foot makes its step."""
        return FootTrajectory(self.signed_step, self.swing_height, self.phase_duration)

    @property
    def pairs(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Indices 0..3 of the legs that swing first and second."""
        return ORDERS[self.order]

    @cached_property
    def standing(self) -> tuple[tuple[bool, ...], ...]:
        """Which feet stand in each phase, (phases, 4)."""
        swings = {FIRST_SWING: self.pairs[0], SECOND_SWING: self.pairs[1]}
        return tuple(
            tuple(leg not in swings.get(phase, ()) for leg in range(LEG_COUNT))
            for phase in self.phases
        )

    def phase_at(self, time: float, side: Literal["right", "left"] = "right") -> int:
        """Index of the phase at a time, the first one before and the last one after the gait.

        Args:
            time: since the gait began [s].
            side: as for `locate`.
        """
        return min(max(int(self.locate(time, side)[0]), 0), len(self.phases) - 1)

    def locate(
        self, time: ArrayLike, side: Literal["right", "left"] = "right"
    ) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Which phase each time falls into, and how much of it has passed.

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
