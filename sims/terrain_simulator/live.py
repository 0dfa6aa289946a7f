"""The bench in a person's hands: sliders move the plate, buttons have the leg walk."""

from dataclasses import replace
from typing import Any

from pydrake.systems.framework import Context

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.panel import Panel, Readout
from parapod.sims.lab.runner import END, RESTART, Live, in_real_time
from parapod.sims.terrain_simulator.courses import COURSES, scenario_of
from parapod.systems.core.controls import shown
from parapod.systems.core.errors import ParapodError

_SPEED = "speed [%]"
# Fastest that a walk may be by the speed at which its terrain is usually walked [%].
_FASTEST = 200.0


class LiveBench:
    """A bench that a person moves, and on which a leg walks on request, until another one.

    Args:
        experiment: its hooks give the loops of the bench and refuse walks.
        scenario: scenario of the bench; its leg walks, over the terrains of the course.
        panel: the page with the scene.
    """

    def __init__(
        self,
        experiment: LoopExperiment[TerrainBenchScenario, Any],
        scenario: TerrainBenchScenario,
        panel: Panel,
    ):
        self._experiment, self._scenario, self._panel = experiment, scenario, panel
        self._terrains = ["level"] if scenario.machine.geometry.belt else list(COURSES)
        self._state = ""
        self._refusals: tuple[str, ...] = ()

    def obey(self) -> str:
        """Obeys in real time until a person clicks a button; returns which."""
        speed = (_SPEED, 10.0, _FASTEST, 5.0, 100.0)
        with shown(self._panel, [speed], (*self._terrains, RESTART, END)):
            while (clicked := self._stand()) not in (RESTART, END):
                self._walk(clicked)
            return clicked

    def walk_of(self, terrain: str, percent: float) -> TerrainBenchScenario:
        """The scenario of a walk over a terrain at a share of its usual speed [%]."""
        own = self._scenario
        if own.machine.geometry.belt:
            courses = own
        else:
            courses = scenario_of(terrain, own.leg, own.hip.mass_kg, own.machine)
            control = replace(courses.control, controller=own.control.controller)
            courses = replace(courses, control=control)
        speed = 0.01 * percent * courses.gait.speed_m_s
        return replace(courses, gait=replace(courses.gait, speed_m_s=speed))

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """Numbers, with what the leg does, and why it does not walk."""
        readings = self._experiment.read_out(loop, root_context)
        state = f"{self._state}, {readings.state}" if readings.state else self._state
        return replace(readings, state=state, remarks=(*self._refusals, *readings.remarks))

    def _stand(self) -> str:
        """Lets the sliders move the plate until a button is obeyed; returns which."""
        self._state = "stands"
        loop = self._experiment.operated(self._scenario, self._panel, self._panel.meshcat)
        assert loop is not None
        live = Live(self._panel, loop, self.read_out)
        clicks = {name: self._panel.GetButtonClicks(name) for name in self._terrains}
        with live.shown():
            live.begin()
            with in_real_time(live.simulator):
                while True:
                    live.advance()
                    for name in (END, RESTART):
                        if self._panel.GetButtonClicks(name):
                            return name
                    for name, before in clicks.items():
                        clicks[name] = self._panel.GetButtonClicks(name)
                        if clicks[name] > before and self._may_walk(name):
                            return name

    def _asked(self, terrain: str) -> TerrainBenchScenario:
        return self.walk_of(terrain, self._panel.GetSliderValue(_SPEED))

    def _may_walk(self, terrain: str) -> bool:
        """Whether the leg can walk over a terrain; the page says why not."""
        self._refusals = ()
        try:
            self._experiment.check(self._asked(terrain))
        except ParapodError as error:
            self._refusals = (f"no walk over {terrain}: {error}",)
        return not self._refusals

    def _walk(self, terrain: str) -> None:
        """Walks over a terrain to its end."""
        scenario = self._asked(terrain)
        self._state = f"walks over {terrain} at {scenario.gait.speed_m_s:.2f} m/s"
        loop = self._experiment.loop(scenario, meshcat=self._panel.meshcat, log=())
        live = Live(self._panel, loop, self.read_out)
        live.begin()
        until = scenario.walk.duration + scenario.end
        with in_real_time(live.simulator):
            while live.simulator.get_context().get_time() < until:
                live.advance()
                if self._panel.GetButtonClicks(END):
                    return
