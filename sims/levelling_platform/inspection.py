"""Look at points with the camera at the arm's tip, one after the other, on unknown ground.

The platform estimates the ground and levels itself; then its tip goes from point to point, and
stays at each. Arm and turntable do what they can, the legs do the rest: before the move by the
inverse kinematics of platform and arm as one chain, at its end by what encoders and inertial
sensor tell of the tip. Of a rod that bends they tell an observer how far.

A real machine is measured by its own sensors, its rod by the observer.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, EventStatus
from pydrake.trajectories import PiecewisePolynomial
from rich.console import Console

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.pointing import carried_arm, make_pointing_controller
from parapod.diagrams.levelling_platform.scenario import SIMULATED, LevellingScenario
from parapod.diagrams.wiring import named_source
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.panel import Panel, Readout, Row
from parapod.sims.lab.run import Monitor, Run, realtime_metric
from parapod.sims.lab.runner import Live, Runner
from parapod.sims.levelling_platform.levelling import check_friction, make_scene
from parapod.sims.levelling_platform.scene import TipScene
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.ports import value_of
from parapod.systems.core.schema import Schema, quantity
from parapod.systems.levelling_platform.pointing import TipScript
from parapod.systems.levelling_platform.sliders import TipSliders

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Largest distance of the tip from its point [mm]: of a machine as drawn, whose sensors are exact;
# of one with errors or noise.
_PERFECT, _WITH_ERRORS = 2.0, 10.0
# Largest amplitude of the rod's vibration at a point [mm]; unshaped it is ten times that.
_RESIDUAL = 15.0
# Deflection of the rod as it is observed, and its largest error, of 150 by which it moves [mm].
_OBSERVED, _OBSERVED_ERROR = "tip_deflection_observed", 18.0
# Time for which the tip stays, beyond which a run goes on [s].
_SEEN = 0.1


@dataclass
class PointScenario(Schema):
    """A point at which the tip is wanted, and how it looks there.

    Attributes:
        place_mm: place in the world: from the middle of the feet, x forward, z up [mm].
        view: direction along the tip's z axis, in the world [-]; null: any. An arm that is not
            free to turn its tip, as the drawn one is not, has one direction for a point.
    """

    place_mm: list[float] = quantity([0.0] * 3, -1e5, 1e5, length=3)
    view: list[float] | None = quantity(None, -1.0, 1.0, length=3)

    @property
    def command(self) -> tuple[float, ...]:
        """Command of the tip (3 or 6) [m]."""
        return (*(1e-3 * x for x in self.place_mm), *(self.view or ()))


# Points around the paper's platform, at all heights [mm].
_POINTS = (
    (1030.0, 20.0, 2360.0),
    (1360.0, 810.0, 1890.0),
    (930.0, 1620.0, 1430.0),
    (0.0, 1470.0, 2020.0),
    (-350.0, 990.0, 2360.0),
    (270.0, 480.0, 2570.0),
    (890.0, -500.0, 2360.0),
    (840.0, -1430.0, 1750.0),
    (0.0, -1890.0, 1270.0),
    (-660.0, -1130.0, 2150.0),
)


@dataclass
class InspectionScenario(Schema):
    """The points, in their order.

    Attributes:
        points: see `PointScenario`.
        hold_s: time at each [s].
        longest_s: time after which a run ends that has not come to the last one [s].
    """

    points: list[PointScenario] = field(
        default_factory=lambda: [PointScenario(list(place)) for place in _POINTS]
    )
    hold_s: float = quantity(0.5, 0.0, 3600.0)
    longest_s: float = quantity(180.0, 1.0, 7200.0)


@dataclass
class InspectScenario(LevellingScenario):
    """A platform whose tip goes from point to point.

    Of `job` beginning, estimate, height and `settled_after` count, after which the tip goes to
    the first point.

    Attributes:
        inspection: see `InspectionScenario`.
    """

    inspection: InspectionScenario = field(default_factory=InspectionScenario)

    @property
    def has_view(self) -> bool:
        """Tell whether points have directions of view."""
        return any(point.view is not None for point in self.inspection.points)


@dataclass(frozen=True)
class Stay:
    """The time for which the tip has stayed at a point.

    Attributes:
        point: the point (3) [m].
        begin: time at which it was asked for [s].
        counts: flags of the samples (n) at which the tip stays there.
    """

    point: NDArray[np.float64]
    begin: float
    counts: NDArray[np.bool_]


class Inspect(LoopExperiment[InspectScenario, Run]):
    """Brings the tip to the points."""

    machine = PLATFORM
    schema = InspectScenario
    signals = (
        *("truth.tip_pose", "truth.tip_deflection", "truth.extension", "truth.posture"),
        *("tip_command", "tip_goal", "tip_estimated", "tip_arrived", "points_done"),
        *("arm.position_command", "stability_margin"),
    )
    backends = (*SIMULATED, "hardware")
    takes = "60 s"
    advice = (
        "Move the tip with the sliders in the browser: arm and turntable go to the red point as "
        "far as they can, and the legs do the rest."
    )

    def needed(self, scenario: InspectScenario) -> tuple[str, ...]:
        """See `LoopExperiment`; of a real machine, what legs measure."""
        is_real = scenario.backend == "hardware"
        return (*super().needed(scenario), *(("legs.extension",) if is_real else ()))

    def check(self, scenario: InspectScenario) -> None:
        """Refuses a platform without an arm, points without end, and views of some points only."""
        super().check(scenario)
        check_friction(scenario)
        carried_arm(scenario)
        if not scenario.has_arm:
            key = "hardware.drivers"
            raise ScenarioError(f"{key}: an arm must be fitted, as !Epos2Arm: its tip moves", key)
        points = scenario.inspection.points
        key = "inspection.points"
        if not points:
            raise ScenarioError(f"{key} must have 1 element or more", key)
        if len({point.view is None for point in points}) > 1:
            raise ScenarioError(f"{key} must all have a view, or none of them", key)
        for i, point in enumerate(points):
            if point.view is not None and not any(point.view):
                key = f"inspection.points.{i}.view"
                raise ScenarioError(
                    f"{key} = {point.view} has no direction: not all may be 0", key
                )

    def duration(self, scenario: InspectScenario) -> float:
        """End of a run that does not come to the last point [s]."""
        return scenario.job.estimate_at + scenario.inspection.longest_s

    def loop(self, scenario: InspectScenario, **options: Any) -> ClosedLoop[Any]:
        """The machine with the controller of its tip, and the list of points."""
        inspection = scenario.inspection
        script = TipScript(
            [point.command for point in inspection.points],
            inspection.hold_s,
            scenario.job.settled_after,
            scenario.control.period,
        )
        parts: dict[str, Any] = {
            "controller": partial(make_pointing_controller, has_view=scenario.has_view),
            "sources": (trigger(scenario), script),
            "log_too": (_OBSERVED,),
        }
        return ClosedLoop(PLATFORM, scenario, **(parts | options))

    def operated(
        self, scenario: InspectScenario, controls: Any, meshcat: Meshcat | None = None
    ) -> ClosedLoop[LevellingScenario]:
        """Sliders in the place of the list."""
        carried = carried_arm(scenario)
        sliders = TipSliders(controls, carried, scenario.level_height)
        return ClosedLoop(
            PLATFORM,
            scenario,
            meshcat=meshcat,
            controller=partial(make_pointing_controller, on_unreachable="clamp"),
            sources=(trigger(scenario), sliders),
            log=(),
        )

    def live(
        self, scenario: InspectScenario, panel: Panel, run: Run, console: Console
    ) -> Callable[[], str]:
        """Sliders move the tip, whose point and way are drawn."""
        loop = self.operated(scenario, panel, panel.meshcat)
        draw = watch_tip(scenario, 0, loop, panel.meshcat)

        def read_out(loop: ClosedLoop[Any], root_context: Context) -> Readout:
            draw(root_context)
            return read_tip(loop, root_context)

        return Live(panel, loop, read_out).obey

    def structure(self, scenario: InspectScenario) -> str:
        """See `LoopExperiment`; all of it but what the machine is reset to."""
        return self.machine.structure(scenario)

    def scene(self, scenario: InspectScenario) -> Meshcat:
        """The ground's slope against a horizontal floor."""
        return make_scene(scenario, with_arm=True)

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """The tip where it is wanted, measured and true."""
        return read_tip(loop, root_context)

    def run(self, scenario: InspectScenario, runner: Runner) -> Run:
        """Runs until the tip has stayed at the last point."""
        monitor = partial(watch_tip, scenario, len(scenario.inspection.points))
        return self.run_loop(scenario, runner, monitor=monitor)

    def measure(self, scenario: InspectScenario, run: Run) -> Iterator[Metric]:
        """Distances from the points, vibration, time and stroke left."""
        count = len(scenario.inspection.points)
        stays = stays_of(run)
        meaning = "number of points at which the tip has not stayed"
        yield Metric("points_left", count - len(stays), "", 0.0, meaning=meaning)
        undefined = "the tip stayed at no point"
        tip = tip_in(run)
        errors = [float(np.linalg.norm(tip[s.counts].mean(axis=0) - s.point)) for s in stays]
        yield Metric(
            "tip_error_mm",
            1e3 * max(errors, default=math.nan),
            "mm",
            tip_bound(scenario),
            meaning="largest distance of the tip from its point, at rest",
            undefined=undefined,
        )
        true, observed = map(run.signals.get, ("truth.tip_deflection", _OBSERVED))
        deflection = observed if true is None else true
        if deflection is not None:
            swings = [0.5 * float(np.ptp(deflection[s.counts], axis=0).max()) for s in stays]
            yield Metric(
                "residual_mm",
                1e3 * max(swings, default=math.nan),
                "mm",
                _RESIDUAL * scenario.machine.size,
                meaning="largest amplitude of the rod's vibration after arrival",
                undefined=undefined,
            )
        if true is not None and observed is not None:
            has_point = np.isfinite(run["tip_goal"][:, 0])
            missed = np.linalg.norm((observed - true)[has_point], axis=1)
            yield Metric(
                "observed_error_mm",
                1e3 * float(missed.max()) if missed.size else math.nan,
                "mm",
                _OBSERVED_ERROR * scenario.machine.size,
                meaning="largest distance of the observed deflection from the true one, always",
                undefined="the tip had no point",
            )
        times = [float(run.time[s.counts][-1]) - s.begin for s in stays]
        yield Metric(
            "time_per_point_s",
            sum(times) / len(times) if times else math.nan,
            "s",
            meaning="time from one point to the end of the stay at the next, on average",
            undefined=undefined,
        )
        yield stroke_metric(scenario, run)
        yield realtime_metric(run)

    def note(self, scenario: InspectScenario, run: Run) -> Iterator[str]:
        """The source of a real machine's tip."""
        if scenario.backend == "hardware":
            yield (
                "the tip as measured: by encoders, inertial sensor and the rod's sag; its "
                "vibration as the observer has it"
            )

    def draw(self, scenario: InspectScenario, run: Run) -> Iterator[Figure]:
        """The way of the tip, and its distance from the points."""
        yield Figure(
            "inspect_way",
            "The way of the tip",
            "The tip from above and from the side; numbers are the points in their order.",
            partial(_draw_way, scenario, run),
            (9.0, 4.6),
        )
        yield Figure(
            "inspect_error",
            "Distance of the tip from its point",
            "Above the distance, true and as the machine measures it, with the times at which the "
            "tip stays; below the extensions of the legs, with the ends of their stroke.",
            partial(_draw_error, scenario, run),
            (9.0, 4.8),
        )


def trigger(scenario: LevellingScenario) -> Any:
    """Source of the trigger of the ground's estimate."""
    times = [0.0, scenario.job.estimate_at, scenario.job.estimate_at + 1e6]
    return named_source(
        "estimate_ground", PiecewisePolynomial.ZeroOrderHold(times, [[0.0, 1.0, 1.0]])
    )


def tip_bound(scenario: LevellingScenario) -> float:
    """Largest admissible distance of the tip from its point [mm]."""
    plant, sensors = scenario.plant, scenario.machine.sensors
    errors = (
        *(plant.length_error_mm, plant.angle_error_deg),
        *(sensors.accel_bias_mg, sensors.gyro_bias_deg_s, sensors.imu_noise),
    )
    return scenario.machine.size * (_WITH_ERRORS if any(errors) else _PERFECT)


def stays_of(run: Run) -> list[Stay]:
    """Times at which the tip has stayed at its points."""
    count, arrived = run["points_done"][:, 0], run["tip_arrived"][:, 0] > 0.5
    goal = run["tip_goal"]
    stays = []
    for k in range(int(count[-1])):
        end = int(np.flatnonzero(count > k)[0])
        is_here = (np.arange(count.size) < end) & (count == k) & np.isfinite(goal[:, 0])
        begin = float(run.time[np.flatnonzero(is_here)[0]])
        # What was true of the point before is not of this one.
        away = np.flatnonzero(is_here & ~arrived)
        first = int(away[-1]) + 1 if away.size else int(np.flatnonzero(is_here)[0])
        counts = is_here & (np.arange(count.size) >= first)
        stays.append(Stay(goal[end - 1], begin, counts))
    return stays


def tip_in(run: Run) -> NDArray[np.float64]:
    """True places of the tip (n, 3), or on a real machine the measured ones [m]."""
    true = run.signals.get("truth.tip_pose")
    return run["tip_estimated"] if true is None else true[:, 4:]


def extension_in(scenario: LevellingScenario, run: Run) -> NDArray[np.float64]:
    """True extensions (n, 4) of the legs, or on a real machine the measured ones [m]."""
    true = run.signals.get("truth.extension")
    return run["legs.extension"] + scenario.control.encoder_offsets if true is None else true


def stroke_metric(scenario: LevellingScenario, run: Run) -> Metric:
    """Stroke that the tightest leg had left at any time after the beginning."""
    geometry = scenario.machine.geometry
    extension = extension_in(scenario, run)[np.isfinite(run["tip_goal"][:, 0])]
    left = np.minimum(extension - geometry.extension_min, geometry.extension_max - extension)
    return Metric(
        "stroke_left_mm",
        1e3 * float(left.min(initial=math.inf)) if left.size else math.nan,
        "mm",
        at_least=0.0,
        meaning="smallest stroke left of any leg",
        undefined="the tip had no point",
    )


def watch_tip(
    scenario: InspectScenario, count: int, loop: ClosedLoop[Any], meshcat: Meshcat | None
) -> Monitor:
    """Draws points and way of the tip, and ends a run after the last point.

    Args:
        scenario: the scenario.
        count: number of the points; 0: the run ends by itself.
        loop: the loop.
        meshcat: its scene, or None.
    """
    points = [point.command[:3] for point in scenario.inspection.points]
    size = scenario.machine.size
    scene = None if meshcat is None else TipScene(meshcat, points[:count], size)
    script = loop.GetSubsystemByName("tip_script") if count else None
    ended: list[float] = []

    def look(root_context: Context) -> EventStatus:
        now = root_context.get_time()
        if scene is not None:
            read = partial(_read, loop, root_context)
            scene.show(read("tip_goal"), read("truth.tip_pose")[4:], now)
        if script is not None and value_of(script, "points_done", root_context)[0] >= count:
            ended.append(now)
            if now >= ended[0] + _SEEN:
                return EventStatus.ReachedTermination(script, "done")
        return EventStatus.DidNothing()

    return look


def _read(loop: ClosedLoop[Any], root_context: Context, name: str) -> NDArray[np.float64]:
    """A signal of controller or station."""
    system = loop.controller if loop.controller.HasOutputPort(name) else loop.station
    return value_of(system, name, root_context)


def read_tip(loop: ClosedLoop[Any], root_context: Context) -> Readout:
    """The tip where it is wanted, measured and true; margin and time."""
    read = partial(_read, loop, root_context)
    goal, measured = 1e3 * read("tip_goal"), 1e3 * read("tip_estimated")
    true = np.full(3, math.nan)
    if loop.station.HasOutputPort("truth.tip_pose"):
        true = 1e3 * read("truth.tip_pose")[4:]
    is_known = bool(read("ground_valid")[0] > 0.5)
    rows = [
        Row(name, _known(goal[i]), _known(measured[i]), _known(true[i]), "mm", 0)
        for i, name in enumerate(("tip's x", "tip's y", "tip's z"))
        if is_known
    ]
    margin = 1e3 * float(read("stability_margin")[0])
    if math.isfinite(margin):
        rows.append(Row("margin", None, margin, None, "mm", 0))
    rows.append(Row("time", measured=root_context.get_time(), unit="s", decimals=1))
    remarks = []
    if read("arm_refused")[0] > 0.5 and is_known and np.isfinite(goal).all():
        remarks.append("refused: the arm's move would leave too small a margin")
    if read("tip_refused")[0] > 0.5:
        remarks.append("refused: the tip cannot be there; the nearest point is aimed at")
    if not is_known:
        state = "waiting for the estimate of the ground"
    elif not np.isfinite(goal).all():
        state = "level"
    else:
        state = "at the point" if read("tip_arrived")[0] > 0.5 else "on its way"
    return Readout(state, rows, remarks)


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _draw_way(scenario: InspectScenario, run: Run, canvas: "Canvas") -> None:
    begins = np.isfinite(run["tip_goal"][:, 0])
    tip = 1e3 * tip_in(run)[begins]
    points = np.array([point.place_mm for point in scenario.inspection.points])
    views: Any = canvas.subplots(1, 2)
    for axes, (i, j) in zip(views, ((0, 1), (0, 2)), strict=True):
        axes.plot(tip[:, i], tip[:, j], linewidth=1.2)
        axes.plot(points[:, i], points[:, j], "o", markersize=4)
        for k, point in enumerate(points):
            at: Any = (point[i], point[j])
            axes.annotate(str(k + 1), at, xytext=(4, 4), textcoords="offset points", fontsize=8)
        axes.set(xlabel="x [mm]", ylabel=f"{'xyz'[j]} [mm]", aspect="equal")
        axes.set_adjustable("datalim")
        axes.margins(0.08)


def _draw_error(scenario: InspectScenario, run: Run, canvas: "Canvas") -> None:
    geometry, goal = scenario.machine.geometry, run["tip_goal"]
    upper, lower = canvas.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    lines = {"as measured": run["tip_estimated"]}
    if "truth.tip_pose" in run:
        lines = {"true": tip_in(run)} | lines
    for label, tip in lines.items():
        distance = 1e3 * np.linalg.norm(tip - goal, axis=1)
        upper.semilogy(run.time, distance, label=label, linewidth=1.2)
    for stay in stays_of(run):
        times = run.time[stay.counts]
        upper.axvspan(times[0], times[-1], color="0.9", zorder=0)
        lower.axvspan(times[0], times[-1], color="0.9", zorder=0)
    bound = tip_bound(scenario)
    upper.axhline(bound, color="0.5", linewidth=0.8, linestyle="--")
    upper.set_ylabel("distance [mm]")
    upper.set_ylim(0.02, None)
    upper.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    lower.plot(run.time, 1e3 * extension_in(scenario, run), linewidth=1.2)
    for end in (geometry.extension_min, geometry.extension_max):
        lower.axhline(1e3 * end, color="0.5", linewidth=0.8, linestyle="--")
    lower.set(ylabel="extension [mm]", xlabel="time [s]")
    times = run.time[np.isfinite(goal[:, 0])]
    if times.size:
        lower.set_xlim(times[0], run.time[-1])
