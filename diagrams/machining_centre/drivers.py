"""Drivers with the machining centres' own defaults: a tripod's six legs, a quadruped's eight."""

from dataclasses import dataclass

from parapod.diagrams.drivers.epos2 import Epos2PositionScrews
from parapod.systems.core.schema import quantity
from parapod.systems.hardware.epos2.switches import switches_of_limbs
from parapod.systems.machining_centre.geometry import CentreGeometry
from parapod.systems.machining_centre.posture import LOCKS_OF_LIMB

_TRIPOD, _QUADRUPED = 3, 4
_THREE, _FOUR = switches_of_limbs(_TRIPOD), switches_of_limbs(_QUADRUPED)
_SHORTEST, _LONGEST = 1e3 * CentreGeometry().stroke_min, 1e3 * CentreGeometry().stroke_max


def _of_legs(limbs: int, value: float) -> list[float]:
    return [value] * (2 * limbs)


@dataclass
class Epos2TripodLegs(Epos2PositionScrews):
    """A tripod's six legs, locks and clamps on EPOS2 24/5 controllers: see `Epos2PositionScrews`.

    Motors, gears and screws are not printed anywhere, so theirs are assumptions.

    Attributes:
        node_ids: addresses of the controllers: left and right leg of limb 1, of limb 2, ...
        max_velocity_rpm: largest velocity of a motor [rpm]; 1800 are 150 mm/s.
        following_error_mm: distance of a leg from its set value at which its drive gives up [mm].
        position_min_mm: lengths from foot to pivot below which nothing retracts [mm].
        position_max_mm: lengths above which nothing extends [mm].
        stop_node: address of the controller at whose digital input is a contact of the emergency
            stop, which is closed while that is not pressed; null: none is measured.
    """

    part: str = "legs"
    node_ids: list[int] = quantity([*range(1, 2 * _TRIPOD + 1)], 1, 127, length=2 * _TRIPOD)
    max_velocity_rpm: float = quantity(1800.0, 1.0, 100_000.0)
    following_error_mm: float = quantity(5.0, 0.01, 100.0)
    signs: list[int] = quantity([1] * 2 * _TRIPOD, -1, 1, length=2 * _TRIPOD)
    position_min_mm: list[float] = quantity(
        _of_legs(_TRIPOD, _SHORTEST), 0.0, 5000.0, length=2 * _TRIPOD
    )
    position_max_mm: list[float] = quantity(
        _of_legs(_TRIPOD, _LONGEST), 0.0, 5000.0, length=2 * _TRIPOD
    )
    position_at_start_mm: list[float] | None = quantity(None, 0.0, 5000.0, length=2 * _TRIPOD)
    lock_nodes: list[int] = quantity(_THREE.lock_nodes, 1, 127, length=LOCKS_OF_LIMB * _TRIPOD)
    lock_outputs: list[int] = quantity(_THREE.lock_outputs, 1, 4, length=LOCKS_OF_LIMB * _TRIPOD)
    lock_inputs: list[int] = quantity(_THREE.lock_inputs, 1, 6, length=LOCKS_OF_LIMB * _TRIPOD)
    clamp_nodes: list[int] = quantity(_THREE.clamp_nodes, 1, 127, length=_TRIPOD)
    clamp_outputs: list[int] = quantity(_THREE.clamp_outputs, 1, 4, length=_TRIPOD)
    clamp_inputs: list[int] = quantity(_THREE.clamp_inputs, 1, 6, length=_TRIPOD)
    stop_node: int | None = quantity(_THREE.stop_node, 1, 127)
    stop_input: int = quantity(_THREE.stop_input, 1, 6)


@dataclass
class Epos2QuadrupedLegs(Epos2TripodLegs):
    """A quadruped's eight legs, with its locks and clamps: see `Epos2TripodLegs`."""

    node_ids: list[int] = quantity([*range(1, 2 * _QUADRUPED + 1)], 1, 127, length=2 * _QUADRUPED)
    signs: list[int] = quantity([1] * 2 * _QUADRUPED, -1, 1, length=2 * _QUADRUPED)
    position_min_mm: list[float] = quantity(
        _of_legs(_QUADRUPED, _SHORTEST), 0.0, 5000.0, length=2 * _QUADRUPED
    )
    position_max_mm: list[float] = quantity(
        _of_legs(_QUADRUPED, _LONGEST), 0.0, 5000.0, length=2 * _QUADRUPED
    )
    position_at_start_mm: list[float] | None = quantity(None, 0.0, 5000.0, length=2 * _QUADRUPED)
    lock_nodes: list[int] = quantity(_FOUR.lock_nodes, 1, 127, length=LOCKS_OF_LIMB * _QUADRUPED)
    lock_outputs: list[int] = quantity(_FOUR.lock_outputs, 1, 4, length=LOCKS_OF_LIMB * _QUADRUPED)
    lock_inputs: list[int] = quantity(_FOUR.lock_inputs, 1, 6, length=LOCKS_OF_LIMB * _QUADRUPED)
    clamp_nodes: list[int] = quantity(_FOUR.clamp_nodes, 1, 127, length=_QUADRUPED)
    clamp_outputs: list[int] = quantity(_FOUR.clamp_outputs, 1, 4, length=_QUADRUPED)
    clamp_inputs: list[int] = quantity(_FOUR.clamp_inputs, 1, 6, length=_QUADRUPED)
