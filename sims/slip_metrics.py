"""What the experiment `slip` measures."""

import numpy as np

from parapod.sims.results import Metric
from parapod.sims.slip_recording import Recording
from parapod.sims.slip_scenario import BEGIN, SlipScenario

# At the smallest one Drake's stiction tolerance, 0.1 mm/s, is what the creep goes by [s].
CREEP_STEPS = (1e-3, 2e-3, 4e-3)
# After the brakes close the rods come to rest first [s].
_STOPPING = 0.1
_HEIGHT_BOUND = 0.1  # [mm]


def slip_metrics(scenario: SlipScenario, recording: Recording) -> tuple[Metric, ...]:
    """How far the support points move while the legs lift, rest, and while the arm swings."""
    lifted = 1e3 * recording.displacement(BEGIN, scenario.braked_at)
    waiting = 1e3 * recording.displacement(scenario.braked_at + _STOPPING, scenario.swing_at)
    swinging = 1e3 * recording.displacement(scenario.swing_at)
    return (
        Metric(
            "arm_slip_mm",
            float(swinging.max()),
            "mm",
            0.01,
            paper="< 0.01",
            meaning="largest of a leg from the arm's swing on, actuators braked",
        ),
        Metric("arm_slip_left_mm", float(swinging[-1].max()), "mm", meaning="at the end"),
        Metric(
            "actuator_slip_mm",
            float(lifted.max()),
            "mm",
            20.0,
            paper=3.0,
            at_least=1.0,
            meaning="largest of a leg while the actuators lift the platform",
        ),
        Metric("rest_slip_mm", float(waiting.max()), "mm", meaning="between lift and swing"),
    )


def lift_metrics(scenario: SlipScenario, recording: Recording) -> tuple[Metric, ...]:
    """Whether the lift was what the experiment takes it for: level, and to the height."""
    lifting = recording.time <= scenario.swing_at + 1e-9
    tilt = np.degrees(np.abs(recording.posture[lifting, :2]))
    reached = 1e3 * float(recording.posture[lifting, 2][-1])
    return (
        Metric(
            "lift_height_error_mm",
            reached - scenario.lift.height_mm,
            "mm",
            _HEIGHT_BOUND,
            meaning="when the arm begins to swing, against the commanded height",
        ),
        Metric("lift_tilt_deg", float(tilt.max()), "deg", meaning="largest until the swing"),
    )


def creep_metrics(scenario: SlipScenario, speeds: list[float]) -> tuple[Metric, ...]:
    """The creep beside the time steps.

    Args:
        scenario: what was run.
        speeds: at each of `CREEP_STEPS` [m/s].
    """
    still = f"standing still on {scenario.creep.pitch_deg:g} deg"
    # Reduced legs creep at the floor, whatever the step.
    is_full = scenario.plant.leg_model == "full"
    keys = ("creep_mm_s", "creep_2ms_mm_s", "creep_4ms_mm_s")
    return (
        *(
            Metric(key, 1e3 * speed, "mm/s", meaning=f"{still}, steps of {1e3 * step:g} ms")
            for key, speed, step in zip(keys, speeds, CREEP_STEPS, strict=True)
        ),
        Metric(
            "creep_ratio",
            speeds[2] / speeds[1],
            bound=2.4 if is_full else None,
            at_least=1.6 if is_full else None,
            meaning="4 ms to 2 ms: 2 says that the creep is in proportion to the time step",
        ),
    )
