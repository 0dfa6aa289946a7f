"""The driver of wheels on EPOS2 controllers."""

import math
from contextlib import AbstractContextManager
from dataclasses import dataclass

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.diagrams.scenario import choice, quantity
from parapod.systems.hardware.device import Device
from parapod.systems.hardware.emulators.directory import resolved
from parapod.systems.hardware.emulators.epos2_node import EmulatedMotor
from parapod.systems.hardware.emulators.epos2_nodes import Epos2Nodes
from parapod.systems.hardware.emulators.harness import Harness
from parapod.systems.hardware.emulators.misbehaviour import Misbehaviour
from parapod.systems.hardware.epos2 import Epos2
from parapod.systems.hardware.epos2_setup import Epos2Params


@dataclass
class Epos2Wheels(Driver):
    """Wheel motors on EPOS2 24/5 controllers: see `Epos2`.

    Attributes:
        part: of the machine.
        interface: of python-can.
        channel: of the interface: a serial port for slcan, a network interface for socketcan.
        bitrate: of the bus [bit/s].
        node_ids: of the controllers, in the order of the wheels.
        gear: reduction between motor and wheel [-].
        counts_per_turn: encoder counts per turn of the motor, all four edges [-].
        max_velocity_rpm: largest velocity of a motor [rpm].
        heartbeat_timeout_ms: silence after which the controllers stop by themselves [ms].
        opening_pause_ms: what an SLCAN adapter needs after its port is opened [ms].
    """

    part: str = "wheels"
    interface: str = choice("slcan", ("slcan", "socketcan", "virtual"))
    channel: str = "emulator/can"
    bitrate: int = quantity(1_000_000, 10_000, 1_000_000)
    node_ids: list[int] = quantity([1, 2, 3, 4], 1, 127)
    gear: float = quantity(26.0, 0.1, 10000.0)
    counts_per_turn: int = quantity(2000, 4, 10_000_000)
    max_velocity_rpm: float = quantity(8000.0, 1.0, 100_000.0)
    heartbeat_timeout_ms: float = quantity(100.0, 40.0, 1000.0)
    opening_pause_ms: float = quantity(0.0, 0.0, 5000.0)

    def make(self, ports: PartPorts) -> Device:
        """See `Driver`."""
        return Epos2(self._params())

    def emulate(
        self, harness: Harness, misbehaviour: Misbehaviour
    ) -> AbstractContextManager[object]:
        """See `Driver`: an SLCAN adapter with all the controllers behind it."""
        link = emulated(self.channel, f"!{type(self).__name__}.channel")
        motor = EmulatedMotor(gear=self.gear, pulses=self.counts_per_turn // 4)
        return Epos2Nodes(
            harness, tuple(self.node_ids), link=link, misbehaviour=misbehaviour, motor=motor
        )

    def _params(self) -> Epos2Params:
        with named(self):
            return Epos2Params(
                interface=self.interface,
                channel=resolved(self.channel),
                bitrate=self.bitrate,
                node_ids=tuple(self.node_ids),
                gear=self.gear,
                counts_per_turn=self.counts_per_turn,
                max_velocity=math.radians(6.0 * self.max_velocity_rpm) / self.gear,
                heartbeat_timeout=1e-3 * self.heartbeat_timeout_ms,
                opening_pause=1e-3 * self.opening_pause_ms,
            )
