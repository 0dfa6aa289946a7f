"""Typed scenario of the levelling platform; what each key means is said in the YAML files too."""

import math
from dataclasses import dataclass, field

from parapod.diagrams.drivers.adis16448 import Adis16448SpiImu
from parapod.diagrams.drivers.ni_daq import NiDaqLegs
from parapod.diagrams.drivers.not_fitted import NotFittedPart
from parapod.diagrams.fault_scenario import FaultScenario
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.drivers import Epos2Wheels
from parapod.diagrams.scenario import choice, quantity
from parapod.systems.actuators.linear_actuator import LinearActuatorParams

SIMULATED = ("multibody", "kinematic")
BACKENDS = (*SIMULATED, "mock", "hardware")


@dataclass
class GroundScenario:
    """The ground that nobody has told the controller about.

    Attributes:
        roll_deg: roll of the ground [deg].
        pitch_deg: pitch of the ground [deg].
        foot_heights_mm: how far the ground under each foot is above the ground's plane [mm].
    """

    roll_deg: float = quantity(2.0, -15.0, 15.0)
    pitch_deg: float = quantity(3.0, -15.0, 15.0)
    foot_heights_mm: list[float] = quantity([0.0] * 4, -50.0, 50.0, length=4)

    @property
    def inclination(self) -> tuple[float, float]:
        """Roll and pitch [rad]."""
        return math.radians(self.roll_deg), math.radians(self.pitch_deg)

    @property
    def foot_offsets(self) -> tuple[float, ...]:
        """Heights under the feet (4) [m]."""
        return tuple(1e-3 * height for height in self.foot_heights_mm)


@dataclass
class PlantScenario:
    """The simulated machine.

    Attributes:
        leg_model: "full" has the actuators as bodies in closed loops, "reduced" their exact
            transmission (multibody backend).
        time_step: of the multibody plant and of the actuators [s]; the kinematic backend steps
            its actuators with the controller's period.
        length_error_mm: each length of each leg as built is off by up to this, drawn from the
            seed; the controller knows the drawing only [mm].
        angle_error_deg: likewise each angle [deg].
        wheels: "braked" makes them part of the base, "rolling" gives them joints that the wheel
            drives turn (multibody backend).
        contact_approximation: Drake's discrete contact approximation.
    """

    leg_model: str = choice("full", ("full", "reduced"))
    wheels: str = choice("braked", ("braked", "rolling"))
    time_step: float = quantity(1e-3, 1e-4, 2e-2)
    length_error_mm: float = quantity(0.0, 0.0, 5.0)
    angle_error_deg: float = quantity(0.0, 0.0, 2.0)
    contact_approximation: str = choice("lagged", ("lagged", "similar", "sap"))


@dataclass
class ActuatorScenario:
    """The four linear actuators.

    Attributes:
        model: "dynamic" (Eq. 15) or "integrator" (Eq. 17).
        gain_error: each actuator's gain is off by up to this share, drawn from the seed [-].
        coulomb_friction: [N].
        supply_voltage: [V].
    """

    model: str = choice("dynamic", ("dynamic", "integrator"))
    gain_error: float = quantity(0.15, 0.0, 0.5)
    coulomb_friction: float = quantity(1000.0, 0.0, 20000.0)
    supply_voltage: float = quantity(12.0, 1.0, 48.0)

    @property
    def params(self) -> LinearActuatorParams:
        """Of an actuator with the nominal gain."""
        return LinearActuatorParams(
            model=self.model,  # type: ignore[arg-type]
            coulomb_friction=self.coulomb_friction,
            supply_voltage=self.supply_voltage,
        )


@dataclass
class SensorScenario:
    """Encoders and inertial sensor.

    Attributes:
        encoder_resolution_mm: one count of the actuators' encoders; 0 for a perfect one [mm].
        imu_noise: noise, bias instability and quantisation of the ADIS16448.
        accel_bias_mg: accelerometer bias left after levelling calibration; each axis has this
            size, with a sign drawn from the seed [mg].
        gyro_bias_deg_s: turn-on bias of the gyro, likewise [deg/s].
        imu_delay_ms: age of the inertial sensor's samples when they are shown, in whole samples
            of 9.77 ms [ms].
    """

    encoder_resolution_mm: float = quantity(0.01, 0.0, 1.0)
    imu_noise: bool = True
    accel_bias_mg: float = quantity(1.0, 0.0, 50.0)
    gyro_bias_deg_s: float = quantity(0.5, 0.0, 5.0)
    imu_delay_ms: float = quantity(0.0, 0.0, 200.0)


@dataclass
class ControlScenario:
    """The controller.

    Attributes:
        period: of all controllers and estimators [s].
        pole: p of the position controllers [rad/s].
        voltage_limit: of the commands [V].
        rate_feedforward: share of the desired rate fed forward to the voltages [-].
        friction_feedforward: voltages that overcome friction and the platform's weight when a leg
            extends and when it retracts [V, V].
        feedforward: "exact" inverse kinematics, or the paper's "differential" law (Eq. 26).
        outer_loop: whether the estimated attitude corrects the inclination.
        outer_loop_gain: integral gain of that loop [1/s].
    """

    period: float = quantity(0.01, 0.001, 0.05)
    pole: float = quantity(10.0, 0.5, 50.0)
    voltage_limit: float = quantity(10.0, 0.5, 48.0)
    rate_feedforward: float = quantity(1.0, 0.0, 1.5)
    friction_feedforward: list[float] = quantity([0.05, 0.12], 0.0, 10.0, length=2)
    feedforward: str = choice("exact", ("exact", "differential"))
    outer_loop: bool = False
    outer_loop_gain: float = quantity(1.0, 0.0, 5.0)


@dataclass
class WaypointScenario:
    """A posture about the level one.

    Attributes:
        time: when it is commanded, from the start of the levelling [s].
        roll_deg: [deg].
        pitch_deg: [deg].
        height_mm: relative to the level posture [mm].
    """

    time: float = quantity(0.0, 0.0, 3600.0)
    roll_deg: float = quantity(0.0, -10.0, 10.0)
    pitch_deg: float = quantity(0.0, -10.0, 10.0)
    height_mm: float = quantity(0.0, -100.0, 100.0)


@dataclass
class ArmScenario:
    """The arm's swing while the platform holds.

    Attributes:
        start: when it begins, from the start of the levelling [s].
        angle_deg: forward from upright [deg].
        duration: of the swing [s].
    """

    start: float = quantity(26.0, 0.0, 3600.0)
    angle_deg: float = quantity(45.0, -90.0, 90.0)
    duration: float = quantity(1.0, 0.1, 60.0)


@dataclass
class JobScenario:
    """What the platform is asked to do.

    Attributes:
        start: "feet", or "wheels" with the legs raised and feet above their places.
        start_x_m: on wheels, how far the platform is from there along its x axis (multibody
            backend) [m].
        initial_extension_mm: on feet, of legs 1 to 3; leg 4 is lowered until its foot touches,
            which on a plane is the same [mm].
        estimate_at: when the ground is estimated and the levelling begins [s].
        height_mm: of the level posture above the ground's plane [mm].
        settled_after: when the level posture is taken, from the start of the levelling [s].
        waypoints: postures to take after that; shrunk together where the stroke is too short.
        arm: the arm's swing.
        end: end of the job, from the start of the levelling [s].
    """

    start: str = choice("feet", ("feet", "wheels"))
    start_x_m: float = quantity(0.0, -100.0, 100.0)
    initial_extension_mm: float = quantity(410.0, 390.0, 420.0)
    estimate_at: float = quantity(3.0, 0.5, 60.0)
    height_mm: float = quantity(477.0, 380.0, 580.0)
    settled_after: float = quantity(6.0, 0.5, 600.0)
    waypoints: list[WaypointScenario] = field(default_factory=list)
    arm: ArmScenario = field(default_factory=ArmScenario)
    end: float = quantity(30.0, 1.0, 3600.0)


def emulated_hardware() -> HardwareScenario:
    """The devices of `parapod emulate level`."""
    return HardwareScenario(
        [
            NiDaqLegs(),
            Adis16448SpiImu(),
            Epos2Wheels(),
            NotFittedPart("arm"),
            NotFittedPart("turntable"),
        ]
    )


@dataclass
class LevellingScenario:
    """One run of the levelling platform.

    Attributes:
        backend: what is behind the station's ports: one of two simulated plants, "mock" (commands
            are mirrored) or "hardware".
        seed: of everything random: gains, biases, noise.
        ground: see `GroundScenario`.
        plant: see `PlantScenario`.
        actuators: see `ActuatorScenario`.
        sensors: see `SensorScenario`.
        control: see `ControlScenario`.
        job: see `JobScenario`.
        faults: see `FaultScenario`.
        hardware: see `HardwareScenario`; by default what is emulated.
    """

    backend: str = choice("multibody", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    ground: GroundScenario = field(default_factory=GroundScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    actuators: ActuatorScenario = field(default_factory=ActuatorScenario)
    sensors: SensorScenario = field(default_factory=SensorScenario)
    control: ControlScenario = field(default_factory=ControlScenario)
    job: JobScenario = field(default_factory=JobScenario)
    faults: list[FaultScenario] = field(default_factory=list)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)
