"""The walking chair seen through its ports; a scenario's backend says what is behind them."""

from collections.abc import Callable

from pydrake.geometry import Meshcat

from parapod.diagrams.station import Station
from parapod.diagrams.walking_chair.hardware_station import make_hardware_station
from parapod.diagrams.walking_chair.mock_station import make_mock_station
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.walking_chair.simulated_station import PLANTS, make_simulated_station

type ChairStation = Station[ChairScenario]

STATIONS: dict[str, Callable[[ChairScenario, Meshcat | None], ChairStation]] = {
    **dict.fromkeys(PLANTS, make_simulated_station),
    "mock": make_mock_station,
    "hardware": make_hardware_station,
}


def make_station(scenario: ChairScenario, meshcat: Meshcat | None = None) -> ChairStation:
    """Builds the station of a scenario's backend.

    Args:
        scenario: what to build; its `backend` decides about what is behind the ports.
        meshcat: draws the machine there; None for no drawing.

    Raises:
        ScenarioError: drivers that do not make a machine.
    """
    return STATIONS[scenario.backend](scenario, meshcat)
