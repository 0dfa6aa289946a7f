"""Drivers with the walking chair's own defaults."""

from dataclasses import dataclass
from typing import ClassVar

from parapod.diagrams.drivers.cia402 import Epos2Screws
from parapod.systems.core.schema import quantity
from parapod.systems.walking_chair.geometry import BRANCHES

_BRANCHES = len(BRANCHES)


@dataclass
class Epos2Legs(Epos2Screws):
    """The chair's twelve screws on EPOS2 24/5 controllers: see `Epos2Screws`.

    Motors, gears and screws are not printed anywhere, so theirs are assumptions.

    Attributes:
        node_ids: addresses of the controllers, in the order of the branches 11, 12, 13, ... 43.
        max_velocity_rpm: largest velocity of a motor [rpm]; 4800 are 80 mm/s.
        position_min_mm: lengths below which nothing retracts [mm]; null: the strokes' ends.
        position_max_mm: lengths above which nothing extends [mm]; null: the strokes' ends.
    """

    axis_names: ClassVar[tuple[str, ...]] = BRANCHES

    part: str = "legs"
    stop_node: int | None = quantity(1, 1, 127)
    node_ids: list[int] = quantity(list(range(1, _BRANCHES + 1)), 1, 127, length=_BRANCHES)
    max_velocity_rpm: float = quantity(4800.0, 1.0, 100_000.0)
    reduction: float = quantity(5.0, 0.01, 10000.0)
    signs: list[int] = quantity([1] * _BRANCHES, -1, 1, length=_BRANCHES)
    position_min_mm: list[float] | None = quantity(None, 0.0, 20_000.0, length=_BRANCHES)
    position_max_mm: list[float] | None = quantity(None, 0.0, 20_000.0, length=_BRANCHES)
    position_at_start_mm: list[float] | None = quantity(None, 0.0, 20_000.0, length=_BRANCHES)
