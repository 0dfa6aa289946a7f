"""Commands that a person gives to a machining centre in the browser."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from parapod.systems.core.vectors import Array
from parapod.systems.machining_centre.geometry import CentreGeometry

# Name, smallest and largest value by the one at first, step, and SI unit of one of them.
SLIDERS = (
    ("x [mm]", 80.0, 1.0, 1e-3),
    ("y [mm]", 80.0, 1.0, 1e-3),
    ("z [mm]", 60.0, 1.0, 1e-3),
    ("roll [deg]", 15.0, 0.5, math.radians(1.0)),
    ("pitch [deg]", 15.0, 0.5, math.radians(1.0)),
    ("yaw [deg]", 20.0, 0.5, math.radians(1.0)),
)


class Controls(Protocol):
    """Sliders, and buttons that count while they are held."""

    # fmt: off
    def AddSlider(self, name: str, min: float, max: float, step: float, value: float) -> Any: ...  # noqa: A002, D102
    def DeleteSlider(self, name: str, strict: bool = True) -> Any: ...  # noqa: D102
    def GetSliderNames(self) -> list[str]: ...  # noqa: D102
    def GetSliderValue(self, name: str) -> float: ...  # noqa: D102
    def AddHold(self, name: str, key: str = "") -> Any: ...  # noqa: D102
    def DeleteHold(self, name: str, strict: bool = True) -> Any: ...  # noqa: D102
    def GetHoldNames(self) -> list[str]: ...  # noqa: D102
    def IsHeld(self, name: str) -> bool: ...  # noqa: D102
    # fmt: on


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
        self._controls, self._first = controls, np.zeros(6) if pose is None else pose
        self._buttons = [f"lift limb {limb}" for limb in range(1, geometry.limbs + 1)]
        self.DeclareStateOutputPort("pose_asked", self.DeclareDiscreteState(self._first))
        self.DeclareStateOutputPort("limb_asked", self.DeclareDiscreteState(1))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Shows sliders and buttons, and takes them away at the end."""
        controls = self._controls
        for (name, reach, step, unit), value in zip(SLIDERS, self._first, strict=True):
            first = step * round(float(value) / unit / step)
            controls.AddSlider(name, first - reach, first + reach, step, first)
        for number, name in enumerate(self._buttons, start=1):
            controls.AddHold(name, str(number))
        try:
            yield
        finally:
            for name, *_ in SLIDERS:
                controls.DeleteSlider(name, strict=False)
            for name in self._buttons:
                controls.DeleteHold(name, strict=False)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        there = set(self._controls.GetSliderNames())
        pose = [
            unit * self._controls.GetSliderValue(name) if name in there else float(first)
            for (name, _, _, unit), first in zip(SLIDERS, self._first, strict=True)
        ]
        values = [
            number
            for number, name in enumerate(self._buttons, start=1)
            if name in self._controls.GetHoldNames() and self._controls.IsHeld(name)
        ]
        discrete_state.set_value(0, np.array(pose))
        discrete_state.set_value(1, np.array([float(values[0] if values else 0)]))
