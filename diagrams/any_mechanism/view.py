"""View of a mechanism: as its encoders have it, pale where its motors are led to."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat

from parapod.diagrams.any_mechanism.plants import add_drawing
from parapod.diagrams.any_mechanism.ports import PART
from parapod.diagrams.any_mechanism.scenario import MechanismScenario
from parapod.diagrams.real import MachineView
from parapod.diagrams.twin import DESIRED, MEASURED, Twin
from parapod.systems.core.errors import ParapodError, WiringError
from parapod.systems.core.vectors import Array

_POSITION, _LED = f"{PART}.position", "motor_desired_state"


class MechanismTwin(Twin):
    """Two drawings of the mechanism, each next to how it was drawn before."""

    needed = frozenset((_POSITION,))
    signals = needed | {_LED}

    def __init__(self, meshcat: Meshcat | None, scenario: MechanismScenario, prefix: str = ""):
        """Draws nothing yet; see `Twin`."""
        super().__init__(meshcat, scenario, prefix)
        built = scenario.machine.built
        self._mechanism = built.mechanism
        self._count = len(built.motors.names)
        self._poses = dict.fromkeys((MEASURED, DESIRED), built.q)
        for drawing in (MEASURED, DESIRED):
            port = self.input(drawing, self._mechanism.plant.num_positions())
            add_drawing(self.builder, scenario.machine, port, meshcat, self.path(drawing))
        self.finish()

    def show(self, values: Mapping[str, NDArray[Any]], time: float = 0.0) -> None:
        """See `Twin`."""
        if not self.knows(values):
            return
        position = np.asarray(values[_POSITION], dtype=float)
        if position.shape != (self._count,):
            raise WiringError(
                f"{_POSITION} of the drawing has {self._count} elements, the signal "
                f"{position.size}"
            )
        goal = np.asarray(values.get(_LED, position), dtype=float)[: self._count]
        self._follow(MEASURED, position)
        self._follow(DESIRED, goal if np.isfinite(goal).all() else position)
        self._publish(self._poses, time)

    def _follow(self, drawing: str, motors: Array) -> None:
        """Poses a drawing; where its loops cannot follow, it stays."""
        try:
            self._poses[drawing] = self._mechanism.forward(motors, self._poses[drawing])
        except ParapodError:
            return


# Drawing and plots by which the machine is looked at.
VIEW = MachineView(
    MechanismTwin,
    plots=(
        "pose_estimated[0:3]",
        "pose_estimated[3:6]",
        f"{PART}.position",
        f"{PART}.velocity",
        "truth.motor_force",
    ),
)
