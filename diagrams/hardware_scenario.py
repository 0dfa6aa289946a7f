"""The part of a scenario that says which devices the machine has."""

from dataclasses import dataclass, field

from parapod.diagrams.drivers.adis16448 import Adis16448IioImu, Adis16448SpiImu
from parapod.diagrams.drivers.bus import LcmPart, Ros2Part
from parapod.diagrams.drivers.cia402 import (
    Epos2Axes,
    Epos2ForceSlides,
    Epos2Screws,
    Epos2TorqueAxes,
)
from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.drivers.ni_daq import NiDaqEncoders, NiDaqForceCells, NiDaqLegs
from parapod.diagrams.drivers.not_fitted import NotFittedPart
from parapod.diagrams.drivers.sabertooth import SabertoothLegs
from parapod.systems.core.schema import Schema

# Drivers that every machine's scenario can name, beside its own and those of other packages.
DRIVERS = (
    NiDaqLegs,
    NiDaqEncoders,
    NiDaqForceCells,
    SabertoothLegs,
    Epos2Axes,
    Epos2Screws,
    Epos2ForceSlides,
    Epos2TorqueAxes,
    Adis16448SpiImu,
    Adis16448IioImu,
    LcmPart,
    Ros2Part,
    NotFittedPart,
)


@dataclass
class HardwareScenario(Schema):
    """Devices of the backend "hardware"; addresses that begin with emulator/ are emulated.

    Attributes:
        drivers: drivers of the machine's parts, chosen by their tags; see `Driver`.
    """

    drivers: list[Driver] = field(default_factory=list)
