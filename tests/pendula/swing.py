"""Swing a pendulum and count its periods.

The rest of the story.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from parapod.sims.lab.experiment import Experiment
from parapod.sims.output.figures import Figure
from parapod.sims.output.results import Metric
from parapod.systems.core.schema import Schema, choice, quantity


@dataclass
class PendulumScenario(Schema):
    """One swing.

    Attributes:
        backend: method: "exact".
        seed: seed; each lengthens the swing a little.
        length_m: length of the string [m].
        heavy: whether the string has a mass.
    """

    backend: str = choice("exact", ("exact",))
    seed: int = quantity(0, 0, 100)
    length_m: float = quantity(1.0, 0.1, 10.0)
    heavy: bool = False


class Swing(Experiment[PendulumScenario, float]):
    """Swings it."""

    schema = PendulumScenario
    backends = ("exact",)
    switches: ClassVar = {"heavy": ("heavy=true", "give the string a mass")}
    takes = "1 s"

    def loop(self, scenario):
        from pydrake.systems.framework import DiagramBuilder
        from pydrake.systems.primitives import ConstantVectorSource

        builder = DiagramBuilder()
        builder.AddNamedSystem("bob", ConstantVectorSource([0.0]))
        return builder.Build()

    def scene(self, scenario):
        from parapod.sims.lab.runner import make_viewer

        return make_viewer((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))

    def run(self, scenario, runner):
        period = 2.0 * math.pi * math.sqrt(scenario.length_m / 9.81)
        return period * (1.0 + 1e-3 * scenario.seed)

    def logged(self, scenario, data):
        return [0.0, data], {"angle": ([[0.1], [0.1]], "rad")}

    def measure(self, scenario, data):
        yield Metric("period_s", data, "s", 2.5, meaning="duration of one swing")

    def draw(self, scenario, data):
        yield Figure("swing", "Swing", "A line.", lambda canvas: canvas.subplots().plot([0, 1]))
