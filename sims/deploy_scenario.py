"""Scenario of the whole operation: drive there, stand up, work, leave."""

import math
from dataclasses import dataclass, field

from parapod.diagrams.fault_scenario import FaultScenario
from parapod.diagrams.levelling_platform.scenario import (
    SIMULATED,
    ActuatorScenario,
    ControlScenario,
    GroundScenario,
    JobScenario,
    LevellingScenario,
    PlantScenario,
    SensorScenario,
)
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.levelling_platform.scripts import Step
from parapod.systems.levelling_platform.supervisor import Command, Phase

# Between one thing that the operator does and the next [s].
_PAUSE = 1.0


def uneven_ground() -> GroundScenario:
    """Ground that is inclined, and higher under three of the feet."""
    return GroundScenario(2.0, 3.0, [20.0, 0.0, 12.0, 5.0])


@dataclass
class DriveScenario(Schema):
    """The ways there and back, straight ahead.

    Attributes:
        distance_m: distance of each way [m].
        speed_m_s: speed [m/s].
    """

    distance_m: float = quantity(0.6, 0.0, 100.0)
    speed_m_s: float = quantity(0.3, 0.01, 2.0)

    @property
    def duration(self) -> float:
        """Duration of one way [s]."""
        return self.distance_m / self.speed_m_s


@dataclass
class WorkScenario(Schema):
    """The work of the platform while it stands.

    Attributes:
        roll_deg: roll of the posture [deg].
        pitch_deg: pitch of the posture [deg].
        height_mm: height of the posture above the mean of the ground under the feet [mm].
        arm_deg: angle to which the arm swings and from which it comes back [deg].
        turn_deg: angle of the turntable meanwhile [deg].
        hold_s: time at rest before, between and after the arm's moves [s].
    """

    roll_deg: float = quantity(0.0, -10.0, 10.0)
    pitch_deg: float = quantity(0.0, -10.0, 10.0)
    height_mm: float = quantity(477.0, 380.0, 580.0)
    arm_deg: float = quantity(45.0, -120.0, 120.0)
    turn_deg: float = quantity(0.0, -360.0, 360.0)
    hold_s: float = quantity(2.0, 0.5, 3600.0)

    @property
    def posture(self) -> tuple[float, float, float]:
        """Roll, pitch, height [rad, rad, m]."""
        return math.radians(self.roll_deg), math.radians(self.pitch_deg), 1e-3 * self.height_mm

    @property
    def arm(self) -> tuple[float, float]:
        """Angles of turntable and arm [rad]."""
        return math.radians(self.turn_deg), math.radians(self.arm_deg)


@dataclass
class DeployScenario(Schema):
    """One operation: drive there, stand up, work, leave.

    Attributes:
        backend: plant behind the station's ports: "multibody" (rigid bodies and contact) or
            "kinematic" (quasi-static).
        seed: seed of everything random: gains, biases, noise.
        ground: see `GroundScenario`; the wheels need foot heights of 0 or more.
        drive: see `DriveScenario`.
        work: see `WorkScenario`.
        plant: see `PlantScenario`; the wheels roll.
        actuators: see `ActuatorScenario`.
        sensors: see `SensorScenario`.
        control: see `ControlScenario`.
        faults: faults of the machine's signals; see `FaultScenario`.
        longest: time after which an operation that has not come to its end is ended [s].
    """

    backend: str = choice("multibody", SIMULATED)
    seed: int = quantity(0, 0, 2**31 - 1)
    ground: GroundScenario = field(default_factory=uneven_ground)
    drive: DriveScenario = field(default_factory=DriveScenario)
    work: WorkScenario = field(default_factory=WorkScenario)
    plant: PlantScenario = field(default_factory=PlantScenario)
    actuators: ActuatorScenario = field(default_factory=ActuatorScenario)
    sensors: SensorScenario = field(default_factory=SensorScenario)
    control: ControlScenario = field(default_factory=ControlScenario)
    faults: list[FaultScenario] = field(default_factory=list)
    longest: float = quantity(120.0, 1.0, 7200.0)

    @property
    def machine(self) -> LevellingScenario:
        """The machine on its wheels, on its way."""
        return LevellingScenario(
            backend=self.backend,
            seed=self.seed,
            ground=self.ground,
            plant=self.plant,
            actuators=self.actuators,
            sensors=self.sensors,
            control=self.control,
            job=JobScenario(start="wheels", start_x_m=-self.drive.distance_m),
            faults=self.faults,
        )

    def steps(self) -> tuple[Step, ...]:
        """Steps of the operator."""
        transport, hold = Phase.TRANSPORT, Phase.HOLD
        ahead, stop = (self.drive.speed_m_s, 0.0), (0.0, 0.0)
        return (
            Step(transport, _PAUSE, drive=ahead),
            Step(transport, self.drive.duration, drive=stop),
            Step(transport, _PAUSE, Command.GO),
            Step(hold, self.work.hold_s, arm=self.work.arm),
            Step(hold, self.work.hold_s + _PAUSE, arm=(0.0, 0.0)),
            Step(hold, self.work.hold_s + _PAUSE, Command.STOP),
            Step(transport, _PAUSE, drive=ahead),
            Step(transport, self.drive.duration, drive=stop),
            Step(transport, _PAUSE),
        )
