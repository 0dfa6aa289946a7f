"""What the experiment `deploy` measures."""

import numpy as np
from numpy.typing import NDArray

from parapod.sims.deploy_figures import figures
from parapod.sims.deploy_scenario import DeployScenario
from parapod.sims.job import Signals
from parapod.sims.posture_errors import error_metrics, in_deg_and_mm
from parapod.sims.results import Metric, Result
from parapod.systems.levelling_platform.fault_detection import Finding
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.plane import normal_of, to_platform
from parapod.systems.levelling_platform.stability_monitor import StabilityMonitorParams
from parapod.systems.levelling_platform.supervisor import Phase, SupervisorParams
from parapod.systems.levelling_platform.wheels import WheelGeometry

NEEDED = (
    "truth.posture",
    "legs.extension",
    "legs.limits",
    "legs.voltage",
    "extension_desired_state",
    "phase",
    "stability_margin",
    "arm_command",
    "findings",
)
# What the paper's closed loop stayed within (section 7).
_ANGLE_BOUND, _HEIGHT_BOUND = 0.2, 2.0
_PAPER = (0.2, 0.2, 2.0)
_LIFTED = 0.5  # a foot that is back sooner has not been lost [s]
_CLEARANCE = 20.0  # of the wheels while the platform works [mm]
# A command that jumps is one that changes by more than this in a period [V].
_VOLTAGE_STEP = 0.5


def measure(
    scenario: DeployScenario,
    steps_left: int,
    time: NDArray[np.float64],
    signals: Signals,
    realtime_factor: float,
) -> Result:
    """What came out of an operation, beside its bounds.

    Args:
        scenario: the operation's.
        steps_left: of those that the operator wanted to take.
        time: (n) times of the samples [s].
        signals: port name -> (n, size) samples.
        realtime_factor: simulated time by wall-clock time.
    """
    metrics = (
        Metric("steps_left", steps_left, "", 0.0, meaning="of what the operator wanted to do"),
        *_posture(scenario, signals),
        *_standing(scenario, signals),
        *_smoothness(scenario, signals),
        _findings(scenario, signals),
        Metric("realtime_factor", realtime_factor, meaning="simulated time by wall-clock time"),
    )
    times, order = phase_times(time, signals["phase"][:, 0]), contact_order(signals)
    found = found_faults(time, signals)
    notes = (
        *(f"found at {at:.2f} s: {name}" for name, at in found.items()),
        "phases: " + ", ".join(f"{name} {lasted:.1f} s" for name, lasted in times.items()),
        "feet touched in the order of legs " + ", ".join(map(str, order)),
    )
    return Result(
        "deploy",
        scenario.backend,
        scenario.seed,
        metrics,
        notes,
        figures(time, signals),
        details={"phase_times_s": times, "contact_order": order, "found_s": found},
    )


def phase_times(time: NDArray[np.float64], phase: NDArray[np.float64]) -> dict[str, float]:
    """How long each phase lasted, all its visits together [s]."""
    period = float(time[1] - time[0])
    return {
        each.name.lower(): round(period * int((phase == each).sum()), 6)
        for each in Phase
        if (phase == each).any()
    }


def contact_order(signals: Signals) -> list[int]:
    """Numbers of the legs in the order in which their switches closed first."""
    contact = signals["legs.limits"][:, 2 * LEG_COUNT :] > 0.5
    touched = [leg for leg in range(LEG_COUNT) if contact[:, leg].any()]
    return [leg + 1 for leg in sorted(touched, key=lambda leg: int(np.argmax(contact[:, leg])))]


def found_faults(time: NDArray[np.float64], signals: Signals) -> dict[str, float]:
    """Findings and when they were made [s]."""
    findings = signals["findings"] > 0.5
    return {
        finding.name.lower(): round(float(time[np.argmax(findings[:, finding])]), 6)
        for finding in Finding
        if findings[:, finding].any()
    }


def _findings(scenario: DeployScenario, signals: Signals) -> Metric:
    count = float((signals["findings"] > 0.5).any(axis=0).sum())
    bound, meaning = (None, "faults were injected") if scenario.faults else (0.0, "false alarms")
    return Metric("findings", count, "", bound, meaning=f"kinds of faults found; {meaning}")


def _holding(signals: Signals) -> NDArray[np.bool_]:
    holding: NDArray[np.bool_] = signals["phase"][:, 0] == Phase.HOLD
    return holding


def _posture(scenario: DeployScenario, signals: Signals) -> list[Metric]:
    """Errors while the posture is held, the arm's swing included."""
    wanted = in_deg_and_mm(np.array(scenario.work.posture))
    # The height counts from the plane that fits the ground under the feet best.
    wanted[2] += np.mean(scenario.ground.foot_heights_mm)
    truth = in_deg_and_mm(signals["truth.posture"][_holding(signals)])
    error = truth - wanted if truth.size else np.full((1, 3), np.nan)
    meaning = "largest while the posture is held, against gravity and the feet's mean height"
    return error_metrics(error, "", (_ANGLE_BOUND, _HEIGHT_BOUND), _PAPER, meaning)


def _standing(scenario: DeployScenario, signals: Signals) -> list[Metric]:
    held = _holding(signals)
    opened = signals["legs.limits"][held, 2 * LEG_COUNT :] < 0.5
    lifted = scenario.control.period * max(map(_longest, opened.T))
    return [
        Metric(
            "smallest_margin_mm",
            1e3 * _smallest(signals["stability_margin"][held]),
            "mm",
            at_least=1e3 * StabilityMonitorParams().margin,
            meaning="of the zero-moment point from the edge between the feet, while held",
        ),
        Metric(
            "wheel_clearance_mm",
            1e3 * _smallest(_clearance(scenario, signals["truth.posture"][held])),
            "mm",
            at_least=_CLEARANCE,
            meaning="of the lowest wheel while held",
        ),
        Metric(
            "lifted_s",
            lifted,
            "s",
            _LIFTED,
            meaning="longest time for which a foot's switch is open while held",
        ),
    ]


def _longest(flags: NDArray[np.bool_]) -> int:
    """Length of the longest run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def _smallest(values: NDArray[np.float64]) -> float:
    return float(values.min()) if values.size else np.nan


def _clearance(scenario: DeployScenario, posture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the wheels (n, 4) above the ground's plane [m]."""
    wheels = WheelGeometry()
    normal = normal_of(*scenario.ground.inclination)
    g = np.array(to_platform(normal, posture[:, 0], posture[:, 1]))
    below = np.array(wheels.axles) @ g.reshape(3, -1)
    clearance: NDArray[np.float64] = posture[:, 2] + below - wheels.radius
    return clearance


def _smoothness(scenario: DeployScenario, signals: Signals) -> list[Metric]:
    """Commands that do not jump, at transitions least of all."""
    desired = signals["extension_desired_state"][:, :LEG_COUNT]
    fastest = 1e3 * scenario.control.period * 1.5 * SupervisorParams().raising_rate
    return [
        Metric(
            "largest_voltage_step_V",
            float(np.abs(np.diff(signals["legs.voltage"], axis=0)).max()),
            "V",
            _VOLTAGE_STEP,
            meaning="largest change of a command from one period to the next",
        ),
        Metric(
            "largest_extension_step_mm",
            1e3 * float(np.abs(np.diff(desired, axis=0)).max()),
            "mm",
            fastest,
            meaning="likewise of a desired extension",
        ),
    ]
