"""What a walk of the chair is measured by."""

import math

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.sims.job import Signals
from parapod.sims.results import Metric, Result
from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.model import CHAIR_GEOMETRY
from parapod.systems.walking_chair.support import SupportLost

NEEDED = (
    "gait_time",
    "done",
    "support",
    "hold",
    "support_margin",
    "payload_estimated",
    "legs.position",
    "legs.velocity",
    "legs.current",
    "truth.body_position",
    "truth.body_attitude",
    "truth.force",
    "truth.foot_height",
    "truth.loop_error",
)
# The bounds of a walk with the paper's largest passenger; feet creep a little, so that each cycle
# beyond the first adds to the body's error what ten may drift.
_BODY_ERROR = 1.0  # [mm]
_TILT = 0.1  # [deg]
_FORCE = 250.0  # [N]
_DRIFT = 5.0  # [mm]
# Contact is stiff, not rigid: under the load of a leg a corner sinks in by a hundredth [mm].
_SINKING = 0.02
# Up to this step of the plant its loops are closed to a micrometre [s].
_FINE_STEP = 1e-3
_LOOP_ERROR = 1.0  # [um]
# The chair has settled on its feet this long after the start [s].
_SETTLED = 0.5


def measure(
    scenario: ChairScenario, time: NDArray[np.float64], signals: Signals, realtime_factor: float
) -> Result:
    """What came out of a walk, beside its bounds.

    Args:
        scenario: the walk's.
        time: (n) times of the samples [s].
        signals: port name -> (n, size) samples.
        realtime_factor: simulated time by wall-clock time.

    Raises:
        SupportLost: the chair stopped because the passenger was too close to tipping it over.
    """
    _refuse_held(scenario, signals)
    kept = time >= min(_SETTLED, scenario.begin)
    metrics: list[Metric] = []
    if "truth.body_position" in signals:
        metrics += _truth_metrics(scenario, signals, kept)
    metrics += _controller_metrics(scenario, signals, kept)
    metrics.append(
        Metric("realtime_factor", realtime_factor, meaning="simulated time by wall-clock time")
    )
    return Result("chair-walk", scenario.backend, scenario.seed, tuple(metrics))


def _refuse_held(scenario: ChairScenario, signals: Signals) -> None:
    """The walk is not over, because the support monitor has held it."""
    holds = signals["hold"][:, 0] > 0.5
    if signals["done"][-1, 0] > 0.5 or not holds[-1]:
        return
    held = int(np.argmax(holds))
    walk = scenario.gait.walk
    phase = walk.phase_at(float(signals["gait_time"][held, 0]))
    raise SupportLost(
        float(signals["support_margin"][held, 0]),
        1e-3 * scenario.control.support_margin_mm,
        walk.phases[min(phase + 1, len(walk.phases) - 1)],
        walk.ends[phase],
    )


def body_desired(scenario: ChairScenario, signals: Signals) -> NDArray[np.float64]:
    """(n, 3) where the body's centre S should have been [m]."""
    times = signals["gait_time"][:, 0]
    motion = scenario.gait.walk.motions(CHAIR_GEOMETRY, times)
    return np.asarray(motion.body.position)


def lengths_desired(scenario: ChairScenario, signals: Signals) -> NDArray[np.float64]:
    """(n, 12) lengths that the branches should have had [m]."""
    times = signals["gait_time"][:, 0]
    motion = scenario.gait.walk.motions(CHAIR_GEOMETRY, times)
    body, feet = motion.body.position, motion.feet.position
    lengths = chair_inverse(CHAIR_GEOMETRY, body, np.eye(3), feet, motion.references)
    return lengths.reshape(len(times), -1)


def _truth_metrics(
    scenario: ChairScenario, signals: Signals, kept: NDArray[np.bool_]
) -> list[Metric]:
    error = 1e3 * (signals["truth.body_position"] - body_desired(scenario, signals))[kept]
    attitude = np.degrees(signals["truth.body_attitude"][kept])
    force = signals["truth.force"][kept]
    is_fine = scenario.backend == "kinematic" or scenario.plant.time_step <= _FINE_STEP
    heavy = scenario.passenger.mass_kg > 57.0
    cycles = max(gait.cycles for gait in scenario.gait.walk.gaits)
    return [
        Metric(
            "body_error_mm",
            float(np.linalg.norm(error, axis=1).max()),
            "mm",
            _BODY_ERROR + 0.1 * _DRIFT * (cycles - 1),
            meaning="largest distance of the body's centre from where the gait has it",
        ),
        Metric(
            "tilt_deg",
            float(np.abs(attitude[:, :2]).max()),
            "deg",
            _TILT,
            meaning="largest roll or pitch of the body",
        ),
        Metric("yaw_deg", float(np.abs(attitude[:, 2]).max()), "deg", meaning="largest heading"),
        Metric(
            "drift_mm",
            float(np.hypot(*error[-1, :2])),
            "mm",
            _DRIFT,
            meaning="of the body along the ground, after all cycles",
        ),
        Metric(
            "foot_below_ground_mm",
            1e3 * max(0.0, -float(signals["truth.foot_height"][kept].min())),
            "mm",
            _SINKING,
            meaning="lowest corner of any foot; contact gives way a little",
        ),
        Metric(
            "peak_force_N",
            float(np.abs(force).max()),
            "N",
            None if heavy else _FORCE,
            paper="427.3 N at most",
            meaning="largest of any branch",
        ),
        Metric(
            "loop_error_um",
            1e6 * float(signals["truth.loop_error"].max()),
            "um",
            _LOOP_ERROR if is_fine else None,
            meaning="largest gap in the legs' closed loops",
        ),
    ]


def _controller_metrics(
    scenario: ChairScenario, signals: Signals, kept: NDArray[np.bool_]
) -> list[Metric]:
    late = signals["legs.position"] - lengths_desired(scenario, signals)
    payload = signals["payload_estimated"][kept][-1]
    passenger = scenario.passenger
    walking = (signals["gait_time"][:, 0] > 0.0) & (signals["done"][:, 0] < 0.5)
    estimates = signals["payload_estimated"][walking]
    mass_error = np.abs(estimates[:, 0] - passenger.mass_kg).max()
    metrics = [
        Metric(
            "branch_error_mm",
            1e3 * float(np.abs(late[kept]).max()),
            "mm",
            meaning="largest distance of a branch from where it should be",
        ),
        Metric(
            "max_branch_speed_mm_s",
            1e3 * float(np.abs(signals["legs.velocity"]).max()),
            "mm/s",
            scenario.drives.max_velocity_mm_s,
            paper=80.0,
            meaning="largest of any branch, by the encoders",
        ),
        Metric(
            "support_margin_mm",
            1e3 * float(signals["support_margin"][walking].min()),
            "mm",
            at_least=scenario.control.support_margin_mm,
            meaning="smallest while walking, from the currents",
        ),
    ]
    if scenario.backend in ("multibody", "kinematic"):
        metrics += [
            Metric("payload_estimated_kg", float(payload[0]), "kg", meaning="from the currents"),
            Metric(
                "payload_error_kg",
                float(mass_error),
                "kg",
                meaning="largest while walking",
            ),
        ]
        if passenger.mass_kg > 0.0:
            x, y = 1e3 * payload[1:]
            away = math.hypot(x - passenger.x_mm, y - passenger.y_mm)
            metrics.append(
                Metric("payload_place_error_mm", away, "mm", meaning="of the centre, at the end")
            )
    return metrics
