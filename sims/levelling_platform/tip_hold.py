"""Hold the tip in a point while ground gives way, the platform is pushed, and a payload comes.

The platform levels itself and puts its tip to a point, as in `inspect`. Then the disturbances of
the scenario come: by default 10 mm of ground under one foot give way, the platform is pushed, and
the tip takes a payload of half a kilogram. The legs bring the tip back by what inertial sensor and
encoders tell. A rod that bends has no sensor at its tip, so the controller is told what the tip
bears, or not (`hold.payload_is_told`). Where feet slip or roll on the ground no sensor sees it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, EventStatus
from pydrake.trajectories import PiecewisePolynomial
from scipy.signal import lfilter  # type: ignore[import-untyped]

from parapod.diagrams.closed_loop import ClosedLoop
from parapod.diagrams.levelling_platform.disturbances import Payload
from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.pointing import carried_arm, make_pointing_controller
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import named_source
from parapod.sims.lab.experiment import LoopExperiment
from parapod.sims.lab.panel import Readout
from parapod.sims.lab.run import Monitor, Run, realtime_metric
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.inspection import (
    PointScenario,
    read_tip,
    stroke_metric,
    trigger,
)
from parapod.sims.levelling_platform.levelling import check_friction, make_scene
from parapod.sims.levelling_platform.scene import PayloadScene, TipScene
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.ports import value_of
from parapod.systems.core.schema import Schema, quantity
from parapod.systems.levelling_platform.pointing import TipScript

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

# Largest distance of the tip from its point once it has come back [mm]: errors of legs and of
# sensors, and what feet slip and roll meanwhile.
_BOUND = 10.0
# Time over which the place of the tip is averaged, longer than a turn of its vibration [s].
_AVERAGED = 0.6


@dataclass
class HoldScenario(Schema):
    """The point, and what the controller knows.

    Attributes:
        point: see `PointScenario`.
        payload_is_told: true if the controller is told what the tip bears.
        end_s: end of the run [s].
    """

    point: PointScenario = field(default_factory=lambda: PointScenario([1360.0, 810.0, 1890.0]))
    payload_is_told: bool = True
    end_s: float = quantity(62.0, 2.0, 7200.0)


@dataclass
class TipHoldScenario(LevellingScenario):
    """A platform whose tip stays in a point while disturbances come.

    Of `job` beginning, estimate, height and `settled_after` count, after which the tip goes to
    the point.

    Attributes:
        hold: see `HoldScenario`.
    """

    hold: HoldScenario = field(default_factory=HoldScenario)


class TipHold(LoopExperiment[TipHoldScenario, Run]):
    """Holds the tip in a point."""

    machine = PLATFORM
    schema = TipHoldScenario
    signals = (
        *("truth.tip_pose", "truth.tip_deflection", "truth.extension", "truth.foot_height"),
        *("tip_goal", "tip_estimated", "tip_arrived", "stability_margin"),
    )
    takes = "60 s"

    def check(self, scenario: TipHoldScenario) -> None:
        """Refuses a platform without an arm, and a run without disturbances."""
        super().check(scenario)
        check_friction(scenario)
        carried_arm(scenario)
        begins, key = [each.at for each in scenario.disturbances], "disturbances"
        if not begins:
            raise ScenarioError(f"{key} must have 1 element or more", key)
        last = scenario.hold.end_s - _AVERAGED
        if max(begins) > last:
            key = f"{key}.{begins.index(max(begins))}.at"
            raise ScenarioError(
                f"{key} = {max(begins):g} s must be {last:g} or less: the run ends "
                f"{_AVERAGED:g} s after that",
                key,
            )

    def duration(self, scenario: TipHoldScenario) -> float:
        """End of the run [s]."""
        return scenario.hold.end_s

    def loop(self, scenario: TipHoldScenario, **options: Any) -> ClosedLoop[Any]:
        """The machine with the controller of its tip, the point, and what the tip bears."""
        point, payload = scenario.hold.point, _payload_told(scenario)
        script = TipScript(
            [point.command], 0.0, scenario.job.settled_after, scenario.control.period
        )
        make = partial(
            make_pointing_controller,
            has_view=point.view is not None,
            has_payload=payload is not None,
        )
        knowledge = () if payload is None else (named_source("payload", payload),)
        parts: dict[str, Any] = {
            "controller": make,
            "sources": (trigger(scenario), script, *knowledge),
        }
        return ClosedLoop(PLATFORM, scenario, **(parts | options))

    def structure(self, scenario: TipHoldScenario) -> str:
        """See `LoopExperiment`; all of it but what the machine is reset to."""
        return self.machine.structure(scenario)

    def scene(self, scenario: TipHoldScenario) -> Meshcat:
        """The ground's slope against a horizontal floor."""
        return make_scene(scenario, with_arm=True)

    def read_out(self, loop: ClosedLoop[Any], root_context: Context) -> Readout:
        """The tip where it is wanted, measured and true."""
        return read_tip(loop, root_context)

    def run(self, scenario: TipHoldScenario, runner: Runner) -> Run:
        """Runs to the end."""
        return self.run_loop(scenario, runner, monitor=partial(_watch, scenario))

    def measure(self, scenario: TipHoldScenario, run: Run) -> Iterator[Metric]:
        """Distances from the point, times of recovery, vibration and stroke left."""
        distance, bound = 1e3 * _distance(run), _BOUND * scenario.machine.size
        windows = _windows(scenario, run)
        # The average at the end of each window.
        rests = [float(distance[window.samples][-1]) for window in windows]
        yield Metric(
            "tip_error_mm",
            max(rests),
            "mm",
            bound,
            meaning="largest distance of the tip from its point before the next disturbance, "
            "averaged over a turn of the vibration",
        )
        yield Metric(
            "recovery_s",
            float(np.max([_recovery(run, distance, window, bound) for window in windows])),
            "s",
            meaning="time from a disturbance until the tip, averaged, stays within the bound of "
            "its error, the longest",
            undefined="the tip did not come back before the next disturbance",
        )
        first = windows[0].samples.start
        yield Metric(
            "excursion_mm",
            1e3 * float(np.linalg.norm(_missed(run)[first:], axis=1).max()),
            "mm",
            meaning="largest distance of the tip from its point after the first disturbance",
        )
        deflection = run["truth.tip_deflection"][-_samples(run) :]
        swing = 0.5 * float(np.ptp(deflection, axis=0).max())
        yield Metric(
            "residual_mm",
            1e3 * swing,
            "mm",
            meaning="largest amplitude of the rod's vibration at the end",
        )
        yield stroke_metric(scenario, run)
        yield realtime_metric(run)

    def draw(self, scenario: TipHoldScenario, run: Run) -> Iterator[Figure]:
        """Distance of the tip from its point, and the legs."""
        yield Figure(
            "tip_hold",
            "The tip held in a point",
            "Distance of the tip from its point while disturbances come, true and as the machine "
            "measures it; below the extensions of the legs, and how high the feet are above the "
            "ground.",
            partial(_draw, scenario, run),
            (9.0, 6.4),
        )


def _payload_told(scenario: TipHoldScenario) -> PiecewisePolynomial | None:
    """Mass (1) over time of which the controller is told [kg]; None: of none."""
    if scenario.hold.payload_is_told:
        for each in scenario.disturbances:
            if isinstance(each, Payload):
                return each.course
    return None


def _missed(run: Run) -> NDArray[np.float64]:
    """Way (n, 3) from the point to the tip at each sample [m]; NaN before it has one."""
    return run["truth.tip_pose"][:, 4:] - run["tip_goal"]


def _distance(run: Run) -> NDArray[np.float64]:
    """Distance (n) of the tip's average over the time before from its point [m]."""
    count = _samples(run)
    averages = lfilter(np.full(count, 1.0 / count), 1.0, np.nan_to_num(_missed(run)), axis=0)
    distance: NDArray[np.float64] = np.linalg.norm(averages, axis=1)
    return distance


def _samples(run: Run) -> int:
    """Number of samples in the time over which is averaged."""
    return max(1, round(_AVERAGED / float(np.median(np.diff(run.time)))))


class _Window(NamedTuple):
    """Time from some disturbances to the next ones."""

    kinds: list[str]
    begin: float  # [s]
    samples: slice


def _windows(scenario: TipHoldScenario, run: Run) -> list[_Window]:
    """The times after disturbances, in their order; those at one time have one."""
    kinds: dict[float, list[str]] = {}
    for each in sorted(scenario.disturbances, key=lambda each: each.at):
        kinds.setdefault(each.at, []).append(type(each).tag().lower())
    starts = np.searchsorted(run.time, list(kinds)).tolist()
    ends = [*starts[1:], len(run.time)]
    return [
        _Window(names, begin, slice(start, end))
        for (begin, names), start, end in zip(kinds.items(), starts, ends, strict=True)
    ]


def _recovery(run: Run, distance: NDArray[np.float64], window: _Window, bound: float) -> float:
    """Time from the beginning of a window until the distance stays below a bound; NaN: never."""
    start, stop = window.samples.start, window.samples.stop
    beyond = np.flatnonzero(~(distance[start:stop] < bound))
    if not beyond.size:
        return 0.0
    last = start + int(beyond[-1]) + 1
    return float(run.time[last] - run.time[start]) if last < stop else math.nan


def _watch(scenario: TipHoldScenario, loop: ClosedLoop[Any], meshcat: Meshcat | None) -> Monitor:
    """Draws point and way of the tip, and its payload."""
    if meshcat is None:
        return lambda root_context: EventStatus.DidNothing()
    size = scenario.machine.size
    scene = TipScene(meshcat, [scenario.hold.point.command[:3]], size)
    payload = PayloadScene(meshcat, scenario.disturbances, size)

    def look(root_context: Context) -> EventStatus:
        now = root_context.get_time()
        tip = value_of(loop.station, "truth.tip_pose", root_context)[4:]
        scene.show(value_of(loop.controller, "tip_goal", root_context), tip, now)
        payload.show(tip, now)
        return EventStatus.DidNothing()

    return look


def _draw(scenario: TipHoldScenario, run: Run, canvas: "Canvas") -> None:
    geometry = scenario.machine.geometry
    upper, middle, lower = canvas.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    true, measured = (
        1e3 * np.linalg.norm(missed, axis=1)
        for missed in (_missed(run), run["tip_estimated"] - run["tip_goal"])
    )
    upper.plot(run.time, true, label="true", linewidth=1.0)
    upper.plot(run.time, measured, label="as measured", linewidth=1.0)
    upper.plot(run.time, 1e3 * _distance(run), label="true, averaged", linewidth=1.6)
    upper.axhline(_BOUND * scenario.machine.size, color="0.5", linewidth=0.8, linestyle="--")
    begin = min(each.at for each in scenario.disturbances) - 5.0
    upper.set_ylim(0.0, 1.1 * float(np.nanmax(true[run.time > begin])))
    for window in _windows(scenario, run):
        for axes in (upper, middle, lower):
            axes.axvline(window.begin, color="0.75", linewidth=0.8, zorder=0)
        at: Any = (window.begin, 1.0)
        upper.annotate(
            ", ".join(window.kinds),
            at,
            xytext=(3, -10),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            fontsize=8,
        )
    upper.set_ylabel("distance [mm]")
    upper.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    for leg, extension in enumerate(1e3 * run["truth.extension"].T, start=1):
        middle.plot(run.time, extension, label=f"leg {leg}", linewidth=1.2)
    middle.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    for end in (geometry.extension_min, geometry.extension_max):
        middle.axhline(1e3 * end, color="0.5", linewidth=0.8, linestyle="--")
    middle.set_ylabel("extension [mm]")
    lower.plot(run.time, 1e3 * run["truth.foot_height"], linewidth=1.2)
    lower.set(ylabel="foot height [mm]", xlabel="time [s]")
    lower.set_xlim(begin, run.time[-1])
