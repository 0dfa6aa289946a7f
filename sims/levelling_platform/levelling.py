"""Experiments in which the platform levels itself: checks, scene, posture errors, live sliders."""

import copy
import math
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.controller import make_controller
from parapod.diagrams.levelling_platform.machine import PLATFORM, make_job_sources
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.bench import (
    RESTART,
    STOP,
    buttons,
    clicked,
    in_real_time,
    make_viewer,
    simulate,
)
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.figures import COLOURS, Figure
from parapod.sims.lab.results import Metric
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.sliders import PostureSliders

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas


class LevellingExperiment[D](LoopExperiment[LevellingScenario, D]):
    """An experiment in which the platform levels itself and follows postures."""

    machine = PLATFORM
    schema = LevellingScenario

    def check(self, scenario: LevellingScenario) -> None:
        """Refuses a scenario whose parts do not fit together."""
        check_job(scenario)

    def duration(self, scenario: LevellingScenario) -> float:
        """End of the job [s]."""
        return scenario.job.estimate_at + scenario.job.end

    def scene(self, scenario: LevellingScenario) -> Meshcat:
        """The ground's slope against a horizontal floor."""
        return make_scene(scenario)


def check_job(scenario: LevellingScenario) -> None:
    """Refuses a scenario whose parts do not fit together.

    Raises:
        ScenarioError: names the key.
    """
    job, plant, control = scenario.job, scenario.plant, scenario.control
    times = [waypoint.time for waypoint in job.waypoints]
    for i, (earlier, later) in enumerate(pairwise(times), start=1):
        if later < earlier:
            _refuse(
                f"job.waypoints.{i}.time", later, f"earlier than the waypoint before, {earlier:g}"
            )
    if times and times[0] < job.settled_after:
        why = f"earlier than job.settled_after = {job.settled_after:g}"
        _refuse("job.waypoints.0.time", times[0], why)
    swung = job.arm.start + job.arm.duration
    for what, at in (
        ("job.settled_after", job.settled_after),
        ("the last waypoint", max(times, default=0.0)),
        ("the end of the arm's swing", swung),
    ):
        if job.end <= at:
            _refuse("job.end", job.end, f"not after {what}, {at:g}")
    if scenario.backend == "multibody" and control.period < plant.time_step:
        _refuse("control.period", control.period, f"below plant.time_step = {plant.time_step:g}")


def _refuse(key: str, value: float, why: str) -> None:
    raise ScenarioError(f"{key} = {value:g} s is {why} s", key)


def make_scene(scenario: LevellingScenario) -> Meshcat:
    """A scene in which the ground's slope shows against a horizontal floor."""
    meshcat = make_viewer(camera=(1.5, -5.4, 1.2), target=(0.25, 0.0, 1.0))
    R_WG = RollPitchYaw(*scenario.ground.inclination, 0.0).ToRotationMatrix()
    # Under the slab of `ground.sdf`, which is 2.6 m by 2.2 m and 0.04 m thick.
    rim = np.array([(-1.3, -1.1), (1.3, -1.1), (1.3, 1.1), (-1.3, 1.1)])
    top = R_WG @ np.column_stack([rim, np.full(4, -0.04)]).T
    floor = top[2].min() - 0.05
    vertices = np.hstack([top, np.vstack([top[:2], np.full(4, floor)])])
    sides = [(i, 4 + i, 4 + (i + 1) % 4) for i in range(4)]
    sides += [(i, 4 + (i + 1) % 4, (i + 1) % 4) for i in range(4)]
    meshcat.SetTriangleMesh("/ground", vertices, np.array(sides).T, Rgba(0.50, 0.46, 0.41))
    meshcat.SetObject("/floor", Cylinder(4.5, 0.02), Rgba(0.86, 0.89, 0.91))
    meshcat.SetTransform("/floor", RigidTransform(np.array([0.0, 0.0, floor - 0.01])))
    return meshcat


# A posture's elements: key of the error, unit, what the axis of a figure says.
AXES = (
    ("roll_error_deg", "deg", "roll [deg]"),
    ("pitch_error_deg", "deg", "pitch [deg]"),
    ("height_error_mm", "mm", "height [mm]"),
)


def in_deg_and_mm(posture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Postures (..., 3) in deg, deg, mm instead of rad, rad, m."""
    return posture * [math.degrees(1.0), math.degrees(1.0), 1e3]


def error_metrics(
    error: NDArray[np.float64],
    prefix: str = "",
    bounds: tuple[float | None, float | None] = (None, None),
    paper: tuple[float | None, float | None, float | None] = (None, None, None),
    meaning: str = "",
) -> list[Metric]:
    """The largest errors as metrics `<prefix>roll_error_deg`, and so on.

    Args:
        error: (n, 3) errors [deg, deg, mm].
        prefix: of the keys.
        bounds: of the angles [deg] and of the height [mm]; None for none.
        paper: what the paper reports of roll, pitch [deg] and height [mm].
        meaning: of the first metric, for people.
    """
    largest = np.abs(error).max(axis=0)
    return [
        Metric(
            prefix + key,
            float(largest[i]),
            unit,
            bounds[0] if unit == "deg" else bounds[1],
            paper=paper[i],
            meaning="likewise" if i and meaning else meaning,
        )
        for i, (key, unit, _) in enumerate(AXES)
    ]


def posture_figure(
    name: str,
    title: str,
    caption: str,
    time: NDArray[np.float64],
    lines: dict[str, NDArray[np.float64]],
    reference: str,
) -> Figure:
    """Roll, pitch and height over time, above their errors against one of the lines.

    Args:
        name: of the figure's file.
        title: a few words.
        caption: a sentence or two.
        time: (n) [s].
        lines: label -> (n, 3) posture [deg, deg, mm].
        reference: label of the line that the others are compared with.
    """

    def draw(canvas: "Canvas") -> None:
        axes: Any = canvas.subplots(2, 3, sharex=True, height_ratios=(2, 1))
        for i, (_, _, label) in enumerate(AXES):
            for k, (line, posture) in enumerate(lines.items()):
                width = 2.2 if line == reference else 1.0
                colour = COLOURS[k % len(COLOURS)]
                axes[0, i].plot(time, posture[:, i], color=colour, linewidth=width, label=line)
                if line != reference:
                    error = posture[:, i] - lines[reference][:, i]
                    axes[1, i].plot(time, error, color=colour, linewidth=1.0)
            axes[0, i].set_ylabel(label)
            axes[1, i].set_ylabel(f"error [{label.split('[')[1]}")
            axes[1, i].set_xlabel("time [s]")
        canvas.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)

    return Figure(name, title, caption, draw, (9.0, 4.4))


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
        self._loop = ClosedLoop(
            PLATFORM,
            scenario,
            meshcat=meshcat,
            controller=make_controller(scenario, on_unreachable="clamp"),
            sources=(self.sliders, *make_job_sources(scenario)),
            log=(),
        )
        self._simulator = Simulator(self._loop)
        self._posture = self._loop.station.GetOutputPort("truth.posture")

    @property
    def posture(self) -> NDArray[np.float64]:
        """True roll, pitch, height (3) [rad, rad, m]."""
        station = self._loop.station
        context = station.GetMyContextFromRoot(self._simulator.get_context())
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
