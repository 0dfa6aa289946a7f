"""Typed scenario of the experiment `chair-payload`."""

from dataclasses import dataclass, field, replace

from parapod.diagrams.walking_chair.scenario import GaitScenario
from parapod.systems.core.schema import Schema, choice, quantity
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.payload import FORCE_LIMIT

BACKENDS = ("exact",)


@dataclass
class PayloadScenario(Schema):
    """What is on the seat.

    Attributes:
        mass_kg: whose margin and forces are looked at [kg].
        x_mm: of its centre of mass, to the right of the seat's middle [mm].
        y_mm: ahead of it [mm].
    """

    mass_kg: float = quantity(57.0, 0.0, 250.0)
    x_mm: float = quantity(0.0, -300.0, 300.0)
    y_mm: float = quantity(0.0, -300.0, 300.0)

    @property
    def passenger(self) -> Passenger:
        """In SI units; its height does not matter to a level chair at rest."""
        return Passenger(self.mass_kg, 1e-3 * self.x_mm, 1e-3 * self.y_mm)


def _printed_gait() -> GaitScenario:
    return GaitScenario(body_law="linear")


@dataclass
class ChairPayloadScenario(Schema):
    """The chair's payload through a step.

    Attributes:
        backend: "exact".
        seed: nothing is random.
        gait: see `GaitScenario`; of its cycles, which are alike, one is looked at. The body's law
            says only when it is where.
        payload: see `PayloadScenario`.
        friction: coefficient between feet and ground, beside none at all [-].
        force_limit: of each branch, either way [N].
        support_margin_mm: smallest admissible distance of the centre of mass from the edge of the
            support polygon [mm].
        instants: at which forces are spread, in each phase.
    """

    backend: str = choice("exact", BACKENDS)
    seed: int = quantity(0, 0, 2**31 - 1)
    gait: GaitScenario = field(default_factory=_printed_gait)
    payload: PayloadScenario = field(default_factory=PayloadScenario)
    friction: float = quantity(0.6, 0.0, 2.0)
    force_limit: float = quantity(FORCE_LIMIT, 1.0, 10000.0)
    support_margin_mm: float = quantity(10.0, 0.0, 200.0)
    instants: int = quantity(40, 1, 1000)

    @property
    def walk(self) -> Walk:
        """One cycle, each way."""
        return replace(self.gait, cycles=1).walk
