"""The part of a scenario that says which devices the machine has."""

from dataclasses import dataclass, field

from parapod.diagrams.drivers.adis16448 import Adis16448IioImu, Adis16448SpiImu
from parapod.diagrams.drivers.driver import Driver
from parapod.diagrams.drivers.epos2 import Epos2Axes, Epos2Screws
from parapod.diagrams.drivers.ni_daq import NiDaqEncoders, NiDaqLegs
from parapod.diagrams.drivers.not_fitted import NotFittedPart
from parapod.diagrams.drivers.sabertooth import SabertoothLegs

# Drivers that every machine's scenario can name, beside its own and those of other packages.
DRIVERS = (
    NiDaqLegs,
    NiDaqEncoders,
    SabertoothLegs,
    Epos2Axes,
    Epos2Screws,
    Adis16448SpiImu,
    Adis16448IioImu,
    NotFittedPart,
)


@dataclass
class HardwareScenario:
    """Devices of the backend "hardware"; each machine has defaults of its own.

    Attributes:
        drivers: of each part of the machine, chosen by their tags; see `Driver`.
    """

    drivers: list[Driver] = field(default_factory=list)
