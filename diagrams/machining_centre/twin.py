"""The real centre as its encoders measure it, and pale beside it where its platform is led to."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat

from parapod.diagrams.machining_centre.drawing import add_colours, add_drawing, draw_panel
from parapod.diagrams.machining_centre.scenario import CentreScenario
from parapod.diagrams.twin import DESIRED, MEASURED, Twin
from parapod.systems.machining_centre.posture import LOCKS_OF_LIMB

# Signal with the platform's pose.
_DRAWN = {MEASURED: "pose_estimated", DESIRED: "pose_desired"}
_FEET, _SWITCHES = "feet_estimated", ("locks.closed", "clamps.closed")


class CentreTwin(Twin):
    """Two drawings of the centre on the footholds that its lengths give."""

    needed = frozenset((_DRAWN[MEASURED], _FEET))
    stand_ins = {_DRAWN[MEASURED]: "truth.pose", _FEET: "truth.feet"}  # noqa: RUF012
    signals = needed | {_DRAWN[DESIRED], *_SWITCHES}

    def __init__(self, meshcat: Meshcat | None, scenario: CentreScenario, prefix: str = ""):
        """Draws nothing yet; see `Twin`."""
        super().__init__(meshcat, scenario, prefix)
        geometry = scenario.machine.geometry
        limbs = geometry.limbs
        for drawing in _DRAWN:
            pose = self.input(f"{drawing}_pose", 6)
            feet = self.input(f"{drawing}_feet", 6 * limbs)
            add_drawing(self.builder, geometry, pose, feet, meshcat, self.path(drawing))
        if meshcat is not None:
            locks = self.input(_SWITCHES[0], LOCKS_OF_LIMB * limbs)
            clamps = self.input(_SWITCHES[1], limbs)
            add_colours(self.builder, geometry, (locks, clamps), meshcat, self.path(MEASURED))
            if not self.is_guest:
                draw_panel(meshcat, scenario.plan, geometry)
        self._switches = {_SWITCHES[0]: LOCKS_OF_LIMB * limbs, _SWITCHES[1]: limbs}
        self.finish()

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """See `Twin`."""
        if not self.knows(values):
            return
        positions = {}
        for drawing, name in _DRAWN.items():
            positions[f"{drawing}_pose"] = values.get(name, values[_DRAWN[MEASURED]])
            positions[f"{drawing}_feet"] = values[_FEET]
        if self.meshcat is not None:
            for name, size in self._switches.items():
                positions[name] = values.get(name, np.ones(size))
        self._publish(positions, time)
