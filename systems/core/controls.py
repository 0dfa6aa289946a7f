"""Controls of a person in the browser: sliders, buttons, and buttons that are held."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, Protocol

import numpy as np

from parapod.systems.core.vectors import Array

# Name, smallest and largest value, step, and value at first.
type Slider = tuple[str, float, float, float, float]


class Controls(Protocol):
    """Sliders and buttons that a person moves, with the names that Drake's Meshcat gives them.

    Meshcat itself has no buttons that count while they are held. Controls that have
    `SetSliderRange(name, min, max)` too are shown what can be reached, and those with `silence()`
    tell for how long nothing was heard of the person.
    """

    def AddSlider(self, name: str, low: float, high: float, step: float, value: float, /) -> Any:
        """Adds a slider."""

    def DeleteSlider(self, name: str, strict: bool = True) -> Any:
        """Deletes a slider."""

    def GetSliderNames(self) -> Sequence[str]:
        """Names of the sliders."""

    def GetSliderValue(self, name: str) -> float:
        """Value of a slider."""

    def AddButton(self, name: str) -> Any:
        """Adds a button."""

    def DeleteButton(self, name: str, strict: bool = True) -> Any:
        """Deletes a button."""

    def GetButtonClicks(self, name: str) -> int:
        """Number of clicks on a button."""

    def AddHold(self, name: str, key: str = "") -> Any:
        """Adds a button that counts while it, or its key, is held."""

    def DeleteHold(self, name: str, strict: bool = True) -> Any:
        """Deletes such a button."""

    def GetHoldNames(self) -> Sequence[str]:
        """Names of these buttons."""

    def IsHeld(self, name: str) -> bool:
        """Tells whether such a button is held now."""


@contextmanager
def shown(
    controls: Controls,
    sliders: Sequence[Slider] = (),
    buttons: Sequence[str] = (),
    holds: Sequence[tuple[str, str]] = (),
) -> Iterator[None]:
    """Shows sliders and buttons, and takes them away at the end.

    Args:
        controls: their owner.
        sliders: the sliders.
        buttons: names of buttons that are clicked.
        holds: names and keys of buttons that are held.
    """
    with ExitStack() as stack:
        for slider in sliders:
            controls.AddSlider(*slider)
            stack.callback(controls.DeleteSlider, slider[0], strict=False)
        for name in buttons:
            controls.AddButton(name)
            stack.callback(controls.DeleteButton, name, strict=False)
        for name, key in holds:
            controls.AddHold(name, key)
            stack.callback(controls.DeleteHold, name, strict=False)
        yield


def is_held(controls: Controls, name: str) -> bool:
    """Tells whether a button is there, and held."""
    return name in controls.GetHoldNames() and controls.IsHeld(name)


class PoseSliders:
    """Sliders of a pose, which go as far to either side of the pose at first.

    Args:
        controls: their owner.
        elements: (n) name, largest distance from the value at first, step, and SI unit of one of
            them, such as 1e-3 for mm.
        first: (n) the pose at first, in SI units.
    """

    def __init__(
        self,
        controls: Controls,
        elements: Sequence[tuple[str, float, float, float]],
        first: Array,
    ):
        self._controls = controls
        self._elements = list(zip(elements, first.tolist(), strict=True))

    def rows(self) -> list[Slider]:
        """The sliders as `shown` takes them."""
        rows = []
        for (name, reach, step, unit), value in self._elements:
            first = step * round(value / unit / step)
            rows.append((name, first - reach, first + reach, step, first))
        return rows

    def read(self) -> Array:
        """The pose (n) in SI units; elements whose sliders are not shown are those at first."""
        there = self._controls.GetSliderNames()
        return np.array(
            [
                unit * self._controls.GetSliderValue(name) if name in there else value
                for (name, _, _, unit), value in self._elements
            ]
        )
