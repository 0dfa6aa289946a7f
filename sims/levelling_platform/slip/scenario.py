"""Scenario of a study of slip, and the movements of legs and arm in it."""

import math
from dataclasses import dataclass, field

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.arm_admission import check_swing
from parapod.diagrams.levelling_platform.design import PlatformDesign
from parapod.diagrams.levelling_platform.machine import swing_to
from parapod.diagrams.levelling_platform.parts import SensorScenario
from parapod.diagrams.levelling_platform.scenario import (
    ControlScenario,
    LevellingScenario,
    PlantScenario,
    emulated_hardware,
)
from parapod.sims.levelling_platform.leg_job import on_level_ground
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.kinematics import forward_kinematics, inverse_kinematics

# Share of the way from the lowest to the highest posture to which the legs lift [-].
_HIGH = 0.73
BEGIN = 0.5  # at rest before the lift, and before the creep counts [s]
LEVEL = (0.0, 0.0)  # roll and pitch of the ground [rad]
# Bounds: error of the height, and slip while the legs lift, which is the curve of the feet [mm].
HEIGHT_BOUND, ACTUATOR_SLIP = 0.1, (1.0, 20.0)


@dataclass
class LiftScenario(Schema):
    """The lift, at level attitude.

    Attributes:
        initial_extension_mm: extension of all legs at the beginning [mm]; null: two thirds of the
            stroke.
        height_mm: height at the end, above the ground's plane [mm]; null: 73 % of the way from the
            lowest posture to the highest.
        duration: duration of the lift [s].
        settle: time from the end of the lift until the actuators are braked, so that they arrive
            first [s].
        rest: time with braked actuators until the arm swings [s].
    """

    initial_extension_mm: float | None = quantity(None, 0.1, 20_000.0)
    height_mm: float | None = quantity(None, 0.0, 20_000.0)
    duration: float = quantity(4.0, 0.5, 60.0)
    settle: float = quantity(1.0, 0.0, 60.0)
    rest: float = quantity(1.0, 0.1, 60.0)


@dataclass
class SwingScenario(Schema):
    """The arm's swing.

    Attributes:
        angle_deg: angle forward from upright [deg].
        duration: duration of the swing [s].
        rest: time at rest after the swing [s].
    """

    angle_deg: float = quantity(45.0, -90.0, 90.0)
    duration: float = quantity(1.0, 0.1, 60.0)
    rest: float = quantity(1.0, 0.0, 60.0)


@dataclass
class CreepScenario(Schema):
    """The solver's creep on inclined ground, at time steps of 1, 2 and 4 ms.

    Attributes:
        pitch_deg: pitch of the ground [deg].
        duration: time over which the creep is measured [s].
    """

    pitch_deg: float = quantity(5.0, 0.5, 10.0)
    duration: float = quantity(1.0, 0.1, 60.0)


@dataclass
class SlipScenario(Schema):
    """One study of slip.

    The legs lift the level platform; once it has settled the actuators are braked and the arm
    swings: section 7, Fig. 23.

    Attributes:
        backend: plant: "multibody"; or the real machine, "hardware".
        seed: seed of the errors of gains and dimensions.
        lift: see `LiftScenario`.
        arm: see `SwingScenario`.
        creep: see `CreepScenario`.
        plant: see `PlantScenario`; the creep is measured at time steps of its own.
        machine: see `PlatformDesign`; or a file: `!File my_machine.yaml`.
        control: see `ControlScenario`; its position controllers lift the platform.
        hardware: see `HardwareScenario`; the defaults are the emulated devices.
    """

    moved = {"actuators": "machine.actuators"}  # noqa: RUF012

    backend: str = choice("multibody", ("multibody", "hardware"))
    seed: int = quantity(0, 0, 2**31 - 1)
    lift: LiftScenario = field(default_factory=LiftScenario)
    arm: SwingScenario = field(default_factory=SwingScenario)
    creep: CreepScenario = field(default_factory=CreepScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    machine: PlatformDesign = field(default_factory=PlatformDesign)
    control: ControlScenario = field(default_factory=ControlScenario)
    hardware: HardwareScenario = field(default_factory=emulated_hardware)

    @property
    def levelling(self) -> LevellingScenario:
        """The machine with perfect sensors on level ground."""
        perfect = SensorScenario(0.0, False, 0.0, 0.0, 0.0, self.machine.sensors.imu_place_mm)
        return on_level_ground(self, perfect, self.lift.initial_extension_mm)

    @property
    def height(self) -> float:
        """Height at the end of the lift [m]."""
        height = self.lift.height_mm
        return self.machine.height_at(_HIGH) if height is None else 1e-3 * height

    @property
    def braked_at(self) -> float:
        """Time at which the lift has settled and the actuators are braked [s]."""
        return BEGIN + self.lift.duration + self.lift.settle

    @property
    def swing_at(self) -> float:
        """Time at which the arm begins to swing [s]."""
        return self.braked_at + self.lift.rest

    @property
    def end(self) -> float:
        """End of the study [s]."""
        return self.swing_at + self.arm.duration + self.arm.rest


def lift_trajectory(scenario: SlipScenario) -> PiecewisePolynomial:
    """Extensions (4) that raise the level platform from rest to rest [m].

    Raises:
        UnreachablePosture: a height outside the stroke.
    """
    geometry = scenario.machine.geometry
    start = np.array(scenario.levelling.initial_extensions)
    low = forward_kinematics(geometry, start, LEVEL)[2]
    high = scenario.height
    times = np.linspace(0.0, 1.0, 21)
    heights = low + (high - low) * times**2 * (3.0 - 2.0 * times)
    postures = np.column_stack([np.zeros((times.size, 2)), heights])
    extensions = inverse_kinematics(geometry, postures, LEVEL)
    knots = [0.0, *(BEGIN + scenario.lift.duration * times), scenario.end + 1.0]
    values = [row[:, None] for row in (extensions[0], *extensions, extensions[-1])]
    return PiecewisePolynomial.CubicShapePreserving(knots, values, True)


def control_trajectory(scenario: SlipScenario) -> PiecewisePolynomial:
    """1 while the actuators are controlled, 0 once they are braked."""
    knots = [0.0, scenario.braked_at, scenario.end + 1.0]
    return PiecewisePolynomial.ZeroOrderHold(knots, [[1.0, 0.0, 0.0]])


def swing_trajectory(scenario: SlipScenario) -> PiecewisePolynomial:
    """Positions (n) of the joints of a platform's arm: cubics from rest to rest [rad or m].

    Raises:
        ScenarioError: a swing that the arm's drives cannot follow, or that hits the ground.
    """
    machine = scenario.levelling.machine
    goal = machine.masses.arm.leaning(math.radians(scenario.arm.angle_deg))
    check_swing(machine, goal, scenario.arm.duration, ("arm.angle_deg", "arm.duration"))
    return swing_to(goal, scenario.swing_at, scenario.arm.duration, scenario.end + 1.0)
