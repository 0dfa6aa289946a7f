"""A list of postures to take one after the other, shrunk to what the ground allows."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.levelling_platform.geometry import PlatformGeometry
from parapod.systems.levelling_platform.kinematics import inverse_kinematics
from parapod.systems.ports import elements, is_on, read_array


@dataclass(frozen=True)
class Waypoint:
    """A posture relative to the level one, and when it is commanded.

    Attributes:
        time: since the script began [s].
        roll: [rad].
        pitch: [rad].
        height: relative to the height of the level posture [m].
    """

    time: float
    roll: float = 0.0
    pitch: float = 0.0
    height: float = 0.0


class PostureScript(LeafSystem):
    """Commands a level posture, then waypoints about it, each at its time.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `ground` | 2 | rad | estimated roll and pitch of the ground |
    | in `enable` | 1 | - | the script begins when this rises above 0.5 |
    | out `posture_command` | 3 | rad, rad, m | commanded roll, pitch, height |
    | out `scale` | 1 | - | share of the waypoints' size that fits the stroke |

    A script is written once and run on grounds that leave little stroke. When it begins, all
    waypoints are shrunk towards the level posture by the largest factor up to 1 with which every
    one of them can be reached. Whether the level posture itself can be reached is not decided
    here but by `PostureReference`, which refuses it by name.

    State: discrete, whether begun (1), start time (1), scale (1), updated every period.

    Bad input: a ground that is not finite does not start the script.
    """

    def __init__(
        self,
        geometry: PlatformGeometry = PlatformGeometry(),
        height: float = 0.477,
        waypoints: Sequence[Waypoint] = (),
        margin: float = 0.3e-3,
        period: float = 0.01,
    ):
        """Creates the script.

        Args:
            geometry: the platform.
            height: of the level posture [m].
            waypoints: in the order of their times.
            margin: stroke that is left unused at each end by the waypoints [m].
            period: of the check whether to begin [s].
        """
        super().__init__()
        self.set_name("posture_script")
        self._geometry, self._height, self._margin = geometry, height, margin
        self._waypoints = tuple(waypoints)
        self._times = [waypoint.time for waypoint in waypoints]
        if self._times != sorted(self._times):
            raise ValueError(f"the waypoints' times must not decrease, but are {self._times}")
        self._ground = self.DeclareVectorInputPort("ground", 2)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        state = self.discrete_state_ticket(self.DeclareDiscreteState(3))
        self.DeclareVectorOutputPort(
            "posture_command", 3, self._calc_command, {state, self.time_ticket()}
        )
        self.DeclareVectorOutputPort("scale", 1, self._calc_scale, {state})
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_start)

    def _calc_command(self, context: Context, output: BasicVector) -> None:
        begun, start, scale = elements(context.get_discrete_state_vector())
        posture = [0.0, 0.0, self._height]
        if begun > 0.5:
            elapsed = context.get_time() - start + 1e-9
            count = sum(time <= elapsed for time in self._times)
            if count:
                posture = self._posture(self._waypoints[count - 1], scale)
        output.SetFromVector(np.array(posture))

    def _calc_scale(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[2:3])

    def _update_start(self, context: Context, discrete_state: Any) -> None:
        begun = context.get_discrete_state_vector().value()[0] > 0.5
        enabled = is_on(self._enable, context)
        if begun == enabled:
            return
        if not enabled:
            discrete_state.set_value(np.zeros(3))
            return
        ground = read_array(self._ground, context)
        if np.isfinite(ground).all():
            discrete_state.set_value(np.array([1.0, context.get_time(), self._fit(ground)]))

    def _posture(self, waypoint: Waypoint, scale: float) -> list[float]:
        return [
            scale * waypoint.roll,
            scale * waypoint.pitch,
            self._height + scale * waypoint.height,
        ]

    def _fit(self, ground: NDArray[np.float64]) -> float:
        """Largest factor of 0, 0.01, ... 1 with which the legs reach every waypoint."""
        if not self._waypoints:
            return 1.0
        scales = np.linspace(1.0, 0.0, 101)
        postures = np.array([[self._posture(w, s) for w in self._waypoints] for s in scales])
        extension = inverse_kinematics(self._geometry, postures, ground, on_unreachable="nan")
        low = self._geometry.extension_min + self._margin
        high = self._geometry.extension_max - self._margin
        fits = ((extension >= low) & (extension <= high)).all(axis=(1, 2))
        return float(scales[int(np.argmax(fits))]) if fits.any() else 0.0
