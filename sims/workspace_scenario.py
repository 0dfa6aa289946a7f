"""Typed scenario of the experiment `workspace`."""

import math
from dataclasses import dataclass, field

from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.geometry import ARM_BASE
from parapod.systems.levelling_platform.workspace import ArmGeometry

BACKENDS = ("exact",)


@dataclass
class SlopeScenario(Schema):
    """The ground on which Eq. (14) is checked; everything else is on level ground.

    Attributes:
        roll_deg: roll of the ground [deg].
        pitch_deg: pitch of the ground [deg].
    """

    roll_deg: float = quantity(3.0, -30.0, 30.0)
    pitch_deg: float = quantity(5.0, -30.0, 30.0)

    @property
    def inclination(self) -> tuple[float, float]:
        """Roll and pitch [rad]."""
        return math.radians(self.roll_deg), math.radians(self.pitch_deg)


@dataclass
class ReachScenario(Schema):
    """The arm whose tip is followed.

    Attributes:
        offset_mm: base of the arm from the platform's centre F [mm]; assumed, because Eq. (13) is
            lost.
        length_mm: length of the arm [mm].
        lean_deg: angle from upright while the turntable turns; otherwise the arm is upright [deg].
    """

    offset_mm: list[float] = quantity([1e3 * x for x in ARM_BASE], -500.0, 500.0, length=3)
    length_mm: float = quantity(2020.0, 100.0, 10000.0)
    lean_deg: float = quantity(45.0, 20.0, 80.0)

    @property
    def upright(self) -> ArmGeometry:
        """The arm as in section 4."""
        x, y, z = (1e-3 * value for value in self.offset_mm)
        return ArmGeometry(offset=(x, y, z), length=1e-3 * self.length_mm)

    @property
    def lean(self) -> float:
        """Angle of the leaning arm from upright [rad]."""
        return math.radians(self.lean_deg)


@dataclass
class WorkspaceScenario(Schema):
    """Questions about the workspace of the arm's tip.

    It is computed exactly, beside the eight surfaces that the paper prints for it: section 4 and
    Fig. 12. Frame {B} has its origin at the support point of leg 2, the right back one; z is up.

    Attributes:
        backend: method: "exact", closed forms.
        seed: seed of the points of the round trip and of the roundings that are tried.
        resolution: number of cells in each of three dimensions of a volume.
        ground: see `SlopeScenario`.
        arm: see `ReachScenario`.
        turntable: turning of the arm by the motor in its base.
    """

    backend: str = choice("exact", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    resolution: int = quantity(64, 16, 128)
    ground: SlopeScenario = field(default_factory=SlopeScenario)
    arm: ReachScenario = field(default_factory=ReachScenario)
    turntable: bool = False
