"""The levelling platform's station with the real machine behind its ports."""

from pydrake.geometry import Meshcat

from parapod.diagrams.hardware_station import HardwareStation, build_hardware_station
from parapod.diagrams.levelling_platform.ports import INPUTS, OUTPUTS, STATUS_PARTS
from parapod.diagrams.levelling_platform.scenario import LevellingScenario


def make_hardware_station(
    scenario: LevellingScenario, meshcat: Meshcat | None = None
) -> HardwareStation[LevellingScenario]:
    """Builds a station from the drivers of a scenario; nothing is opened yet.

    Args:
        scenario: its `hardware` and `control.period` are taken.
        meshcat: not used; there is no model to draw.

    Raises:
        ScenarioError: drivers that do not make a levelling platform.
    """
    return build_hardware_station(scenario, INPUTS, OUTPUTS, STATUS_PARTS)
