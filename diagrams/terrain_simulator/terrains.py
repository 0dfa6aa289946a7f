"""Terrains as scenarios name them, by a tag such as `!Stairs {rise_mm: 170, tread_mm: 290}`."""

import math
from dataclasses import dataclass

from parapod.systems.core.schema import Variant, quantity
from parapod.systems.terrain_simulator import terrain
from parapod.systems.terrain_simulator.terrain import Terrain


@dataclass
class TerrainChoice(Variant):
    """Root of the terrains; a dataclass derived from it can be named in any scenario."""

    def make(self) -> Terrain:
        """The terrain.

        Raises:
            ScenarioError: a file that cannot be read.
        """
        raise NotImplementedError(f"{type(self).__name__} does not define make")


@dataclass
class Level(TerrainChoice):
    """Level ground."""

    def make(self) -> Terrain:
        """See `TerrainChoice`."""
        return terrain.Level()


@dataclass
class Slope(TerrainChoice):
    """Ground of one slope everywhere.

    Attributes:
        angle_deg: slope, positive uphill [deg].
    """

    angle_deg: float = quantity(20.0, -60.0, 60.0)

    def make(self) -> Terrain:
        """See `TerrainChoice`."""
        return terrain.Slope(math.radians(self.angle_deg))


@dataclass
class Step(TerrainChoice):
    """One vertical step on level ground.

    Attributes:
        rise_mm: height of the step, negative for one down [mm].
        at_m: distance of its edge [m].
    """

    rise_mm: float = quantity(120.0, -500.0, 500.0)
    at_m: float = quantity(0.5, -100.0, 1000.0)

    def make(self) -> Terrain:
        """See `TerrainChoice`."""
        return terrain.Step(1e-3 * self.rise_mm, self.at_m)


@dataclass
class Stairs(TerrainChoice):
    """Stairs on level ground, endless or with a landing.

    Attributes:
        rise_mm: height of each step, negative for stairs down [mm].
        tread_mm: depth of each step [mm].
        at_m: distance of the first edge [m].
        count: number of steps; null: endless.
    """

    rise_mm: float = quantity(170.0, -500.0, 500.0)
    tread_mm: float = quantity(290.0, 10.0, 2000.0)
    at_m: float = quantity(0.5, -100.0, 1000.0)
    count: int | None = quantity(None, 1, 10_000)

    def make(self) -> Terrain:
        """See `TerrainChoice`."""
        return terrain.Stairs(1e-3 * self.rise_mm, 1e-3 * self.tread_mm, self.at_m, self.count)


@dataclass
class AlternatingSlopes(TerrainChoice):
    """Slopes up and down by turns.

    Attributes:
        angle_deg: slope of the first one, positive uphill [deg].
        length_m: horizontal length of each [m].
    """

    angle_deg: float = quantity(10.0, -60.0, 60.0)
    length_m: float = quantity(1.0, 0.05, 100.0)

    def make(self) -> Terrain:
        """See `TerrainChoice`."""
        return terrain.AlternatingSlopes(math.radians(self.angle_deg), self.length_m)


@dataclass
class Heave(TerrainChoice):
    """Level ground that moves up and down with the time.

    Attributes:
        amplitude_mm: largest height above and below its mean [mm].
        frequency_Hz: cycles a second [Hz].
    """

    amplitude_mm: float = quantity(20.0, 0.0, 500.0)
    frequency_Hz: float = quantity(1.0, 0.01, 20.0)  # noqa: N815 (the unit's symbol)

    def make(self) -> Terrain:
        """See `TerrainChoice`."""
        return terrain.Heave(1e-3 * self.amplitude_mm, self.frequency_Hz)


@dataclass
class Rough(TerrainChoice):
    """Rough ground, drawn from a seed.

    Attributes:
        deviation_mm: standard deviation of its height [mm].
        correlation_length_m: way over which heights are alike [m].
        terrain_seed: seed of the ground.
    """

    deviation_mm: float = quantity(15.0, 0.0, 500.0)
    correlation_length_m: float = quantity(0.5, 0.02, 100.0)
    terrain_seed: int = quantity(0, 0, 2**31 - 1)

    def make(self) -> Terrain:
        """See `TerrainChoice`."""
        return terrain.Rough(
            1e-3 * self.deviation_mm, self.correlation_length_m, self.terrain_seed
        )


@dataclass
class Recorded(TerrainChoice):
    """Ground whose heights were recorded.

    Attributes:
        file: CSV file with the columns distance and height [m].
        largest_gap_m: largest distance of two records [m].
    """

    file: str = ""
    largest_gap_m: float = quantity(0.1, 1e-4, 10.0)

    def make(self) -> Terrain:
        """See `TerrainChoice`."""
        return terrain.read_profile(self.file, self.largest_gap_m)
