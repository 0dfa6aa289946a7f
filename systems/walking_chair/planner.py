"""Planners of references, a period ahead: a gait of the chair, a circle of one foot."""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import declare_cached, has_value, is_on
from parapod.systems.walking_chair.gait import GaitMotion, Walk
from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry, LegGeometry
from parapod.systems.walking_chair.leg import leg_inverse
from parapod.systems.walking_chair.trajectories import FootCircle

# Nodes that are computed at once, and how near to one the clock must be to be on it [s].
_CHUNK = 512
_ON_GRID = 1e-9


class GaitPlanner(LeafSystem):
    """A gait with a clock of its own, which can be held where all feet stand, and halted anywhere.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `hold` | 1 | - | above 0.5: no further step; unconnected: never |
    | in `halt` | 1 | - | above 0.5: no further move; unconnected: never |
    | out `gait_time` | 1 | s | the gait's clock now |
    | out `support` | 4 | 0/1 | feet that stand now, as planned; a foot that swings does not |
    | out `done` | 1 | 0/1 | whether the gait is over |
    | out `body_motion` | 9 | m, m/s, m/s^2 | of S in the world, at the end of this period |
    | out `foot_motion` | 36 | m, m/s, m/s^2 | of the feet's reference corners |
    | out `references` | 4 | - | numbers 1, 2, 3 of these corners |

    `foot_motion` has all positions, then all velocities, then all accelerations, each by legs.

    State: discrete, the gait's clock [s] and its pace (0 stopped, 1 running), updated every
    period. While held the clock slows down and stops within the phase if all feet stand in it;
    a step that has begun is completed, because a chair that stands on two feet with the others
    in the air is no better off. Phases end and begin with the body at rest for all body laws but
    "linear", so that a clock that stops there leaves nothing to brake. Halted it stops at once,
    in the middle of a step too: on the feet that stand the gait is balanced at every instant. The
    chair rests at the
    gait's beginning until `begin`.

    Args:
        walk: the gaits.
        geometry: the chair.
        period: period of the controller [s].
        begin: time at which the gait begins [s].
        pause: time that the clock takes to stop, and to run again [s].
        halting: time that it takes to stop when it is halted [s].
    """

    def __init__(
        self,
        walk: Walk = Walk(),
        geometry: ChairGeometry = ChairGeometry(),
        period: float = 0.01,
        begin: float = 0.0,
        pause: float = 0.5,
        halting: float = 0.1,
    ):
        super().__init__()
        self.set_name("gait_planner")
        self._halting = halting
        self.walk, self._geometry = walk, geometry
        self._period, self._begin, self._pause = period, begin, pause
        self._hold = self.DeclareVectorInputPort("hold", 1)
        self._halt = self.DeclareVectorInputPort("halt", 1)
        index = self.DeclareDiscreteState(BasicVector(np.array((0.0, 1.0))))
        state = {self.discrete_state_ticket(index)}
        clock = state | {self.time_ticket()} if begin > 0.0 else state
        self._node = declare_cached(self, "node", self._calc_node, clock)
        for name, size, calc, tickets in (
            ("gait_time", 1, self._calc_gait_time, state),
            ("support", LEG_COUNT, self._calc_support, state),
            ("done", 1, self._calc_done, state),
            ("body_motion", 9, self._calc_body_motion, {self._node.ticket}),
            ("foot_motion", 9 * LEG_COUNT, self._calc_foot_motion, {self._node.ticket}),
            ("references", LEG_COUNT, self._calc_references, {self._node.ticket}),
        ):
            self.DeclareVectorOutputPort(name, size, calc, tickets)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_clock)

    def _clock(self, context: Context) -> tuple[float, float]:
        """The gait's time and pace."""
        state: Any = context.get_discrete_state_vector()
        time, pace = state.value().tolist()
        return time, pace

    def _ahead(self, context: Context, time: float, pace: float) -> float:
        """The clock a period ahead."""
        if context.get_time() < self._begin - 0.5 * self._period:
            return time
        return time + pace * self._period

    def _calc_node(self, context: Context) -> tuple[NDArray[np.float64], ...]:
        """Body's motion (9), feet's motion (36) and reference corners (4) at the next sample."""
        time, pace = self._clock(context)
        ahead = self._ahead(context, time, pace)
        index = round(ahead / self._period)
        if abs(ahead - index * self._period) < _ON_GRID:
            chunk = _nodes(self.walk, self._geometry, self._period, index // _CHUNK)
            body, feet, references = (table[index % _CHUNK] for table in chunk)
        else:
            motion = self.walk.motions(self._geometry, np.array([ahead]))
            body, feet, references = (table[0] for table in _tables(motion))
        if pace == 1.0:
            return body, feet, references
        slowed = np.array((1.0, pace, pace**2))
        return np.repeat(slowed, 3) * body, np.repeat(slowed, 3 * LEG_COUNT) * feet, references

    def _calc_gait_time(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([self._clock(context)[0]]))

    def _calc_support(self, context: Context, output: BasicVector) -> None:
        phase = self.walk.phase_at(self._clock(context)[0])
        output.SetFromVector(np.array(self.walk.standing[phase], dtype=float))

    def _calc_done(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.array([float(self._clock(context)[0] >= self.walk.duration)]))

    def _calc_body_motion(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._node.value(self, context)[0])

    def _calc_foot_motion(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._node.value(self, context)[1])

    def _calc_references(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._node.value(self, context)[2])

    def _update_clock(self, context: Context, discrete_state: Any) -> None:
        time, pace = self._clock(context)
        ahead = self._ahead(context, time, pace)
        step = self._period / self._pause
        if has_value(self._halt, context) and is_on(self._halt, context):
            pace = max(0.0, pace - self._period / self._halting)
        elif has_value(self._hold, context) and is_on(self._hold, context):
            ahead, pace = self._held(time, ahead, pace, step)
        else:
            pace = min(1.0, pace + step)
        discrete_state.set_value(np.array([min(ahead, self.walk.duration), pace]))

    def _held(self, time: float, ahead: float, pace: float, step: float) -> tuple[float, float]:
        """Clock and pace a period ahead while no further step may be made."""
        # At the instant between two phases the gait is still in the one that ends.
        phase = self.walk.phase_at(time - _ON_GRID, "left")
        if not all(self.walk.standing[phase]):
            return ahead, min(1.0, pace + step)
        # Not into the next phase: that is where the feet leave the ground.
        ahead = min(ahead, self.walk.ends[phase])
        return ahead, 0.0 if ahead == time else max(0.0, pace - step)


@lru_cache(maxsize=8)
def _nodes(
    walk: Walk, geometry: ChairGeometry, period: float, chunk: int
) -> tuple[NDArray[np.float64], ...]:
    """Nodes of the walk, a chunk of them at once: by far cheaper than one by one."""
    times: Any = period * np.arange(chunk * _CHUNK, (chunk + 1) * _CHUNK)
    return _tables(walk.motions(geometry, times))


def _tables(motion: GaitMotion) -> tuple[NDArray[np.float64], ...]:
    """Rows of body's motion (n, 9), feet's motion (n, 36) and reference corners (n, 4)."""
    body = np.concatenate(
        (motion.body.position, motion.body.velocity, motion.body.acceleration), axis=-1
    )
    rows = len(motion.references)
    feet = np.concatenate([part.reshape(rows, -1) for part in motion.feet], axis=-1)
    return body, feet, motion.references.astype(float)


class CircleReference(LeafSystem):
    """Lengths of a leg's branches that lead its foot round a circle, node by node.

    | port | size | unit | meaning |
    |---|---|---|---|
    | out `position_node` | 3 | m | of the branches UP, UPS, UPS a period after a sample |

    Who samples it at a time t that is a multiple of the period gets the lengths for where Eq. (49)
    has the foot at t + period (section "Control system": discrete position nodes).

    State: discrete, the node that the next sample is given.

    Bad input: there is none; for a circle out of the leg's reach the lengths are NaN.

    Args:
        circle: path of the foot, from time 0 on.
        geometry: the leg.
        period: between two nodes [s].
    """

    def __init__(
        self,
        circle: FootCircle = FootCircle(),
        geometry: LegGeometry = LegGeometry(),
        period: float = 0.01,
    ):
        super().__init__()
        self.set_name("circle_reference")
        self._circle, self._geometry, self._period = circle, geometry, period
        index = self.DeclareDiscreteState(BasicVector(self._node(period)))
        self.DeclareStateOutputPort("position_node", index)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_node)

    def _node(self, time: float) -> NDArray[np.float64]:
        return leg_inverse(self._geometry, self._circle.motion(time).position)

    def _update_node(self, context: Context, discrete_state: Any) -> None:
        # The next sample is a period ahead, and its node another one.
        discrete_state.set_value(self._node(context.get_time() + 2.0 * self._period))
