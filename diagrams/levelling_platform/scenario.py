"""Typed scenario of the levelling platform; keys are explained in the YAML files too."""

import math
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.disturbances import Disturbance
from parapod.diagrams.drivers.adis16448 import Adis16448SpiImu
from parapod.diagrams.drivers.ni_daq import NiDaqLegs
from parapod.diagrams.drivers.not_fitted import NotFittedPart
from parapod.diagrams.faults import FaultScenario, targets_of
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.drivers import Epos2Wheels
from parapod.diagrams.levelling_platform.ports import PORTS
from parapod.diagrams.machine import ControlScenario as UsualControlScenario
from parapod.systems.arm.input_shaper import ShaperKind
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.fault_detection import FaultDetectorParams
from parapod.systems.levelling_platform.geometry import (
    LEG_COUNT,
    LegDeviation,
    PlatformGeometry,
    drawn_deviations,
)

BODIES = ("multibody", "mujoco")  # backends of rigid bodies, each by an engine of its own
SIMULATED = ("multibody", "kinematic", "mujoco")
BACKENDS = (*SIMULATED, "mock", "hardware")
# Pole of the position controllers by that of an actuator [-]; supply by the largest command [-].
_POLE, _RESERVE = 0.1, 1.2
# Faster than legs that damp ever turn the platform: twice what the arm's fastest swing takes
# [rad/s].
_DAMPING_TURN_RATE = 0.5


@dataclass
class GroundScenario(Schema):
    """The ground, which the controller does not know.

    Attributes:
        roll_deg: roll of the ground [deg].
        pitch_deg: pitch of the ground [deg]; the paper's stroke of 30 mm levels about 5 deg.
        foot_heights_mm: height of the ground under each foot above the ground's plane [mm].
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
class PlantScenario(Schema):
    """The simulated machine.

    Attributes:
        leg_model: legs of rigid bodies: "full" has the actuators as bodies in closed loops,
            "reduced" their exact transmission.
        wheels: wheels of rigid bodies: "braked" makes them part of the base, "rolling" gives them
            joints that the wheel drives turn.
        time_step: step of the rigid bodies and of the actuators [s]; the kinematic backend steps
            its actuators with the controller's period.
        accuracy: largest error of a position in a step, with which Drake's CENIC integrates the
            rigid bodies [m, rad]; null: they take steps of `time_step`. With a number that is the
            step of the drives, and the longest one of the bodies. Of the multibody backend alone.
        length_error_mm: largest error of each length of each leg as built, drawn from the seed
            [mm]; the controller knows the drawing only.
        angle_error_deg: largest error of each angle of each leg as built, drawn from the seed
            [deg].
        contact_approximation: Drake's discrete contact approximation: "lagged", "similar" or
            "sap".
    """

    leg_model: str = choice("full", ("full", "reduced"))
    wheels: str = choice("braked", ("braked", "rolling"))
    time_step: float = quantity(1e-3, 1e-4, 2e-2)
    accuracy: float | None = quantity(None, 1e-9, 1e-1)
    length_error_mm: float = quantity(0.0, 0.0, 5.0)
    angle_error_deg: float = quantity(0.0, 0.0, 2.0)
    contact_approximation: str = choice("lagged", ("lagged", "similar", "sap"))


@dataclass
class LegDeviationScenario(Schema):
    """Difference of one leg from its drawing, as far as `parapod run calibrate` can tell.

    Attributes:
        l_x_mm: x from the hip to the platform's centre [mm].
        l_y_mm: y from the hip to the platform's centre [mm].
        l_z_mm: z from the hip to the platform's centre [mm]; answers for the foot's column too.
        beta_deg: yaw of the leg [deg].
        l_3_mm: short side of the parallelogram [mm].
        l_4_mm: long side of the parallelogram [mm].
        alpha_deg: inclination of the short side [deg].
    """

    l_x_mm: float = quantity(0.0, -20.0, 20.0)
    l_y_mm: float = quantity(0.0, -20.0, 20.0)
    l_z_mm: float = quantity(0.0, -20.0, 20.0)
    beta_deg: float = quantity(0.0, -5.0, 5.0)
    l_3_mm: float = quantity(0.0, -10.0, 10.0)
    l_4_mm: float = quantity(0.0, -20.0, 20.0)
    alpha_deg: float = quantity(0.0, -5.0, 5.0)

    @property
    def deviation(self) -> LegDeviation:
        """The same in SI units."""
        return LegDeviation(
            l_x=1e-3 * self.l_x_mm,
            l_y=1e-3 * self.l_y_mm,
            l_z=1e-3 * self.l_z_mm,
            beta=math.radians(self.beta_deg),
            l_3=1e-3 * self.l_3_mm,
            l_4=1e-3 * self.l_4_mm,
            alpha=math.radians(self.alpha_deg),
        )


@dataclass
class ControlScenario(UsualControlScenario):
    """The controller, and what it knows of its machine beside the drawing.

    `parapod adopt` puts what experiments have identified into the last four keys and into
    friction_feedforward.

    Attributes:
        period: period of all controllers and estimators [s].
        pole: p of the position controllers, Eq. (21) [rad/s]; null: a tenth of the actuators' own.
        voltage_limit: largest voltage that is commanded [V]; null: 5/6 of the supply's.
        rate_feedforward: share of the desired rate that is fed forward to the voltages [-].
        friction_feedforward: voltages against friction and the platform's weight, for a leg that
            extends and for one that retracts [V, V]; null: those of the machine as it is set.
        feedforward: law of the legs' feedforward: "exact" is inverse kinematics, "differential"
            the paper's Eq. (26).
        outer_loop: correction of the inclination by the estimated attitude.
        outer_loop_gain: integral gain of that correction [1/s].
        actuator_gains: K of each actuator [(m/s)/V]; null: that of `machine.actuators`.
        encoder_offsets_mm: lengths that are added to what each actuator's encoder measures [mm].
        inclination_bias_deg: errors of the inertial sensor's roll and pitch, which are subtracted
            [deg, deg].
        leg_deviations: differences of legs 1 to 4 from their drawing; empty for none.
        arm_shaper: shaping of the arm's commands, so that its rod does not vibrate: "none", or
            with zero vibration ("zv"), zero derivative besides ("zvd"), or extra insensitive to
            the frequency ("ei").
        arm_frequencies_Hz: frequencies of the arm's vibration [Hz]; null: the first ones of the
            rod that bends, upright.
        arm_damping_ratio: damping ratio of that vibration [-]; null: that of the rod.
        arm_damping_by_legs: inclination of the platform by the legs so that the arm's rod does
            not vibrate: "none", by the arm's commands ("feedforward"), against the vibration that
            an observer has from encoders ("feedback"), or "both".
        tip_answer_ms: time from a command of the tip to posture and joints for it [ms]; null: none
            in a simulation, 300 on hardware, where another process works them out.
    """

    period: float = quantity(0.01, 0.001, 0.05)
    pole: float | None = quantity(None, 0.5, 500.0)
    voltage_limit: float | None = quantity(None, 0.5, 1000.0)
    rate_feedforward: float = quantity(1.0, 0.0, 1.5)
    friction_feedforward: list[float] | None = quantity(None, 0.0, 100.0, length=2)
    feedforward: str = choice("exact", ("exact", "differential"))
    outer_loop: bool = False
    outer_loop_gain: float = quantity(1.0, 0.0, 5.0)
    actuator_gains: list[float] | None = quantity(None, 1e-5, 10.0, length=LEG_COUNT)
    encoder_offsets_mm: list[float] = quantity([0.0] * LEG_COUNT, -20.0, 20.0, length=LEG_COUNT)
    inclination_bias_deg: list[float] = quantity([0.0] * 2, -5.0, 5.0, length=2)
    leg_deviations: list[LegDeviationScenario] = field(default_factory=list)
    arm_shaper: str = choice("none", ("none", *get_args(ShaperKind.__value__)))
    arm_frequencies_Hz: list[float] | None = quantity(None, 0.01, 500.0)  # noqa: N815 (the unit's)
    arm_damping_ratio: float | None = quantity(None, 0.0, 0.3)
    arm_damping_by_legs: str = choice("none", ("none", "feedforward", "feedback", "both"))
    tip_answer_ms: float | None = quantity(None, 0.0, 10_000.0)

    @property
    def encoder_offsets(self) -> NDArray[np.float64]:
        """Lengths (4) that are added to the encoders' extensions [m]."""
        return 1e-3 * np.array(self.encoder_offsets_mm)

    @property
    def inclination_bias(self) -> NDArray[np.float64]:
        """Errors (2) of the inertial sensor's roll and pitch [rad]."""
        return np.radians(self.inclination_bias_deg)


@dataclass
class WaypointScenario(Schema):
    """A posture relative to the level one.

    Attributes:
        time: time of the command, from the start of the levelling [s].
        roll_deg: roll against the level posture [deg].
        pitch_deg: pitch against the level posture [deg].
        height_mm: height above the level posture [mm].
    """

    time: float = quantity(0.0, 0.0, 3600.0)
    roll_deg: float = quantity(0.0, -10.0, 10.0)
    pitch_deg: float = quantity(0.0, -10.0, 10.0)
    height_mm: float = quantity(0.0, -10_000.0, 10_000.0)


@dataclass
class ArmScenario(Schema):
    """The arm's swing while the platform holds.

    Attributes:
        start: beginning of the swing, from the start of the levelling [s].
        angle_deg: angle of the arm's second joint, or its only one; of the drawn arm forward from
            upright [deg].
        duration: duration of the swing [s].
    """

    start: float = quantity(26.0, 0.0, 3600.0)
    angle_deg: float = quantity(45.0, -90.0, 90.0)
    duration: float = quantity(1.0, 0.1, 60.0)


@dataclass
class JobScenario(Schema):
    """The job; times but `estimate_at` are counted from the start of the levelling.

    Attributes:
        start: stance at the beginning: on its "feet", or on its "wheels" with the legs raised and
            the feet above their places.
        start_x_m: distance on wheels from those places, along the platform's x axis (multibody
            backend) [m].
        initial_extension_mm: extension of legs 1 to 3 on feet [mm]; leg 4 is lowered until its
            foot touches, which on a plane makes it equal; null: two thirds of the stroke.
        estimate_at: time at which the ground is estimated and the levelling begins [s]; until then
            the attitude filter settles, and later if that takes longer.
        height_mm: height of the level posture above the ground's plane [mm]; null: about the
            middle of what the stroke allows.
        settled_after: time at which the level posture is taken [s]; errors count from here on.
        waypoints: postures that follow, shrunk together where the stroke is too short.
        arm: see `ArmScenario`.
        end: end of the job [s].
    """

    start: str = choice("feet", ("feet", "wheels"))
    start_x_m: float = quantity(0.0, -100.0, 100.0)
    initial_extension_mm: float | None = quantity(None, 0.1, 20_000.0)
    estimate_at: float = quantity(3.0, 0.5, 60.0)
    height_mm: float | None = quantity(None, 0.0, 20_000.0)
    settled_after: float = quantity(6.0, 0.5, 600.0)
    waypoints: list[WaypointScenario] = field(default_factory=list)
    arm: ArmScenario = field(default_factory=ArmScenario)
    end: float = quantity(30.0, 1.0, 3600.0)


_TARGETS = targets_of(PORTS)


@dataclass
class PlatformFault(FaultScenario):
    """One fault of the platform's signals.

    Attributes:
        target: signal, by its port's name; "supply" is all four drives' voltage at once,
            "posture_command" the posture that is asked for.
        index: element of the port, counted from 0; -1 for all of them.
    """

    target: str = choice("legs.extension", tuple(_TARGETS))
    index: int = quantity(-1, -1, max(target.port.size for target in _TARGETS.values()) - 1)


def emulated_hardware() -> HardwareScenario:
    """The devices of `parapod emulate level`."""
    return HardwareScenario(
        [
            NiDaqLegs(),
            Adis16448SpiImu(),
            Epos2Wheels(),
            NotFittedPart("arm"),
        ]
    )


@dataclass
class LevellingScenario(Schema):
    """One run of the levelling platform.

    Angles are roll and pitch against gravity: positive roll lowers the right side (-y), positive
    pitch lowers the front (+x). Heights are those of the platform's centre above the ground's
    plane. Legs are numbered 1 to 4; leg 4 is the passive one. Equations are those of the paper on
    the platform.

    Attributes:
        backend: plant behind the station's ports: "multibody" (rigid bodies and contact),
            "kinematic" (quasi-static), "mujoco" (rigid bodies of another engine), "mock"
            (commands are mirrored) or "hardware" (devices).
        seed: seed of everything random: gains, biases, noise.
        machine: see `PlatformDesign`; or a file: `!File my_machine.yaml`.
        ground: see `GroundScenario`.
        plant: see `PlantScenario`.
        control: see `ControlScenario`.
        job: see `JobScenario`.
        disturbances: pushes, payload and moving ground, of a simulated machine; see
            `Disturbance`.
        faults: faults of the machine's signals; see `PlatformFault`.
        hardware: see `HardwareScenario`; the defaults are the emulated devices.
    """

    moved = {  # noqa: RUF012
        name: f"machine.{name}" for name in ("actuators", "sensors")
    }

    backend: str = choice("multibody", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: PlatformDesign = field(default_factory=PlatformDesign)
    ground: GroundScenario = field(default_factory=GroundScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    control: ControlScenario = field(default_factory=ControlScenario)
    job: JobScenario = field(default_factory=JobScenario)
    disturbances: list[Disturbance] = field(default_factory=list)
    faults: list[PlatformFault] = field(default_factory=list)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)

    @property
    def has_arm(self) -> bool:
        """Tell whether an arm can be moved: a real one may not be fitted."""
        drivers = self.hardware.drivers if self.backend == "hardware" else []
        is_fitted = not any(d.part == "arm" and isinstance(d, NotFittedPart) for d in drivers)
        return is_fitted and self.machine.masses.arm.count > 0

    @property
    def geometry_as_built(self) -> PlatformGeometry:
        """Dimensions of the machine: the drawing, and errors drawn from the seed."""
        length, angle = self.plant.length_error_mm, self.plant.angle_error_deg
        geometry = self.machine.geometry
        if not (length or angle):
            return geometry
        # A stream of its own: errors do not change what else is drawn from the seed.
        random = np.random.default_rng((self.seed, 1))
        deviations = drawn_deviations(random, 1e-3 * length, math.radians(angle))
        return replace(geometry, deviations=deviations)

    @property
    def geometry_as_known(self) -> PlatformGeometry:
        """Dimensions that the controller reckons with: the drawing, or the legs as identified.

        Raises:
            ScenarioError: deviations of some legs only.
        """
        geometry, legs = self.machine.geometry, self.control.leg_deviations
        if not legs:
            return geometry
        count, key = len(legs), "control.leg_deviations"
        if count != LEG_COUNT:
            raise ScenarioError(f"{key} must have {LEG_COUNT} elements or none, not {count}", key)
        return replace(geometry, deviations=tuple(leg.deviation for leg in legs))

    @property
    def tuned_control(self) -> ControlScenario:
        """The controller, with what follows from the machine where a key is null."""
        control, actuators = self.control, self.machine.actuators
        pole, limit = control.pole, control.voltage_limit
        friction, gains = control.friction_feedforward, control.actuator_gains
        if friction is None:
            friction = [round(volts, 2) for volts in self.machine.friction_voltages]
        return replace(
            control,
            pole=_POLE / (actuators.time_constant_ms / 1e3) if pole is None else pole,
            voltage_limit=actuators.supply_voltage / _RESERVE if limit is None else limit,
            friction_feedforward=friction,
            actuator_gains=[actuators.gain_m_s_V] * LEG_COUNT if gains is None else gains,
        )

    @property
    def fault_detector(self) -> FaultDetectorParams:
        """Limits of normal signals; legs that damp turn the platform faster than postures do."""
        limits = self.machine.fault_detector
        if self.control.arm_damping_by_legs == "none":
            return limits
        return replace(limits, turn_rate=_DAMPING_TURN_RATE)

    @property
    def gain_share(self) -> tuple[float, ...]:
        """Gains of the actuators (4), as the controller knows them, by the nominal one [-]."""
        nominal = self.machine.actuators.params.gain
        return tuple(gain / nominal for gain in self.tuned_control.actuator_gains or ())

    @property
    def level_height(self) -> float:
        """Height of the level posture [m]."""
        height = self.job.height_mm
        return self.machine.working_height if height is None else 1e-3 * height

    @property
    def initial_extensions(self) -> tuple[float, ...]:
        """Extensions of the legs (4) at the beginning on feet, of leg 4 as far as known [m]."""
        extension = self.job.initial_extension_mm
        if extension is None:
            return self.machine.initial_extensions
        return (1e-3 * extension,) * LEG_COUNT
