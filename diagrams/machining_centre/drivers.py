"""The driver of a machining centre's legs, with its own defaults."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from parapod.diagrams.drivers.cia402 import Epos2PositionScrews
from parapod.systems.core.schema import quantity
from parapod.systems.hardware.cia402.switches import switches_of_limbs
from parapod.systems.machining_centre.geometry import CentreGeometry

# Stop contact of the first limb, which every centre has.
_SWITCHES = switches_of_limbs(1)


@dataclass
class Epos2CentreLegs(Epos2PositionScrews):
    """A centre's legs, locks and clamps on EPOS2 24/5 controllers: see `Epos2PositionScrews`.

    Motors, gears and screws are not printed anywhere, so theirs are assumptions. Lists that are
    empty or null follow from the number of the limbs and from their strokes, as
    `switches_of_limbs` has them.

    Attributes:
        node_ids: addresses of the controllers: left and right leg of limb 1, of limb 2, ...
        signs: 1, or -1 where the motor's positive direction retracts the leg.
        max_velocity_rpm: largest velocity of a motor [rpm]; 1800 are 150 mm/s.
        following_error_mm: distance of a leg from its set value at which its drive gives up [mm].
        position_min_mm: lengths from foot to pivot below which nothing retracts [mm].
        position_max_mm: lengths above which nothing extends [mm].
    """

    former: ClassVar[tuple[str, ...]] = ("Epos2TripodLegs", "Epos2QuadrupedLegs")

    part: str = "legs"
    node_ids: list[int] = quantity([], 1, 127)
    max_velocity_rpm: float = quantity(1800.0, 1.0, 100_000.0)
    following_error_mm: float = quantity(5.0, 0.01, 100.0)
    signs: list[int] = quantity([], -1, 1)
    position_min_mm: list[float] | None = quantity(None, 0.0, 20_000.0)
    position_max_mm: list[float] | None = quantity(None, 0.0, 20_000.0)
    stop_node: int | None = quantity(_SWITCHES["stop_node"], 1, 127)
    stop_input: int = quantity(_SWITCHES["stop_input"], 1, 6)


def fittings_of(geometry: CentreGeometry) -> Mapping[str, Any]:
    """Settings of the legs' driver that follow from a centre."""
    legs = 2 * geometry.limbs
    lists = switches_of_limbs(geometry.limbs)
    return {name: numbers for name, numbers in lists.items() if isinstance(numbers, list)} | {
        "node_ids": list(range(1, legs + 1)),
        "signs": [1] * legs,
        "position_min_mm": [1e3 * geometry.stroke_min] * legs,
        "position_max_mm": [1e3 * geometry.stroke_max] * legs,
    }
