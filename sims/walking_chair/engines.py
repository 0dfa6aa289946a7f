"""Compare Drake and MuJoCo on the walking chair: body, forces, loops, convergence of the steps.

Both simulate the same bodies, drives and gait. Feet that come down and leave make it harder than
the platform. Four flat feet have twelve corners, of which three bear what statics determines; how
much each branch bears hangs on micrometres, while all feet together bear the weight.

| step | 4 ms | 2 ms | 1 ms | .5 ms |
|---|---|---|---|---|
| body [mm] | .14 | .11 | .10 | .096 |
| roll and pitch [deg] | .0039 | .0024 | .0020 | .0018 |

At 1 ms the heading differs by .025 deg, all feet together bear the same within 3.5 N rms of 1040
N, and the branches' forces differ by 10 N rms. The tenth of a millimetre that no step removes is
along the ground, at touchdowns, where corners slide on regularised friction until all of them
bear; .04 mm of it are left in the end, and height differs by .02 mm. Gaits so hasty that Drake's
drives saturate (427 N) are not comparable: MuJoCo's drives have no limit here.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from parapod.diagrams.walking_chair.machine import CHAIR
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.sims.lab.engines import EngineComparison, Floats, Quantity
from parapod.sims.walking_chair.walk import ChairExperiment, weight_share
from parapod.systems.core.schema import quantity
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT

_DEGREE = math.degrees(1.0)
_BRANCHES, _LEGS = tuple(range(len(BRANCHES))), tuple(range(LEG_COUNT))
# The chair has settled on its feet this long after the start [s].
_SETTLED = 0.5


@dataclass
class ChairEnginesScenario(ChairScenario):
    """One comparison of engines on the walking chair; the walk's keys are those of `chair-walk`.

    Attributes:
        steps_ms: steps with which both engines repeat the walk [ms].
    """

    steps_ms: list[float] = quantity([4.0, 2.0, 1.0, 0.5], 0.1, 10.0)


class ChairEngines(EngineComparison[ChairScenario], ChairExperiment):
    """Runs the walk with both engines."""

    machine = CHAIR
    schema = ChairEnginesScenario
    takes = "2 min"
    signals = (
        "truth.body_position",
        "truth.body_attitude",
        "truth.force",
        "truth.contact_force",
        "truth.loop_error",
    )
    quantities = (
        Quantity(
            "position", "truth.body_position", "mm", 1e3, "the body's place", (0, 1, 2), 0.3, True
        ),
        Quantity(
            "tilt", "truth.body_attitude", "deg", _DEGREE, "roll and pitch", (0, 1), 0.02, True
        ),
        Quantity("heading", "truth.body_attitude", "deg", _DEGREE, "the heading", (2,)),
        Quantity(
            "force", "truth.force", "N", 1.0, "branches' forces", _BRANCHES, 20.0, is_rough=True
        ),
        Quantity("weight", "weight", "N", 1.0, "all feet together", (0,), 20.0, is_rough=True),
        Quantity(
            "contact_force", "truth.contact_force", "N", 1.0, "feet's forces", _LEGS, is_rough=True
        ),
    )

    def derived(
        self, scenario: ChairScenario, signals: Mapping[str, Floats]
    ) -> Mapping[str, Floats]:
        """The force that all feet bear together, which statics determines."""
        return {"weight": signals["truth.contact_force"].sum(axis=1, keepdims=True)}

    def scales(self, scenario: ChairScenario) -> Mapping[str, float]:
        """Ways by the stroke of the branches, forces by the mass with the passenger."""
        return {"mm": scenario.machine.geometry.leg.size, "N": weight_share(scenario)}

    def counts_from(self, scenario: ChairScenario) -> float:
        """The time at which it stands on its feet [s]."""
        return min(_SETTLED, scenario.begin)
