"""Level the platform on unknown ground, follow postures, and hold while the arm swings.

Until `job.estimate_at` the platform stands still and its attitude filter settles. Then the ground
is estimated, and the platform levels itself at `job.height_mm`, takes the waypoints' postures one
after the other, and holds while the arm swings.
"""

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from parapod.diagrams.levelling_platform.machine import PLATFORM
from parapod.diagrams.levelling_platform.scenario import BODIES, JobScenario, LevellingScenario
from parapod.sims.lab.panel import Panel
from parapod.sims.lab.run import Run, realtime_metric
from parapod.sims.lab.runner import RESTART
from parapod.sims.levelling_platform.levelling import (
    AS_MEASURED,
    LevellingExperiment,
    LivePlatform,
    in_deg_and_mm,
    measured_posture,
    posture_figure,
)
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.levelling_platform.kinematics import inverse_kinematics

# Errors of the paper's closed loop (section 7), and the bounds of "level".
_ANGLE_BOUND = 0.2  # [deg]
_HEIGHT_BOUND = 2.0  # [mm]
# Number of time constants in which the position loops reach a reference at rest.
_TIME_CONSTANTS = 5.0
# A passive foot that is higher than this does not carry [mm].
_LIFT_BOUND = 1.0
_PASSIVE_LEG = 3  # index of leg 4
# Signals of the metrics; everything else is recorded only for a log. True values are known
# of simulated machines only; of others what they measure.
_NEEDED = (
    "truth.posture",
    "truth.foot_height",
    "truth.loop_error",
    "posture_desired_state",
    "attitude_estimated",
    "ground_estimated",
    "ground_valid",
    "foot_offsets_estimated",
    "legs.extension",
    "legs.voltage",
    "posture_scale",
)


class Level(LevellingExperiment[Run]):
    """Runs the job."""

    backends = PLATFORM.backends
    # Truth is known of simulated machines only; of others what they measure.
    signals = _NEEDED
    takes = "10 s"
    advice = (
        "Move the platform with the sliders in the browser, as far as its legs reach on this "
        "ground."
    )

    def measure(self, scenario: LevellingScenario, run: Run) -> Iterator[Metric]:
        """Errors beside what the paper's closed loop stayed within."""
        is_true = "truth.posture" in run
        true = run.signals.get("truth.posture")
        posture = in_deg_and_mm(measured_posture(run, scenario) if true is None else true)
        if is_true:
            yield from _ground_metrics(scenario, run)
        yield from _posture_metrics(scenario, run, posture)
        if is_true:
            yield from _estimate_metrics(scenario, run, posture)
        yield _peak_voltage(scenario, run)
        if is_true:
            yield from _leg_metrics(scenario, run)
        meaning = "share of the waypoints' size that fits the stroke"
        yield Metric("posture_scale", _scale(run), meaning=meaning)
        yield realtime_metric(run)

    def note(self, scenario: LevellingScenario, run: Run) -> Iterator[str]:
        """The source of the posture, a late estimate, and waypoints that were shrunk."""
        if "truth.posture" not in run:
            yield AS_MEASURED
        times = run.time[run["ground_valid"][:, 0] > 0.5]
        if not times.size:
            yield "the ground was not estimated: the attitude did not settle"
            return
        # The estimate is seen a period after its trigger.
        if (late := times[0] - scenario.job.estimate_at) > 1.5 * scenario.control.period:
            yield f"the ground was estimated {late:.2f} s late: the attitude had not settled"
        if (scale := _scale(run)) < 1.0:
            stroke_left = _stroke_left(scenario, run)
            yield f"waypoints scaled to {100.0 * scale:.0f} %: {stroke_left}"

    def draw(self, scenario: LevellingScenario, run: Run) -> Iterator[Figure]:
        """The posture over the job."""
        yield _figure(scenario, run)

    def live(
        self, scenario: LevellingScenario, panel: Panel, run: Run, console: Console
    ) -> Callable[[], str]:
        """Sliders move the platform; "Restart" runs the job again."""

        def live() -> str:
            platform.level(console)
            with platform.shown():
                button = platform.go_on()
            if button == RESTART:
                run.again()
            return button

        platform = LivePlatform(scenario, panel, self.read_out)
        return live


def _scale(run: Run) -> float:
    return float(run["posture_scale"][-1, 0])


def _ground_metrics(scenario: LevellingScenario, run: Run) -> list[Metric]:
    error = np.degrees(np.abs(run["ground_estimated"][-1] - scenario.ground.inclination))
    return [
        Metric(
            f"ground_{axis}_error_deg",
            float(error[i]),
            "deg",
            _ANGLE_BOUND,
            meaning=f"error of the estimated ground {axis}",
        )
        for i, axis in enumerate(("roll", "pitch"))
    ]


def _posture_metrics(
    scenario: LevellingScenario,
    run: Run,
    posture: NDArray[np.float64],
) -> list[Metric]:
    desired = in_deg_and_mm(run["posture_desired_state"][:, :3])
    height_bound = _HEIGHT_BOUND * scenario.machine.size
    roll, pitch, height = _largest(posture - desired, _settled(scenario.job, run.time))
    return [
        Metric(
            "roll_error_deg",
            roll,
            "deg",
            _ANGLE_BOUND,
            paper=0.2,
            meaning="largest roll error after settling, against gravity",
        ),
        Metric(
            "pitch_error_deg",
            pitch,
            "deg",
            _ANGLE_BOUND,
            paper=0.2,
            meaning="largest pitch error after settling, against gravity",
        ),
        Metric(
            "height_error_mm",
            height,
            "mm",
            height_bound,
            paper=2.0,
            meaning="largest height error after settling, above the ground's plane",
        ),
        Metric(
            "settling_time_s",
            _settling_time(scenario, run.time, posture, _scale(run)),
            "s",
            _settling_bound(scenario, run.time, posture),
            meaning=f"time until level within {_ANGLE_BOUND:g} deg and {height_bound:.3g} mm",
            undefined="the platform was not level before a waypoint asked for another posture, or "
            "the end",
        ),
    ]


def _estimate_metrics(
    scenario: LevellingScenario,
    run: Run,
    posture: NDArray[np.float64],
) -> list[Metric]:
    attitude = np.degrees(run["attitude_estimated"]) - posture[:, :2]
    return [
        Metric(
            "attitude_estimate_error_deg",
            max(_largest(attitude, run.time >= scenario.job.estimate_at)),
            "deg",
            _ANGLE_BOUND,
            meaning="largest error of the estimated roll and pitch once levelling has begun",
        )
    ]


def _peak_voltage(scenario: LevellingScenario, run: Run) -> Metric:
    return Metric(
        "peak_voltage_V",
        float(np.abs(run["legs.voltage"]).max()),
        "V",
        scenario.machine.actuators.supply_voltage,
        meaning="largest command to a motor",
    )


def _leg_metrics(scenario: LevellingScenario, run: Run) -> list[Metric]:
    lift = 1e3 * run["truth.foot_height"][_settled(scenario.job, run.time)].max(axis=0)
    active = np.delete(lift, _PASSIVE_LEG)
    metrics = [
        Metric(
            "passive_leg_lift_mm",
            max(0.0, float(lift[_PASSIVE_LEG])),
            "mm",
            _LIFT_BOUND * scenario.machine.size,
            meaning="largest height of leg 4's foot above the ground",
        ),
        Metric(
            "active_leg_lift_mm",
            max(0.0, float(active.max())),
            "mm",
            _LIFT_BOUND * scenario.machine.size,
            meaning="largest height of another foot above the ground",
        ),
    ]
    if scenario.backend in BODIES and scenario.plant.leg_model == "full":
        gap = 1e6 * float(run["truth.loop_error"].max())
        metrics.append(
            Metric("closure_error_um", gap, "um", meaning="largest gap in the legs' closed loops")
        )
    return metrics


def _largest(error: NDArray[np.float64], when: NDArray[np.bool_]) -> list[float]:
    """Largest absolute value of each column in the rows that count."""
    return np.abs(error[when]).max(axis=0).tolist()


def _settled(job: JobScenario, time: NDArray[np.float64]) -> NDArray[np.bool_]:
    return time >= job.estimate_at + job.settled_after


def _level_bounds(scenario: LevellingScenario) -> NDArray[np.float64]:
    """Bounds of "level": roll and pitch [deg], and height [mm]."""
    return np.array([_ANGLE_BOUND, _ANGLE_BOUND, _HEIGHT_BOUND * scenario.machine.size])


def _settling_bound(
    scenario: LevellingScenario, time: NDArray[np.float64], posture: NDArray[np.float64]
) -> float:
    """Longest duration of the way to the level posture [s].

    The reference moves at most so fast, and the position loops lag behind it.
    """
    job, limits = scenario.job, scenario.machine.posture_reference
    estimated = posture[(time >= job.estimate_at) & np.isfinite(posture).all(axis=1)]
    if not estimated.size:
        return job.settled_after
    roll, pitch, height = estimated[0] - [0.0, 0.0, 1e3 * scenario.level_height]
    longest = limits.duration((math.radians(roll), math.radians(pitch), 1e-3 * height))
    pole = scenario.tuned_control.pole
    assert pole is not None
    return longest + _TIME_CONSTANTS / pole


def _settling_time(
    scenario: LevellingScenario,
    time: NDArray[np.float64],
    posture: NDArray[np.float64],
    scale: float,
) -> float:
    """From the estimate until the platform stays level [s]; infinite if it does not.

    It has to stay so until a waypoint asks for another posture. Waypoints that are shrunk until
    level and they differ by less than the bounds ask for none; they widen the bounds instead.
    """
    job = scenario.job
    since = time - job.estimate_at
    level = _level_bounds(scenario)
    until, tolerance = job.end, np.tile(level, (time.size, 1))
    for waypoint in job.waypoints:
        size = scale * np.abs([waypoint.roll_deg, waypoint.pitch_deg, waypoint.height_mm])
        if (size > level).any():
            until = min(until, waypoint.time)
        else:
            later = since >= waypoint.time
            tolerance[later] = np.maximum(tolerance[later], level + size)
    levelling = (since >= 0.0) & (since < until)
    error = np.abs(posture - [0.0, 0.0, 1e3 * scenario.level_height])
    outside = np.flatnonzero((error > tolerance)[levelling].any(axis=1))
    if not outside.size:
        return 0.0
    last = int(outside[-1]) + 1
    times = time[levelling]
    return float(times[last] - job.estimate_at) if last < times.size else math.inf


def _stroke_left(scenario: LevellingScenario, run: Run) -> str:
    """Stroke that the level posture leaves to the waypoints, in words."""
    geometry = scenario.geometry_as_known
    level = (0.0, 0.0, scenario.level_height)
    extension = inverse_kinematics(geometry, level, run["ground_estimated"][-1])
    stroke_left = np.minimum(
        extension - geometry.extension_min, geometry.extension_max - extension
    )
    leg = int(np.argmin(stroke_left))
    left_mm = 1e3 * stroke_left[leg]
    return f"once level, the ground leaves leg {leg + 1} only {left_mm:.1f} mm of stroke"


def _figure(scenario: LevellingScenario, run: Run) -> Figure:
    desired = run["posture_desired_state"][:, :3]
    started = desired[:, 2] > 0.0
    name, posture = "true", run.signals.get("truth.posture")
    if posture is None:
        name, posture = "measured", measured_posture(run, scenario)
    lines = {
        "asked for": in_deg_and_mm(desired[started]),
        name: in_deg_and_mm(posture[started]),
    }
    return posture_figure(
        "level",
        "The job",
        "Posture against gravity while the platform levels itself, follows postures and holds.",
        run.time[started],
        lines,
        "asked for",
        scenario.job.estimate_at + scenario.job.settled_after,
        (_ANGLE_BOUND, _HEIGHT_BOUND * scenario.machine.size),
    )
