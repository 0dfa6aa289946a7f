"""Design of a levelling platform: dimensions, bodies, drives, sensors; the paper's by default.

What is null follows from the other dimensions: wheels, arm and the drawn base keep their places
by the hips.
"""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.bodies import Body, BodyScenario, body_of, in_si
from parapod.diagrams.levelling_platform.masses import masses_of
from parapod.diagrams.levelling_platform.model import (
    ARM_JOINTS,
    OwnModel,
    PlatformStructure,
)
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.actuators.velocity_servo import VelocityServoParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.fault_detection import FaultDetectorParams
from parapod.systems.levelling_platform.geometry import (
    ARM_BASE,
    LEG_COUNT,
    LegGeometry,
    PlatformGeometry,
)
from parapod.systems.levelling_platform.kinematics import (
    height_range,
    inverse_kinematics,
    posture_jacobian,
)
from parapod.systems.levelling_platform.leg import foot_to_centre
from parapod.systems.levelling_platform.reference import PostureReferenceParams
from parapod.systems.levelling_platform.statics import KinematicPlatformParams, stand
from parapod.systems.levelling_platform.supervisor import SupervisorParams
from parapod.systems.levelling_platform.wheels import WHEEL_GEAR, WheelGeometry
from parapod.systems.levelling_platform.workspace import ArmGeometry
from parapod.systems.sensors.limit_switches import LimitSwitchesParams

# Smallest and largest length [mm].
_SHORT, _LONG = 0.1, 20_000.0
_PAPER = PlatformGeometry()
# Share of the way from the lowest to the highest level posture at which a job works, and of the
# stroke at which it begins on feet [-].
_WORKING, _INITIAL = 0.488, 2.0 / 3.0
# Shares of an actuator's way beyond the stroke on the ground: a leg that leaves the ground alone,
# and one that is up [-].
_CLEAR, _RAISED = 0.5, 0.75
# Extensions beyond the stroke on the ground, by it, at which feet stand [-]; share of the way to
# the end stops at which they are in the air [-].
_STANDING, _LIFTED = 1.0 / 6.0, (0.2, 0.95)
# Rates of legs that look for the ground, and that go up, by the actuators' largest speed [-].
_LOWERING, _RAISING = 0.025, 0.05
# Height at which the paper's platform works [m]; share of an actuator's speed that a posture's way
# may take [-].
_PAPER_HEIGHT, _SHARE_OF_SPEED = 0.477, 0.5
# Extensions that a wrong encoder alone shows, by the way between the end stops; speeds by the
# largest one; ways that voltages do not explain, by the largest speed [-, -, s].
_TOLERANCE, _FASTEST, _RESPONSE = 0.0625, 1.25, 1.0 / 300.0


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


@dataclass
class ArmDesign(Schema):
    """The arm on its turntable.

    Attributes:
        base_mm: its base, on the turntable's axis, from the platform's centre F [mm]; null: 0, 20
            and 145, by the hips' places.
        length_mm: distance of the arm's tip from its base [mm]; the drawn arm is as long.
        mount: part of the turntable that stands still.
        turntable: part that turns.
        link: the drawn arm with what it carries; its frame is in its joint, z along it.
        stiffness_Nm_rad: stiffness of both joints' drives [N m/rad].
        urdf: URDF or SDFormat file of an arm of one's own, or a `package://` URL; empty: the drawn
            arm.
        frame: its link or frame that is fixed to the platform, in the arm's base, z up.
        joints: its joints that are driven: the turntable's about z, and the arm's, which swings it
            forward; every other one must be fixed.
    """

    base_mm: list[float] | None = quantity(None, -_LONG, _LONG, length=3)
    length_mm: float = quantity(2020.0, _SHORT, _LONG)
    mount: BodyScenario = body_of(0.1)
    turntable: BodyScenario = body_of(0.4)
    link: BodyScenario = body_of(1.0)
    stiffness_Nm_rad: float = quantity(2e4, 1.0, 1e9)  # noqa: N815
    urdf: str = ""
    frame: str = "mount"
    joints: list[str] = field(default_factory=lambda: ["turntable", "arm"])


@dataclass
class PlatformDesign(Schema):
    """The platform: dimensions of its legs are those of the paper, the others assumptions.

    Attributes:
        legs: see `LegsDesign`.
        each_leg: differences of legs 1 to 4, from the rear left against the clock; empty for legs
            that are alike. See `LegDesign`.
        base: see `BaseDesign`.
        hip: hip of a leg.
        lower_link: long side of a leg's parallelogram.
        coupler: short side of it with the foot's column.
        roller: roller of a foot.
        cylinder: cylinder of an actuator.
        rod: rod of an actuator.
        wheel: each wheel.
        wheels: see `WheelsDesign`.
        arm: see `ArmDesign`.
        actuators: see `ActuatorScenario`.
        sensors: see `SensorScenario`.
    """

    legs: LegsDesign = field(default_factory=LegsDesign)
    each_leg: list[LegDesign] = field(default_factory=list)
    base: BaseDesign = field(default_factory=BaseDesign)
    hip: BodyScenario = body_of(0.35)
    lower_link: BodyScenario = body_of(1.05)
    coupler: BodyScenario = body_of(0.8)
    roller: BodyScenario = body_of(0.5)
    cylinder: BodyScenario = body_of(1.2)
    rod: BodyScenario = body_of(0.3)
    wheel: BodyScenario = body_of(1.2)
    wheels: WheelsDesign = field(default_factory=WheelsDesign)
    arm: ArmDesign = field(default_factory=ArmDesign)
    actuators: ActuatorScenario = field(default_factory=ActuatorScenario)
    sensors: SensorScenario = field(default_factory=SensorScenario)

    @property
    def geometry(self) -> PlatformGeometry:
        """Its dimensions in SI units.

        Raises:
            ScenarioError: dimensions that no platform has; names the key.
        """
        common = in_si(self.legs, PlatformGeometry, "machine.legs")
        key, count = "machine.each_leg", len(self.each_leg)
        if count not in (0, LEG_COUNT):
            raise ScenarioError(f"{key} must have {LEG_COUNT} elements or none, not {count}", key)
        if not count:
            return common
        legs = zip(common.legs, self.each_leg, strict=True)
        return replace(common, own_legs=tuple(_own(leg, of_leg) for leg, of_leg in legs))

    @property
    def stretch(self) -> tuple[float, float, float]:
        """Factors by which its base is larger than the paper's."""
        own = in_si(self.legs, PlatformGeometry, "machine.legs")
        names = ("l_c1", "l_c2", "l_c3")
        along, across, up = (getattr(own, name) / getattr(_PAPER, name) for name in names)
        return along, across, up

    @property
    def wheel_geometry(self) -> WheelGeometry:
        """Its wheels in SI units."""
        usual, own = WheelGeometry(), self.wheels
        base, track, radius = (
            factor * of_paper if mm is None else mm / 1e3
            for factor, of_paper, mm in (
                (self.stretch[0], usual.half_base, own.half_base_mm),
                (self.stretch[1], usual.half_track, own.half_track_mm),
                (self.stretch[2], usual.radius, own.radius_mm),
            )
        )
        if own.depth_mm is None:
            depth = round(self.level_heights[0] - radius, 3)
        else:
            depth = own.depth_mm / 1e3
        return WheelGeometry(base, track, -depth, radius)

    @property
    def arm_base(self) -> tuple[float, float, float]:
        """Base of its arm, from F [m]."""
        if self.arm.base_mm is not None:
            x, y, z = (length / 1e3 for length in self.arm.base_mm)
        else:
            x, y, z = (a * b for a, b in zip(self.stretch, ARM_BASE, strict=True))
        return x, y, z

    @property
    def reach(self) -> ArmGeometry:
        """Its arm, upright."""
        return ArmGeometry(self.arm_base, self.arm.length_mm / 1e3)

    @property
    def level_heights(self) -> tuple[float, float]:
        """Heights of the level platform that all legs reach: lowest and highest [m].

        Raises:
            ScenarioError: legs that do not stand so.
        """
        geometry = self.geometry
        return _level_heights(geometry)

    @property
    def working_height(self) -> float:
        """Height of a level posture with room to all sides, to a millimetre [m]."""
        return self.height_at(_WORKING)

    def height_at(self, share: float) -> float:
        """Height of a level posture, to a millimetre [m].

        Args:
            share: share of the way from the lowest to the highest one [-].
        """
        low, high = self.level_heights
        return round(low + share * (high - low), 3)

    @property
    def bodies(self) -> dict[str, Body]:
        """Its links by their names in `parapod.urdf.levelling_platform`."""
        names = ("hip", "lower_link", "coupler", "roller", "cylinder", "rod", "wheel")
        bodies = {name: getattr(self, name).body for name in names}
        arm = {name: getattr(self.arm, name).body for name in ("mount", "turntable", "link")}
        return bodies | arm | {"base": self.base.body.body}

    @property
    def structure(self) -> PlatformStructure:
        """Its parts beside the legs, as the model of its bodies has them.

        Raises:
            ScenarioError: as `geometry`.
        """
        arm, actuators = self.arm, self.actuators
        if len(arm.joints) != len(ARM_JOINTS):
            key = "machine.arm.joints"
            raise ScenarioError(f"{key} must name two joints, not {len(arm.joints)}", key)
        return PlatformStructure(
            stretch=self.stretch,
            wheels=self.wheel_geometry,
            arm_base=self.arm_base,
            arm_length=arm.length_mm / 1e3,
            arm_stiffness=arm.stiffness_Nm_rad,
            stops=self.stops,
            rod_stiffness=1e6 * actuators.stiffness_N_um,
            roll_damping=self.legs.roll_damping_Nms,
            base=OwnModel("machine.base.urdf", self.base.urdf, self.base.frame),
            arm=OwnModel("machine.arm.urdf", arm.urdf, arm.frame, (arm.joints[0], arm.joints[1])),
            bodies=tuple(self.bodies.items()),
        )

    @property
    def masses(self) -> KinematicPlatformParams:
        """Its masses, as the plant that is built has them with its legs in the middle.

        Raises:
            ScenarioError: as `geometry`.
        """
        masses = masses_of(self.geometry, self.structure)
        return replace(
            masses,
            foot_stiffness=1e6 * self.legs.stiffness_N_um,
            wheel_stiffness=1e6 * self.wheels.stiffness_N_um,
        )

    @property
    def stops(self) -> tuple[float, float]:
        """End stops of its actuators [m]."""
        return self.actuators.stop_min_mm / 1e3, self.actuators.stop_max_mm / 1e3

    @property
    def standing_stroke(self) -> tuple[float, float]:
        """Extensions at which it stands on its feet, a little more than the stroke used [m]."""
        low, high = self.geometry.extension_min, self.geometry.extension_max
        beyond = _STANDING * (high - low)
        return low - beyond, high + beyond

    @property
    def lifted_stroke(self) -> tuple[float, float]:
        """Extensions at which it stands on its wheels, feet in the air, and no end is near [m]."""
        low, high = _LIFTED
        return self.beyond_stroke(low), self.beyond_stroke(high)

    @property
    def size(self) -> float:
        """Working height by that of the paper's platform [-]."""
        return self.working_height / _PAPER_HEIGHT

    @property
    def posture_reference(self) -> PostureReferenceParams:
        """Limits of the way to a new posture.

        Time goes with the root of the size, which leaves accelerations what they are. No actuator
        is asked for more than half its speed.
        """
        usual, slower = PostureReferenceParams(), math.sqrt(self.size)
        rates = np.array((usual.angle_rate, usual.angle_rate, usual.height_rate * self.size))
        posture = (0.0, 0.0, self.working_height)
        jacobian = np.abs(posture_jacobian(self.geometry, posture, (0.0, 0.0)))
        fastest = float((jacobian @ rates).max()) / slower
        slower *= max(1.0, fastest / (_SHARE_OF_SPEED * self.actuators.max_speed))
        angle, _, height = (rates / slower).tolist()
        return PostureReferenceParams(angle, height, usual.shortest_move * slower)

    @property
    def initial_extensions(self) -> tuple[float, ...]:
        """Extensions of the legs (4) at the beginning of a job on feet, to a micrometre [m].

        Legs that are alike are extended alike; others bear the platform level.
        """
        return self.extensions_at(_INITIAL)

    def extensions_at(self, share: float) -> tuple[float, ...]:
        """Extensions of the legs (4) with the platform as the ground lies, to a micrometre [m].

        Args:
            share: share of the stroke of legs that are alike; of others, of the way from the
                highest to the lowest posture [-].
        """
        geometry = self.geometry
        if self.each_leg:
            low, high = self.level_heights
            posture = (0.0, 0.0, high + share * (low - high))
            extensions = inverse_kinematics(geometry, posture, (0.0, 0.0)).tolist()
        else:
            low, high = geometry.extension_min, geometry.extension_max
            extensions = [low + share * (high - low)] * LEG_COUNT
        return tuple(1e-3 * round(1e3 * extension, 3) for extension in extensions)

    @property
    def raised(self) -> float:
        """Extension of a leg that is up [m]."""
        return self.beyond_stroke(_RAISED)

    @property
    def supervisor(self) -> SupervisorParams:
        """Extensions and rates of the supervised operation."""
        fastest, usual, size = self.actuators.max_speed, SupervisorParams(), self.size
        return SupervisorParams(
            raised=self.raised,
            clear=self.beyond_stroke(_CLEAR),
            lowering_rate=_LOWERING * fastest,
            raising_rate=_RAISING * fastest,
            touched=usual.touched * size,
            arrived=usual.arrived * size,
            clearance=usual.clearance * size,
        )

    @property
    def fault_detector(self) -> FaultDetectorParams:
        """Limits of normal signals."""
        actuators, switches = self.actuators, self.actuators.switches
        params = actuators.params
        beyond = _TOLERANCE * (params.stop_max - params.stop_min)
        return FaultDetectorParams(
            shortest=params.stop_min - beyond,
            longest=params.stop_max + beyond,
            fastest=_FASTEST * actuators.max_speed,
            gain=params.gain,
            friction=round(2.0 * self.friction_voltages[1], 2),
            response=actuators.max_speed * _RESPONSE,
            extended=switches.extended,
            retracted=switches.retracted,
            up=self.beyond_stroke(_CLEAR),
        )

    @property
    def friction_voltages(self) -> tuple[float, float]:
        """Voltages that an actuator takes to move without load, and to lift the platform [V]."""
        params, geometry = self.actuators.params, self.geometry
        posture = (0.0, 0.0, self.working_height)
        extension = inverse_kinematics(geometry, posture, (0.0, 0.0)).tolist()
        still = [0.0] * LEG_COUNT
        stance = stand(geometry, self.masses, extension, still, [0.0, 0.0], [0.0, 0.0])
        load = max(map(abs, stance.load_force)) / params.screw_efficiency
        alone = params.coulomb_friction / params.motor_constant
        return alone, alone + load / params.motor_constant

    def check(self) -> None:
        """Refuses a platform that cannot stand, tips over, or cannot lift itself.

        Raises:
            ScenarioError: names the key, and the admissible values.
        """
        self._check_order()
        low, high = (1e3 * stop for stop in self.stops)
        shortest = 1e3 * min(leg.extension_min for leg in self.geometry.legs)
        longest = 1e3 * max(leg.extension_max for leg in self.geometry.legs)
        if not low <= shortest < longest <= high:
            key = "machine.legs"
            raise ScenarioError(
                f"{key}: extensions on the ground of {shortest:g} to {longest:g} mm are not "
                f"within the end stops of machine.actuators, {low:g} to {high:g} mm",
                key,
            )
        self._check_loops()
        lowest, depth = self.level_heights[0], -float(self.structure.underside[0, 2])
        if not self.base.urdf and lowest <= depth:
            key = "machine.legs"
            raise ScenarioError(
                f"{key}: its base touches the ground: in the lowest posture F is "
                f"{1e3 * lowest:.0f} mm high; it must be more than {1e3 * depth:.0f} mm",
                key,
            )
        if (outside := self._beyond_feet()) > 0.0:
            raise ScenarioError(
                f"machine: it tips over: its centre of mass is {1e3 * outside:.0f} mm outside its "
                "feet, arm upright; it must be between them",
                "machine",
            )
        needed, supply = self.friction_voltages[1], self.actuators.supply_voltage
        if needed >= supply:
            key = "machine.actuators"
            least = math.ceil(self.actuators.motor_constant_N_V * needed / supply)
            raise ScenarioError(
                f"{key}: it cannot lift itself: that takes {needed:.3g} V of a supply of "
                f"{supply:g} V; motor_constant_N_V must be more than {least}",
                key,
            )

    @property
    def stance(self) -> NDArray[np.float64]:
        """Feet (4, 2) about F from above, of the level platform at its working height [m]."""
        posture = (0.0, 0.0, self.working_height)
        extensions = inverse_kinematics(self.geometry, posture, (0.0, 0.0)).tolist()
        legs = zip(self.geometry.legs, extensions, strict=True)
        return np.array([-np.array(foot_to_centre(leg, each)[:2]) for leg, each in legs])

    def _check_order(self) -> None:
        """Refuses legs that cross, or that are not numbered against the clock."""
        feet = self.stance
        sides = np.roll(feet, -1, axis=0) - feet
        turns = np.linalg.det(np.stack([sides, np.roll(sides, -1, axis=0)], axis=1))
        if (turns <= 0.0).any():
            places = ", ".join(f"({1e3 * x:.0f}, {1e3 * y:.0f})" for x, y in feet)
            key = "machine.each_leg" if self.each_leg else "machine.legs"
            raise ScenarioError(
                f"{key}: its feet stand at {places} mm from F; from the rear left one they must "
                "go round against the clock, as the corners of a convex figure",
                key,
            )

    def _check_loops(self) -> None:
        """Refuses parallelograms that become flat, and open, where it stands."""
        low, high = self.standing_stroke
        for number, leg in enumerate(self.geometry.legs, start=1):
            shortest, longest = abs(leg.l_4 - leg.l_3), leg.l_4 + leg.l_3
            for flat, is_open in ((shortest, low <= shortest), (longest, high >= longest)):
                if is_open:
                    key = "machine.each_leg" if self.each_leg else "machine.legs"
                    raise ScenarioError(
                        f"{key}: the parallelogram of leg {number} is flat at an extension of "
                        f"{1e3 * flat:.1f} mm, and it stands on {1e3 * low:.1f} to "
                        f"{1e3 * high:.1f} mm: l_3_mm and l_4_mm must allow for that",
                        key,
                    )

    def _beyond_feet(self) -> float:
        """Distance of the centre of mass beyond the feet's edges, level, arm upright [m]."""
        masses = self.masses
        whole = masses.mass + masses.arm_mass
        centre = (
            masses.mass * np.array(masses.centre_of_mass[:2])
            + masses.arm_mass * np.array(masses.arm_base[:2])
        ) / whole
        feet = self.stance
        sides = np.roll(feet, -1, axis=0) - feet
        outwards = np.column_stack([sides[:, 1], -sides[:, 0]])
        outwards /= np.linalg.norm(outwards, axis=1)[:, np.newaxis]
        return float(((centre - feet) * outwards).sum(axis=1).max())

    def beyond_stroke(self, share: float) -> float:
        """Extension beyond the stroke on the ground [m].

        Args:
            share: share of the way from there to the end stop [-].
        """
        used, stop = self.legs.extension_max_mm / 1e3, self.actuators.stop_max_mm / 1e3
        return used + share * (stop - used)


def _own(leg: LegGeometry, design: LegDesign) -> LegGeometry:
    """A leg with what is its own."""
    own: dict[str, float] = {}
    for name in ("x", "y", "z"):
        place = getattr(design, f"hip_{name}_mm")
        if place is not None:
            own[f"l_{name}"] = -place / 1e3
    for name in ("l_3", "l_4", "l_6", "l_7"):
        length = getattr(design, f"{name}_mm")
        if length is not None:
            own[name] = length / 1e3
    for name, angle in (("beta", design.yaw_deg), ("alpha", design.alpha_deg)):
        if angle is not None:
            own[name] = math.radians(angle)
    return replace(leg, **own)


@lru_cache(maxsize=64)
def _level_heights(geometry: PlatformGeometry) -> tuple[float, float]:
    low, high = height_range(geometry, (0.0, 0.0), (0.0, 0.0)).tolist()
    if not low < high:
        shortest, longest = 1e3 * geometry.extension_min, 1e3 * geometry.extension_max
        key = "machine.legs"
        raise ScenarioError(
            f"{key}: it cannot stand level on actuators of {shortest:g} to {longest:g} mm", key
        )
    return low, high
