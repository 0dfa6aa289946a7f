"""The time after a walk: the chair walks on, and sliders move its passenger."""

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from rich.console import Console

from parapod.diagrams.walking_chair.closed_loop import make_closed_loop
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.walking_chair.simulated_station import SimulatedStation
from parapod.sims.live_buttons import RESTART, STOP, buttons, clicked
from parapod.sims.simulate import in_real_time
from parapod.systems.walking_chair.masses import Passenger

# Simulated time between two looks at sliders and buttons [s].
_LOOK_PERIOD = 0.1
_HELP = (
    "The chair walks on, forward and back; move its passenger with the sliders in the browser "
    "(open its controls at the top right). Where the passenger would make it tip over it waits. "
    f"'{RESTART}' begins anew; '{STOP}' or Ctrl-C ends."
)
# Name, smallest and largest value, step: of the passenger's mass and place.
_SLIDERS = (
    ("passenger [kg]", 20.0, 120.0, 1.0),
    ("to the right [mm]", -150.0, 150.0, 5.0),
    ("ahead [mm]", -150.0, 150.0, 5.0),
)


class LiveChair:
    """A chair that walks forward and back until told otherwise.

    Args:
        scenario: its gait, plant and control are taken.
        meshcat: where the chair is drawn and the sliders are.
    """

    def __init__(self, scenario: ChairScenario, meshcat: Meshcat):
        self._scenario, self._meshcat = copy.deepcopy(scenario), meshcat
        gait = self._scenario.gait
        gait.way, gait.cycles = "forward and back", max(gait.cycles, 2)
        self._loop = make_closed_loop(self._scenario, meshcat, log=())
        self._simulator = Simulator(self._loop.diagram)
        assert isinstance(self._loop.station, SimulatedStation)
        self._station = self._loop.station
        self._seated: Passenger | None = None

    def begin(self) -> None:
        """Puts the chair where its walk begins, with whom the sliders say."""
        self._loop.reset(self._simulator.get_mutable_context())
        self._seated = None
        self._simulator.Initialize()

    def advance(self) -> None:
        """Simulates for a moment, with whom the sliders say."""
        context = self._simulator.get_mutable_context()
        passenger = self.asked()
        if passenger != self._seated:
            self._station.plant.seat(context, passenger)
            self._seated = passenger
        self._simulator.AdvanceTo(context.get_time() + _LOOK_PERIOD)

    def asked(self) -> Passenger:
        """The passenger that the sliders ask for."""
        mass, x, y = (self._meshcat.GetSliderValue(name) for name, *_ in _SLIDERS)
        height = 1e-3 * self._scenario.passenger.height_mm
        return Passenger(mass, 1e-3 * x, 1e-3 * y, height)

    def signal(self, name: str) -> float:
        """First element of an output of the controller."""
        controller = self._loop.controller
        context = controller.GetMyContextFromRoot(self._simulator.get_context())
        value: Any = controller.GetOutputPort(name).Eval(context)
        return float(value[0])

    def walk(self, stop: Callable[[], bool]) -> None:
        """Walks in real time until told to stop."""
        self.begin()
        with in_real_time(self._simulator):
            while not stop():
                self.advance()
                if self.signal("done") > 0.5:
                    self.begin()

    @contextmanager
    def sliders(self) -> Iterator[None]:
        """Shows the sliders while it lasts."""
        seat = self._scenario.passenger
        values = (min(max(seat.mass_kg, _SLIDERS[0][1]), _SLIDERS[0][2]), seat.x_mm, seat.y_mm)
        for (name, low, high, step), value in zip(_SLIDERS, values, strict=True):
            self._meshcat.AddSlider(name, low, high, step, value)
        try:
            yield
        finally:
            for name, *_ in _SLIDERS:
                self._meshcat.DeleteSlider(name, strict=False)


def stay_live(scenario: ChairScenario, meshcat: Meshcat, console: Console) -> None:
    """Lets the chair walk on until "Stop" or Ctrl-C.

    Args:
        scenario: of the walk.
        meshcat: where the walk was shown.
        console: where it is said what to do.
    """
    try:
        chair = LiveChair(scenario, meshcat)
        console.print(_HELP, markup=False, highlight=False, soft_wrap=True)
        while True:
            with chair.sliders(), buttons(meshcat):
                chair.walk(lambda: clicked(meshcat, RESTART) or clicked(meshcat, STOP))
                if clicked(meshcat, STOP):
                    return
    except KeyboardInterrupt:
        return
