"""The levelling platform's job: find out how the ground slopes, level, follow postures, hold.

Until `job.estimate_at` the platform stands still and its attitude filter settles. Then the ground
is estimated, and the platform levels itself at `job.height_mm`, takes the waypoints' postures one
after the other, and holds while the arm swings.
"""

import math
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, Rgba
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from parapod.diagrams.levelling_platform.closed_loop import make_closed_loop
from parapod.diagrams.levelling_platform.ports import INPUTS, OUTPUTS, TRUTH_OUTPUTS
from parapod.diagrams.levelling_platform.scenario import BACKENDS, JobScenario, LevellingScenario
from parapod.diagrams.scenario import dump_scenario
from parapod.sims.experiment import Experiment, RunOptions
from parapod.sims.live import stay_live
from parapod.sims.outputs import write_log
from parapod.sims.results import Metric, Result
from parapod.sims.simulate import (
    in_real_time,
    make_viewer,
    recording,
    simulate,
    write_graphviz,
)
from parapod.systems.errors import ScenarioError
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.levelling_platform.platform_model import MODEL_GEOMETRY

# What the paper's closed loop stayed within (section 7), and what counts as level.
_ANGLE_BOUND = 0.2  # [deg]
_HEIGHT_BOUND = 2.0  # [mm]
# A passive foot that is higher than this does not carry [mm].
_LIFT_BOUND = 1.0
_PASSIVE_LEG = 3  # index of leg 4

# What the metrics are made of; everything else is recorded only for a log.
_NEEDED = (
    "truth.posture",
    "truth.foot_height",
    "truth.loop_error",
    "posture_desired",
    "attitude_estimated",
    "ground_estimated",
    "legs.voltage",
)
_CONTROLLER_UNITS = {
    "posture_command": "rad, rad, m",
    "posture_desired": "rad, rad, m",
    "extension_desired": "m",
    "ground_estimated": "rad",
    "ground_valid": "0/1",
    "attitude_estimated": "rad",
}

type Signals = dict[str, NDArray[Any]]


def run(scenario: LevellingScenario, options: RunOptions) -> Result:
    """Runs the job.

    Raises:
        ScenarioError: a scenario whose parts do not fit together.
        UnreachablePosture: the level posture is out of reach on this ground.
        OutputError: a file cannot be written.
    """
    check_job(scenario)
    meshcat = _viewer(scenario) if options.meshcat or options.html else None
    loop = make_closed_loop(scenario, meshcat, log=_NEEDED if options.log is None else None)
    if options.graphviz is not None:
        write_graphviz(options.graphviz, loop.diagram)
    simulator = Simulator(loop.diagram)
    until = scenario.job.estimate_at + scenario.job.end

    def job() -> float:
        loop.reset(simulator.get_mutable_context())
        simulator.Initialize()
        with in_real_time(simulator) if options.meshcat else nullcontext():
            return simulate(simulator, until, options.console, "levelling")

    if meshcat is not None and options.meshcat:
        where = f"The platform is shown at {meshcat.web_url()}"
        options.console.print(where, markup=False, highlight=False, soft_wrap=True)
    if meshcat is not None and options.html is not None:
        with recording(meshcat, options.html):
            elapsed = job()
    else:
        elapsed = job()

    context = simulator.get_context()
    time, signals = loop.recorded(context)
    if options.log is not None:
        write_log(options.log, time, signals, _metadata(scenario, signals))
    script = loop.diagram.GetSubsystemByName("posture_script")
    scale = np.asarray(script.GetOutputPort("scale").Eval(script.GetMyContextFromRoot(context)))
    result = _result(scenario, time, signals, float(scale[0]), until / elapsed)
    if meshcat is not None and options.meshcat and options.live:
        go_live = partial(stay_live, scenario, meshcat, options.console, job)
        return replace(result, afterwards=go_live)
    return result


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


def _viewer(scenario: LevellingScenario) -> Meshcat:
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


def _result(
    scenario: LevellingScenario,
    time: NDArray[np.float64],
    signals: Signals,
    scale: float,
    realtime_factor: float,
) -> Result:
    metrics = (
        *_ground_metrics(scenario, signals),
        *_posture_metrics(scenario, time, signals),
        *_leg_metrics(scenario, time, signals),
        Metric(
            "posture_scale", scale, meaning="share of the waypoints' size that fits the stroke"
        ),
        Metric("realtime_factor", realtime_factor, meaning="simulated time by wall-clock time"),
    )
    notes = []
    if scale < 1.0:
        notes.append(
            f"waypoints scaled to {100.0 * scale:.0f} %: {_stroke_left(scenario, signals)}"
        )
    return Result("level", scenario.backend, scenario.seed, metrics, tuple(notes))


def _ground_metrics(scenario: LevellingScenario, signals: Signals) -> list[Metric]:
    error = np.degrees(np.abs(signals["ground_estimated"][-1] - scenario.ground.inclination))
    return [
        Metric(
            f"ground_{axis}_error_deg",
            float(error[i]),
            "deg",
            _ANGLE_BOUND,
            meaning=f"of the estimate of the ground's {axis}",
        )
        for i, axis in enumerate(("roll", "pitch"))
    ]


def _posture_metrics(
    scenario: LevellingScenario, time: NDArray[np.float64], signals: Signals
) -> list[Metric]:
    posture = _in_deg_and_mm(signals["truth.posture"])
    desired = _in_deg_and_mm(signals["posture_desired"])
    roll, pitch, height = _largest(posture - desired, _settled(scenario.job, time))
    attitude = np.degrees(signals["attitude_estimated"]) - posture[:, :2]
    return [
        Metric(
            "roll_error_deg",
            roll,
            "deg",
            _ANGLE_BOUND,
            paper=0.2,
            meaning="largest after settling, against gravity",
        ),
        Metric("pitch_error_deg", pitch, "deg", _ANGLE_BOUND, paper=0.2, meaning="likewise"),
        Metric(
            "height_error_mm",
            height,
            "mm",
            _HEIGHT_BOUND,
            paper=2.0,
            meaning="largest after settling, above the ground's plane",
        ),
        Metric(
            "settling_time_s",
            _settling_time(scenario.job, time, posture),
            "s",
            scenario.job.settled_after,
            meaning=f"until level within {_ANGLE_BOUND:g} deg and {_HEIGHT_BOUND:g} mm",
        ),
        Metric(
            "attitude_estimate_error_deg",
            max(_largest(attitude, time >= scenario.job.estimate_at)),
            "deg",
            _ANGLE_BOUND,
            meaning="largest of roll and pitch once levelling has begun",
        ),
    ]


def _leg_metrics(
    scenario: LevellingScenario, time: NDArray[np.float64], signals: Signals
) -> list[Metric]:
    lift = 1e3 * signals["truth.foot_height"][_settled(scenario.job, time)].max(axis=0)
    active = np.delete(lift, _PASSIVE_LEG)
    metrics = [
        Metric(
            "peak_voltage_V",
            float(np.abs(signals["legs.voltage"]).max()),
            "V",
            scenario.actuators.supply_voltage,
            meaning="largest command to a motor",
        ),
        Metric(
            "passive_leg_lift_mm",
            max(0.0, float(lift[_PASSIVE_LEG])),
            "mm",
            _LIFT_BOUND,
            meaning="how far leg 4's foot leaves the ground",
        ),
        Metric(
            "active_leg_lift_mm",
            max(0.0, float(active.max())),
            "mm",
            _LIFT_BOUND,
            meaning="how far another foot leaves the ground",
        ),
    ]
    if scenario.backend == "multibody" and scenario.plant.leg_model == "full":
        gap = 1e6 * float(signals["truth.loop_error"].max())
        metrics.append(
            Metric("closure_error_um", gap, "um", meaning="largest gap in the legs' closed loops")
        )
    return metrics


def _largest(error: NDArray[np.float64], when: NDArray[np.bool_]) -> list[float]:
    """Largest absolute value of each column in the rows that count."""
    return np.abs(error[when]).max(axis=0).tolist()


def _in_deg_and_mm(posture: NDArray[np.float64]) -> NDArray[np.float64]:
    return posture * [math.degrees(1.0), math.degrees(1.0), 1e3]


def _settled(job: JobScenario, time: NDArray[np.float64]) -> NDArray[np.bool_]:
    return time >= job.estimate_at + job.settled_after


def _settling_time(
    job: JobScenario, time: NDArray[np.float64], posture: NDArray[np.float64]
) -> float:
    """From the estimate until the platform stays level [s]; infinite if it does not."""
    first = job.waypoints[0].time if job.waypoints else job.end
    levelling = (time >= job.estimate_at) & (time < job.estimate_at + first)
    away = np.abs(posture[levelling] - [0.0, 0.0, job.height_mm])
    outside = np.flatnonzero((away > [_ANGLE_BOUND, _ANGLE_BOUND, _HEIGHT_BOUND]).any(axis=1))
    if not outside.size:
        return 0.0
    last = int(outside[-1]) + 1
    times = time[levelling]
    return float(times[last] - job.estimate_at) if last < times.size else math.inf


def _stroke_left(scenario: LevellingScenario, signals: Signals) -> str:
    """How much stroke the level posture leaves to the waypoints, in words."""
    geometry = MODEL_GEOMETRY
    level = (0.0, 0.0, 1e-3 * scenario.job.height_mm)
    extension = inverse_kinematics(geometry, level, signals["ground_estimated"][-1])
    left = np.minimum(extension - geometry.extension_min, geometry.extension_max - extension)
    leg = int(np.argmin(left))
    return f"once level, the ground leaves leg {leg + 1} only {1e3 * left[leg]:.1f} mm of stroke"


def _metadata(scenario: LevellingScenario, signals: Signals) -> dict[str, Any]:
    ports = (*INPUTS, *OUTPUTS, *TRUTH_OUTPUTS)
    units = {port.name: port.unit for port in ports} | _CONTROLLER_UNITS
    return {
        "experiment": "level",
        "parapod": version("parapod"),
        "scenario": dump_scenario(scenario),
        "units": {name: units[name] for name in signals},
    }


EXPERIMENT = Experiment(
    name="level",
    summary=(
        "The platform finds out how the ground slopes, levels itself and follows posture commands."
    ),
    scenario=LevellingScenario,
    backends=BACKENDS,
    run=run,
)
