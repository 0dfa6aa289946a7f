"""Typed scenario of the experiment `chair-gait`."""

from dataclasses import dataclass, field, replace

from parapod.diagrams.walking_chair.scenario import GaitScenario
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.walking_chair.checks import check_gait
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.geometry import ChairGeometry

BACKENDS = ("exact",)
PRINTED = "linear"  # the law of Eq. (45)
# Cycles are all alike; these are enough to be drawn and written to a log.
_MOST_CYCLES = 10


@dataclass
class ChairGaitScenario(Schema):
    """A gait that is compared with the paper's.

    The body is moved by Eq. (45) and by a law without steps of the speed: section "Trotting gait
    simulation", Figs. 7 and 8. A gait that takes a branch out of its stroke or is too fast for it
    is refused.

    Attributes:
        backend: method: "exact", closed forms.
        seed: seed, which changes nothing: nothing is random.
        gait: see `GaitScenario`; its body law is the one that is compared with Eq. (45).
    """

    backend: str = choice("exact", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    gait: GaitScenario = field(default_factory=GaitScenario)

    @property
    def walks(self) -> tuple[Walk, Walk]:
        """The gait with the body moved by Eq. (45), and by the scenario's law."""
        return replace(self.gait, body_law=PRINTED).walk, self.gait.walk


def check_walks(scenario: ChairGaitScenario, geometry: ChairGeometry) -> None:
    """Refuse a gait that is too long to be drawn, or that the actuators cannot do.

    Raises:
        ScenarioError: too many cycles.
        StrokeExceeded: names the branch and the time of the largest excess.
        SpeedExceeded: names the branch and the time of the largest speed.
    """
    cycles = scenario.gait.cycles
    if cycles > _MOST_CYCLES:
        raise ScenarioError(
            f"gait.cycles = {cycles}: cycles are all alike, and up to {_MOST_CYCLES} are drawn",
            "gait.cycles",
        )
    for walk in scenario.walks:
        for gait in walk.gaits:
            check_gait(geometry, gait)
