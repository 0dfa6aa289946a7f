"""Typed scenario of the terrain simulator; `parapod scenario bench-walk` explains it."""

import math
from dataclasses import dataclass, field

from parapod.diagrams.disturbances import Disturbance
from parapod.diagrams.drivers.ni_daq import NiDaqForceCells
from parapod.diagrams.drivers.not_fitted import NotFittedPart
from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.machine import ControlScenario
from parapod.diagrams.terrain_simulator.design import BenchDesign
from parapod.diagrams.terrain_simulator.drivers import Epos2HipSlide, Epos2Sliders
from parapod.diagrams.terrain_simulator.leg import (
    DEFAULT_URDF,
    LegDescription,
    LegUnderTest,
    UrdfLeg,
)
from parapod.diagrams.terrain_simulator.terrains import Level, TerrainChoice
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.terrain_simulator.gait import Gait
from parapod.systems.terrain_simulator.hip_support import HipSupportParams
from parapod.systems.terrain_simulator.path import PlatePath
from parapod.systems.terrain_simulator.walk import BenchWalk

BODIES = ("multibody",)  # backends of rigid bodies
SIMULATED = (*BODIES, "kinematic")
BACKENDS = (*SIMULATED, "mock", "hardware")
LOADS = ("half sine", "even")
LEGS = ("urdf", "walking_chair")
_SCREWS = 3  # screws of a leg of the walking chair


@dataclass
class GaitScenario(Schema):
    """Gait of the leg.

    Attributes:
        speed_m_s: speed of the body [m/s].
        frequency_Hz: strides a second [Hz].
        duty: share of the stride in which the foot stands [-].
        ramp: share of the plate's return in which its speed ramps up, and down [-]; null: a
            quintic, which needs less acceleration and more speed.
        strides: number of strides at that speed.
        run_up: number of strides in which it speeds up before them, and slows down after them.
        clearance_mm: height of the foot above the plate in the middle of the swing [mm].
        dip_mm: depth by which the plate keeps clear of the foot then [mm].
        load: force of the leg in its stance: "half sine", with which the body bounces, or "even",
            for slow walks: two pairs of legs hand the weight over while both stand.
    """

    speed_m_s: float = quantity(1.5, 0.0, 5.0)
    frequency_Hz: float = quantity(2.0, 0.1, 10.0)  # noqa: N815 (the unit's symbol)
    duty: float = quantity(0.5, 0.05, 0.95)
    ramp: float | None = quantity(0.28, 0.01, 0.5)
    strides: int = quantity(8, 1, 1000)
    run_up: int = quantity(1, 0, 20)
    clearance_mm: float = quantity(30.0, 0.0, 200.0)
    dip_mm: float = quantity(0.0, 0.0, 100.0)
    load: str = choice("half sine", LOADS)


@dataclass
class PlaceScenario(Schema):
    """Place of the leg over the bench.

    Attributes:
        x_mm: place of the hip along the rail, and of the plate's middle under it [mm]; null: the
            middle of what the level plate reaches; with a treadmill a little behind it.
        z_mm: height of the plate's middle with the body at the height of the foothold [mm]; null:
            one at which the bench works well, by the length of its links.
        hip_mm: height of the hip above it [mm].
        start_m: way of the body over the terrain at the beginning [m].
    """

    x_mm: float | None = quantity(None, -20_000.0, 20_000.0)
    z_mm: float | None = quantity(None, 0.0, 20_000.0)
    hip_mm: float = quantity(580.0, 50.0, 20_000.0)
    start_m: float = quantity(0.0, -1000.0, 1000.0)


# Quarter of the robot for which the support of the other legs is given [kg].
_USUAL_MASS = 30.0


@dataclass
class HipScenario(Schema):
    """The hip's slide and its drive.

    Attributes:
        mass_kg: mass that the slide has with the leg [kg]: a quarter of a robot of 120 kg.
        max_force_N: largest force of its drive, both ways [N] (assumption).
        stiffness_N_m: stiffness of the other legs, which the drive plays [N/m]; null: 20000 N/m
            for 30 kg, by the mass (assumption).
        damping_Ns_m: damping of these [N s/m]; null: 1100 N s/m for 30 kg, by the mass
            (assumption).
        washout_s: time constant with which a lasting force of these fades [s].
        adds_inertia: true if the drive adds the force with which the body resists the acceleration
            of its rise over the terrain: on the bench it does not rise, the plate falls.
    """

    mass_kg: float = quantity(30.0, 0.1, 1000.0)
    max_force_N: float = quantity(2000.0, 0.0, 1e5)  # noqa: N815
    stiffness_N_m: float | None = quantity(None, 0.0, 1e6)  # noqa: N815
    damping_Ns_m: float | None = quantity(None, 0.0, 1e5)  # noqa: N815
    washout_s: float = quantity(0.2, 0.01, 100.0)
    adds_inertia: bool = True

    @property
    def support(self) -> HipSupportParams:
        """Stiffness and limit of the drive."""
        usual, mass = HipSupportParams(), self.mass_kg
        stiffness, damping = (
            of_mass * mass / _USUAL_MASS if setting is None else setting
            for setting, of_mass in (
                (self.stiffness_N_m, usual.stiffness),
                (self.damping_Ns_m, usual.damping),
            )
        )
        return HipSupportParams(stiffness, damping, self.washout_s, self.max_force_N)


@dataclass
class ChairLegScenario(Schema):
    """The walking chair's leg as the leg under test: its place on the slide, and its screws.

    Attributes:
        turned: true if its hinge and the corner E_1 are at the rear, as with the rear legs of the
            chair; otherwise they are ahead.
        lean_deg: angle by which the leg hangs inclined, as the chair does on a slope; positive
            uphill [deg].
        ahead_mm: place from the hip, along the slope, over which the leg hangs straight and its
            sole is flat [mm]; behind the whole way of the foot it treads on its rear end alone,
            ahead of it on its front end.
        height_mm: height of the upper platform above the sole there [mm].
        max_velocity_mm_s: largest velocity of a screw [mm/s].
        stiffness_N_um: stiffness of a screw's position loop [N/um].
        damping_Ns_mm: damping of it [N s/mm].
    """

    turned: bool = False
    lean_deg: float = quantity(0.0, -30.0, 30.0)
    ahead_mm: float = quantity(0.0, -200.0, 200.0)
    height_mm: float = quantity(780.1, 600.0, 1000.0)
    max_velocity_mm_s: float = quantity(80.0, 1.0, 1000.0)
    stiffness_N_um: float = quantity(1.0, 0.01, 10.0)  # noqa: N815
    damping_Ns_mm: float = quantity(20.0, 0.01, 100.0)  # noqa: N815

    @property
    def leg(self) -> LegUnderTest:
        """The leg; the walking chair is imported only here."""
        from parapod.diagrams.terrain_simulator.chair_leg import ChairLeg
        from parapod.systems.terrain_simulator.chair_leg import (
            ChairLegModel,
            ChairLegMount,
            ChairScrewParams,
        )

        mount = ChairLegMount(
            self.turned,
            math.radians(self.lean_deg),
            1e-3 * self.ahead_mm,
            1e-3 * self.height_mm,
        )
        return ChairLeg(
            ChairLegModel(mount, max_velocity=1e-3 * self.max_velocity_mm_s),
            ChairScrewParams(1e6 * self.stiffness_N_um, 1e3 * self.damping_Ns_mm),
        )


@dataclass
class LegScenario(Schema):
    """The leg under test, and its controller.

    Attributes:
        controller: controller in the place of the leg's own, as "package.module:name" or
            "file.py:name": what makes it of a scenario; empty: the leg's own.
        kind: "urdf", a leg with a round foot that a file describes, or "walking_chair", the leg of
            that machine, which stands on a platform; of the other keys only `chair` is its own.
        chair: see `ChairLegScenario`.
        urdf: URDF or SDFormat file of the leg, or a `package://` URL.
        hip_frame: its link or frame that is fixed to the slide, x to the front and z up.
        foot_frame: its link or frame in the middle of the round foot.
        foot_radius_mm: radius of the foot [mm].
        joints: its actuated joints, in the order of the ports of the leg.
        posture_deg: positions of the joints in which it stands, about [deg; mm for a slide].
        max_torque: largest torques of the joints' drives [N m; N]; null: those of the file.
        friction: coefficient of friction of the foot on the plate [-].
        stance_stiffness_N_m: springs of the standing foot along x and z [N/m]; null, here and
            below: those of the default leg, 4000 and 8000 N/m, by the mass that the foot shows.
        stance_damping_Ns_m: dampers then [N s/m]; of the default leg 150 and 300 N s/m.
        swing_stiffness_N_m: springs of the swinging foot [N/m]; of the default leg 15000 N/m.
        swing_damping_Ns_m: dampers then [N s/m]; of the default leg 250 N s/m.
    """

    controller: str = ""
    kind: str = choice("urdf", LEGS)
    chair: ChairLegScenario = field(default_factory=ChairLegScenario)
    urdf: str = DEFAULT_URDF
    hip_frame: str = "hip"
    foot_frame: str = "foot"
    foot_radius_mm: float = quantity(20.0, 1.0, 200.0)
    joints: list[str] = field(default_factory=lambda: ["hip", "knee"])
    posture_deg: list[float] = quantity([35.0, -70.0], -1000.0, 1000.0)
    max_torque: list[float] | None = quantity(None, 0.0, 1e6)
    friction: float = quantity(0.8, 0.0, 2.0)
    stance_stiffness_N_m: list[float] | None = quantity(None, 0.0, 1e6, length=2)  # noqa: N815
    stance_damping_Ns_m: list[float] | None = quantity(None, 0.0, 1e5, length=2)  # noqa: N815
    swing_stiffness_N_m: list[float] | None = quantity(None, 0.0, 1e6, length=2)  # noqa: N815
    swing_damping_Ns_m: list[float] | None = quantity(None, 0.0, 1e5, length=2)  # noqa: N815

    @property
    def ports(self) -> int:
        """Number of the actuated joints, which the ports of the leg have."""
        return len(self.joints) if self.kind == "urdf" else _SCREWS

    @property
    def foot_radius(self) -> float:
        """Radius of the foot [m]; 0 of a foot with a flat sole."""
        return 1e-3 * self.foot_radius_mm if self.kind == "urdf" else 0.0

    @property
    def under_test(self) -> LegUnderTest:
        """The leg.

        Raises:
            ScenarioError: see `add_leg`.
        """
        return UrdfLeg(self.description, self.gains) if self.kind == "urdf" else self.chair.leg

    @property
    def description(self) -> LegDescription:
        """The leg in SI units."""
        return LegDescription(
            urdf=self.urdf,
            hip_frame=self.hip_frame,
            foot_frame=self.foot_frame,
            joints=tuple(self.joints),
            posture=tuple(math.radians(angle) for angle in self.posture_deg),
            foot_radius=1e-3 * self.foot_radius_mm,
            max_torque=None if self.max_torque is None else tuple(self.max_torque),
            friction=self.friction,
        )

    @property
    def gains(self) -> tuple[tuple[str, tuple[float, float]], ...]:
        """Springs and dampers of the foot that are given, by their names in `ImpedanceParams`."""
        gains = {
            "stance_stiffness": self.stance_stiffness_N_m,
            "stance_damping": self.stance_damping_Ns_m,
            "swing_stiffness": self.swing_stiffness_N_m,
            "swing_damping": self.swing_damping_Ns_m,
        }
        return tuple((name, (value[0], value[1])) for name, value in gains.items() if value)


@dataclass
class BenchPlantScenario(Schema):
    """The simulated machine.

    Attributes:
        time_step: step of the rigid bodies and of the drives [s].
        accuracy: largest error of a position in a step, with which Drake's CENIC integrates the
            rigid bodies [m, rad]; null: they take steps of `time_step`. With a number that is the
            step of the drives, and the longest one of the bodies. Of the multibody backend alone.
            Joints of the leg have no ends then, and a run in which one comes to an end is refused.
    """

    time_step: float = quantity(1e-3, 1e-4, 5e-3)
    accuracy: float | None = quantity(None, 1e-9, 1e-1)


@dataclass
class BenchControlScenario(ControlScenario):
    """The controllers of bench and leg.

    Attributes:
        period: their period [s].
    """

    period: float = quantity(0.001, 0.0005, 0.02)


def emulated_hardware() -> HardwareScenario:
    """The devices of `parapod emulate bench-walk`."""
    return HardwareScenario(
        [
            Epos2Sliders(),
            Epos2HipSlide(),
            NotFittedPart("belt"),
            NiDaqForceCells(),
            NotFittedPart("leg"),
        ]
    )


@dataclass
class TerrainBenchScenario(Schema):
    """A walk of one leg over a terrain that the bench plays under it.

    Attributes:
        backend: plant behind the station's ports: "multibody" (rigid bodies, contact),
            "kinematic" (the plate without a leg on it), "mock" (commands are mirrored) or
            "hardware".
        seed: seed of everything random: the noise of the force cells.
        machine: see `BenchDesign`; or a file: `!File my_machine.yaml`.
        begin: time for which the leg stands first [s].
        end: time for which it stands at last [s].
        shift: time in which it unloads before the first swing, and loads after the last [s].
        terrain: ground that the leg walks over; see `TerrainChoice`.
        gait: see `GaitScenario`.
        place: see `PlaceScenario`.
        leg: see `LegScenario`.
        hip: see `HipScenario`.
        plant: see `BenchPlantScenario`.
        control: see `BenchControlScenario`.
        disturbances: forces on bodies, of simulated ones: `Push`, `Weight`, `Cable`, `Wind`.
        hardware: see `HardwareScenario`; the defaults are the emulated devices of a pedal.
    """

    moved = {  # noqa: RUF012
        name: f"machine.{name}" for name in ("configuration", "sliders", "cells")
    }

    backend: str = choice("multibody", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    machine: BenchDesign = field(default_factory=BenchDesign)
    begin: float = quantity(0.4, 0.0, 60.0)
    end: float = quantity(0.3, 0.0, 60.0)
    shift: float = quantity(0.3, 0.05, 10.0)
    terrain: TerrainChoice = field(default_factory=Level)
    gait: GaitScenario = field(default_factory=GaitScenario)
    place: PlaceScenario = field(default_factory=PlaceScenario)
    leg: LegScenario = field(default_factory=LegScenario)
    hip: HipScenario = field(default_factory=HipScenario)
    plant: BenchPlantScenario = field(default_factory=BenchPlantScenario)
    control: BenchControlScenario = field(default_factory=BenchControlScenario)
    disturbances: list[Disturbance] = field(default_factory=list)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)

    @property
    def drives_leg(self) -> bool:
        """Whether the leg's drives obey: on the real bench it may have its own controller."""
        if self.backend != "hardware":
            return True
        drivers = self.hardware.drivers
        return any(d.part == "leg" and not isinstance(d, NotFittedPart) for d in drivers)

    @property
    def leg_period(self) -> float:
        """Period with which drives of a leg are commanded [s]; 0 where nothing moves it."""
        moves = self.backend in BODIES or (self.backend == "hardware" and self.drives_leg)
        return self.control.period if moves else 0.0

    @property
    def walk(self) -> BenchWalk:
        """The walk.

        Raises:
            ScenarioError: a terrain whose file cannot be read, or a load that the gait excludes.
        """
        gait, place = self.gait, self.place
        if gait.load == "even" and not gait.duty > 0.5:
            raise ScenarioError(
                f"gait.load = even needs a gait.duty above 0.5, not {gait.duty:g}", "gait.load"
            )
        height = None if place.z_mm is None else 1e-3 * place.z_mm
        x, z = (
            (1e-3 * place.x_mm, 1e-3 * place.z_mm)
            if place.x_mm is not None and place.z_mm is not None
            else self.machine.place(height)
        )
        path = PlatePath(
            self.terrain.make(),
            Gait(gait.speed_m_s, gait.frequency_Hz, gait.duty, gait.ramp),
            x_c=x if place.x_mm is None else 1e-3 * place.x_mm,
            z_c=z,
            dip=1e-3 * gait.dip_mm,
            start=place.start_m,
            treadmill=self.machine.geometry.belt,
        )
        return BenchWalk(
            path,
            mass=self.hip.mass_kg,
            hip_height=1e-3 * place.hip_mm,
            foot_radius=self.leg.foot_radius,
            clearance=1e-3 * gait.clearance_mm,
            begin=self.begin,
            shift=self.shift,
            strides=gait.strides,
            run_up=gait.run_up,
            is_inertial=self.hip.adds_inertia,
            is_even=gait.load == "even",
        )
