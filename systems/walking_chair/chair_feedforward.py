"""Exact inverse kinematics of the chair: from motions of body and feet to the branches'."""

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.caching import declare_cached
from parapod.systems.ports import read_array
from parapod.systems.walking_chair.branches import BRANCHES
from parapod.systems.walking_chair.chair import chair_inverse, chair_motion
from parapod.systems.walking_chair.geometry import LEG_COUNT, ChairGeometry
from parapod.systems.walking_chair.motion import BodyMotion, BranchMotion, Motion

_LEVEL = np.eye(3)


class ChairFeedforward(LeafSystem):
    """Lengths, velocities and accelerations of the branches of a chair that stays level.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `body_motion` | 9 | m, m/s, m/s^2 | position, velocity, acceleration of S in the world |
    | in `foot_motion` | 36 | m, m/s, m/s^2 | of the feet's reference corners, likewise by legs |
    | in `references` | 4 | - | numbers 1, 2, 3 of these corners |
    | out `length` | 12 | m | of the branches 11, 12, 13, 21, ... 43 (Eqs. 29-31) |
    | out `velocity` | 12 | m/s | their rates (Eqs. 33, 34, corrected) |
    | out `acceleration` | 12 | m/s^2 | theirs (Eqs. 35, 36, corrected) |

    State: none. Lengths are calculated without the rates, which nobody needs who controls
    positions from node to node.

    Bad input: where a leg cannot reach, the outputs of its branches are NaN.
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
        return body, feet, read_array(self._references, context).astype(np.intp)

    def _calc_length(self, context: Context, output: BasicVector) -> None:
        body, feet, references = self._inputs(context)
        lengths = chair_inverse(self._geometry, body.position, _LEVEL, feet.position, references)
        output.SetFromVector(lengths.ravel())

    def _calc_motion(self, context: Context) -> BranchMotion:
        return chair_motion(self._geometry, *self._inputs(context))

    def _calc_velocity(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._motion.of(self, context).velocity.ravel())

    def _calc_acceleration(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._motion.of(self, context).acceleration.ravel())
