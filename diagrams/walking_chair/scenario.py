"""Typed scenario of the walking chair; `parapod scenario chair-walk` shows its explanations."""

from dataclasses import dataclass, field
from typing import ClassVar

from parapod.diagrams.disturbances import Disturbance
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.machine import ControlScenario
from parapod.diagrams.walking_chair.design import ChairDesign, DriveScenario
from parapod.diagrams.walking_chair.drivers import Epos2Legs
from parapod.systems.actuators.compound_position_controller import (
    MODES,
    CompoundPositionControllerParams,
)
from parapod.systems.core.motion_laws import MOTION_LAWS
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.walking_chair.gait import ORDERS, TrotGait, Walk, there_and_back
from parapod.systems.walking_chair.geometry import LegGeometry
from parapod.systems.walking_chair.masses import Passenger

BODIES = ("multibody", "mujoco")  # backends of rigid bodies, each by an engine of its own
SIMULATED = ("multibody", "kinematic", "mujoco")
BACKENDS = (*SIMULATED, "mock", "hardware")
WAYS = ("forward", "back", "forward and back")


@dataclass
class PassengerScenario(Schema):
    """The passenger on the chair.

    Attributes:
        mass_kg: mass [kg]; 57 is the paper's largest, 0 an empty seat.
        x_mm: centre of mass, to the right of the seat's middle [mm].
        y_mm: centre of mass, ahead of the seat's middle [mm].
        height_mm: centre of mass, above the plane of the legs' upper faces [mm].
        gyration_mm: radius of gyration about any axis through the centre of mass [mm]; it
            stretches the drawn person.
    """

    mass_kg: float = quantity(57.0, 0.0, 10_000.0)
    x_mm: float = quantity(0.0, -5000.0, 5000.0)
    y_mm: float = quantity(0.0, -5000.0, 5000.0)
    height_mm: float = quantity(350.0, 0.0, 5000.0)
    gyration_mm: float = quantity(260.0, 1.0, 5000.0)

    @property
    def passenger(self) -> Passenger:
        """The passenger in SI units."""
        places = (1e-3 * self.x_mm, 1e-3 * self.y_mm, 1e-3 * self.height_mm)
        return Passenger(self.mass_kg, *places, gyration=self.gyration_mm / 1e3)


@dataclass
class GaitScenario(Schema):
    """The trotting gait, section "Trotting gait simulation".

    Attributes:
        order: legs that step first: "13-24" begins with legs 1 and 3, "24-13" with legs 2 and 4.
        cycles: steps of each foot, one way.
        way: direction of the walk: "forward", "back" or "forward and back".
        body_law: motion of the body within a phase: "linear" is Eq. (45), with steps of the
            velocity; "ramped", "cycloid" and "quintic" have none.
        lift_mm: z_s, height by which the body is lifted before the first step [mm]; null: 114.7
            of each 300 of the actuators' stroke.
        step_mm: S_0, length of a step [mm]; null: 102.7 of each 300 of the stroke.
        swing_height_mm: H, height of the feet's swing [mm]; null: a third of the stroke.
        phase_duration: T_m, duration of each phase: lift, swing, shift, swing, lowering [s]; null:
            5 s, or as much more as the stroke is longer than the paper's, whose speeds remain.
    """

    order: str = choice("13-24", tuple(ORDERS))
    cycles: int = quantity(1, 1, 1000)
    way: str = choice("forward", WAYS)
    body_law: str = choice("ramped", tuple(MOTION_LAWS))
    lift_mm: float | None = quantity(None, 0.1, 5000.0)
    step_mm: float | None = quantity(None, 0.1, 5000.0)
    swing_height_mm: float | None = quantity(None, 0.1, 5000.0)
    phase_duration: float | None = quantity(None, 0.5, 60.0)

    def walk_of(self, leg: LegGeometry) -> Walk:
        """The gaits in SI units.

        Args:
            leg: legs that walk; theirs are the sizes that are not set.
        """
        usual, size, duration = TrotGait(), leg.size, self.phase_duration
        sizes = (self.lift_mm, usual.lift), (self.step_mm, usual.step)
        lift, step, height = (
            size * of_paper if own_mm is None else 1e-3 * own_mm
            for own_mm, of_paper in (*sizes, (self.swing_height_mm, usual.swing_height))
        )
        gait = TrotGait(
            order=self.order,
            cycles=self.cycles,
            direction="back" if self.way == "back" else "forward",
            lift=lift,
            step=step,
            swing_height=height,
            phase_duration=duration or max(1.0, size) * usual.phase_duration,
            body_law=self.body_law,
        )
        return there_and_back(gait) if self.way == "forward and back" else Walk((gait,))


@dataclass
class ChairPlantScenario(Schema):
    """The simulated machine.

    Attributes:
        time_step: step of the plant of rigid bodies and of the drives [s].
        accuracy: largest error of a position in a step, with which Drake's CENIC integrates the
            rigid bodies [m, rad]; null: they take steps of `time_step`. With a number that is the
            step of the drives, and the longest one of the bodies. Of the multibody backend alone.
        contact_approximation: Drake's discrete contact approximation: "lagged", "similar" or
            "sap".
    """

    time_step: float = quantity(1e-3, 1e-4, 1e-2)
    accuracy: float | None = quantity(None, 1e-9, 1e-1)
    contact_approximation: str = choice("lagged", ("lagged", "similar", "sap"))


@dataclass
class ChairControlScenario(ControlScenario):
    """The controller.

    Attributes:
        period: period of planner and position controllers [s].
        mode: control of the drives, Eqs. (46) to (48): "compound" corrects velocities by the
            positions' errors, "velocity" does not, "position" runs at full speed until the node is
            reached.
        proportional: P of Eq. (47) [1/s].
        k_p: proportional gain of the velocity PI, Eq. (48) [-].
        k_i: integral gain of the velocity PI per sample, Eq. (48) [-].
        support_margin_mm: smallest distance of the centre of mass from the edge of the support
            polygon with which a step is begun [mm].
    """

    period: float = quantity(0.01, 0.001, 0.1)
    mode: str = choice("compound", MODES)
    proportional: float = quantity(10.0, 0.0, 100.0)
    k_p: float = quantity(0.6, 0.0, 10.0)
    k_i: float = quantity(0.25, 0.0, 10.0)
    support_margin_mm: float = quantity(10.0, 0.0, 200.0)

    def params(self, drives: DriveScenario) -> CompoundPositionControllerParams:
        """Parameters of the position controllers."""
        return CompoundPositionControllerParams(
            mode=self.mode,
            proportional=self.proportional,
            k_p=self.k_p,
            k_i=self.k_i,
            velocity_limit=1e-3 * drives.max_velocity_mm_s,
            dead_band=1e-3 * max(drives.encoder_resolution_mm, 1e-3),
        )


def emulated_hardware() -> HardwareScenario:
    """The devices of `parapod emulate chair-walk`."""
    return HardwareScenario([Epos2Legs()])


@dataclass
class ChairScenario(Schema):
    """One walk of the chair.

    x is to the right of the seat, y ahead. Legs are numbered 1 to 4 from the rear left, against
    the clock seen from above: 1 and 2 are the rear ones. Branches are 11, 12, 13, 21, ... 43.

    Attributes:
        backend: plant behind the station's ports: "multibody" (rigid bodies and contact),
            "kinematic" (quasi-static), "mujoco" (rigid bodies of another engine), "mock"
            (commands are mirrored) or "hardware" (devices).
        seed: seed of everything random: the drives' imperfections.
        begin: beginning of the gait; until then the chair settles on its feet [s].
        end: time for which it stands afterwards [s].
        machine: see `ChairDesign`.
        passenger: see `PassengerScenario`.
        gait: see `GaitScenario`.
        plant: see `ChairPlantScenario`.
        control: see `ChairControlScenario`.
        disturbances: forces on bodies, of simulated ones: `Push`, `Weight`, `Cable`, `Wind`; and
            ground that gives, `Subsidence`.
        hardware: see `HardwareScenario`; the defaults are the emulated devices.
    """

    moved: ClassVar = {"drives": "machine.drives"}

    backend: str = choice("multibody", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    begin: float = quantity(1.0, 0.0, 60.0)
    end: float = quantity(1.0, 0.0, 60.0)
    machine: ChairDesign = field(default_factory=ChairDesign)
    passenger: PassengerScenario = field(default_factory=PassengerScenario)
    gait: GaitScenario = field(default_factory=GaitScenario)
    plant: ChairPlantScenario = field(default_factory=ChairPlantScenario)
    control: ChairControlScenario = field(default_factory=ChairControlScenario)
    disturbances: list[Disturbance] = field(default_factory=list)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)

    @property
    def walk(self) -> Walk:
        """The gaits that its legs walk."""
        return self.gait.walk_of(self.machine.geometry.leg)
