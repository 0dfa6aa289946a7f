"""Drivers with the terrain simulator's own defaults: sliders, the hip's slide, the belt."""

from dataclasses import dataclass

from parapod.diagrams.drivers.cia402 import Epos2Axes, Epos2ForceSlides, Epos2PositionScrews
from parapod.systems.core.schema import quantity

_SLIDERS = 3


@dataclass
class Epos2Sliders(Epos2PositionScrews):
    """The bench's three sliders on EPOS2 24/5 controllers: see `Epos2PositionScrews`.

    Motors and belts that lead the sliders are not printed anywhere, so theirs are assumptions.

    Attributes:
        node_ids: addresses of the controllers of the sliders 1, 2 and 3.
        max_velocity_rpm: largest velocity of a motor [rpm]; 2100 are 3.5 m/s.
        lead_mm: way of a slider per turn of its pulley [mm].
        following_error_mm: distance of a slider from its set value at which its drive gives up
            [mm].
        position_min_mm: places along the rail behind which nothing goes [mm]; null: its ends.
        position_max_mm: places ahead of which nothing goes [mm]; null: its ends.
    """

    part: str = "sliders"
    node_ids: list[int] = quantity([1, 2, 3], 1, 127, length=_SLIDERS)
    counts_per_turn: int = quantity(20_000, 4, 10_000_000)
    max_velocity_rpm: float = quantity(2100.0, 1.0, 100_000.0)
    lead_mm: float = quantity(100.0, 0.01, 100.0)
    following_error_mm: float = quantity(50.0, 0.01, 1000.0)
    quick_stop_mm_s2: float = quantity(40_000.0, 1.0, 1e6)
    signs: list[int] = quantity([1] * _SLIDERS, -1, 1, length=_SLIDERS)
    position_min_mm: list[float] | None = quantity(None, 0.0, 20_000.0, length=_SLIDERS)
    position_max_mm: list[float] | None = quantity(None, 0.0, 20_000.0, length=_SLIDERS)
    position_at_start_mm: list[float] | None = quantity(None, 0.0, 20_000.0, length=_SLIDERS)
    position_file: str = "emulator/sliders.json"
    stop_node: int | None = quantity(1, 1, 127)


@dataclass
class Epos2HipSlide(Epos2ForceSlides):
    """The drive of the hip's slide, whose force is commanded: see `Epos2ForceSlides`.

    The slide is vertical: a holding brake that closes without power is expected on it.

    Attributes:
        channel: a bus of its own.
        lead_mm: way of the slide per turn of its pulley [mm].
        max_force_N: largest force that is commanded [N].
        force_per_current_N_A: force by the motor's current [N/A].
        position_min_mm: height of the hip below which only forces upwards are allowed [mm]; null:
            the slide's end.
        position_max_mm: height above which only forces downwards are [mm]; null: the slide's end.
    """

    part: str = "hip"
    channel: str = "emulator/hip_can"
    node_ids: list[int] = quantity([1], 1, 127, length=1)
    max_velocity_rpm: float = quantity(2400.0, 1.0, 100_000.0)
    lead_mm: float = quantity(100.0, 0.01, 100.0)
    max_force_N: float = quantity(2000.0, 0.1, 1e5)  # noqa: N815 (the unit's symbol)
    force_per_current_N_A: float = quantity(400.0, 0.01, 1e5)  # noqa: N815
    signs: list[int] = quantity([1], -1, 1, length=1)
    position_min_mm: list[float] | None = quantity(None, 0.0, 20_000.0, length=1)
    position_max_mm: list[float] | None = quantity(None, 0.0, 20_000.0, length=1)
    position_at_start_mm: list[float] | None = quantity(None, 0.0, 20_000.0, length=1)
    position_file: str = "emulator/hip.json"


@dataclass
class Epos2Belt(Epos2Axes):
    """The belt of a treadmill, whose velocity is commanded: see `Epos2Axes`.

    Attributes:
        channel: a bus of its own.
        max_velocity_rpm: largest velocity of the motor [rpm]; 1150 are 3 m/s.
        drum_mm: radius of the drum with its belt [mm].
    """

    part: str = "belt"
    channel: str = "emulator/belt_can"
    max_velocity_rpm: float = quantity(1150.0, 1.0, 100_000.0)
    drum_mm: float = quantity(25.0, 1.0, 1000.0)

    @property
    def motor_per_unit(self) -> float:
        """Turn of the motor by the way of the belt [rad/m]."""
        return self.gear / (1e-3 * self.drum_mm)

    @property
    def acceleration(self) -> float:
        """Acceleration of the belt [m/s^2] (assumption)."""
        return 30.0
