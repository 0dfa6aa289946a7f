"""Drilling as the machine feels it: thrust and torque of the material on the tool."""

import math

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues

from parapod.systems.core.elementwise import Elementwise, greatest, least, where
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import elements, read_batch
from parapod.systems.core.rows import number_of
from parapod.systems.machining_centre.job import Process
from parapod.systems.machining_centre.panel import Panel

# Depth at which the drill's point is all in the material [m], how much more than at the feed that
# is meant it may be loaded [-], and the height at which it has left the hole [m].
_POINT, _MOST, _OUT = 2e-3, 1.5, 1e-3
# Time constant with which chips form, so that load follows feed [s] (assumption).
_LAG = 0.02
# The drill does not cut where its angle to the panel's normal has a smaller cosine [-], nor where
# it is farther than that from everything [m]; its tip is then taken to be so high [m].
_COSINE, _FAR, _AWAY = 0.5, 100.0, 1.0


class DrillingProcess(LeafSystem):
    """Load of a drill by how fast it is going deeper.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pose` | 6 | m, rad | of the platform |
    | out `tool_force` | 2 | N, N m | thrust on the drill, out of the material; torque on it |
    | out `tip_height` | 1 | m | of the tip above the panel |

    Where the tip is deeper than the hole is by now material is cut: at the feed that is meant the
    load is that of the `Process`, faster more in proportion, and less until the drill's point is
    in. A tip that stays or goes back is free.

    State: discrete; depth of the hole [m], thrust as a share of the process's [-]; updated every
    period.

    Bad input: a pose that is not finite has no load.

    Args:
        process: the drill.
        panel: the panel.
        feed: intended feed [m/s].
        period: between two updates [s].
    """

    def __init__(
        self,
        process: Process = Process(),
        panel: Panel = Panel(),
        feed: float = 0.003,
        period: float = 0.01,
    ):
        super().__init__()
        self.set_name("drilling")
        self._process, self._panel, self._feed, self._period = process, panel, feed, period
        self._pose = self.DeclareVectorInputPort("pose", 6)
        state = self.DeclareDiscreteState(2)
        self.DeclareVectorOutputPort(
            "tool_force", 2, self._calc_force, {self.discrete_state_ticket(state)}
        )
        self.DeclareVectorOutputPort("tip_height", 1, self._calc_height, {self._pose.ticket()})
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _height(self, context: Context) -> Elementwise:
        """Height of the tip above the panel; far away if it is not known."""
        pose = read_batch(self._pose, context)
        is_near = (np.abs(pose) < _FAR).all(axis=-1)
        pose = np.where(is_near[..., np.newaxis], pose, 0.0)
        height = self._panel.place(self._process.tip(pose))[..., 2]
        is_upright = np.cos(pose[..., 3]) * np.cos(pose[..., 4]) > _COSINE
        return number_of(np.where(is_near & is_upright, height, _AWAY))

    def _update(self, context: Context, state: DiscreteValues) -> None:
        depth, share = elements(context.get_discrete_state(0))
        deep = -self._height(context)
        depth = where(deep < -_OUT, 0.0, depth)
        cut = greatest(0.0, deep - greatest(depth, 0.0)) / self._period / self._feed
        feed = least(_MOST, cut) * least(1.0, greatest(deep, 0.0) / _POINT)
        share += -math.expm1(-self._period / _LAG) * (feed - share)
        state.set_value(0, np.array((greatest(depth, deep), share)))

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        _, share = elements(context.get_discrete_state(0))
        output.SetFromVector(
            np.array((share * self._process.thrust, share * self._process.torque))
        )

    def _calc_height(self, context: Context, output: BasicVector) -> None:
        output[0] = self._height(context)
