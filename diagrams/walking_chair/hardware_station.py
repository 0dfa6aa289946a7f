"""The walking chair's station with the real machine behind its ports."""

from pydrake.geometry import Meshcat

from parapod.diagrams.hardware_station import HardwareStation, build_hardware_station
from parapod.diagrams.walking_chair.ports import INPUTS, OUTPUTS, STATUS_PARTS
from parapod.diagrams.walking_chair.scenario import ChairScenario


def make_hardware_station(
    scenario: ChairScenario, meshcat: Meshcat | None = None
) -> HardwareStation[ChairScenario]:
    """Builds a station from the drivers of a scenario; nothing is opened yet.

    Args:
        scenario: its `hardware` and `control.period` are taken.
        meshcat: not used; there is no model to draw.

    Raises:
        ScenarioError: drivers that do not make a chair.
    """
    return build_hardware_station(scenario, INPUTS, OUTPUTS, STATUS_PARTS)
