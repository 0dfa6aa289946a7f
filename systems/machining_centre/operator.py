"""Commands that a person gives to a machining centre in the browser."""

import math
from contextlib import AbstractContextManager

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues

from parapod.systems.core.controls import Controls, PoseSliders, is_held, shown
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry

# See `PoseSliders`.
_SLIDERS = (
    ("x [mm]", 80.0, 1.0, 1e-3),
    ("y [mm]", 80.0, 1.0, 1e-3),
    ("z [mm]", 60.0, 1.0, 1e-3),
    ("roll [deg]", 15.0, 0.5, math.radians(1.0)),
    ("pitch [deg]", 15.0, 0.5, math.radians(1.0)),
    ("yaw [deg]", 20.0, 0.5, math.radians(1.0)),
)


class CentreControls(LeafSystem):
    """The operator of a centre: six sliders move its platform, a button a limb lifts its foot.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `pose_asked` | 6 | m, rad | of the platform |
    | out `limb_asked` | 1 | - | limb whose foot is to be lifted and put down again; 0: none |

    Sliders and buttons exist while `shown` is entered. A foot goes up and down as long as its
    button is held.

    State: discrete, both outputs (6, 1), updated every period.

    Bad input: without the sliders the pose is the one at first.

    Args:
        controls: owner of sliders and buttons.
        geometry: the centre.
        pose: (6) of the platform at first [m, rad].
        period: time between two readings of them [s].
    """

    def __init__(
        self,
        controls: Controls,
        geometry: CentreGeometry = CentreGeometry(),
        pose: Array | None = None,
        period: float = 0.1,
    ):
        super().__init__()
        self.set_name("centre_controls")
        first = np.zeros(6) if pose is None else pose
        self._controls, self._sliders = controls, PoseSliders(controls, _SLIDERS, first)
        self._buttons = [f"lift limb {limb}" for limb in range(1, geometry.limbs + 1)]
        self.DeclareStateOutputPort("pose_asked", self.DeclareDiscreteState(first))
        self.DeclareStateOutputPort("limb_asked", self.DeclareDiscreteState(1))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def shown(self) -> AbstractContextManager[None]:
        """Shows sliders and buttons, and takes them away at the end."""
        holds = [(name, str(number)) for number, name in enumerate(self._buttons, start=1)]
        return shown(self._controls, self._sliders.rows(), holds=holds)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        buttons = enumerate(self._buttons, start=1)
        limb = next((number for number, name in buttons if is_held(self._controls, name)), 0)
        discrete_state.set_value(0, self._sliders.read())
        discrete_state.set_value(1, np.array([float(limb)]))
