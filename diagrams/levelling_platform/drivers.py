"""Drivers with the levelling platform's own defaults."""

from dataclasses import dataclass
from typing import ClassVar

from parapod.diagrams.drivers.cia402 import Epos2Axes, Epos2PositionAxes
from parapod.systems.core.schema import quantity
from parapod.systems.levelling_platform.wheels import WHEEL_GEAR


@dataclass
class Epos2Wheels(Epos2Axes):
    """The platform's four wheel motors on EPOS2 24/5 controllers: see `Cia402Velocities`.

    Motors and encoders are not printed anywhere, so theirs are assumptions.

    Attributes:
        node_ids: addresses of the controllers, in the order of the wheels.
        gear: reduction between motor and wheel [-] (section 2.1 of the paper).
    """

    part: str = "wheels"
    node_ids: list[int] = quantity([1, 2, 3, 4], 1, 127)
    gear: float = quantity(WHEEL_GEAR, 0.1, 10000.0)


@dataclass
class Epos2Arm(Epos2PositionAxes):
    """The joints of the platform's arm on EPOS2 24/5 controllers: see `Cia402Positions`.

    Motors and gears are not printed anywhere, so theirs are assumptions. The joints turn; with the
    arm upright their angles are zero.

    Attributes:
        node_ids: addresses of the controllers, in the order of the joints from the platform on.
        channel: serial port of an adapter of their own for slcan, or see `AxesSettings`.
        gear: reduction between motor and joint [-].
    """

    has_brake: ClassVar[bool] = False  # the arm has no such signal

    part: str = "arm"
    node_ids: list[int] = quantity([1, 2], 1, 127)
    channel: str = "emulator/can_arm"
    gear: float = quantity(100.0, 0.1, 10000.0)
