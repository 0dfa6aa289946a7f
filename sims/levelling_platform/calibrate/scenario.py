"""Scenario of a calibration; `parapod scenario calibrate` explains it."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.scenario import (
    ControlScenario,
    GroundScenario,
    JobScenario,
    LevellingScenario,
    PlantScenario,
    emulated_hardware,
)
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.calibration.equations import (
    Tolerances,
)
from parapod.systems.levelling_platform.calibration.poses import MeasurementNoise

# Floor of the measurements' standard deviations [m, rad]: below it the squares of errors, which
# least squares leaves out, are larger than the errors.
_FINEST = 1e-6


@dataclass
class PosesScenario(Schema):
    """The poses that are simulated, or through which a real machine is led.

    Attributes:
        count: number of poses to calibrate with.
        validation: number of other poses, which show the worth of the calibration.
        tracked: inclination from the optical tracker that measures the height; the inertial sensor
            alone cannot tell its bias from legs that lean.
        turns_deg: headings of the platform, taken in turn from pose to pose [deg]; [0, 180] finds
            unknown ground. A real machine is not turned.
    """

    count: int = quantity(30, 1, 300)
    validation: int = quantity(100, 1, 10000)
    tracked: bool = True
    turns_deg: list[float] = quantity([0.0], -360.0, 360.0)


@dataclass
class ToleranceScenario(Schema):
    """Tolerances of the machine to its drawing, either way.

    Attributes:
        length_error_mm: error of each length of each leg [mm].
        angle_error_deg: error of each angle of each leg [deg].
        offset_error_mm: constant error of each actuator's encoder [mm].
        accel_bias_mg: bias of the accelerometer on each axis [mg]; 1 mg tilts by 0.057 deg.
    """

    length_error_mm: float = quantity(0.5, 1e-3, 5.0)
    angle_error_deg: float = quantity(0.2, 1e-3, 2.0)
    offset_error_mm: float = quantity(0.3, 1e-3, 5.0)
    accel_bias_mg: float = quantity(5.0, 1e-3, 50.0)

    @property
    def tolerances(self) -> Tolerances:
        """Tolerances in SI units."""
        return Tolerances(
            length=1e-3 * self.length_error_mm,
            angle=math.radians(self.angle_error_deg),
            offset=1e-3 * self.offset_error_mm,
            bias=1e-3 * self.accel_bias_mg,
        )


@dataclass
class NoiseScenario(Schema):
    """Standard deviations of the measurements.

    Attributes:
        encoder_resolution_mm: one count of the encoders [mm]; 0 for perfect ones.
        inclination_deg: inclination by the inertial sensor at rest, beside its bias [deg].
        height_mm: height by the tracker, Appendix B [mm].
        tracked_inclination_deg: inclination by the tracker, Appendix B [deg].
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
        known: true if the inclination counts as known, as in the paper's experiment; false: it is
            identified too.
        roll_deg: roll of the ground at heading 0 [deg].
        pitch_deg: pitch of the ground at heading 0 [deg].
    """

    known: bool = True
    roll_deg: float = quantity(0.0, -15.0, 15.0)
    pitch_deg: float = quantity(0.0, -15.0, 15.0)

    @property
    def inclination(self) -> np.ndarray:
        """Roll and pitch (2) [rad]."""
        return np.radians([self.roll_deg, self.pitch_deg])


@dataclass
class MeasuringScenario(Schema):
    """A real machine's way through the poses, and what is measured from outside.

    Attributes:
        poses_file: file in which the poses are recorded, .csv, .npz or .mcap; written after each
            one. `recording` reads it.
        answers_file: CSV file with the columns height_mm and, where tracked, roll_deg and
            pitch_deg, a row a pose, which may be written while the machine waits; a column pose
            may tell the number of the pose. Empty: they are asked for at the console.
        rest_s: time at rest before encoders and inertial sensor are averaged, so that the attitude
            settles [s].
        average_s: time over which they are averaged [s].
        rate_mm_s: largest rate of a leg on its way [mm/s]; the guard ends a job in which the
            platform turns faster than some 3 deg/s.
    """

    poses_file: str = "poses.csv"
    answers_file: str = ""
    rest_s: float = quantity(4.0, 0.1, 60.0)
    average_s: float = quantity(2.0, 0.1, 60.0)
    rate_mm_s: float = quantity(3.0, 0.5, 4.0)


@dataclass
class CalibrateScenario(Schema):
    """One calibration.

    The recording is simulated, or is a file, from a real machine too. `parapod run calibrate --log
    poses.npz` writes one, and `--set recording=poses.npz` calibrates with it. It holds

        t (n) [s], legs.extension (n,4) [m],
        attitude_estimated (n,2) [rad], height_measured (n,1) [m]

    and, if there are any, attitude_reference (n,2) [rad], the inclination by the tracker, NaN
    where it was not measured; legs.contact (n,4), the feet that stand; ground_measured (n,2)
    [rad], roll and pitch of the ground in the platform's heading; heading_measured (n,1) [rad],
    the angle by which the platform was turned about the vertical.

    Attributes:
        backend: stand-in for the machine: "kinematic", the closed forms; or the real machine,
            "hardware".
        seed: seed of the machine, the poses and the noise.
        machine: see `PlatformDesign`; or a file: `!File my_machine.yaml`.
        recording: file with recorded poses; empty for simulated ones.
        poses: see `PosesScenario`.
        tolerances: see `ToleranceScenario`.
        noise: see `NoiseScenario`.
        ground: see `KnownGroundScenario`; a recording's own ground_measured takes its place.
        measuring: see `MeasuringScenario`.
        control: see `ControlScenario`; it leads a real machine's legs.
        hardware: see `HardwareScenario`; the defaults are the emulated devices.
    """

    backend: str = choice("kinematic", ("kinematic", "hardware"))
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: PlatformDesign = field(default_factory=PlatformDesign)
    recording: str = ""
    poses: PosesScenario = field(default_factory=PosesScenario)
    tolerances: ToleranceScenario = field(default_factory=ToleranceScenario)
    noise: NoiseScenario = field(default_factory=NoiseScenario)
    ground: KnownGroundScenario = field(default_factory=KnownGroundScenario)
    measuring: MeasuringScenario = field(default_factory=MeasuringScenario)
    control: ControlScenario = field(default_factory=ControlScenario)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)

    @property
    def levelling(self) -> LevellingScenario:
        """The machine on its feet; the legs of a simulated one are as the tolerances allow."""
        tolerances, ground = self.tolerances, self.ground
        sensors = SensorScenario(encoder_resolution_mm=self.noise.encoder_resolution_mm)
        low, high = self.machine.geometry.extension_min, self.machine.geometry.extension_max
        return LevellingScenario(
            backend=self.backend,
            seed=self.seed,
            ground=GroundScenario(ground.roll_deg, ground.pitch_deg),
            plant=PlantScenario(
                length_error_mm=tolerances.length_error_mm,
                angle_error_deg=tolerances.angle_error_deg,
            ),
            machine=replace(self.machine, sensors=sensors),
            control=self.control,
            job=JobScenario(initial_extension_mm=500.0 * (low + high)),
            hardware=self.hardware,
        )
