"""Drivers of axes on EPOS2 controllers: axes that turn behind gears, screws and slides that push.

A machine derives its own from them, with its own defaults.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.epos2.settings import (
    Control,
    Epos2Settings,
    ForceSettings,
    ForceSlideSettings,
    GearSettings,
    PositionScrewSettings,
    PositionTurnSettings,
    ScrewSettings,
    StrokeSettings,
    TorqueSettings,
)

if TYPE_CHECKING:
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
    from parapod.systems.hardware.epos2.device import Epos2Device


@dataclass
class _Epos2(Epos2Settings, Driver):
    """Axes on EPOS2 24/5 controllers: see `Epos2Device`."""

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        with named(self):
            device = self._device()
            if "emergency_stop" in device.measures and "emergency_stop" not in ports.measures:
                raise ValueError(f"with stop_node there must be a port {self.part}.emergency_stop")
            return device

    def _device(self) -> "Epos2Device":
        """The device of what is commanded."""
        from parapod.systems.hardware.epos2.drives import Epos2
        from parapod.systems.hardware.epos2.forces import Epos2Forces
        from parapod.systems.hardware.epos2.positions import Epos2Positions

        if isinstance(self, ForceSettings):
            return Epos2Forces(self)
        return Epos2Positions(self) if self.control is Control.POSITION else Epos2(self)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: an SLCAN adapter with all the controllers behind it."""
        from parapod.systems.hardware.epos2.emulator import EmulatedMotor, Epos2Nodes

        link = emulated(self.channel, f"!{type(self).__name__}.channel")
        motor = EmulatedMotor(gear=self.motor_per_unit, pulses=self.counts_per_turn // 4)
        if isinstance(self, ForceSettings):
            motor = motor._replace(force_per_current=self.force_per_current)
        return Epos2Nodes(
            harness,
            self.node_ids,
            channel=link,  # drivers in one process have buses of their own, too
            link=link,
            misbehaviour=misbehaviour,
            motor=motor,
            part=self.part,
            signs=self.directions,
            measures_current=self.measures_current and f"{self.part}.current" in harness,
            stop_contact=None if self.stop_node is None else (self.stop_node, self.stop_input),
            switches=self.switches,
        )


@dataclass
class Epos2Axes(GearSettings, _Epos2):
    """Axes that turn behind gears, on EPOS2 24/5 controllers: see `Epos2`."""


@dataclass
class Epos2PositionAxes(PositionTurnSettings, _Epos2):
    """Axes that turn behind gears and whose positions are commanded: see `Epos2Positions`."""


@dataclass
class Epos2TorqueAxes(TorqueSettings, _Epos2):
    """Axes that turn behind gears and whose torques are commanded, by the motors' currents.

    See `Epos2Forces`: without a command, and after any stop, nothing holds them.
    """


@dataclass
class _Epos2Screws(StrokeSettings, _Epos2):
    """Screws on EPOS2 24/5 controllers, with a file that remembers where they stand."""

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        with named(self):
            if not self.position_file:
                raise ValueError("it needs a position_file")
        return super().make(ports)

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: as for other axes, and a file that knows the lengths."""
        from parapod.systems.hardware.position_memory import PositionMemory

        emulator = super().emulate(harness, misbehaviour)
        position_file_path = resolved(self.position_file)
        if position_file_path != self.position_file:  # a file elsewhere is of another machine
            memory = PositionMemory(Path(position_file_path), len(self.node_ids))
            memory.save(harness.get(f"{self.part}.position"))
        return emulator


@dataclass
class Epos2Screws(ScrewSettings, _Epos2Screws):
    """Screws on EPOS2 24/5 controllers, with a file that remembers where they stand.

    See `Epos2`, `PositionMemory` and `SoftLimits`.
    """


@dataclass
class Epos2PositionScrews(PositionScrewSettings, _Epos2Screws):
    """Screws whose positions are commanded, and locks and clamps at the same controllers.

    See `Epos2Positions` and `PositionMemory`; for a machine of limbs `switches_of_limbs`.
    """


@dataclass
class Epos2ForceSlides(ForceSlideSettings, _Epos2Screws):
    """Slides whose forces are commanded, by the motors' currents, on EPOS2 24/5 controllers.

    See `Epos2Forces`: without a command, and after any stop, nothing holds them.
    """
