"""What a simulation knows and no sensor tells: the platform's true posture, feet and loops."""

from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.inclined_ground import OnInclinedGround
from parapod.systems.levelling_platform.plane import dot, normal_of
from parapod.systems.levelling_platform.platform_model import MODEL_GEOMETRY, PlatformModel
from parapod.systems.ports import read_array
from parapod.systems.rotations import Axes


class PlatformTruth(OnInclinedGround):
    """True posture of the platform, from the plant's state.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `state` | n | - | state of the plant |
    | out `posture` | 3 | rad, rad, m | roll, pitch, height above the ground |

    State: none. Parameters (Context): the ground, see `OnInclinedGround`.
    """

    def __init__(self, model: PlatformModel):
        super().__init__()
        self.set_name("platform_truth")
        self._start = model.base.floating_positions_start()
        self._state = self.DeclareVectorInputPort("state", model.plant.num_multibody_states())
        self.DeclareVectorOutputPort(
            "posture",
            3,
            self._calc_posture,
            {self._state.ticket(), self.all_parameters_ticket()},
        )

    def _calc_posture(self, context: Context, output: BasicVector) -> None:
        state: Any = self._state.EvalBasicVector(context)
        pose = state.value()[self._start : self._start + 7].tolist()
        roll, pitch, _ = Axes.from_quaternion(pose[:4]).roll_pitch_yaw()
        height = dot(normal_of(*self._ground_of(context)), pose[4:])
        output.SetFromVector(np.array([roll, pitch, height]))


class FootTruth(OnInclinedGround):
    """True contact of the feet, and how well the legs' loops are closed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `contact_results` | abstract | - | contact results of the plant |
    | in `body_poses` | abstract | - | poses of the plant's bodies |
    | out `contact_force` | 4 | N | of the ground on the feet, normal to the ground |
    | out `foot_height` | 4 | m | lowest point of the rollers above the ground |
    | out `loop_error` | 4 | m | distance of rod end and coupler at K; zero for reduced legs |

    State: none. Parameters (Context): the ground, see `OnInclinedGround`.
    """

    def __init__(self, model: PlatformModel):
        super().__init__()
        self.set_name("foot_truth")
        self._radius = model.geometry.foot_radius
        self._rollers = [body.index() for body in model.leg_bodies("roller")]
        self._loops = []
        if model.is_full:
            leg = MODEL_GEOMETRY.legs[0]  # `stand` moves the actuator's pivot, not K
            self._p_MK = np.array([leg.l_3 * leg.e_a[0], 0.0, leg.l_3 * leg.e_a[1]])
            rods, couplers = (model.leg_bodies(name) for name in ("rod", "coupler"))
            self._loops = [(a.index(), b.index()) for a, b in zip(rods, couplers, strict=True)]
        self._contact = self.DeclareAbstractInputPort("contact_results", Value[ContactResults]())
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]([]))
        ground = self.all_parameters_ticket()
        poses = self._poses.ticket()
        for name, calc, tickets in (
            ("contact_force", self._calc_force, {self._contact.ticket(), ground}),
            ("foot_height", self._calc_height, {poses, ground}),
            ("loop_error", self._calc_loop_error, {poses}),
        ):
            self.DeclareVectorOutputPort(name, LEG_COUNT, calc, tickets)

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        results: Any = self._contact.Eval(context)
        n = normal_of(*self._ground_of(context))
        force = [0.0] * LEG_COUNT
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            for sign, body in ((-1.0, info.bodyA_index()), (1.0, info.bodyB_index())):
                if body in self._rollers:
                    force[self._rollers.index(body)] += sign * dot(
                        n, info.contact_force().tolist()
                    )
        output.SetFromVector(np.array(force))

    def _calc_height(self, context: Context, output: BasicVector) -> None:
        poses: Any = self._poses.Eval(context)
        n = normal_of(*self._ground_of(context))
        centres = [poses[i].translation().tolist() for i in self._rollers]
        offsets = self._offsets_of(context)
        output.SetFromVector(
            np.array(
                [
                    dot(n, centre) - self._radius - offset
                    for centre, offset in zip(centres, offsets, strict=True)
                ]
            )
        )

    def _calc_loop_error(self, context: Context, output: BasicVector) -> None:
        if not self._loops:
            output.SetFromVector(np.zeros(LEG_COUNT))
            return
        poses: Any = self._poses.Eval(context)
        output.SetFromVector(
            np.array(
                [
                    float(np.linalg.norm(poses[rod].translation() - poses[coupler] @ self._p_MK))
                    for rod, coupler in self._loops
                ]
            )
        )


class PlatformPose(LeafSystem):
    """Positions of all joints of a platform's model, for drawing a plant that has no such joints.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | 4 | m | extensions |
    | in `base_pose` | 7 | -, m | quaternion (w, x, y, z) and position of the platform |
    | in `arm_position` | 2 | rad | turntable and arm angle |
    | out `positions` | n | - | positions of the model's plant |

    State: none.
    """

    def __init__(self, model: PlatformModel):
        super().__init__()
        self.set_name("platform_pose")
        self._model = model
        self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._base_pose = self.DeclareVectorInputPort("base_pose", 7)
        self._arm = self.DeclareVectorInputPort("arm_position", 2)
        self.DeclareVectorOutputPort(
            "positions",
            model.plant.num_positions(),
            self._calc_positions,
            {self._extension.ticket(), self._base_pose.ticket(), self._arm.ticket()},
        )

    def _calc_positions(self, context: Context, output: BasicVector) -> None:
        q = self._model.positions_at(
            read_array(self._extension, context),
            read_array(self._base_pose, context),
            read_array(self._arm, context),
        )
        output.SetFromVector(q)
