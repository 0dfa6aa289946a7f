"""Jobs of a machining centre, as experiments run them: refused, timed, watched, judged."""

import copy
import math
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, EventStatus

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.machining_centre.controller import make_controller
from parapod.diagrams.machining_centre.machine import MACHINING_CENTRE
from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.machining_centre.view import draw_panel
from parapod.sims.lab.experiment import LoopExperiment, largest
from parapod.sims.lab.panel import Readout, Row
from parapod.sims.lab.run import Monitor, Run, realtime_metric
from parapod.sims.lab.runner import Runner, make_viewer
from parapod.sims.output.figures import Figure, shade
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ParapodError, ScenarioError
from parapod.systems.core.ports import value_of
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.job import Process
from parapod.systems.machining_centre.operator import CentreControls
from parapod.systems.machining_centre.platform_mode import displacement
from parapod.systems.machining_centre.sequence import (
    Fault,
    Phase,
    SequenceParams,
    expected_duration,
    words_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

type Signals = Mapping[str, NDArray[Any]]

SIGNALS = (
    "pose_desired",
    "phase",
    "operation",
    "fault",
    "done",
    "wrench_index",
    "wrench_margin",
    "clamps.closed",
    "locks.closed",
    "tool.force",
    "legs.position",
    "truth.pose",
    "truth.feet",
    "truth.joints",
    "truth.leg_force",
    "truth.clamp_gap",
    "truth.tip_height",
)
# By how much longer than expected a job may take [-, s].
_LONGER, _MORE = 1.3, 5.0
# Share of the clearance at which the tool counts as retracted.
_RETRACTED = 0.9


class CentreJob(LoopExperiment[CentreScenario, Run]):
    """Runs the job of a scenario to its end.

    Attributes:
        needed_key: key of the scenario that must not be 0, and what the job does if it is.
        picture: name, title, caption and size of its figure.
    """

    machine = MACHINING_CENTRE
    schema = CentreScenario
    backends = MACHINING_CENTRE.backends
    signals = SIGNALS
    advice = (
        "Move the platform with the sliders in the browser; hold a button to lift a foot, again "
        "and again."
    )
    needed_key: ClassVar[tuple[str, str]]
    picture: ClassVar[tuple[str, str, str, tuple[float, float]]]

    def of_truth(self, scenario: CentreScenario, run: Run) -> Iterable[Metric]:
        """Metrics of a job that is simulated."""
        raise NotImplementedError(f"{type(self).__name__} does not define of_truth")

    def draw_truth(self, scenario: CentreScenario, run: Run, canvas: "Canvas") -> None:
        """Draws a job that is simulated."""
        raise NotImplementedError(f"{type(self).__name__} does not define draw_truth")

    def measure(self, scenario: CentreScenario, run: Run) -> Iterator[Metric]:
        """Those of a job that is simulated, forces, and how the centre stands at the end.

        Raises:
            ParapodError: the job was broken off.
        """
        refuse_fault(scenario, run)
        if "truth.pose" in run:
            yield from self.of_truth(scenario, run)
        yield from common_metrics(scenario, run)

    def draw(self, scenario: CentreScenario, run: Run) -> Iterator[Figure]:
        """The picture of a job that is simulated."""
        if "truth.pose" in run:
            name, title, caption, size = self.picture
            drawing = partial(self.draw_truth, scenario, run)
            yield Figure(name, title, caption, drawing, size)

    def check(self, scenario: CentreScenario) -> None:
        """Refuses a job before anything moves.

        Raises:
            ScenarioError: names the key.
            Refused: names the operation, and why it cannot be done.
        """
        super().check(scenario)
        key, words = self.needed_key
        section, name = key.split(".")
        if getattr(getattr(scenario, section), name) == 0:
            raise ScenarioError(f"{key} = 0 {words}; it must be above 0", key)
        _ = scenario.plan

    def duration(self, scenario: CentreScenario) -> float:
        """Longest time in which the job should be done [s]; it ends as soon as it is."""
        plan = scenario.plan
        params = SequenceParams(begin=scenario.begin, settling=scenario.control.settling)
        expected = expected_duration(scenario.machine.geometry, plan.job, plan.beginning, params)
        return _LONGER * expected + scenario.end + _MORE

    def scene(self, scenario: CentreScenario) -> Meshcat:
        """A scene around the centre's way, with the panel."""
        along, across = (0.5 * way for way in scenario.plan.shift)
        camera, target = (along + 1.25, across - 1.45, 0.75), (along, across, 0.24)
        meshcat = make_viewer(camera, target)
        draw_panel(meshcat, scenario.plan, scenario.machine.geometry)
        return meshcat

    def run(self, scenario: CentreScenario, runner: Runner) -> Run:
        """Runs the job until it is done."""

        def until_done(loop: ClosedLoop[Any], meshcat: Meshcat | None) -> Monitor:
            return _until_done(loop, scenario.end)

        return self.run_loop(scenario, runner, monitor=until_done)

    def operated(
        self, scenario: CentreScenario, controls: Any, meshcat: Meshcat | None = None
    ) -> ClosedLoop[CentreScenario]:
        """The centre without a job: a person moves its platform and lifts its feet."""
        idle = copy.deepcopy(scenario)
        idle.holes.count, idle.walk.advance_mm, idle.stop_at = 0, 0.0, None
        source = CentreControls(controls, idle.machine.geometry, idle.plan.beginning.pose)
        controller = partial(make_controller, is_operated=True)
        parts: Any = {"controller": controller, "sources": (source,)}
        return ClosedLoop(MACHINING_CENTRE, idle, meshcat=meshcat, log=(), **parts)

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """Phase, error and margin."""

        def read(port: str) -> list[float]:
            return value_of(loop.controller, port, root_context).tolist()

        phase, (fault, where) = Phase(round(read("phase")[0])), read("fault")
        margin, operations_done = read("wrench_margin")[0], read("operation")[0]
        pose = value_of(loop.controller, "pose_desired", root_context)
        true = loop.readings(root_context, ("truth.pose", "tool.force"))
        at = true["truth.pose"]() if "truth.pose" in true else np.full(6, np.nan)
        rows = [
            Row(name, 1e3 * pose[i], true=1e3 * float(at[i]), unit="mm", decimals=2)
            for i, name in enumerate("xyz")
        ]
        rows += [
            Row(name, math.degrees(pose[i]), true=math.degrees(at[i]), unit="deg", decimals=2)
            for i, name in enumerate(("roll", "pitch", "yaw"), start=3)
        ]
        rows.append(Row("thrust", measured=float(true["tool.force"]()[0]), unit="N", decimals=0))
        rows.append(Row("wrench margin", 0.0, margin, unit="N", decimals=0))
        total = len(loop.scenario.plan.job.operations)
        state = phase.name.lower() + (
            f", {round(operations_done)} of {total} operations done" if total else ""
        )
        if fault:
            return Readout(words_of(round(fault), round(where)), rows, (), True)
        return Readout(state, rows)


def _until_done(loop: ClosedLoop[Any], rest: float) -> Monitor:
    """Ends a run some time after the job is done."""
    done_port = loop.ports["done"]
    system: Any = done_port.get_system()
    ended = math.inf

    def look(root_context: Context) -> EventStatus:
        nonlocal ended
        now = root_context.get_time()
        value: Any = done_port.Eval(system.GetMyContextFromRoot(root_context))
        if value[0] < 0.5:
            ended = math.inf
            return EventStatus.DidNothing()
        ended = min(ended, now)
        if now - ended >= rest:
            return EventStatus.ReachedTermination(system, "the job is done")
        return EventStatus.DidNothing()

    return look


def refuse_fault(scenario: CentreScenario, run: Signals) -> None:
    """Tells why a job was broken off, or was not done in time.

    Raises:
        ParapodError: names phase, fault and where.
    """
    fault, where = (round(value) for value in run["fault"][-1])
    operation = round(run["operation"][-1, 0])
    if fault == Fault.REFUSED:
        words = words_of(fault, where)
    elif fault:
        before = run["phase"][:, 0][run["phase"][:, 0] != Phase.FAULT]
        name = Phase(round(before[-1])).name.lower() if before.size else "the beginning"
        words = f"{words_of(fault, where)}, in {name}"
    elif run["done"][-1, 0] < 0.5:
        words = f"it is still in {Phase(round(run['phase'][-1, 0])).name.lower()}"
    else:
        return
    total = len(scenario.plan.job.operations)
    raise ParapodError(
        f"the job has ended after {operation} of {total} operations: {words}; "
        "everything stands where it was"
    )


def common_metrics(scenario: CentreScenario, run: Run) -> Iterator[Metric]:
    """Forces, index, and how the centre stands at the end."""
    is_simulated = "truth.pose" in run
    if is_simulated:
        yield Metric(
            "peak_force_N",
            largest(run["truth.leg_force"]),
            "N",
            scenario.machine.legs.max_force_N,
            meaning="largest force of any leg",
        )
    machining = run["phase"][:, 0] == Phase.MACHINING
    if machining.any():
        yield Metric(
            "smallest_wrench_index",
            float(run["wrench_index"][machining].min()),
            meaning="smallest w_MinMax of the postures while drilling",
        )
        yield Metric(
            "smallest_wrench_margin_N",
            float(run["wrench_margin"][machining].min()),
            "N",
            at_least=0.0,
            meaning="smallest force resisted in every direction, less drill and weight",
        )
    yield Metric(
        "clamps_open",
        float((run["clamps.closed"][-1] < 0.5).sum()),
        bound=0,
        meaning="feet that are loose at the end",
    )
    if is_simulated and scenario.holes.count:
        yield Metric(
            "tip_height_mm",
            1e3 * float(run["truth.tip_height"][-1, 0]),
            "mm",
            at_least=_RETRACTED * scenario.process.clearance_mm,
            meaning="height of the drill's tip above the panel at the end",
        )
    yield realtime_metric(run)


def tip_errors(process: Process, run: Signals) -> tuple[Array, Array]:
    """Distances of the drill's tip from where it is to be (k) [m], and angles (k) [rad]."""
    true, desired = run["truth.pose"], run["pose_desired"]
    by = displacement(desired, true)
    off = process.tip(true) - process.tip(desired)
    return np.linalg.norm(off, axis=-1), np.linalg.norm(by[:, :3], axis=-1)


def rms(values: Array) -> float:
    """Root mean square; NaN of none."""
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


_SHADES = {
    Phase.MACHINING: "#0072B2",
    Phase.SWING: "#D55E00",
    Phase.RECONFIGURATION: "#999999",
}


def shade_phases(axes: "Axes", run: Run) -> None:
    """Shades the times of machining, swings and reconfigurations."""
    phase = run["phase"][:, 0]
    for kind, colour in _SHADES.items():
        shade(axes, run.time, phase == kind, color=colour, alpha=0.12, lw=0)
