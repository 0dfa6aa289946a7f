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
    """The payload on the seat.

    Attributes:
        mass_kg: mass whose margin and forces are computed [kg]; 57 is the paper's largest.
        x_mm: centre of mass, to the right of the seat's middle [mm].
        y_mm: centre of mass, ahead of the seat's middle [mm].
    """

    mass_kg: float = quantity(57.0, 0.0, 250.0)
    x_mm: float = quantity(0.0, -300.0, 300.0)
    y_mm: float = quantity(0.0, -300.0, 300.0)

    @property
    def passenger(self) -> Passenger:
        """Payload in SI units; its height does not matter to a level chair at rest."""
        return Passenger(self.mass_kg, 1e-3 * self.x_mm, 1e-3 * self.y_mm)


def _printed_gait() -> GaitScenario:
    return GaitScenario(body_law="linear")


@dataclass
class ChairPayloadScenario(Schema):
    """The chair's payload through a step.

    Section "Walking experiment research", Eqs. (50) to (54). Forces are spread over the feet's
    corners in the best possible way, by linear programming. A payload that leaves too small a
    margin to the edge of the support polygon is refused.

    Attributes:
        backend: method: "exact", statics of closed forms.
        seed: seed, which changes nothing: nothing is random.
        gait: see `GaitScenario`; one of its equal cycles is computed, and the body's law says only
            when the body is where.
        payload: see `PayloadScenario`.
        friction: coefficient between feet and ground, which is compared with none at all [-].
        force_limit: F_N of Eq. (53): largest force of each branch, either way [N].
        support_margin_mm: smallest admissible distance of the centre of mass from the edge of the
            support polygon [mm].
        instants: number of instants in each phase at which forces are spread.
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
