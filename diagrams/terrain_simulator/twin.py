"""The real bench as its encoders measure it, and pale beside it where its plate is led to."""

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray
from pydrake.geometry import Meshcat

from parapod.diagrams.terrain_simulator.plants import add_drawing
from parapod.diagrams.terrain_simulator.scenario import TerrainBenchScenario
from parapod.diagrams.twin import DESIRED, MEASURED, Twin

# Signal with the plate's pose.
_DRAWN = {MEASURED: "pose_estimated", DESIRED: "pose_desired"}
_HIP, _LEG = "hip.position", "leg.position"


class BenchTwin(Twin):
    """Two drawings of the bench, with the leg as it is measured."""

    needed = frozenset((_DRAWN[MEASURED], _HIP, _LEG))
    stand_ins = {_DRAWN[MEASURED]: "truth.pose"}  # noqa: RUF012
    signals = needed | {_DRAWN[DESIRED]}

    def __init__(self, meshcat: Meshcat | None, scenario: TerrainBenchScenario, prefix: str = ""):
        """Draws nothing yet; see `Twin`."""
        super().__init__(meshcat, scenario, prefix)
        self._x = scenario.walk.hip[0]
        sizes = {"pose": 3, "hip": 2, "leg": scenario.leg.ports}
        for drawing in _DRAWN:
            pose, hip, leg = (self.input(f"{drawing}_{name}", n) for name, n in sizes.items())
            add_drawing(self.builder, scenario, (pose, hip, leg), meshcat, self.path(drawing))
        self.finish()

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """See `Twin`."""
        if not self.knows(values):
            return
        positions: dict[str, Any] = {}
        for drawing, name in _DRAWN.items():
            positions[f"{drawing}_pose"] = values.get(name, values[_DRAWN[MEASURED]])
            positions[f"{drawing}_hip"] = [self._x, values[_HIP][0]]
            positions[f"{drawing}_leg"] = values[_LEG]
        self._publish(positions, time)
