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
from parapod.diagrams.levelling_platform.admission import check_platform
from parapod.diagrams.levelling_platform.arms import ArmDesign, Rod
from parapod.diagrams.levelling_platform.masses import masses_of
from parapod.diagrams.levelling_platform.model import (
    OwnModel,
    PlatformStructure,
)
from parapod.diagrams.levelling_platform.parts import (
    ActuatorScenario,
    BaseDesign,
    LegDesign,
    LegsDesign,
    SensorScenario,
    WheelsDesign,
)
from parapod.systems.actuators.position_drive import PositionDriveParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema
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
from parapod.systems.levelling_platform.stability_monitor import StabilityMonitorParams
from parapod.systems.levelling_platform.statics import KinematicPlatformParams, stand
from parapod.systems.levelling_platform.supervisor import SupervisorParams
from parapod.systems.levelling_platform.wheels import WheelGeometry
from parapod.systems.levelling_platform.workspace import ArmGeometry

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
# Shares of the drives' speed and acceleration that supervised moves of the arm take: those of
# moves of twice the shortest duration [-].
_MOVING = 0.5, 0.25
# Distances, on a platform of the paper's size, of a leg from where it touched the ground and from
# its goal, of the wheels from the ground, of feet from the measured ground [m].
_TOUCHED, _ARRIVED, _CLEARANCE, _FEET = 3e-5, 2e-4, 1e-3, 4e-3
# Extensions that a wrong encoder alone shows, and tolerance of end switches, by the way between
# the end stops; speeds by the largest one; ways that voltages do not explain, by the largest speed
# [-, -, -, s].
_TOLERANCE, _END, _FASTEST, _RESPONSE = 0.0625, 0.025, 1.25, 1.0 / 300.0


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
        arm: one of `!Rod`, `!FlexibleRod`, `!Urdf` and `!None`; without a tag `!Rod`. See
            `ArmDesign`.
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
    arm: ArmDesign = field(default_factory=Rod)
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
        """Its arm at zero, as a rod that stands upright."""
        if self.arm.length is not None:
            return ArmGeometry(self.arm_base, self.arm.length)
        arm = self.masses.arm
        x, y, z = arm.tip_pose([0.0] * arm.count).place
        length = max(0.0, z - self.arm_base[2])
        return ArmGeometry((x, y, z - length), length)

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
        return bodies | self.arm.bodies | {"base": self.base.body.body}

    @property
    def structure(self) -> PlatformStructure:
        """Its parts beside the legs, as the model of its bodies has them.

        Raises:
            ScenarioError: as `geometry`.
        """
        arm, actuators = self.arm, self.actuators
        return PlatformStructure(
            stretch=self.stretch,
            wheels=self.wheel_geometry,
            arm_base=self.arm_base,
            arm_length=arm.length,
            arm_drives=tuple(
                zip(
                    (drive.stiffness_Nm_rad for drive in arm.each_drive or [arm.drives]),
                    arm.efforts(len(arm.each_drive) or 1),
                    strict=True,
                )
            ),
            stops=self.stops,
            rod_stiffness=1e6 * actuators.stiffness_N_um,
            roll_damping=self.legs.roll_damping_Nms,
            base=OwnModel("machine.base.urdf", self.base.urdf, self.base.frame),
            arm=arm.own,
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
            arm=self.arm.driven(masses.arm),
            foot_stiffness=1e6 * self.legs.stiffness_N_um,
            wheel_stiffness=1e6 * self.wheels.stiffness_N_um,
        )

    @property
    def stability_monitor(self) -> StabilityMonitorParams:
        """Limits of the arm's moves.

        Raises:
            ScenarioError: as `geometry`.
        """
        masses, drives = self.masses, self.arm_drives
        return StabilityMonitorParams(
            rate=tuple(_MOVING[0] * drive.max_velocity for drive in drives),
            acceleration=tuple(_MOVING[1] * drive.max_acceleration for drive in drives),
            reach=tuple((joint.lower, joint.upper) for joint in masses.arm.joints),
            platform=masses,
        )

    @property
    def arm_drives(self) -> tuple[PositionDriveParams, ...]:
        """Drives of its arm's joints (n)."""
        joints = self.masses.arm.joints
        settings = self.arm.drive_settings(len(joints))
        return tuple(drive.drive_of(joint) for joint, drive in zip(joints, settings, strict=True))

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
        fastest, size = self.actuators.max_speed, self.size
        return SupervisorParams(
            raised=self.raised,
            clear=self.beyond_stroke(_CLEAR),
            lowering_rate=_LOWERING * fastest,
            raising_rate=_RAISING * fastest,
            touched=_TOUCHED * size,
            arrived=_ARRIVED * size,
            clearance=_CLEARANCE * size,
        )

    @property
    def fault_detector(self) -> FaultDetectorParams:
        """Limits of normal signals."""
        actuators, switches = self.actuators, self.actuators.switches
        params = actuators.params
        way = params.stop_max - params.stop_min
        beyond = _TOLERANCE * way
        return FaultDetectorParams(
            shortest=params.stop_min - beyond,
            longest=params.stop_max + beyond,
            fastest=_FASTEST * actuators.max_speed,
            gain=params.gain,
            friction=round(2.0 * self.friction_voltages[1], 2),
            response=actuators.max_speed * _RESPONSE,
            extended=switches.extended,
            retracted=switches.retracted,
            feet=_FEET * self.size,
            end=_END * way,
            up=self.beyond_stroke(_CLEAR),
        )

    @property
    def friction_voltages(self) -> tuple[float, float]:
        """Voltages that an actuator takes to move without load, and to lift the platform [V]."""
        params, geometry = self.actuators.params, self.geometry
        posture = (0.0, 0.0, self.working_height)
        extension = inverse_kinematics(geometry, posture, (0.0, 0.0)).tolist()
        still = [0.0] * LEG_COUNT
        masses = self.masses
        at_zero = [0.0] * masses.arm.count
        stance = stand(geometry, masses, extension, still, [0.0, 0.0], at_zero)
        load = max(map(abs, stance.load_force)) / params.screw_efficiency
        alone = params.coulomb_friction / params.motor_constant
        return alone, alone + load / params.motor_constant

    def check(self) -> None:
        """Refuses a platform that cannot stand, tips over, or cannot lift itself.

        Raises:
            ScenarioError: names the key, and the admissible values.
        """
        check_platform(self)

    @property
    def stance(self) -> NDArray[np.float64]:
        """Feet (4, 2) about F from above, of the level platform at its working height [m]."""
        posture = (0.0, 0.0, self.working_height)
        extensions = inverse_kinematics(self.geometry, posture, (0.0, 0.0)).tolist()
        legs = zip(self.geometry.legs, extensions, strict=True)
        return np.array([-np.array(foot_to_centre(leg, each)[:2]) for leg, each in legs])

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
