"""The levelling platform without its controller: an experiment drives the ports that it needs."""

from typing import Protocol

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.hardware_scenario import HardwareScenario
from parapod.diagrams.levelling_platform.scenario import (
    ActuatorScenario,
    ControlScenario,
    GroundScenario,
    JobScenario,
    LevellingScenario,
    PlantScenario,
    SensorScenario,
)
from parapod.diagrams.station import Station
from parapod.diagrams.wiring import idle_inputs


class DrivenScenario(Protocol):
    """Settings that the scenarios of such experiments have in common."""

    backend: str
    seed: int
    plant: PlantScenario
    actuators: ActuatorScenario
    control: ControlScenario
    hardware: HardwareScenario


def on_level_ground(
    scenario: DrivenScenario, sensors: SensorScenario, initial_extension_mm: float
) -> LevellingScenario:
    """The machine of a scenario, standing on level ground.

    Args:
        scenario: its backend, seed, plant, actuators, control and hardware are taken.
        sensors: the machine's sensors.
        initial_extension_mm: extension of all legs [mm].
    """
    return LevellingScenario(
        backend=scenario.backend,
        seed=scenario.seed,
        ground=GroundScenario(0.0, 0.0),
        plant=scenario.plant,
        actuators=scenario.actuators,
        sensors=sensors,
        control=scenario.control,
        job=JobScenario(initial_extension_mm=initial_extension_mm),
        hardware=scenario.hardware,
    )


def make_simulator(builder: DiagramBuilder, station: Station[LevellingScenario]) -> Simulator:
    """A simulator, to be initialized, of a diagram in which the machine stands on its feet.

    Args:
        builder: has the station and what drives it; ports that nothing drives are idle.
        station: the machine.
    """
    idle_inputs(builder, station, {port.name: port.idle for port in station.machine.inputs})
    return Simulator(builder.Build())
