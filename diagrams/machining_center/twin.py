"""The real centre as its encoders tell it, and pale beside it where its platform is led to."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import PassThrough

from parapod.diagrams.machining_center.plants import add_drawing
from parapod.diagrams.machining_center.scenario import CenterScenario
from parapod.diagrams.wiring import add

# Path in the scene, and the signal with the platform's pose.
_DRAWN = {"measured": "pose_estimated", "desired": "pose_desired"}
_FEET = "feet_estimated"
_PALE = 0.25  # opacity


class CenterTwin:
    """Two drawings of the centre on the footholds that its lengths tell."""

    signals = frozenset((*_DRAWN.values(), _FEET))

    def __init__(self, meshcat: Meshcat, scenario: CenterScenario):
        """Draws nothing yet.

        Args:
            meshcat: the scene.
            scenario: of the machine.
        """
        self._meshcat, builder = meshcat, DiagramBuilder()
        for path in _DRAWN:
            pose = add(builder, PassThrough(6), f"{path}_pose")
            feet = add(builder, PassThrough(6 * scenario.limbs), f"{path}_feet")
            for each in (pose, feet):
                builder.ExportInput(each.get_input_port(), each.get_name())
            shown = (pose.get_output_port(), feet.get_output_port())
            add_drawing(builder, scenario, shown[0], shown[1], meshcat, path)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def show(self, values: Mapping[str, NDArray[Any]]) -> None:
        """See `Twin`."""
        measured, feet = values[_DRAWN["measured"]], values[_FEET]
        if not (np.isfinite(measured).all() and np.isfinite(feet).all()):
            return  # nothing is known: the last picture stays
        for path, name in _DRAWN.items():
            pose = values.get(name, measured)
            self._diagram.GetInputPort(f"{path}_pose").FixValue(self._context, pose)
            self._diagram.GetInputPort(f"{path}_feet").FixValue(self._context, feet)
        self._diagram.ForcedPublish(self._context)
        self._meshcat.SetProperty("desired", "modulated_opacity", _PALE)
