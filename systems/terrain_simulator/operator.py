"""Commands that a person gives to the bench in the browser: sliders move the plate."""

import math
from contextlib import AbstractContextManager

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.controls import Controls, PoseSliders, shown
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import read_array
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.reference import trot
from parapod.systems.terrain_simulator.walk import BenchWalk

# See `PoseSliders`.
_SLIDERS = (
    ("x [mm]", 250.0, 1.0, 1e-3),
    ("z [mm]", 150.0, 1.0, 1e-3),
    ("phi [deg]", 60.0, 0.5, math.radians(1.0)),
)
_LAG = 0.25  # time constant with which the plate goes where the sliders are [s]


class BenchControls(LeafSystem):
    """The operator of a bench: three sliders move the plate, and the leg stands on it.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pose_desired` | 3 | m, m, rad | pose that the guard lets the plate be led to |
    | out `pose_asked` | 3 | m, m, rad | x, z, phi of the plate a period later |
    | out `plate_motion` | 9 | m, rad, s | pose of the plate, at rest |
    | out `foot_desired` | 6 | m, s | x, z of the foot from the hip, at rest |
    | out `foot_force_desired` | 1 | N | weight that the leg carries |
    | out `hip_force` | 1 | N | 0: the leg carries it alone |
    | out `hip_desired` | 2 | m, m/s | height of the hip, at rest |
    | out `stance` | 1 | 0/1 | 1: the leg stands |

    The plate goes where the sliders are within some tenths of a second, as far as its guard lets
    it; the foot stays on it. Sliders exist while `shown` is entered.

    State: discrete, the pose (3), updated every period.

    Bad input: without the sliders the pose is the one at first.

    Args:
        controls: owner of the sliders.
        walk: walk in whose beginning the bench stands; None for `trot`.
        period: time between two readings of them [s].
    """

    def __init__(self, controls: Controls, walk: BenchWalk | None = None, period: float = 0.001):
        super().__init__()
        walk = trot() if walk is None else walk
        self.set_name("bench_controls")
        self._controls, self._hip = controls, np.array(walk.hip)
        start = walk.at(0.0)
        self._first, self._radius = start.pose[0], walk.foot_radius
        self._sliders = PoseSliders(controls, _SLIDERS, self._first)
        self._share = -math.expm1(-period / _LAG)
        self._led = self.DeclareVectorInputPort("pose_desired", 3)
        commanded = self.DeclareDiscreteState(self._first)
        self.DeclareStateOutputPort("pose_asked", commanded)
        on_plate = {self._led.ticket()}
        self.DeclareVectorOutputPort("plate_motion", 9, self._calc_motion, on_plate)
        self.DeclareVectorOutputPort("foot_desired", 6, self._calc_foot, on_plate)
        still = {
            "foot_force_desired": [walk.support.weight],
            "hip_force": [0.0],
            "hip_desired": [walk.hip[1], 0.0],
            "stance": [1.0],
        }
        for name, value in still.items():
            state = self.DeclareDiscreteState(np.array(value))
            self.DeclareStateOutputPort(name, state)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def shown(self) -> AbstractContextManager[None]:
        """Shows the sliders, and takes them away at the end."""
        return shown(self._controls, self._sliders.rows())

    def _update(self, context: Context, state: DiscreteValues) -> None:
        now = context.get_discrete_state(0).value()
        state.set_value(0, now + self._share * (self._sliders.read() - now))

    def _pose(self, context: Context) -> Array:
        lead = read_array(self._led, context)
        return lead if np.isfinite(lead).all() else self._first

    def _calc_motion(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.concatenate((self._pose(context), np.zeros(6))))

    def _calc_foot(self, context: Context, output: BasicVector) -> None:
        x, z, phi = self._pose(context)
        normal = self._radius * np.array((math.sin(phi), math.cos(phi)))
        output.SetFromVector(np.concatenate((np.array((x, z)) + normal - self._hip, np.zeros(4))))
