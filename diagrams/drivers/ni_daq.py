"""Drivers of a multifunction card of National Instruments."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.ni.settings import NiDaqSettings, NiForceCellSettings

if TYPE_CHECKING:
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


@dataclass
class NiDaqLegs(NiDaqSettings, Driver):
    """Analog motor drivers, encoders, switches and emergency stop on an NI PXIe-6363: `NiDaq`."""

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        return self._card(drives_motors=True)

    def _card(self, drives_motors: bool) -> "Device":
        from parapod.systems.hardware.ni.card import NiDaq

        with named(self):
            if not self.extension_file and self.extension_at_start_mm is None:
                raise ValueError("without extension_file it needs extension_at_start_mm")
            return NiDaq(self, drives_motors)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: an NI gRPC Device Server, and a file that knows the extensions."""
        from parapod.systems.hardware.ni.emulator import NiServer
        from parapod.systems.hardware.ni.terminals import LegWiring
        from parapod.systems.hardware.position_memory import PositionMemory

        path = _socket(self)
        position_store = resolved(self.extension_file)
        if position_store != self.extension_file:  # a file elsewhere is of another machine
            memory = PositionMemory(Path(position_store), len(self.counter_names), "extension")
            memory.save(harness.get(f"{self.part}.extension"))
        with named(self):
            device = self.device
        wiring = LegWiring(
            harness,
            misbehaviour,
            supply_voltage=self.supply_voltage,
            metres_per_count=self.metres_per_count,
            relay_line=_terminal(self.relay),
            part=self.part,
            stop_line=_terminal(self.stop_input),
        )
        return NiServer(path, wiring, device, self.product)


@dataclass
class NiDaqEncoders(NiDaqLegs):
    """The same card for encoders, limit switches and relay only; other drivers drive the motors.

    Its analog outputs are kept neutral, and nothing should be connected to them.
    """

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        return self._card(drives_motors=False)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: as for `NiDaqLegs`, without wires to the motors."""
        from parapod.systems.hardware.emulation.harness import MutedHarness

        return super().emulate(MutedHarness(harness, [f"{self.part}.voltage"]), misbehaviour)


@dataclass
class NiDaqForceCells(NiForceCellSettings, Driver):
    """Force cells whose amplifiers are at analog inputs of an NI PXIe-6363: `NiForceCells`."""

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        from parapod.systems.hardware.ni.cells import NiForceCells

        with named(self):
            return NiForceCells(self)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: an NI gRPC Device Server with a card of its own."""
        from parapod.systems.hardware.ni.emulator import NiServer
        from parapod.systems.hardware.ni.terminals import CellWiring

        path = _socket(self)
        with named(self):
            device, cells = self.device, self.cells
        wiring = CellWiring(
            harness,
            misbehaviour,
            {_terminal(cell.channel): cell.newton_per_volt for cell in cells},
            {_terminal(cell.channel): cell.zero for cell in cells},
            self.part,
        )
        return NiServer(path, wiring, device, self.product)


def _socket(driver: NiDaqLegs | NiDaqForceCells) -> str:
    """Path of the socket of a card's emulated server."""
    address = emulated(driver.target, f"!{type(driver).__name__}.target")
    return address.removeprefix("unix:")


def _terminal(channel: str) -> str:
    """Name of a channel on its card."""
    return channel.partition("/")[2]
