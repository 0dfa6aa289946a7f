"""Parts of a levelling platform's design: legs, actuators, sensors, wheels, base, arm."""

import math
from dataclasses import dataclass

from parapod.diagrams.bodies import BodyScenario, body_of
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.actuators.velocity_servo import VelocityServoParams
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.wheels import WHEEL_GEAR
from parapod.systems.sensors.limit_switches import LimitSwitchesParams

# Smallest and largest length [mm].
_SHORT, _LONG = 0.1, 20_000.0


@dataclass
class LegsDesign(Schema):
    """The four legs, as far as they are alike: Table 1.

    Attributes:
        l_c1_mm: half distance of the hips along x [mm].
        l_c2_mm: half distance of the hips along y [mm].
        l_c3_mm: height of the platform's centre F above the hips [mm].
        l_3_mm: short sides of the parallelogram [mm].
        l_4_mm: long sides of the parallelogram [mm].
        l_6_mm: coupler from the parallelogram to the foot's column [mm].
        l_7_mm: foot's column [mm].
        alpha_deg: inclination of the parallelogram's short sides [deg].
        beta_deg: yaw of the legs [deg].
        foot_radius_mm: radius of the foot's rollers [mm].
        extension_min_mm: smallest extension of the actuators on the ground [mm].
        extension_max_mm: largest extension of the actuators on the ground [mm].
        roll_damping_Nms: damping of a roller's bearing, which keeps a platform on a slope from
            rolling away [N m s/rad]; null: 1, by its mass and the square of its radius.
        stiffness_N_um: stiffness of a foot with its leg, by which legs share a load [N/um].
    """

    l_c1_mm: float = quantity(400.0, _SHORT, _LONG)
    l_c2_mm: float = quantity(170.0, _SHORT, _LONG)
    l_c3_mm: float = quantity(113.0, _SHORT, _LONG)
    l_3_mm: float = quantity(80.0, _SHORT, _LONG)
    l_4_mm: float = quantity(440.0, _SHORT, _LONG)
    l_6_mm: float = quantity(165.0, _SHORT, _LONG)
    l_7_mm: float = quantity(205.0, _SHORT, _LONG)
    alpha_deg: float = quantity(61.0, -180.0, 180.0)
    beta_deg: float = quantity(49.0, -180.0, 180.0)
    foot_radius_mm: float = quantity(25.0, 1.0, 1000.0)
    extension_min_mm: float = quantity(390.0, _SHORT, _LONG)
    extension_max_mm: float = quantity(420.0, _SHORT, _LONG)
    roll_damping_Nms: float | None = quantity(None, 0.0, 1e6)  # noqa: N815 (the unit's symbol)
    stiffness_N_um: float = quantity(2.0, 0.01, 10_000.0)  # noqa: N815


@dataclass
class LegDesign(Schema):
    """One leg, as far as it differs from the others; null: as the others.

    Attributes:
        hip_x_mm: place of its hip, ahead of the platform's centre F [mm].
        hip_y_mm: place of its hip, to the left of F [mm].
        hip_z_mm: place of its hip, above F [mm].
        yaw_deg: yaw of its plane, from the hip towards the middle [deg].
        l_3_mm: short side of its parallelogram [mm].
        l_4_mm: long side of its parallelogram [mm].
        l_6_mm: its coupler [mm].
        l_7_mm: its foot's column [mm].
        alpha_deg: inclination of its parallelogram's short side [deg].
    """

    hip_x_mm: float | None = quantity(None, -_LONG, _LONG)
    hip_y_mm: float | None = quantity(None, -_LONG, _LONG)
    hip_z_mm: float | None = quantity(None, -_LONG, _LONG)
    yaw_deg: float | None = quantity(None, -360.0, 360.0)
    l_3_mm: float | None = quantity(None, _SHORT, _LONG)
    l_4_mm: float | None = quantity(None, _SHORT, _LONG)
    l_6_mm: float | None = quantity(None, _SHORT, _LONG)
    l_7_mm: float | None = quantity(None, _SHORT, _LONG)
    alpha_deg: float | None = quantity(None, -180.0, 180.0)


@dataclass
class ActuatorScenario(Schema):
    """The four linear actuators.

    Attributes:
        model: law of their motion: "dynamic" is Eq. (15), "integrator" Eq. (17).
        gain_m_s_V: K of Eq. (18), speed by voltage [(m/s)/V].
        motor_constant_N_V: force by voltage [N/V].
        time_constant_ms: time constant of rotor and gear [ms].
        gain_error: largest error of each actuator's gain as a share of it, drawn from the seed
            [-].
        coulomb_friction: Coulomb friction of an actuator [N].
        screw_efficiency: efficiency of the screw when it lifts a load [-]; at 0.5 and below it
            locks itself.
        supply_voltage: voltage at which the motors saturate [V].
        stop_min_mm: end stop, rod retracted [mm].
        stop_max_mm: end stop, rod extended [mm].
        switch_mm: distance from an end stop at which its switch closes [mm].
        stiffness_N_um: axial stiffness of a rod [N/um].
    """

    model: str = choice("dynamic", ("dynamic", "integrator"))
    gain_m_s_V: float = quantity(0.01, 1e-5, 10.0)  # noqa: N815
    motor_constant_N_V: float = quantity(2e4, 0.1, 1e7)  # noqa: N815
    time_constant_ms: float = quantity(10.0, 0.1, 1000.0)
    gain_error: float = quantity(0.15, 0.0, 0.5)
    coulomb_friction: float = quantity(1000.0, 0.0, 1e6)
    screw_efficiency: float = quantity(0.5, 0.05, 1.0)
    supply_voltage: float = quantity(12.0, 1.0, 1000.0)
    stop_min_mm: float = quantity(380.0, _SHORT, _LONG)
    stop_max_mm: float = quantity(460.0, _SHORT, _LONG)
    switch_mm: float = quantity(0.5, 0.0, 1000.0)
    stiffness_N_um: float = quantity(100.0, 0.01, 100_000.0)  # noqa: N815

    @property
    def params(self) -> LinearActuatorParams:
        """Parameters of an actuator with the nominal gain."""
        viscous_friction = self.motor_constant_N_V / self.gain_m_s_V
        return LinearActuatorParams(
            model=self.model,  # type: ignore[arg-type]
            motor_constant=self.motor_constant_N_V,
            viscous_friction=viscous_friction,
            inertia=self.time_constant_ms / 1e3 * viscous_friction,
            coulomb_friction=self.coulomb_friction,
            screw_efficiency=self.screw_efficiency,
            supply_voltage=self.supply_voltage,
            stop_min=self.stop_min_mm / 1e3,
            stop_max=self.stop_max_mm / 1e3,
        )

    @property
    def switches(self) -> LimitSwitchesParams:
        """Places of the end switches."""
        return LimitSwitchesParams(
            extended=(self.stop_max_mm - self.switch_mm) / 1e3,
            retracted=(self.stop_min_mm + self.switch_mm) / 1e3,
            contact_force=_CONTACT_FORCE,
        )

    @property
    def max_speed(self) -> float:
        """Speed of a rod at the supply's voltage, without load [m/s]."""
        return self.gain_m_s_V * self.supply_voltage


# Force from which on a contact switch is closed [N]: well below a leg's share of the platform's
# weight, above the foot's own (assumption).
_CONTACT_FORCE = 5.0


@dataclass
class SensorScenario(Schema):
    """Encoders and inertial sensor.

    Attributes:
        encoder_resolution_mm: one count of the actuators' encoders [mm]; 0 for perfect ones.
        imu_noise: noise, bias instability and quantisation of the ADIS16448.
        accel_bias_mg: accelerometer bias left after calibration, of this size on each axis with a
            sign drawn from the seed [mg]; 1 mg tilts by 0.06 deg.
        gyro_bias_deg_s: turn-on bias of the gyro, of this size on each axis with a sign drawn from
            the seed [deg/s].
        imu_delay_ms: age of the inertial sensor's samples when they are shown, in whole samples of
            9.77 ms [ms].
        imu_place_mm: place of the inertial sensor, from the platform's centre F [mm].
    """

    encoder_resolution_mm: float = quantity(0.01, 0.0, 1.0)
    imu_noise: bool = True
    accel_bias_mg: float = quantity(1.0, 0.0, 50.0)
    gyro_bias_deg_s: float = quantity(0.5, 0.0, 5.0)
    imu_delay_ms: float = quantity(0.0, 0.0, 200.0)
    imu_place_mm: list[float] = quantity([0.0] * 3, -_LONG, _LONG, length=3)

    @property
    def imu_place(self) -> list[float]:
        """Place of the inertial sensor, from F [m]."""
        return [length / 1e3 for length in self.imu_place_mm]


@dataclass
class WheelsDesign(Schema):
    """The four wheels and their drives; the paper has their gear alone.

    Attributes:
        half_base_mm: half distance of the axles along x [mm]; null: 260, by `legs.l_c1_mm`.
        half_track_mm: half distance of the wheels along y [mm]; null: 200, by `legs.l_c2_mm`.
        radius_mm: radius of the wheels [mm]; null: 125, by `legs.l_c3_mm`.
        depth_mm: depth of the axles below the platform's centre F [mm]; null: as much as lets the
            platform stand on them in its lowest posture on the legs, to a millimetre.
        gear: reduction between motor and wheel [-] (section 2.1).
        max_velocity_rpm: largest velocity of a motor [rpm].
        counts_per_turn: encoder counts per turn of a motor [-].
        time_constant_ms: time constant of the drives [ms].
        acceleration_rad_s2: largest acceleration of a wheel [rad/s^2].
        stiffness_N_um: stiffness of a wheel [N/um].
    """

    half_base_mm: float | None = quantity(None, _SHORT, _LONG)
    half_track_mm: float | None = quantity(None, _SHORT, _LONG)
    radius_mm: float | None = quantity(None, _SHORT, _LONG)
    depth_mm: float | None = quantity(None, -_LONG, _LONG)
    gear: float = quantity(WHEEL_GEAR, 0.1, 10_000.0)
    max_velocity_rpm: float = quantity(8000.0, 1.0, 100_000.0)
    counts_per_turn: int = quantity(2000, 4, 10_000_000)
    time_constant_ms: float = quantity(50.0, 0.1, 1000.0)
    acceleration_rad_s2: float = quantity(20.0, 0.1, 10_000.0)
    stiffness_N_um: float = quantity(2.0, 0.01, 10_000.0)  # noqa: N815

    @property
    def drive(self) -> VelocityServoParams:
        """The drives, referred to the wheels."""
        turn = 2.0 * math.pi
        return VelocityServoParams(
            resolution=turn / (self.counts_per_turn * self.gear),
            time_constant=self.time_constant_ms / 1e3,
            max_velocity=self.max_velocity_rpm * turn / 60.0 / self.gear,
            acceleration=self.acceleration_rad_s2,
        )


@dataclass
class BaseDesign(Schema):
    """The platform's body.

    Attributes:
        body: the drawn base; its frame is in the platform's centre F.
        urdf: URDF or SDFormat file of a base of one's own, or a `package://` URL; empty: the drawn
            base.
        frame: its link or frame that is the platform's centre F, x to the front and z up.
    """

    body: BodyScenario = body_of(27.9)
    urdf: str = ""
    frame: str = "base"
