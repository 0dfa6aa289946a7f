"""The time after the job: a person moves the platform by sliders in the browser."""

import copy
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator
from rich.console import Console

from parapod.diagrams.levelling_platform.closed_loop import make_closed_loop
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.live_buttons import RESTART, STOP, buttons, clicked
from parapod.sims.simulate import in_real_time, simulate
from parapod.systems.levelling_platform.sliders import PostureSliders

# Simulated time between two looks at the buttons [s].
_LOOK_PERIOD = 0.1
_HELP = (
    "Move the platform with the sliders in the browser (open its controls at the top right). "
    f"'{RESTART}' runs the job again; '{STOP}' or Ctrl-C ends."
)


class LivePlatform:
    """The scenario's platform, which levels itself and then obeys sliders.

    Args:
        scenario: the job's; its waypoints and the arm's swing are left out.
        meshcat: where the platform is drawn and the sliders are.
    """

    def __init__(self, scenario: LevellingScenario, meshcat: Meshcat):
        scenario = copy.deepcopy(scenario)
        scenario.job.arm.angle_deg = 0.0
        self._job = scenario.job
        self.sliders = PostureSliders(meshcat, height=1e-3 * scenario.job.height_mm)
        self._loop = make_closed_loop(
            scenario, meshcat, command=self.sliders, on_unreachable="clamp", log=()
        )
        self._simulator = Simulator(self._loop.diagram)
        self._posture = self._loop.station.diagram.GetOutputPort("truth.posture")

    @property
    def posture(self) -> NDArray[np.float64]:
        """True roll, pitch, height (3) [rad, rad, m]."""
        machine = self._loop.station.diagram
        context = machine.GetMyContextFromRoot(self._simulator.get_context())
        return np.array(self._posture.Eval(context), dtype=float)

    def level(self, console: Console) -> None:
        """Begins anew: estimates the ground and levels, as fast as possible."""
        self._loop.reset(self._simulator.get_mutable_context())
        self._simulator.Initialize()
        until = self._job.estimate_at + self._job.settled_after
        simulate(self._simulator, until, console, "levelling for the sliders")

    def advance(self, duration: float) -> None:
        """Simulates for a duration [s]."""
        self._simulator.AdvanceTo(self._simulator.get_context().get_time() + duration)

    def obey(self, stop: Callable[[], bool]) -> None:
        """Obeys the sliders in real time until told to stop."""
        with in_real_time(self._simulator):
            while not stop():
                self.advance(_LOOK_PERIOD)


def stay_live(
    scenario: LevellingScenario, meshcat: Meshcat, console: Console, job: Callable[[], object]
) -> None:
    """Lets sliders move the platform until "Stop" or Ctrl-C.

    Args:
        scenario: the job's.
        meshcat: where the job was shown.
        console: where it is said what to do.
        job: runs the scripted job once more, in real time.
    """
    try:
        platform = LivePlatform(scenario, meshcat)
        console.print(_HELP, markup=False, highlight=False, soft_wrap=True)
        while True:
            platform.level(console)
            with platform.sliders.shown(), buttons(meshcat):
                platform.obey(lambda: clicked(meshcat, RESTART) or clicked(meshcat, STOP))
                if clicked(meshcat, STOP):
                    return
            job()
    except KeyboardInterrupt:
        return
