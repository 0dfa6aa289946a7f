"""Posture commands that a person gives by sliders in the browser."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import degrees, radians
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, LeafSystem


@dataclass(frozen=True)
class PostureSlidersParams:
    """Range of the sliders, a little more than the legs reach on level ground.

    Attributes:
        angle: largest roll and pitch to either side [rad].
        height_min: smallest height [m].
        height_max: largest height [m].
        angle_step: of the sliders of roll and pitch [rad].
        height_step: of the slider of the height [m].
    """

    angle: float = radians(7.0)
    height_min: float = 0.39
    height_max: float = 0.57
    angle_step: float = radians(0.1)
    height_step: float = 0.001


class PostureSliders(LeafSystem):
    """Commands the posture that three sliders show.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `ground_estimated` | 2 | rad | not used; there so that it can take the place of a script |
    | in `ground_valid` | 1 | - | not used, likewise |
    | out `posture_command` | 3 | rad, rad, m | commanded roll, pitch, height; jumps |

    The sliders exist while `shown` is entered, and start at the level posture. What cannot be
    reached is left to `PostureReference` with `on_unreachable="clamp"`.

    State: discrete, the command (3), read from the sliders every period.

    Bad input: while there are no sliders the last command stays.
    """

    ROLL, PITCH, HEIGHT = "roll [deg]", "pitch [deg]", "height [mm]"

    def __init__(
        self,
        meshcat: Meshcat,
        height: float = 0.477,
        params: PostureSlidersParams = PostureSlidersParams(),
        period: float = 0.05,
    ):
        """Creates the source; shows no sliders yet.

        Args:
            meshcat: where the sliders are.
            height: of the level posture [m].
            params: range of the sliders.
            period: of reading the sliders [s].
        """
        super().__init__()
        self.set_name("posture_sliders")
        self._meshcat, self._params = meshcat, params
        self._level = np.array([0.0, 0.0, height])
        self.DeclareVectorInputPort("ground_estimated", 2)
        self.DeclareVectorInputPort("ground_valid", 1)
        self.DeclareStateOutputPort("posture_command", self.DeclareDiscreteState(self._level))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_command)

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Shows the sliders, and takes them away at the end."""
        limits = self._params
        angle, step = degrees(limits.angle), degrees(limits.angle_step)
        added: list[str] = []
        try:
            for name, low, high, step_size, value in (
                (self.ROLL, -angle, angle, step, 0.0),
                (self.PITCH, -angle, angle, step, 0.0),
                (
                    self.HEIGHT,
                    1e3 * limits.height_min,
                    1e3 * limits.height_max,
                    1e3 * limits.height_step,
                    1e3 * self._level[2],
                ),
            ):
                self._meshcat.AddSlider(name, low, high, step_size, value)
                added.append(name)
            yield
        finally:
            for name in added:
                self._meshcat.DeleteSlider(name, strict=False)

    def _update_command(self, context: Context, discrete_state: Any) -> None:
        command = self._read()
        if command is not None:
            discrete_state.set_value(command)

    def _read(self) -> NDArray[np.float64] | None:
        """The sliders' posture; None while they are not shown."""
        if self.HEIGHT not in self._meshcat.GetSliderNames():
            return None
        roll, pitch, height = (
            self._meshcat.GetSliderValue(name) for name in (self.ROLL, self.PITCH, self.HEIGHT)
        )
        return np.array([radians(roll), radians(pitch), 1e-3 * height])
