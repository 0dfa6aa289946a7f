"""What the experiment `level` measures."""

import math

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.levelling_platform.scenario import JobScenario, LevellingScenario
from parapod.sims.job import Signals
from parapod.sims.posture_errors import in_deg_and_mm
from parapod.sims.results import Metric, Result
from parapod.systems.levelling_platform.kinematics import forward_kinematics, inverse_kinematics
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY

# What the paper's closed loop stayed within (section 7), and what counts as level.
_ANGLE_BOUND = 0.2  # [deg]
_HEIGHT_BOUND = 2.0  # [mm]
# A passive foot that is higher than this does not carry [mm].
_LIFT_BOUND = 1.0
_PASSIVE_LEG = 3  # index of leg 4


def measure(
    scenario: LevellingScenario,
    time: NDArray[np.float64],
    signals: Signals,
    scale: float,
    realtime_factor: float,
) -> Result:
    """What came out of a job, beside its bounds and what the paper reports.

    Args:
        scenario: the job's.
        time: (n,) times of the samples [s].
        signals: port name -> (n, size) samples.
        scale: share of the waypoints' size that fitted.
        realtime_factor: simulated time by wall-clock time.
    """
    is_true = "truth.posture" in signals
    posture = in_deg_and_mm(signals["truth.posture"] if is_true else measured_posture(signals))
    metrics = (
        *(_ground_metrics(scenario, signals) if is_true else ()),
        *_posture_metrics(scenario, time, signals, posture),
        *(_estimate_metrics(scenario, time, signals, posture) if is_true else ()),
        _peak_voltage(scenario, signals),
        *(_leg_metrics(scenario, time, signals) if is_true else ()),
        Metric(
            "posture_scale", scale, meaning="share of the waypoints' size that fits the stroke"
        ),
        Metric("realtime_factor", realtime_factor, meaning="simulated time by wall-clock time"),
    )
    notes = []
    if not is_true:
        notes.append(
            "posture as measured: angles by the inertial sensor, heights by the encoders on the "
            "estimated ground"
        )
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


def measured_posture(signals: Signals) -> NDArray[np.float64]:
    """Postures (n, 3) as the machine's own sensors tell them [rad, rad, m].

    Roll and pitch are those of the inertial sensor, which knows nothing of the legs; the height is
    that of the extensions on the estimated ground, and NaN before there is one.
    """
    ground, valid = signals["ground_estimated"], signals["ground_valid"][:, 0] > 0.5
    posture = np.full((len(ground), 3), np.nan)
    posture[:, :2] = signals["attitude_estimated"]
    posture[valid] = np.column_stack(
        [
            posture[valid, :2],
            forward_kinematics(
                MODEL_GEOMETRY,
                signals["legs.extension"][valid],
                ground[valid],
                legs=(0, 1, 2),
                foot_offsets=signals["foot_offsets_estimated"][valid],
            )[:, 2],
        ]
    )
    return posture


def _posture_metrics(
    scenario: LevellingScenario,
    time: NDArray[np.float64],
    signals: Signals,
    posture: NDArray[np.float64],
) -> list[Metric]:
    desired = in_deg_and_mm(signals["posture_desired_state"][:, :3])
    roll, pitch, height = _largest(posture - desired, _settled(scenario.job, time))
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
    ]


def _estimate_metrics(
    scenario: LevellingScenario,
    time: NDArray[np.float64],
    signals: Signals,
    posture: NDArray[np.float64],
) -> list[Metric]:
    attitude = np.degrees(signals["attitude_estimated"]) - posture[:, :2]
    return [
        Metric(
            "attitude_estimate_error_deg",
            max(_largest(attitude, time >= scenario.job.estimate_at)),
            "deg",
            _ANGLE_BOUND,
            meaning="largest of roll and pitch once levelling has begun",
        )
    ]


def _peak_voltage(scenario: LevellingScenario, signals: Signals) -> Metric:
    return Metric(
        "peak_voltage_V",
        float(np.abs(signals["legs.voltage"]).max()),
        "V",
        scenario.actuators.supply_voltage,
        meaning="largest command to a motor",
    )


def _leg_metrics(
    scenario: LevellingScenario, time: NDArray[np.float64], signals: Signals
) -> list[Metric]:
    lift = 1e3 * signals["truth.foot_height"][_settled(scenario.job, time)].max(axis=0)
    active = np.delete(lift, _PASSIVE_LEG)
    metrics = [
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
