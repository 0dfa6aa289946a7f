"""Compare Drake and MuJoCo on the platform: postures, forces, loops, convergence of the steps.

Both simulate the same bodies, drives and commands. The posture must agree, as it follows from
geometry and stiffness. How four feet share the weight does not follow from statics: legs that are
a few micrometres longer or shorter bear some newtons more or less, and which do is a matter of
history.
"""

from dataclasses import dataclass

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.sims.lab.engines import EngineComparison, Quantity, check_steps
from parapod.sims.levelling_platform.levelling import LevellingExperiment, check_job
from parapod.systems.core.schema import quantity

_DEGREE = 57.29577951308232


@dataclass
class PlatformEnginesScenario(LevellingScenario):
    """One comparison of engines on the levelling platform; the job's keys are those of `level`.

    Attributes:
        steps_ms: steps with which both engines repeat the job [ms].
    """

    steps_ms: list[float] = quantity([4.0, 2.0, 1.0, 0.5], 0.1, 20.0)


class CompareEngines(EngineComparison[LevellingScenario], LevellingExperiment):  # type: ignore[misc]
    """Runs the job with both engines."""

    schema = PlatformEnginesScenario
    takes = "1 min"
    signals = (
        "truth.posture",
        "truth.extension",
        "truth.load_force",
        "truth.contact_force",
        "truth.loop_error",
    )
    quantities = (
        Quantity("angle", "truth.posture", "deg", _DEGREE, "roll and pitch", (0, 1), 0.02, True),
        Quantity("height", "truth.posture", "mm", 1e3, "height", (2,), 0.3, True),
        Quantity("load_force", "truth.load_force", "N", 1.0, "rods' forces", (0, 1, 2, 3)),
        Quantity("contact_force", "truth.contact_force", "N", 1.0, "feet's forces", (0, 1, 2, 3)),
    )

    def check(self, scenario: LevellingScenario) -> None:
        """Refuses a job or steps that do not fit together."""
        check_job(scenario)
        check_steps(scenario)

    def counts_from(self, scenario: LevellingScenario) -> float:
        """The beginning of the levelling [s]."""
        return scenario.job.estimate_at
