"""Level the platform where its feet stand at different heights.

The paper leaves this out. At touchdown the extensions tell how far each foot is from the plane
that fits all four best, and from then on every leg is given that much more or less. Heights are
counted from that plane.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.run import Run
from parapod.sims.levelling_platform.levelling import (
    LevellingExperiment,
    error_metrics,
    in_deg_and_mm,
    posture_figure,
)
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric

# The bounds of the job on a plane: what the paper's closed loop reached there.
_ANGLE_BOUND, _HEIGHT_BOUND = 0.2, 2.0
_LIFT_BOUND = 1.0  # [mm]


class UnevenGround(LevellingExperiment[Run]):
    """Levels on uneven ground."""

    signals = (
        "truth.posture",
        "truth.foot_height",
        "posture_desired_state",
        "foot_offsets_estimated",
    )
    takes = "10 s"

    def measure(self, scenario: LevellingScenario, run: Run) -> Iterator[Metric]:
        """Errors after settling, and how the feet stand."""
        settled = run.time >= scenario.job.estimate_at + scenario.job.settled_after
        yield from error_metrics(
            (_truth(scenario, run) - _desired(run))[settled],
            bounds=_bounds(scenario),
            condition="after settling, against gravity and the feet's mean height",
        )
        yield from _feet(scenario, run, np.array(scenario.ground.foot_heights_mm))

    def draw(self, scenario: LevellingScenario, run: Run) -> Iterator[Figure]:
        """The posture over the job."""
        yield posture_figure(
            "uneven_ground",
            "Levelling on uneven ground",
            f"The ground under the feet is {scenario.ground.foot_heights_mm} mm above its plane.",
            run.time,
            {"asked for": _desired(run), "true": _truth(scenario, run)},
            "asked for",
            scenario.job.estimate_at + scenario.job.settled_after,
            _bounds(scenario),
        )


def _truth(scenario: LevellingScenario, run: Run) -> NDArray[np.float64]:
    """True postures (n, 3) above the feet's mean height [deg, deg, mm]."""
    mean = float(np.mean(scenario.ground.foot_heights_mm))
    return in_deg_and_mm(run["truth.posture"]) - [0.0, 0.0, mean]


def _bounds(scenario: LevellingScenario) -> tuple[float, float]:
    """Bounds of the errors of angles [deg] and of the height [mm]."""
    return _ANGLE_BOUND, _HEIGHT_BOUND * scenario.machine.size


def _desired(run: Run) -> NDArray[np.float64]:
    return in_deg_and_mm(run["posture_desired_state"][:, :3])


def _feet(scenario: LevellingScenario, run: Run, heights: np.ndarray) -> list[Metric]:
    lift = 1e3 * run["truth.foot_height"].max(axis=0)
    offsets = 1e3 * run["foot_offsets_estimated"][-1]
    return [
        Metric(
            "unevenness_mm",
            float(np.ptp(heights)),
            "mm",
            meaning="height of the highest foot above the lowest",
        ),
        Metric(
            "largest_offset_mm",
            float(np.abs(offsets).max()),
            "mm",
            meaning="largest distance of a foot from the plane that fits all four best",
        ),
        Metric(
            "foot_lift_mm",
            float(lift.max()),
            "mm",
            _LIFT_BOUND * scenario.machine.size,
            meaning="largest height of a foot above the ground",
        ),
    ]
