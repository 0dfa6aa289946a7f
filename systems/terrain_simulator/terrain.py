"""Terrains: height and slope of the ground by the distance that the body has gone.

The paper names slopes, vertical steps, stairs and dynamically varied terrain; their sizes, and
those of rough ground, are the user's.
"""

import csv
import math
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.vectors import Array

__all__ = [
    "TERRAINS",
    "AlternatingSlopes",
    "Heave",
    "Level",
    "Lift",
    "RecordedProfile",
    "Rough",
    "Slope",
    "Stairs",
    "Step",
    "Terrain",
    "read_profile",
]

_WAVES = 96  # enough that the sum of a rough ground's waves is nearly normally distributed
_COLUMNS = ["distance", "height"]


class Lift(NamedTuple):
    """Height by which the whole ground is lifted at times (...), and its derivatives.

    Attributes:
        height: (...) [m].
        velocity: (...) [m/s].
        acceleration: (...) [m/s^2].
    """

    height: Array
    velocity: Array
    acceleration: Array


class Terrain:
    """Ground under a walking robot: level and at rest but for what a terrain says itself."""

    def height(self, distance: ArrayLike) -> Array:
        """Height of the ground (...) [m] at distances (...) along the way [m]."""
        return np.zeros(np.shape(distance))

    def slope(self, distance: ArrayLike) -> Array:
        """Angle of the ground (...) [rad] at distances (...) [m]; positive is uphill."""
        return np.zeros(np.shape(distance))

    def lift(self, time: ArrayLike) -> Lift:
        """Motion of the whole ground at times (...) [s]."""
        zero = np.zeros(np.shape(time))
        return Lift(zero, zero, zero)


@dataclass(frozen=True)
class Level(Terrain):
    """Level ground."""


@dataclass(frozen=True)
class Slope(Terrain):
    """Ground of one slope everywhere.

    Attributes:
        angle: slope, positive uphill [rad].
    """

    angle: float

    def __post_init__(self) -> None:
        _check(self)

    def height(self, distance: ArrayLike) -> Array:
        """Height from where the distance is zero [m]."""
        return math.tan(self.angle) * np.asarray(distance, dtype=np.float64)

    def slope(self, distance: ArrayLike) -> Array:
        """Angle, the same everywhere [rad]."""
        return np.full(np.shape(distance), self.angle)


@dataclass(frozen=True)
class Step(Terrain):
    """One vertical step on level ground.

    Attributes:
        rise: height of the step, negative for one down [m].
        at: distance of its edge [m].
    """

    rise: float
    at: float = 0.0

    def __post_init__(self) -> None:
        _check(self)

    def height(self, distance: ArrayLike) -> Array:
        """Zero before the edge, and the rise from there on [m]."""
        return np.where(np.asarray(distance) >= self.at, self.rise, 0.0)


@dataclass(frozen=True)
class Stairs(Terrain):
    """Stairs on level ground, endless or with a landing.

    Attributes:
        rise: height of each step, negative for stairs down [m].
        tread: depth of each step [m].
        at: distance of the first edge [m].
        count: number of steps; None for endless stairs.
    """

    rise: float
    tread: float
    at: float = 0.0
    count: int | None = None

    def __post_init__(self) -> None:
        _check(self, "tread")
        if self.count is not None and not (isinstance(self.count, int) and self.count >= 1):
            raise ValueError(f"count must be a whole number from 1 on, not {self.count!r}")

    def speed(self, frequency: float, treads: int = 1) -> float:
        """Speed [m/s] at which a stride takes this many treads.

        Args:
            frequency: strides a second [Hz].
            treads: treads a stride, usually one or two.
        """
        return frequency * treads * self.tread

    def height(self, distance: ArrayLike) -> Array:
        """Height of the tread [m]."""
        steps_passed = (
            np.floor((np.asarray(distance, dtype=np.float64) - self.at) / self.tread) + 1.0
        )
        return self.rise * np.clip(
            steps_passed, 0.0, math.inf if self.count is None else self.count
        )


@dataclass(frozen=True)
class AlternatingSlopes(Terrain):
    """Slopes up and down by turns.

    Attributes:
        angle: slope of the first one, positive uphill [rad]; the next one has the negative.
        length: horizontal length of each [m].
    """

    angle: float
    length: float

    def __post_init__(self) -> None:
        _check(self, "length")

    def height(self, distance: ArrayLike) -> Array:
        """Height from where the distance is zero [m]."""
        return math.tan(self.angle) * (self.length - np.abs(self._place(distance) - self.length))

    def slope(self, distance: ArrayLike) -> Array:
        """Angle of the slope at each distance [rad]; at an edge that of the one ahead."""
        return np.where(self._place(distance) < self.length, self.angle, -self.angle)

    def _place(self, distance: ArrayLike) -> Array:
        return np.mod(np.asarray(distance, dtype=np.float64), 2.0 * self.length)


@dataclass(frozen=True)
class Heave(Terrain):
    """Level ground that moves up and down with the time, wherever the body is.

    Attributes:
        amplitude: largest height above and below its mean [m].
        frequency: cycles a second [Hz].
    """

    amplitude: float
    frequency: float

    def __post_init__(self) -> None:
        _check(self, "frequency")

    def lift(self, time: ArrayLike) -> Lift:
        """Sine of the time, from zero upwards."""
        omega = 2.0 * math.pi * self.frequency
        angle = omega * np.asarray(time, dtype=np.float64)
        height = self.amplitude * np.sin(angle)
        return Lift(height, self.amplitude * omega * np.cos(angle), -(omega**2) * height)


@dataclass(frozen=True)
class Rough(Terrain):
    """Rough ground: waves with a given spectrum, and with random phases.

    The spectral density of the height is proportional to (1 + (k c)^2)^(-w/2), k being the angular
    wave number, c the correlation length and w the falloff. With w = 2 it falls as that of roads
    (ISO 8608), and the autocorrelation is exp(-distance / c) but for the waves that are cut off.

    Attributes:
        deviation: standard deviation of the height over a long way [m].
        correlation_length: the length c [m].
        seed: whole number from 0 on; the same one gives the same ground.
        falloff: the exponent w of short waves [-].
        shortest: length of the shortest wave [m]; assumed: a foot does not feel shorter ones.
        longest: length of the longest wave by the correlation length [-].
    """

    deviation: float
    correlation_length: float
    seed: int = 0
    falloff: float = 2.0
    shortest: float = 0.1
    longest: float = 100.0

    def __post_init__(self) -> None:
        _check(self, "correlation_length", "falloff", "shortest", "longest")
        if not self.deviation >= 0.0:
            raise ValueError(f"deviation must not be negative, but is {self.deviation!r}")
        if not (isinstance(self.seed, int) and self.seed >= 0):
            raise ValueError(f"seed must be a whole number from 0 on, not {self.seed!r}")
        longest = self.longest * self.correlation_length
        if not self.shortest < longest:
            raise ValueError(
                f"shortest = {self.shortest:g} m must be less than the longest wave, {longest:g} m"
            )

    def height(self, distance: ArrayLike) -> Array:
        """Sum of the waves [m]; its mean over a long way is zero."""
        amplitude, number, phase = self._waves
        return np.cos(np.multiply.outer(distance, number) + phase) @ amplitude

    def slope(self, distance: ArrayLike) -> Array:
        """Angle of the tangent [rad]."""
        amplitude, number, phase = self._waves
        angle = np.multiply.outer(distance, number) + phase
        return np.arctan(-np.sin(angle) @ (amplitude * number))

    @cached_property
    def _waves(self) -> tuple[Array, Array, Array]:
        """Amplitudes [m], wave numbers [rad/m] and phases, one wave a band."""
        random = np.random.default_rng(self.seed)
        lowest = 2.0 * math.pi / (self.longest * self.correlation_length)
        edges = np.geomspace(lowest, 2.0 * math.pi / self.shortest, _WAVES + 1)
        # Equally spaced waves would repeat themselves.
        number = random.uniform(edges[:-1], edges[1:])
        middle = np.sqrt(edges[:-1] * edges[1:])
        power = np.diff(edges) * (1.0 + (self.correlation_length * middle) ** 2) ** (
            -0.5 * self.falloff
        )
        amplitude = self.deviation * np.sqrt(2.0 * power / power.sum())
        return amplitude, number, random.uniform(0.0, 2.0 * math.pi, _WAVES)


@dataclass(frozen=True)
class RecordedProfile(Terrain):
    """Ground whose heights were recorded; level before the first and after the last of them.

    Attributes:
        distances: distances along the way, increasing [m].
        heights: heights at these distances [m].
        foot: length over which a foot takes the slope [m]; assumed.
    """

    distances: tuple[float, ...]
    heights: tuple[float, ...]
    foot: float = 0.04

    def __post_init__(self) -> None:
        if not (math.isfinite(self.foot) and self.foot > 0.0):
            raise ValueError(f"foot must be positive, not {self.foot!r}")
        if len(self.distances) != len(self.heights) or len(self.distances) < 2:
            raise ValueError(
                "a profile must have as many heights as distances, and at least two, "
                f"not {len(self.heights)} and {len(self.distances)}"
            )
        numbers = np.array((self.distances, self.heights))
        if not np.isfinite(numbers).all():
            raise ValueError("distances and heights must be finite")
        if not (np.diff(numbers[0]) > 0.0).all():
            raise ValueError("distances must increase")

    def height(self, distance: ArrayLike) -> Array:
        """Height on the straight lines between the records [m]."""
        return np.asarray(np.interp(np.asarray(distance, dtype=np.float64), *self._records))

    def slope(self, distance: ArrayLike) -> Array:
        """Angle of the chord under a foot [rad]."""
        middle, half = np.asarray(distance, dtype=np.float64), 0.5 * self.foot
        rise = self.height(middle + half) - self.height(middle - half)
        return np.arctan2(rise, self.foot)

    @cached_property
    def _records(self) -> tuple[Array, Array]:
        return np.array(self.distances), np.array(self.heights)


def read_profile(path: str | Path, largest_gap: float = 0.1) -> RecordedProfile:
    """Profile from a CSV file with the columns distance and height [m].

    Args:
        path: the file; its first line is `distance,height`.
        largest_gap: largest difference of two distances [m]; assumed.

    Raises:
        ScenarioError: the file cannot be read, has other columns or fewer than two rows, or a row
            has something else than two finite numbers, a distance that does not increase, or one
            that is too far from that before; names the file and the row, by its line.
        ValueError: `largest_gap` is not positive.
    """
    if not largest_gap > 0.0:
        raise ValueError(f"largest_gap must be positive, not {largest_gap!r}")
    rows: list[tuple[float, float]] = []
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = [name.strip() for name in next(reader, [])]
            if header != _COLUMNS:
                columns_found = ",".join(header) or "nothing"
                raise ScenarioError(
                    f"{path}: row 1 must be {','.join(_COLUMNS)}, not {columns_found}"
                )
            for cells in reader:
                if cells:
                    before = rows[-1][0] if rows else None
                    where = f"{path}: row {reader.line_num}"
                    rows.append(_row(where, cells, before, largest_gap))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(f"{path}: the profile cannot be read: {error}") from error
    if len(rows) < 2:
        raise ScenarioError(
            f"{path}: a profile needs at least two rows of numbers, not {len(rows)}"
        )
    distances, heights = zip(*rows, strict=True)
    return RecordedProfile(distances, heights)


def _row(
    where: str, cells: list[str], before: float | None, largest_gap: float
) -> tuple[float, float]:
    """Distance and height of a row that may follow the distance `before`."""
    try:
        distance, height = map(float, cells)
    except ValueError:
        raise ScenarioError(f"{where} must be two numbers, not {','.join(cells)}") from None
    if not (math.isfinite(distance) and math.isfinite(height)):
        raise ScenarioError(f"{where} must be two finite numbers, not {','.join(cells)}")
    if before is not None and not distance > before:
        raise ScenarioError(
            f"{where}: the distance must increase, but {distance:g} m follows {before:g} m"
        )
    # Distances of equal steps are not exactly equal.
    if before is not None and distance - before > largest_gap * (1.0 + 1e-9):
        raise ScenarioError(
            f"{where}: the gap from {before:g} m to {distance:g} m is larger than "
            f"{largest_gap:g} m"
        )
    return distance, height


def _check(
    terrain: Level | Slope | Step | Stairs | AlternatingSlopes | Heave | Rough, *positive: str
) -> None:
    """Refuses numbers that are not finite, angles that are too steep, and sizes below zero."""
    for field in fields(terrain):
        value = getattr(terrain, field.name)
        if value is None:
            continue
        if not math.isfinite(value):
            raise ValueError(f"{field.name} must be finite, not {value!r}")
        if field.name == "angle" and not abs(value) < 0.5 * math.pi:
            raise ValueError(f"angle must be within +-pi/2, not {value!r}")
        if field.name in positive and not value > 0.0:
            raise ValueError(f"{field.name} must be positive, not {value!r}")


# Terrains by their names.
TERRAINS: dict[str, type[Terrain]] = {
    "level": Level,
    "slope": Slope,
    "step": Step,
    "stairs": Stairs,
    "alternating slopes": AlternatingSlopes,
    "heave": Heave,
    "rough": Rough,
    "recorded": RecordedProfile,
}
