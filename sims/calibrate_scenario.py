"""Typed scenario of the experiment `calibrate`."""

import math
from dataclasses import dataclass, field

import numpy as np

from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.calibration.equations import Tolerances
from parapod.systems.levelling_platform.calibration.poses import MeasurementNoise

BACKENDS = ("kinematic",)

# Nothing is taken to be measured better than this, whatever the scenario says [m, rad]: beyond it
# the squares of errors, which least squares leaves out, are larger than the errors.
_FINEST = 1e-6


@dataclass
class PosesScenario(Schema):
    """The poses that are recorded.

    Attributes:
        count: how many there are to calibrate with.
        validation: how many others there are to find out what the calibration is worth.
        tracked: the optical tracker that measures the height measures the inclination too.
        turns_deg: the platform's headings, taken in turn from pose to pose [deg].
    """

    count: int = quantity(30, 1, 300)
    validation: int = quantity(100, 1, 10000)
    tracked: bool = True
    turns_deg: list[float] = quantity([0.0], -360.0, 360.0)


@dataclass
class ToleranceScenario(Schema):
    """How far the machine may be from its drawing, either way.

    Attributes:
        length_error_mm: each length of each leg [mm].
        angle_error_deg: each angle of each leg [deg].
        offset_error_mm: each actuator's encoder, a constant [mm].
        accel_bias_mg: the accelerometer on each axis; 1 mg tilts by 1 mrad [mg].
    """

    length_error_mm: float = quantity(0.5, 1e-3, 5.0)
    angle_error_deg: float = quantity(0.2, 1e-3, 2.0)
    offset_error_mm: float = quantity(0.3, 1e-3, 5.0)
    accel_bias_mg: float = quantity(5.0, 1e-3, 50.0)

    @property
    def tolerances(self) -> Tolerances:
        """In SI units."""
        return Tolerances(
            length=1e-3 * self.length_error_mm,
            angle=math.radians(self.angle_error_deg),
            offset=1e-3 * self.offset_error_mm,
            bias=1e-3 * self.accel_bias_mg,
        )


@dataclass
class NoiseScenario(Schema):
    """How exact measurements are.

    Attributes:
        encoder_resolution_mm: one count of the encoders; 0 for perfect ones [mm].
        inclination_deg: standard deviation of the inertial sensor at rest, beside its bias [deg].
        height_mm: of the height [mm], Appendix B.
        tracked_inclination_deg: of the tracker's inclination [deg], Appendix B.
    """

    encoder_resolution_mm: float = quantity(0.01, 0.0, 1.0)
    inclination_deg: float = quantity(0.01, 0.0, 1.0)
    height_mm: float = quantity(0.05, 0.0, 5.0)
    tracked_inclination_deg: float = quantity(0.01, 0.0, 1.0)

    @property
    def deviations(self) -> MeasurementNoise:
        """Standard deviations in SI units; a rounding's is the count by the root of 12."""
        return MeasurementNoise(
            extension=max(_FINEST, 1e-3 * self.encoder_resolution_mm / math.sqrt(12.0)),
            attitude=max(_FINEST, math.radians(self.inclination_deg)),
            height=max(_FINEST, 1e-3 * self.height_mm),
            reference=max(_FINEST, math.radians(self.tracked_inclination_deg)),
        )


@dataclass
class KnownGroundScenario(Schema):
    """The ground during the recording.

    Attributes:
        known: whether the calibration is told how it is inclined.
        roll_deg: at heading 0 [deg].
        pitch_deg: [deg].
    """

    known: bool = True
    roll_deg: float = quantity(0.0, -15.0, 15.0)
    pitch_deg: float = quantity(0.0, -15.0, 15.0)

    @property
    def inclination(self) -> np.ndarray:
        """Roll and pitch (2) [rad]."""
        return np.radians([self.roll_deg, self.pitch_deg])


@dataclass
class CalibrateScenario(Schema):
    """One calibration.

    Attributes:
        backend: "kinematic": the closed forms stand in for the machine.
        seed: of the machine, the poses and the noise.
        recording: a file with recorded poses; empty for simulated ones.
        poses: see `PosesScenario`; of a recording nothing is simulated.
        tolerances: see `ToleranceScenario`.
        noise: see `NoiseScenario`.
        ground: see `KnownGroundScenario`; where a recording says how the ground is inclined,
            that holds.
    """

    backend: str = choice("kinematic", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    recording: str = ""
    poses: PosesScenario = field(default_factory=PosesScenario)
    tolerances: ToleranceScenario = field(default_factory=ToleranceScenario)
    noise: NoiseScenario = field(default_factory=NoiseScenario)
    ground: KnownGroundScenario = field(default_factory=KnownGroundScenario)
