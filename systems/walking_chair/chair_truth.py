"""What a simulation knows and no drive tells: the chair's true pose, feet, contacts and loops."""

import functools
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.caching import declare_cached
from parapod.systems.walking_chair.chair_model import ChairModel
from parapod.systems.walking_chair.geometry import LEG_COUNT


class ChairTruth(LeafSystem):
    """True pose of the body, contact of the feet, and how well the legs' loops are closed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `contact_results` | abstract | - | contact results of the plant |
    | in `body_poses` | abstract | - | poses of the plant's bodies |
    | out `body_position` | 3 | m | of S in the world |
    | out `body_attitude` | 3 | rad | roll, pitch, yaw |
    | out `foot_height` | 12 | m | corners E_1, E_2, E_3 of each foot above the ground |
    | out `loop_error` | 8 | m | distance of rod end and foot at each ball joint |
    | out `contact_force` | 4 | N | of the ground on the feet, upwards |

    State: none.
    """

    def __init__(self, model: ChairModel):
        super().__init__()
        self.set_name("chair_truth")
        self._body = model.body.index()
        self._feet = [foot.index() for foot in model.feet]
        self._rods = [rod.index() for leg in range(LEG_COUNT) for rod in model.rods(leg)]
        self._corners = model.geometry.leg.corners
        self._balls = model.geometry.leg.lower_joints[1:]
        self._contact = self.DeclareAbstractInputPort("contact_results", Value[ContactResults]())
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]([]))
        self._shown = declare_cached(self, "shown", self._calc_shown, {self._poses.ticket()})
        for i, (name, size) in enumerate(
            (("body_position", 3), ("body_attitude", 3), ("foot_height", 12), ("loop_error", 8))
        ):
            calc = functools.partial(_copy_shown, weakref.ref(self), i)
            self.DeclareVectorOutputPort(name, size, calc, {self._shown.ticket})
        self.DeclareVectorOutputPort(
            "contact_force", LEG_COUNT, self._calc_force, {self._contact.ticket()}
        )

    def shown(self, context: Context, index: int) -> NDArray[np.float64]:
        """What follows from the poses: position, attitude, heights of corners, gaps of loops."""
        part: NDArray[np.float64] = self._shown.of(self, context)[index]
        return part

    def _calc_shown(self, context: Context) -> tuple[NDArray[np.float64], ...]:
        poses: Any = self._poses.Eval(context)
        body = poses[self._body]
        feet = [poses[foot] for foot in self._feet]
        heights = [(foot @ self._corners.T)[2] for foot in feet]
        balls = [foot @ self._balls.T for foot in feet]
        rods = np.array([poses[rod].translation() for rod in self._rods])
        gaps = rods - np.concatenate(balls, axis=1).T
        return (
            body.translation(),
            RollPitchYaw(body.rotation()).vector(),
            np.concatenate(heights),
            np.linalg.norm(gaps, axis=1),
        )

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        results: Any = self._contact.Eval(context)
        force = [0.0] * LEG_COUNT
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            for sign, body in ((-1.0, info.bodyA_index()), (1.0, info.bodyB_index())):
                if body in self._feet:
                    force[self._feet.index(body)] += sign * info.contact_force()[2]
        output.SetFromVector(np.array(force))


def _copy_shown(
    truth: weakref.ref[ChairTruth], index: int, context: Context, output: BasicVector
) -> None:
    """Calculates one output port; knows the system weakly, as a port must not keep it alive."""
    system = truth()
    assert system is not None
    output.SetFromVector(system.shown(context, index))
