"""Drivers of axes on EPOS2 controllers: axes that turn behind a gear, screws that push.

A machine that names them `Epos2Wheels`, say, derives from them with its own defaults.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.epos2.settings import Epos2Settings, GearSettings, ScrewSettings

if TYPE_CHECKING:
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


@dataclass
class Epos2Axes(GearSettings, Driver):
    """Axes that turn behind gears, on EPOS2 24/5 controllers: see `Epos2`."""

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        return _made(self, self)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: an SLCAN adapter with all the controllers behind it."""
        return _emulated(self, self, harness, misbehaviour)


@dataclass
class Epos2Screws(ScrewSettings, Driver):
    """Screws on EPOS2 24/5 controllers, with a file that remembers where they stand.

    See `Epos2`, `PositionMemory` and `SoftLimits`.
    """

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        with named(self):
            if not self.position_file:
                raise ValueError("it needs a position_file")
        return _made(self, self)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: as for other axes, and a file that knows the lengths."""
        from parapod.systems.hardware.position_memory import PositionMemory

        kept = resolved(self.position_file)
        if kept != self.position_file:  # a file elsewhere is of another machine
            memory = PositionMemory(Path(kept), len(self.node_ids))
            memory.save(harness.get(f"{self.part}.position"))
        return _emulated(self, self, harness, misbehaviour)


def _made(driver: Driver, settings: Epos2Settings) -> "Device":
    from parapod.systems.hardware.epos2.drives import Epos2

    with named(driver):
        return Epos2(settings)


def _emulated(
    driver: Driver, settings: Epos2Settings, harness: "Harness", misbehaviour: "Misbehaviour"
) -> AbstractContextManager[object]:
    from parapod.systems.hardware.epos2.emulator import EmulatedMotor, Epos2Nodes

    link = emulated(settings.channel, f"!{type(driver).__name__}.channel")
    _made(driver, settings)
    pulses = settings.counts_per_turn // 4
    return Epos2Nodes(
        harness,
        settings.node_ids,
        link=link,
        misbehaviour=misbehaviour,
        motor=EmulatedMotor(gear=settings.motor_per_unit, pulses=pulses),
        part=settings.part,
        signs=settings.directions,
        measures_current=settings.measures_current,
    )
