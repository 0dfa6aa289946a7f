"""Typed scenario of the walking chair; what each key means is said in the YAML files too."""

from dataclasses import dataclass, field

from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.scenario import choice, quantity
from parapod.diagrams.walking_chair.drivers import Epos2Legs
from parapod.systems.actuators.compound_position_controller import (
    MODES,
    CompoundPositionControllerParams,
)
from parapod.systems.walking_chair.gait import ORDERS, TrotGait, Walk, there_and_back
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.trajectories import MOTION_LAWS

SIMULATED = ("multibody", "kinematic")
BACKENDS = (*SIMULATED, "mock", "hardware")
WAYS = ("forward", "back", "forward and back")


@dataclass
class PassengerScenario:
    """Who sits on the chair.

    Attributes:
        mass_kg: 0 for nobody [kg].
        x_mm: of the centre of mass, to the right of the seat's middle [mm].
        y_mm: ahead of it [mm].
        height_mm: above the plane of the legs' upper faces [mm].
    """

    mass_kg: float = quantity(57.0, 0.0, 250.0)
    x_mm: float = quantity(0.0, -300.0, 300.0)
    y_mm: float = quantity(0.0, -300.0, 300.0)
    height_mm: float = quantity(350.0, 0.0, 1000.0)

    @property
    def passenger(self) -> Passenger:
        """The passenger in SI units."""
        return Passenger(self.mass_kg, 1e-3 * self.x_mm, 1e-3 * self.y_mm, 1e-3 * self.height_mm)


@dataclass
class GaitScenario:
    """The trotting gait, section "Trotting gait simulation".

    Attributes:
        order: legs 1 and 3 first, or 2 and 4.
        cycles: steps of each foot, one way.
        way: where the chair walks.
        body_law: of the body within a phase; "linear" is Eq. (45), with steps of the velocity.
        lift_mm: z_s, how far the body is lifted first [mm].
        step_mm: S_0 [mm].
        swing_height_mm: H of the feet's swing [mm].
        phase_duration: T_m [s].
    """

    order: str = choice("13-24", tuple(ORDERS))
    cycles: int = quantity(1, 1, 1000)
    way: str = choice("forward", WAYS)
    body_law: str = choice("ramped", tuple(MOTION_LAWS))
    lift_mm: float = quantity(114.7, 1.0, 300.0)
    step_mm: float = quantity(102.7, 1.0, 300.0)
    swing_height_mm: float = quantity(100.0, 1.0, 300.0)
    phase_duration: float = quantity(5.0, 0.5, 60.0)

    @property
    def walk(self) -> Walk:
        """The gaits in SI units."""
        gait = TrotGait(
            order=self.order,
            cycles=self.cycles,
            direction="back" if self.way == "back" else "forward",
            lift=1e-3 * self.lift_mm,
            step=1e-3 * self.step_mm,
            swing_height=1e-3 * self.swing_height_mm,
            phase_duration=self.phase_duration,
            body_law=self.body_law,
        )
        return there_and_back(gait) if self.way == "forward and back" else Walk((gait,))


@dataclass
class ChairPlantScenario:
    """The simulated machine.

    Attributes:
        time_step: of the multibody plant and of the drives [s].
        contact_approximation: Drake's discrete contact approximation.
    """

    time_step: float = quantity(1e-3, 1e-4, 1e-2)
    contact_approximation: str = choice("lagged", ("lagged", "similar", "sap"))


@dataclass
class DriveScenario:
    """The twelve velocity-controlled drives; all values are assumptions.

    Attributes:
        time_constant_ms: of a drive's velocity loop [ms].
        max_velocity_mm_s: largest velocity of a branch [mm/s].
        gain_error: each drive's velocity is off by up to this share, drawn from the seed [-].
        offset_mm_s: each drive creeps by up to this, drawn from the seed [mm/s].
        encoder_resolution_mm: one count of the encoders; 0 for a perfect one [mm].
    """

    time_constant_ms: float = quantity(40.0, 1.0, 500.0)
    max_velocity_mm_s: float = quantity(80.0, 1.0, 1000.0)
    gain_error: float = quantity(0.02, 0.0, 0.5)
    offset_mm_s: float = quantity(1.0, 0.0, 20.0)
    encoder_resolution_mm: float = quantity(0.005, 0.0, 1.0)


@dataclass
class ChairControlScenario:
    """The controller.

    Attributes:
        period: of planner and position controllers [s].
        mode: compound corrects velocities by the positions' errors (Eq. 47), velocity does not.
        proportional: P of Eq. (47) [1/s].
        k_p: of the velocity PI, Eq. (48) [-].
        k_i: likewise, per sample [-].
        support_margin_mm: with less between centre of mass and the edge of the support polygon
            no step is begun [mm].
    """

    period: float = quantity(0.01, 0.001, 0.1)
    mode: str = choice("compound", MODES)
    proportional: float = quantity(10.0, 0.0, 100.0)
    k_p: float = quantity(0.6, 0.0, 10.0)
    k_i: float = quantity(0.25, 0.0, 10.0)
    support_margin_mm: float = quantity(10.0, 0.0, 200.0)

    def params(self, drives: DriveScenario) -> CompoundPositionControllerParams:
        """Of the position controllers."""
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
class ChairScenario:
    """One walk of the chair.

    Attributes:
        backend: what is behind the station's ports: one of two simulated plants, "mock" (commands
            are mirrored) or "hardware".
        seed: of everything random: the drives' imperfections.
        begin: when the gait begins; until then the chair stands [s].
        end: how long it stands afterwards [s].
        passenger: see `PassengerScenario`.
        gait: see `GaitScenario`.
        plant: see `ChairPlantScenario`.
        drives: see `DriveScenario`.
        control: see `ChairControlScenario`.
        hardware: see `HardwareScenario`; by default what is emulated.
    """

    backend: str = choice("multibody", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    begin: float = quantity(1.0, 0.0, 60.0)
    end: float = quantity(1.0, 0.0, 60.0)
    passenger: PassengerScenario = field(default_factory=PassengerScenario)
    gait: GaitScenario = field(default_factory=GaitScenario)
    plant: ChairPlantScenario = field(default_factory=ChairPlantScenario)
    drives: DriveScenario = field(default_factory=DriveScenario)
    control: ChairControlScenario = field(default_factory=ChairControlScenario)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)
