"""Pushes on a platform, and a payload at the tip of its arm, as a plant takes them."""

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues

from parapod.systems.arm.serial_arm import SerialArm
from parapod.systems.core.elementwise import all_finite, sumprod
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.physics import GRAVITY
from parapod.systems.core.ports import read, read_or_zeros
from parapod.systems.core.triples import Vector3, cross, plus
from parapod.systems.core.vectors import Axes

_NONE: Vector3 = (0.0, 0.0, 0.0)
_WRENCH, _APPLIED = range(2)


class ExternalLoad(LeafSystem):
    """Wrench and generalized force of pushes on a base, and of a payload at the tip of its arm.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `base_pose` | 7 | -, m | quaternion (w, x, y, z) and place of the base |
    | in `joint_state` | 2n | rad or m, and per s | positions and rates; unconnected: zero |
    | in `pushes` | 6k | N m, N | moment and force of each, by the world's axes; unconnected: 0 |
    | in `payload` | 1 | kg | mass whose weight the tip bears; unconnected: 0 |
    | out `wrench` | 6 | N m, N | all of it about the base, by the base's axes |
    | out `applied_force` | m | N m, N | the same along the velocities, m = 6 + n |

    Each push acts at a place of its own on the base. Of the payload the weight counts, and not
    the inertia: of a rigid arm, which a `FlexibleArm` does not need. `applied_force` is along
    the velocities of the base in the world, angular before linear, and along those of the joints.

    State: discrete, both outputs (6 and 6 + n), so that what a plant takes at once does not
    depend on where it is at once; updated every period.

    Bad input: with a number that is not finite both outputs stay.
    """

    def __init__(
        self,
        places: Sequence[Vector3] = (_NONE,),
        arm: SerialArm = SerialArm(),
        period: float = 1e-3,
    ):
        """Creates the system.

        Args:
            places: places of the k pushes, from the base's origin, by its axes [m].
            arm: the arm.
            period: period of the updates [s].
        """
        super().__init__()
        self.set_name("external_load")
        self._places, self._arm = tuple(places), arm
        self._pose = self.DeclareVectorInputPort("base_pose", 7)
        self._joints = self.DeclareVectorInputPort("joint_state", 2 * arm.count)
        self._pushes = self.DeclareVectorInputPort("pushes", 6 * len(self._places))
        self._payload = self.DeclareVectorInputPort("payload", 1)
        for name, size in (("wrench", 6), ("applied_force", 6 + arm.count)):
            self.DeclareStateOutputPort(name, self.DeclareDiscreteState(size))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _update(self, context: Context, discrete_state: DiscreteValues) -> None:
        axes = Axes.from_quaternion(read(self._pose, context)[:4])
        pushes = read_or_zeros(self._pushes, context)
        moment, force = _NONE, _NONE
        for i, place in enumerate(self._places):
            m_x, m_y, m_z, *push = pushes[6 * i : 6 * i + 6]
            pushed = axes.components(push)
            force = plus(force, pushed)
            turned = plus(axes.components((m_x, m_y, m_z)), cross(place, pushed))
            moment = plus(moment, turned)
        position = read_or_zeros(self._joints, context)[: self._arm.count]
        (weight,) = read_or_zeros(self._payload, context)
        hung = axes.components((0.0, 0.0, -GRAVITY * weight))
        (tip, _), columns = self._arm.tip_motion(position)
        efforts = [sumprod(column[3:], hung) for column in columns]
        force, moment = plus(force, hung), plus(moment, cross(tip, hung))
        wrench = [*moment, *force]
        applied = [*axes.in_world(moment), *axes.in_world(force), *efforts]
        if all_finite([*wrench, *applied]):
            discrete_state.set_value(_WRENCH, np.array(wrench))
            discrete_state.set_value(_APPLIED, np.array(applied))
