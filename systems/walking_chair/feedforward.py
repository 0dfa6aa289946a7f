"""Exact inverse kinematics of the chair as a system, and an eased start of its branches.

The start leads the branches from where they are to where the gait has them, without a jump.
"""

from typing import Any

import numpy as np
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.errors import ParapodError
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.motion_laws import MOTION_LAWS
from parapod.systems.core.ports import declare_cached, read_array
from parapod.systems.walking_chair.chair import chair_inverse, chair_motion
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.trajectories import (
    BodyMotion,
    BranchMotion,
    Motion,
)

_LEVEL = np.eye(3)


class ChairFeedforward(LeafSystem):
    """Lengths, velocities and accelerations of the branches of a chair that stays level.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `body_motion` | 9 | m, m/s, m/s^2 | position, velocity, acceleration of S in the world |
    | in `foot_motion` | 36 | m, m/s, m/s^2 | of the feet's reference corners, leg by leg |
    | in `references` | 4 | - | numbers 1, 2, 3 of these corners |
    | out `length` | 12 | m | of the branches 11, 12, 13, 21, ... 43 (Eqs. 29-31) |
    | out `velocity` | 12 | m/s | their rates (Eqs. 33, 34, corrected) |
    | out `acceleration` | 12 | m/s^2 | theirs (Eqs. 35, 36, corrected) |

    State: none. Lengths are calculated without the rates, which a position controller does not
    need from node to node.

    Bad input: where a leg cannot reach, the outputs of its branches are NaN; an unknown corner
    is a ValueError.
    """

    def __init__(self, geometry: ChairGeometry = ChairGeometry()):
        super().__init__()
        self.set_name("chair_feedforward")
        self._geometry = geometry
        self._body = self.DeclareVectorInputPort("body_motion", 9)
        self._feet = self.DeclareVectorInputPort("foot_motion", 9 * LEG_COUNT)
        self._references = self.DeclareVectorInputPort("references", LEG_COUNT)
        inputs = {port.ticket() for port in (self._body, self._feet, self._references)}
        count = len(BRANCHES)
        self.DeclareVectorOutputPort("length", count, self._calc_length, inputs)
        self._motion = declare_cached(self, "motion", self._calc_motion, inputs)
        rates = {self._motion.ticket}
        self.DeclareVectorOutputPort("velocity", count, self._calc_velocity, rates)
        self.DeclareVectorOutputPort("acceleration", count, self._calc_acceleration, rates)

    def _inputs(self, context: Context) -> tuple[BodyMotion, Motion, "np.ndarray"]:
        position, velocity, acceleration = read_array(self._body, context).reshape(3, 3)
        body = BodyMotion(position, _LEVEL, velocity=velocity, acceleration=acceleration)
        feet = Motion(*read_array(self._feet, context).reshape(3, LEG_COUNT, 3))
        return body, feet, read_array(self._references, context)

    def _calc_length(self, context: Context, output: BasicVector) -> None:
        body, feet, references = self._inputs(context)
        lengths = chair_inverse(self._geometry, body.position, _LEVEL, feet.position, references)
        output.SetFromVector(lengths.ravel())

    def _calc_motion(self, context: Context) -> BranchMotion:
        return chair_motion(self._geometry, *self._inputs(context))

    def _calc_velocity(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._motion.value(self, context).velocity.ravel())

    def _calc_acceleration(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._motion.value(self, context).acceleration.ravel())


# Largest distance of a branch from its length at the start, of the paper's leg [m].
FARTHEST = 0.020


class NotAtStart(ParapodError):
    """A chair that does not stand where its walk begins.

    Attributes:
        branch: the branch with the largest distance, as in "branch 12".
        length: its length [m].
        expected: its length at the beginning of the walk [m].
    """

    def __init__(self, branch: str, length: float, expected: float, farthest: float):
        self.branch, self.length, self.expected = branch, length, expected
        super().__init__(
            f"{branch} is {1e3 * length:.2f} mm long, but the walk begins with "
            f"{1e3 * expected:.2f} mm; bring all branches to within {1e3 * farthest:g} mm of that"
        )


class EasedStart(LeafSystem):
    """Nodes that begin where the branches are measured and soon are the gait's.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `length` | 12 | m | lengths of the branches that the gait has |
    | in `position_measured` | 12 | m | lengths that they have |
    | out `position_node` | 12 | m | lengths to be reached at the end of this period |

    State: discrete, what the branches were off at the first sample (12) [m], whether there has
    been one, and when (2). The difference fades by a quintic within `duration`.

    Bad input: `NotAtStart` is raised at the first sample if a branch is further off than
    `farthest`; where a value is not finite, nodes are the gait's.

    Args:
        duration: duration of the fading [s].
        period: period of the samples [s].
        farthest: largest distance of a branch from its length at the start [m].
    """

    def __init__(self, duration: float = 1.0, period: float = 0.01, farthest: float = FARTHEST):
        super().__init__()
        self.set_name("eased_start")
        self._duration, self.farthest = duration, farthest
        count = len(BRANCHES)
        self._length = self.DeclareVectorInputPort("length", count)
        self._measured = self.DeclareVectorInputPort("position_measured", count)
        index = self.DeclareDiscreteState(count + 2)
        self.DeclareVectorOutputPort(
            "position_node",
            count,
            self._calc_position_node,
            {
                self._length.ticket(),
                self._measured.ticket(),
                self.discrete_state_ticket(index),
                self.time_ticket(),
            },
        )
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update_offset)

    def _offset(self, context: Context) -> np.ndarray:
        """Offset of the branches, without the fading."""
        offset = read_array(self._measured, context) - read_array(self._length, context)
        return np.where(np.isfinite(offset), offset, 0.0)

    def _calc_position_node(self, context: Context, output: BasicVector) -> None:
        state: Any = context.get_discrete_state_vector()
        values, length = state.value(), read_array(self._length, context)
        if not values[-2] > 0.5:
            output.SetFromVector(length + self._offset(context))
            return
        since = (context.get_time() - values[-1]) / self._duration
        if since < 1.0:
            progress = float(MOTION_LAWS["quintic"](np.array(max(since, 0.0)))[0])
            length = length + (1.0 - progress) * values[:-2]
        output.SetFromVector(length)

    def _update_offset(self, context: Context, discrete_state: Any) -> None:
        state: Any = context.get_discrete_state_vector()
        if state.value()[-2] > 0.5:
            return
        offset = self._offset(context)
        worst = int(np.abs(offset).argmax())
        if abs(offset[worst]) > self.farthest:
            expected = float(read_array(self._length, context)[worst])
            length = expected + float(offset[worst])
            raise NotAtStart(BRANCHES[worst], length, expected, self.farthest)
        discrete_state.set_value(np.concatenate((offset, (1.0, context.get_time()))))
