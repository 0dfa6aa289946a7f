"""The real centre as its encoders tell it, and pale beside it where its platform is led to."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import PassThrough

from parapod.diagrams.machining_center.drawing import add_colours, add_drawing, draw_panel
from parapod.diagrams.machining_center.scenario import CenterScenario
from parapod.diagrams.wiring import add
from parapod.systems.machining_center.posture import LOCKS_OF_LIMB

# Path in the scene, and the signal with the platform's pose.
_DRAWN = {"measured": "pose_estimated", "desired": "pose_desired"}
_FEET, _SWITCHES = "feet_estimated", ("locks.closed", "clamps.closed")
_PALE = 0.25  # opacity


class CenterTwin:
    """Two drawings of the centre on the footholds that its lengths tell."""

    signals = frozenset((*_DRAWN.values(), _FEET, *_SWITCHES))

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
            add_drawing(builder, scenario.geometry, shown[0], shown[1], meshcat, path)
        told = []
        for name, size in zip(_SWITCHES, (LOCKS_OF_LIMB, 1), strict=True):
            each = add(builder, PassThrough(size * scenario.limbs), name)
            builder.ExportInput(each.get_input_port(), name)
            told.append(each.get_output_port())
        add_colours(builder, scenario.geometry, (told[0], told[1]), meshcat, "measured")
        draw_panel(meshcat, scenario.plan, scenario.geometry)
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
        for name in _SWITCHES:
            port = self._diagram.GetInputPort(name)
            port.FixValue(self._context, values.get(name, np.ones(port.size())))
        self._diagram.ForcedPublish(self._context)
        self._meshcat.SetProperty("desired", "modulated_opacity", _PALE)
