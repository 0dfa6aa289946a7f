"""What the experiment `identify-actuators` measures."""

import numpy as np
from numpy.typing import NDArray

from parapod.sims.identify_actuators_estimate import Separated, Steps
from parapod.sims.identify_actuators_recording import CASES, Recordings
from parapod.sims.identify_actuators_scenario import NOMINAL, STROKE
from parapod.sims.results import Metric

SHARE = 0.15  # largest deviation from the nominal K that the paper found
# A load that moves from leg to leg during the steps is no constant friction; over gain errors of
# up to 15 % that puts the estimate off by 0.7 % at most [%].
_SEPARATED_BOUND = 1.0


def gain_metrics(unloaded: Steps, loaded: Steps) -> tuple[Metric, ...]:
    """The paper's K, in which friction and load are contained."""
    means = [float(case.gain.mean()) for case in (unloaded, loaded)]
    return (
        *(_mean_gain(case, mean) for case, mean in zip(CASES, means, strict=True)),
        Metric(
            "load_effect_percent",
            100.0 * (means[1] / means[0] - 1.0),
            "%",
            100.0 * SHARE,
            paper="very little",
            meaning="K with load against K without",
        ),
        *(
            Metric(
                f"step_deviation_{case}_percent",
                found.deviation_percent,
                "%",
                100.0 * SHARE,
                paper=100.0 * SHARE,
                meaning="largest of a step's K from 0.01, any leg",
            )
            for case, found in zip(CASES, (unloaded, loaded), strict=True)
        ),
        *(
            Metric(
                f"leg_spread_{case}_percent",
                found.spread_percent,
                "%",
                paper="similar",
                meaning="of the four legs' mean K, largest less smallest",
            )
            for case, found in zip(CASES, (unloaded, loaded), strict=True)
        ),
    )


def separated_metrics(
    cases: tuple[Separated, ...], truth: NDArray[np.float64]
) -> tuple[Metric, ...]:
    """K apart from friction, against the truth.

    Args:
        cases: without load and with it.
        truth: (4) the actuators' K [(m/s)/V].
    """
    return tuple(
        Metric(
            f"gain_error_{case}_percent",
            100.0 * float(np.abs(found.gain / truth - 1.0).max()),
            "%",
            _SEPARATED_BOUND,
            meaning="of K with friction separated, against the true K, largest of a leg",
        )
        for case, found in zip(CASES, cases, strict=True)
    )


def stroke_metrics(recordings: Recordings) -> tuple[Metric, ...]:
    """Where the legs and the platform went."""
    both = [recordings.unloaded.extension, recordings.loaded.extension]
    low, high = (1e3 * limit for limit in STROKE)
    metrics = [
        Metric("smallest_extension_mm", 1e3 * float(np.min(both)), "mm", at_least=low),
        Metric("largest_extension_mm", 1e3 * float(np.max(both)), "mm", high),
    ]
    if recordings.loaded.posture is not None:
        tilt = float(np.degrees(np.abs(recordings.loaded.posture[:, :2])).max())
        meaning = "largest roll or pitch; no controller is at work"
        metrics.append(Metric("largest_tilt_deg", tilt, "deg", meaning=meaning))
    return tuple(metrics)


def _mean_gain(case: str, mean: float) -> Metric:
    return Metric(
        f"gain_{case}",
        mean,
        "(m/s)/V",
        (1.0 + SHARE) * NOMINAL,
        paper=NOMINAL,
        at_least=(1.0 - SHARE) * NOMINAL,
        meaning="K of Eq. (17), mean over ten steps and four legs",
    )
