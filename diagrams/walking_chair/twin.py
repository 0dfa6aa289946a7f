"""The real chair as its encoders tell it, and pale beside it where its branches are led to."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import PassThrough

from parapod.diagrams.walking_chair.plants import Beginning, add_drawing
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.walking_chair.geometry import BRANCHES
from parapod.systems.walking_chair.kinematic_chair import KinematicChair

# Path in the scene, and the signal.
_DRAWN = {"measured": "legs.position", "desired": "position_node"}
_PALE = 0.25  # opacity


class ChairTwin:
    """Two drawings of the chair, at rest on its feet with the lengths that its branches have.

    Feet that stand do not slip: the drawing goes where the lengths lead it, from the place at
    which the scenario begins.
    """

    signals = frozenset(_DRAWN.values())

    def __init__(self, meshcat: Meshcat, scenario: ChairScenario):
        """Draws nothing yet.

        Args:
            meshcat: the scene.
            scenario: of the machine.
        """
        self._meshcat = meshcat
        begun, builder = Beginning.of(scenario, scenario.gait.walk), DiagramBuilder()
        for path in _DRAWN:
            through = add(builder, PassThrough(len(BRANCHES)), f"{path}_position")
            builder.ExportInput(through.get_input_port(), path)
            chair = KinematicChair(passenger=begun.passenger, place=begun.body[:2])
            add(builder, chair, f"statics_of_{path}")
            position = through.get_output_port()
            connect(builder, position, chair.GetInputPort("position"))
            add_drawing(builder, scenario, position, chair, meshcat, path)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def show(self, values: Mapping[str, NDArray[Any]]) -> None:
        """See `Twin`."""
        measured = values[_DRAWN["measured"]]
        if not np.isfinite(measured).all():
            return  # nothing is known: the last picture stays
        for path, name in _DRAWN.items():
            self._diagram.GetInputPort(path).FixValue(self._context, values.get(name, measured))
        ahead = self._diagram.EvalUniquePeriodicDiscreteUpdate(self._context)
        self._context.get_mutable_discrete_state().SetFrom(ahead)
        self._diagram.ForcedPublish(self._context)
        self._meshcat.SetProperty("desired", "modulated_opacity", _PALE)
