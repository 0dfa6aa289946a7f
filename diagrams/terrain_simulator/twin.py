"""The real bench as its encoders tell it, and pale beside it where its plate is led to."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import PassThrough

from parapod.diagrams.terrain_simulator.plants import add_drawing
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.wiring import add

# Path in the scene, and the signal with the plate's pose.
_DRAWN = {"measured": "pose_estimated", "desired": "pose_desired"}
_HIP, _LEG = "hip.position", "leg.position"
_PALE = 0.25  # opacity


class BenchTwin:
    """Two drawings of the bench, with the leg as it is measured."""

    signals = frozenset((*_DRAWN.values(), _HIP, _LEG))

    def __init__(self, meshcat: Meshcat, scenario: TerrainBenchScenario):
        """Draws nothing yet.

        Args:
            meshcat: the scene.
            scenario: of the machine.
        """
        self._meshcat, builder = meshcat, DiagramBuilder()
        self._x = scenario.walk.hip[0]
        sizes = {"pose": 3, "hip": 2, "leg": scenario.leg.ports}
        for path in _DRAWN:
            shown = []
            for name, size in sizes.items():
                each = add(builder, PassThrough(size), f"{path}_{name}")
                builder.ExportInput(each.get_input_port(), each.get_name())
                shown.append(each.get_output_port())
            add_drawing(builder, scenario, (shown[0], shown[1], shown[2]), meshcat, path)
        self._diagram = builder.Build()
        self._context = self._diagram.CreateDefaultContext()

    def show(self, values: Mapping[str, NDArray[Any]]) -> None:
        """See `Twin`."""
        measured, hip, leg = (values[name] for name in (_DRAWN["measured"], _HIP, _LEG))
        if not all(np.isfinite(each).all() for each in (measured, hip, leg)):
            return  # nothing is known: the last picture stays
        for path, name in _DRAWN.items():
            drawn = {"pose": values.get(name, measured), "hip": [self._x, hip[0]], "leg": leg}
            for part, value in drawn.items():
                self._diagram.GetInputPort(f"{path}_{part}").FixValue(self._context, value)
        self._diagram.ForcedPublish(self._context)
        self._meshcat.SetProperty("desired", "modulated_opacity", _PALE)
