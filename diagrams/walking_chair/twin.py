"""The real chair as its encoders tell it, and pale beside it where its branches are led to."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray
from pydrake.geometry import Meshcat

from parapod.diagrams.twin import DESIRED, MEASURED, Twin
from parapod.diagrams.walking_chair.plants import Beginning, add_drawing
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.walking_chair.geometry import BRANCHES
from parapod.systems.walking_chair.kinematic_chair import KinematicChair

# Signal with the branches' lengths.
_DRAWN = {MEASURED: "legs.position", DESIRED: "position_node"}


class ChairTwin(Twin):
    """Two drawings of the chair, at rest on its feet with the lengths that its branches have.

    Feet that stand do not slip: the drawing goes where the lengths lead it, from the place at
    which the scenario begins.
    """

    needed = frozenset((_DRAWN[MEASURED],))
    signals = needed | {_DRAWN[DESIRED]}

    def __init__(self, meshcat: Meshcat | None, scenario: ChairScenario, prefix: str = ""):
        """Draws nothing yet; see `Twin`."""
        super().__init__(meshcat, scenario, prefix)
        begun = Beginning.of(scenario, scenario.gait.walk)
        for drawing in _DRAWN:
            position = self.input(drawing, len(BRANCHES))
            chair = KinematicChair(passenger=begun.passenger, place=begun.body[:2])
            add(self.builder, chair, f"statics_of_{drawing}")
            connect(self.builder, position, chair.GetInputPort("position"))
            add_drawing(self.builder, scenario, position, chair, meshcat, self.path(drawing))
        self.finish()

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """See `Twin`."""
        if not self.knows(values):
            return
        measured = values[_DRAWN[MEASURED]]
        for drawing, name in _DRAWN.items():
            self._fix(drawing, values.get(name, measured))
        ahead = self._diagram.EvalUniquePeriodicDiscreteUpdate(self._context)
        self._context.get_mutable_discrete_state().SetFrom(ahead)
        self._publish({}, time)
