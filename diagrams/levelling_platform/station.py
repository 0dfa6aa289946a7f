"""The levelling platform seen through its ports; a scenario's backend says what is behind them."""

from collections.abc import Callable

from pydrake.geometry import Meshcat

from parapod.diagrams.levelling_platform.hardware_station import make_hardware_station
from parapod.diagrams.levelling_platform.mock_station import make_mock_station
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.simulated_station import PLANTS, make_simulated_station
from parapod.diagrams.station import Station
from parapod.systems.core.errors import ScenarioError

type LevellingStation = Station[LevellingScenario]

STATIONS: dict[str, Callable[[LevellingScenario, Meshcat | None], LevellingStation]] = {
    **dict.fromkeys(PLANTS, make_simulated_station),
    "mock": make_mock_station,
    "hardware": make_hardware_station,
}


def make_station(scenario: LevellingScenario, meshcat: Meshcat | None = None) -> LevellingStation:
    """Builds the station of a scenario's backend.

    Args:
        scenario: what to build; its `backend` decides about what is behind the ports.
        meshcat: draws the machine there; None for no drawing.

    Raises:
        ScenarioError: unknown backend, or drivers that do not make a machine.
    """
    if scenario.backend not in STATIONS:
        raise ScenarioError(f"backend {scenario.backend!r} is not one of {', '.join(STATIONS)}")
    return STATIONS[scenario.backend](scenario, meshcat)
