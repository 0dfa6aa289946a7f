"""Compare the kinematic model with the multibody plant, with legs as drawn and as built.

Figs. 8 to 11 of the paper. The platform moves in roll, pitch and height; the model solves
Eqs. (10) to (12) for the drawing, the ground's inclination and the encoders' extensions, and is
compared with the plant's posture: once with legs as drawn on a slope of 5 deg (Figs. 8, 9), once
with manufacturing errors on the nearly level floor of the prototype (Figs. 10, 11).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from parapod.diagrams.levelling_platform.scenario import GroundScenario, LevellingScenario
from parapod.sims.lab.run import Run
from parapod.sims.lab.runner import Runner
from parapod.sims.levelling_platform.levelling import (
    LevellingExperiment,
    error_metrics,
    in_deg_and_mm,
    posture_figure,
)
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.levelling_platform.kinematics import forward_kinematics

_ANGLE_BOUND, _HEIGHT_BOUND = 0.02, 0.1
# Errors that the paper found: in its co-simulation, and between its model and its prototype.
_SIMULATED = (0.07, 0.07, 0.3)
_MEASURED = (0.2, 0.1, 1.0)
# Ground of the experiment with the prototype (section 3.3.2).
_FLOOR = GroundScenario(roll_deg=0.1, pitch_deg=-0.3)
# The platform settles on its feet first [s].
_STANDING = 0.5


@dataclass(frozen=True)
class Comparison:
    """Postures of plant and model on the way.

    Attributes:
        time: (n) [s].
        truth: (n, 3) posture of the plant [deg, deg, mm].
        model: (n, 3) posture by the kinematic model [deg, deg, mm].
    """

    time: NDArray[np.float64]
    truth: NDArray[np.float64]
    model: NDArray[np.float64]


@dataclass(frozen=True)
class Comparisons:
    """Both comparisons, and the run that was watched.

    Attributes:
        run: run with legs as drawn.
        drawn: legs as drawn, on a slope.
        built: legs as built, on the prototype's floor.
    """

    run: Run
    drawn: Comparison
    built: Comparison


class ValidateKinematics(LevellingExperiment[Comparisons]):
    """Compares model and plant.

    The scenario's `plant.length_error_mm` and `plant.angle_error_deg` are those of the second
    comparison, on the prototype's floor.
    """

    backends = ("multibody",)
    signals = ("truth.posture", "legs.extension")
    takes = "20 s"

    def run(self, scenario: LevellingScenario, runner: Runner) -> Comparisons:
        """Moves both platforms; the first is the one that is watched."""
        as_drawn = replace(scenario.plant, length_error_mm=0.0, angle_error_deg=0.0)
        as_nominal = replace(scenario, plant=as_drawn)
        as_manufactured = replace(scenario, ground=_FLOOR)
        run = self.run_loop(as_nominal, runner)
        unwatched = self.run_loop(as_manufactured, runner, watched=False)
        return Comparisons(run, _compare(as_nominal, run), _compare(as_manufactured, unwatched))

    def measure(self, scenario: LevellingScenario, data: Comparisons) -> Iterator[Metric]:
        """Largest differences, beside what the paper found."""
        for case, prefix, bounds, paper, legs in (
            (data.drawn, "", _bounds(scenario), _SIMULATED, "as drawn, on a slope"),
            (data.built, "perturbed_", (None, None), _MEASURED, "as built, on a floor"),
        ):
            condition = f"of the model against the plant, legs {legs}"
            yield from error_metrics(case.truth - case.model, prefix, bounds, paper, condition)

    def draw(self, scenario: LevellingScenario, data: Comparisons) -> Iterator[Figure]:
        """Postures of both (Figs. 8 to 11)."""
        for case, name, legs, bounds in (
            (data.drawn, "fig08_09", "as drawn, on a slope", _bounds(scenario)),
            (data.built, "fig10_11", "as built, on a floor", (None, None)),
        ):
            lines = {"multibody plant": case.truth, "kinematic model": case.model}
            caption = (
                f"Kinematic model and multibody plant, legs {legs} (the paper's {_named(name)})."
            )
            title = f"Model and plant, legs {legs}"
            reference = "multibody plant"
            yield posture_figure(name, title, caption, case.time, lines, reference, bounds=bounds)


def _bounds(scenario: LevellingScenario) -> tuple[float, float]:
    """Largest differences of angles [deg] and of the height [mm]."""
    return _ANGLE_BOUND, _HEIGHT_BOUND * scenario.machine.size


def _compare(scenario: LevellingScenario, run: Run) -> Comparison:
    standing = run.time >= _STANDING
    # The three active legs, as the paper's Eqs. (10) to (12) have it.
    model = forward_kinematics(
        scenario.machine.geometry,
        run["legs.extension"][standing],
        scenario.ground.inclination,
        legs=(0, 1, 2),
    )
    truth = run["truth.posture"][standing]
    return Comparison(run.time[standing], in_deg_and_mm(truth), in_deg_and_mm(model))


def _named(figure: str) -> str:
    first, second = (int(part) for part in figure.removeprefix("fig").split("_"))
    return f"Figs. {first} and {second}"
