"""Drivers of axes on CiA 402 drives: axes that turn behind gears, screws and slides that push.

A machine derives its own from them, with its own defaults.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.systems.hardware.cia402.settings import (
    AxesSettings,
    Control,
    ForceSlideSettings,
    GearSettings,
    PositionScrewSettings,
    PositionTurnSettings,
    ScrewSettings,
    TorqueSettings,
)

if TYPE_CHECKING:
    from parapod.systems.hardware.device import Device
    from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour


@dataclass
class _Axes(AxesSettings, Driver):
    """Axes on CiA 402 drives: see `Cia402Device`."""

    def make(self, ports: PartPorts) -> "Device":
        """See `Driver`."""
        from parapod.systems.hardware.cia402.forces import Cia402Forces
        from parapod.systems.hardware.cia402.positions import Cia402Positions
        from parapod.systems.hardware.cia402.velocities import Cia402Velocities

        kinds: dict[Control, type[Cia402Velocities | Cia402Positions | Cia402Forces]] = {
            Control.VELOCITY: Cia402Velocities,
            Control.POSITION: Cia402Positions,
            Control.FORCE: Cia402Forces,
        }
        with named(self):
            if self.has("position_file") and not self.position_file:
                raise ValueError("it needs a position_file")
            device = kinds[self.control](self)
            if "emergency_stop" in device.measures and "emergency_stop" not in ports.measures:
                raise ValueError(f"with stop_node there must be a port {self.part}.emergency_stop")
            return device

    def emulate(
        self, harness: "Harness", misbehaviour: "Misbehaviour"
    ) -> AbstractContextManager[object]:
        """See `Driver`: an SLCAN adapter, all controllers behind it, and a file of positions."""
        from parapod.systems.hardware.cia402.emulated_drive import EmulatedMotor
        from parapod.systems.hardware.cia402.emulator import Cia402Nodes
        from parapod.systems.hardware.cia402.makers import MAKERS
        from parapod.systems.hardware.position_memory import PositionMemory

        if self.interface == "ethercat":  # has no emulator
            return super().emulate(harness, misbehaviour)
        link = emulated(self.channel, f"!{type(self).__name__}.channel")
        motor = EmulatedMotor(
            gear=self.motor_per_unit,
            pulses=self.counts_per_turn // 4,
            maker=MAKERS[self.drive],
            force_per_current=self.force_per_current,
        )
        nodes = Cia402Nodes(
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
        path = self.positions_path
        if path and path != self.position_file:  # a file elsewhere is of another machine
            memory = PositionMemory(Path(path), len(self.node_ids))
            memory.save(harness.get(f"{self.part}.position"))
        return nodes


@dataclass
class Epos2Axes(GearSettings, _Axes):
    """Axes that turn behind gears, on EPOS2 24/5 controllers: see `Cia402Velocities`."""


@dataclass
class Epos2PositionAxes(PositionTurnSettings, _Axes):
    """Axes that turn behind gears and whose positions are commanded: see `Cia402Positions`."""


@dataclass
class Epos2TorqueAxes(TorqueSettings, _Axes):
    """Axes that turn behind gears and whose torques are commanded, by the motors' currents.

    See `Cia402Forces`: without a command, and after any stop, nothing holds them.
    """


@dataclass
class Epos2Screws(ScrewSettings, _Axes):
    """Screws on EPOS2 24/5 controllers, with a file that remembers where they stand.

    See `Cia402Velocities`, `PositionMemory` and `SoftLimits`.
    """


@dataclass
class Epos2PositionScrews(PositionScrewSettings, _Axes):
    """Screws whose positions are commanded, and locks and clamps at the same controllers.

    See `Cia402Positions` and `PositionMemory`; for a machine of limbs `switches_of_limbs`.
    """


@dataclass
class Epos2ForceSlides(ForceSlideSettings, _Axes):
    """Slides whose forces are commanded, by the motors' currents, on EPOS2 24/5 controllers.

    See `Cia402Forces`: without a command, and after any stop, nothing holds them.
    """
