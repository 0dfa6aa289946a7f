"""What every plant of the levelling platform takes and offers."""

from collections.abc import Callable
from dataclasses import dataclass

from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import ZeroOrderHold

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.levelling_platform.inclined_ground import OnInclinedGround
from parapod.systems.levelling_platform.model import PlatformModel


@dataclass(frozen=True)
class Drives:
    """What moves a plant: the drives that all backends share.

    Attributes:
        rods: outputs `extension`, `velocity`, `next_state` of the linear actuators.
        wheels: angles and velocities (8) that the wheels are held to.
        arm: angles and velocities (4) of turntable and arm.
        arm_angles: angles (2) of turntable and arm.
    """

    rods: LeafSystem
    wheels: OutputPort
    arm: OutputPort
    arm_angles: OutputPort


@dataclass(frozen=True)
class Plant:
    """What a plant offers to the sensors and to the truth.

    Attributes:
        signals: ports by name: posture, attitude, angular_velocity, specific_force,
            contact_force, foot_height, load_force, loop_error.
        on_ground: systems that must be told how the ground is inclined.
        holds: holds of attitude, angular_velocity or specific_force, by that name, which begin
            at rest and must be told what that is.
        model: bodies and joints; None where none are simulated.
    """

    signals: dict[str, OutputPort]
    on_ground: tuple[OnInclinedGround, ...]
    holds: dict[str, ZeroOrderHold]
    model: PlatformModel | None


type PlantMaker = Callable[[DiagramBuilder, LevellingScenario, Drives, Meshcat | None], Plant]
