"""The part of a scenario that says which devices the machine has."""

from dataclasses import dataclass, field

from parapod.diagrams.drivers.adis16448 import Adis16448IioImu, Adis16448SpiImu
from parapod.diagrams.drivers.bus import LcmBus, LcmPart, Ros2Part, bus_named
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
from parapod.systems.hardware.buses.address import LCM, Address, address_of

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
        lcm_buses: buses of LCM, which drivers and controllers may name.
    """

    drivers: list[Driver] = field(default_factory=list)
    lcm_buses: list[LcmBus] = field(default_factory=list)

    @property
    def connected(self) -> list[Driver]:
        """The drivers, each with the bus that it names.

        Raises:
            ScenarioError: there is none of that name.
        """
        return [
            one.on_bus(bus_named(self.lcm_buses, one.lcm_bus, f"hardware.drivers.{i}.lcm_bus"))
            if isinstance(one, LcmPart) and one.lcm_bus
            else one
            for i, one in enumerate(self.drivers)
        ]

    def address(self, text: str, key: str) -> Address:
        """Address of a bus, as `address_of` has it, or the name of one of `lcm_buses`.

        Args:
            text: the address, such as "lcm://left" for a bus that is named left.
            key: key of the scenario, or option, that has the text.

        Raises:
            ScenarioError: another kind, a place that the kind does not have, or a name of none.
        """
        address = address_of(text, key)
        name = text.partition("://")[2].partition("#")[0]
        is_name = address.kind == LCM and name.isidentifier()
        return bus_named(self.lcm_buses, name, key).address if is_name else address
