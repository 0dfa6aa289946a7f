"""Drivers of axes on EPOS2 controllers: wheels that turn, legs that are pushed by screws."""

import math
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from parapod.diagrams.drivers.driver import Driver, PartPorts, emulated, named
from parapod.diagrams.scenario import choice, quantity
from parapod.systems.hardware.addresses import resolved
from parapod.systems.hardware.device import Device
from parapod.systems.hardware.emulation.harness import Harness, Misbehaviour
from parapod.systems.hardware.epos2.drives import Epos2
from parapod.systems.hardware.epos2.emulator import EmulatedMotor, Epos2Nodes
from parapod.systems.hardware.epos2.settings import Epos2Params
from parapod.systems.hardware.position_memory import PositionMemory, Referenced
from parapod.systems.hardware.soft_limits import SoftLimits

_LEGS = 12
# Lengths of the walking chair's branches, retracted and extended: of a UP branch and of the two
# UPS branches of a leg, four times [mm].
_RETRACTED, _EXTENDED = [591.4, 574.0, 574.0] * 4, [891.4, 874.0, 874.0] * 4


@dataclass
class _Epos2Axes(Driver):
    """What all axes on EPOS2 24/5 controllers have: see `Epos2`.

    Attributes:
        part: of the machine.
        interface: of python-can.
        channel: of the interface: a serial port for slcan, a network interface for socketcan.
        bitrate: of the bus [bit/s].
        node_ids: of the controllers, in the order of the axes.
        counts_per_turn: encoder counts per turn of the motor, all four edges [-].
        max_velocity_rpm: largest velocity of a motor [rpm].
        heartbeat_timeout_ms: silence after which the controllers stop by themselves [ms].
        opening_pause_ms: what an SLCAN adapter needs after its port is opened [ms].
    """

    interface: str = choice("slcan", ("slcan", "socketcan", "virtual"))
    channel: str = "emulator/can"
    bitrate: int = quantity(1_000_000, 10_000, 1_000_000)
    node_ids: list[int] = quantity([1, 2, 3, 4], 1, 127)
    counts_per_turn: int = quantity(2000, 4, 10_000_000)
    max_velocity_rpm: float = quantity(8000.0, 1.0, 100_000.0)
    heartbeat_timeout_ms: float = quantity(100.0, 40.0, 1000.0)
    opening_pause_ms: float = quantity(0.0, 0.0, 5000.0)

    @property
    def motor_per_unit(self) -> float:
        """By how much a motor turns for one unit of its axis [rad per rad or m]."""
        raise NotImplementedError(f"{type(self).__name__} does not define motor_per_unit")

    def make(self, ports: PartPorts) -> Device:
        """See `Driver`."""
        return Epos2(self._params())

    def emulate(
        self, harness: Harness, misbehaviour: Misbehaviour
    ) -> AbstractContextManager[object]:
        """See `Driver`: an SLCAN adapter with all the controllers behind it."""
        link = emulated(self.channel, f"!{type(self).__name__}.channel")
        params = self._params()
        motor = EmulatedMotor(gear=params.gear, pulses=self.counts_per_turn // 4)
        return Epos2Nodes(
            harness,
            params.node_ids,
            link=link,
            misbehaviour=misbehaviour,
            motor=motor,
            part=self.part,
            signs=params.signs,
            measures_current=params.measures_current,
        )

    def _params(self) -> Epos2Params:
        with named(self):
            return Epos2Params(
                interface=self.interface,
                channel=resolved(self.channel),
                bitrate=self.bitrate,
                node_ids=tuple(self.node_ids),
                gear=self.motor_per_unit,
                counts_per_turn=self.counts_per_turn,
                max_velocity=math.radians(6.0 * self.max_velocity_rpm) / self.motor_per_unit,
                heartbeat_timeout=1e-3 * self.heartbeat_timeout_ms,
                opening_pause=1e-3 * self.opening_pause_ms,
                **self._more_params(),
            )

    def _more_params(self) -> dict[str, Any]:
        """Parameters of the kind of axis."""
        return {}


@dataclass
class Epos2Wheels(_Epos2Axes):
    """Wheel motors on EPOS2 24/5 controllers: see `Epos2`.

    Attributes, beside those of all axes:
        gear: reduction between motor and wheel [-].
    """

    part: str = "wheels"
    gear: float = quantity(26.0, 0.1, 10000.0)

    @property
    def motor_per_unit(self) -> float:
        """Turns of the motor by turns of the wheel."""
        return self.gear


@dataclass
class Epos2Legs(_Epos2Axes):
    """Screws on EPOS2 24/5 controllers, with a file that remembers where they stand.

    See `Epos2`, `Referenced` and `SoftLimits`. The defaults are those of the walking chair; its
    motors, gears and screws are not printed anywhere, so theirs are assumptions.

    Attributes, beside those of all axes:
        node_ids: of the controllers, in the order of the branches 11, 12, 13, 21, ... 43.
        max_velocity_rpm: largest velocity of a motor [rpm]; 4800 are 80 mm/s.
        lead_mm: way of a screw's nut per turn of the screw [mm].
        reduction: turns of the motor per turn of the screw [-].
        signs: 1, or -1 where the motor's positive direction retracts.
        acceleration_mm_s2: with which the drives follow a command, up and down [mm/s^2].
        quick_stop_mm_s2: with which they stop for want of heartbeats, and to brake [mm/s^2].
        position_min_mm: lengths below which nothing retracts [mm].
        position_max_mm: lengths above which nothing extends [mm].
        limit_lead_ms: how early an axis slows down before these: the time for which it could go
            on and still stop in time [ms].
        position_at_start_mm: what the lengths are when the program starts, as somebody has
            measured them [mm]; None: nobody has, and the file must know them.
        position_file: where the lengths are kept from one program to the next, in the folder in
            which the program is started if it has no other; while there is none, a program
            begins with `position_at_start_mm`.
    """

    part: str = "legs"
    node_ids: list[int] = quantity(list(range(1, _LEGS + 1)), 1, 127, length=_LEGS)
    max_velocity_rpm: float = quantity(4800.0, 1.0, 100_000.0)
    lead_mm: float = quantity(5.0, 0.01, 100.0)
    reduction: float = quantity(5.0, 0.01, 10000.0)
    signs: list[int] = quantity([1] * _LEGS, -1, 1, length=_LEGS)
    acceleration_mm_s2: float = quantity(2000.0, 1.0, 1e6)
    quick_stop_mm_s2: float = quantity(4000.0, 1.0, 1e6)
    position_min_mm: list[float] = quantity(_RETRACTED, 0.0, 5000.0, length=_LEGS)
    position_max_mm: list[float] = quantity(_EXTENDED, 0.0, 5000.0, length=_LEGS)
    limit_lead_ms: float = quantity(150.0, 10.0, 1000.0)
    # No default: a guess would be believed, and the limits would be where they are not.
    position_at_start_mm: list[float] | None = quantity(None, 0.0, 5000.0, length=_LEGS)
    position_file: str = "emulator/positions.json"

    @property
    def motor_per_unit(self) -> float:
        """Angle of the motor by the way of the nut [rad/m]."""
        return 2.0 * math.pi * self.reduction / (1e-3 * self.lead_mm)

    def make(self, ports: PartPorts) -> Device:
        """See `Driver`."""
        with named(self):
            if not self.position_file:
                raise ValueError("it needs a position_file")
        device = Epos2(self._params())
        return Referenced(device, Path(resolved(self.position_file)), self.part)

    def emulate(
        self, harness: Harness, misbehaviour: Misbehaviour
    ) -> AbstractContextManager[object]:
        """See `Driver`: as for wheels, and a file that knows the lengths."""
        kept = resolved(self.position_file)
        if kept != self.position_file:  # a file elsewhere is of another machine
            memory = PositionMemory(Path(kept), len(self.node_ids))
            memory.save(harness.get(f"{self.part}.position"))
        return super().emulate(harness, misbehaviour)

    def _more_params(self) -> dict[str, Any]:
        start, acceleration = self.position_at_start_mm, 1e-3 * self.acceleration_mm_s2
        return {
            "signs": tuple(self.signs),
            "acceleration": acceleration,
            "deceleration": acceleration,
            "quick_stop_deceleration": 1e-3 * self.quick_stop_mm_s2,
            "measures_current": True,
            "position_at_start": None if start is None else tuple(1e-3 * mm for mm in start),
            "limits": SoftLimits(
                lower=tuple(1e-3 * mm for mm in self.position_min_mm),
                upper=tuple(1e-3 * mm for mm in self.position_max_mm),
                lead=1e-3 * self.limit_lead_ms,
                deceleration=acceleration,
            ),
        }
