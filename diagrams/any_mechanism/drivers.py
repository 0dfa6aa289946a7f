"""Drivers of a mechanism's motors on EPOS2 controllers, whatever their number."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from parapod.diagrams.any_mechanism.design import Motors
from parapod.diagrams.drivers.cia402 import Epos2PositionAxes, Epos2PositionScrews
from parapod.systems.core.schema import quantity


@dataclass
class Epos2MotorScrews(Epos2PositionScrews):
    """A mechanism's motors that push, on EPOS2 24/5 controllers: see `Epos2PositionScrews`.

    Lists that are empty or null follow from the model: its motors, and their ends.

    Attributes:
        node_ids: addresses of the controllers, in the order of the motors.
        signs: 1, or -1 where the motor's positive direction is the joint's negative one.
        following_error_mm: distance of a motor from its set value at which its drive gives up
            [mm].
        position_min_mm: smallest positions of the joints [mm]; null: those of the model.
        position_max_mm: largest positions [mm]; null: those of the model.
        position_at_start_mm: measured positions at the start of the program [mm]; null: not
            measured, so the file must know them.
    """

    part: str = "motors"
    node_ids: list[int] = quantity([], 1, 127)
    max_velocity_rpm: float = quantity(6000.0, 1.0, 100_000.0)
    following_error_mm: float = quantity(10.0, 0.01, 1000.0)
    signs: list[int] = quantity([], -1, 1)
    position_min_mm: list[float] | None = quantity(None, -20_000.0, 20_000.0)
    position_max_mm: list[float] | None = quantity(None, -20_000.0, 20_000.0)
    position_at_start_mm: list[float] | None = quantity(None, -20_000.0, 20_000.0)
    position_file: str = "emulator/motors.json"
    stop_node: int | None = quantity(1, 1, 127)


@dataclass
class Epos2MotorAxes(Epos2PositionAxes):
    """A mechanism's motors that turn, on EPOS2 24/5 controllers: see `Epos2PositionAxes`.

    Attributes:
        node_ids: addresses of the controllers, in the order of the motors; empty: 1, 2, ...
    """

    part: str = "motors"
    node_ids: list[int] = quantity([], 1, 127)

    @property
    def measures_current(self) -> bool:
        """See `AxesSettings`."""
        return True


def fittings_of(motors: Motors) -> Mapping[str, Any]:
    """Settings of the motors' driver that follow from a mechanism."""
    count = len(motors.names)
    fittings: dict[str, Any] = {"node_ids": list(range(1, count + 1)), "signs": [1] * count}
    if set(motors.units) == {"m"}:
        fittings |= {
            "position_min_mm": [1e3 * end for end in motors.lower],
            "position_max_mm": [1e3 * end for end in motors.upper],
        }
    return fittings
