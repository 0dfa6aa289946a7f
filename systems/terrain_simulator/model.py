"""The terrain simulator's bench as bodies and joints: names, closed-form pose, loops."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, ModelInstanceIndex, RigidBody
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.batching import columns
from parapod.systems.core.elementwise import atan2, sin_cos
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import declare_cached, read_array
from parapod.systems.core.vectors import Array
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.kinematics import (
    UnreachablePlate,
    forward_kinematics,
    slider_places,
)

SLIDERS = ("slider_1", "slider_2", "slider_3")
_CLOSED = ("link_2", "plate", "strut", "slider_3")  # bodies between which the loops are closed
_ON_RAIL, _CARRIED = (*SLIDERS, "link_1", "link_2"), ("plate", "strut")


@dataclass(frozen=True)
class BenchModel:
    """A finalized plant that holds a bench of `parapod.urdf.terrain_simulator`.

    The tree is rail, slider 1, link 1, plate and strut; two ball constraints close it, from the
    tip of link 2 to P and from the strut's foot to slider 3. Rotations are about the world's y.

    Attributes:
        plant: the plant.
        geometry: geometry to which the files are drawn.
        rail: model instance of the rail, its sliders and two links.
        carried: model instance of the plate and the strut.
    """

    plant: MultibodyPlant
    geometry: BenchGeometry
    rail: ModelInstanceIndex
    carried: ModelInstanceIndex

    def stand(self, context: Context, pose: ArrayLike, twist: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Puts the bench into a pose with a motion, loops closed.

        Args:
            context: the plant's context.
            pose: (3) x, z, phi of the plate's middle [m, m, rad].
            twist: (3) its rates [m/s, m/s, rad/s].
        """
        q, v = self.motion(pose, twist)
        positions, velocities = self.plant.GetPositions(context), self.plant.GetVelocities(context)
        for joint, value, rate in zip(self._joints, q, v, strict=True):
            positions[joint.position_start()], velocities[joint.velocity_start()] = value, rate
        self.plant.SetPositions(context, positions)
        self.plant.SetVelocities(context, velocities)

    def motion(
        self, pose: ArrayLike, twist: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions and velocities of the joints (7), (7) for a motion of the plate.

        Args:
            pose: (3) x, z, phi [m, m, rad].
            twist: (3) rates [m/s, m/s, rad/s].

        Returns:
            Three sliders [m, m/s], link 1, link 2, plate and strut [rad, rad/s].
        """
        q = self.positions(pose)
        moving = self._positions(InitializeAutoDiff(np.asarray(pose, dtype=float)).ravel())
        v = ExtractGradient(np.array(moving)) @ np.asarray(twist, dtype=float)
        return q, v

    def pose(self, context: Context) -> NDArray[np.float64]:
        """Pose (3) x, z, phi of the plate's middle [m, m, rad].

        Args:
            context: the plant's context.
        """
        return self.pose_of(self.plant.EvalBodyPoseInWorld(context, self.body("plate")))

    def pose_of(self, X_WP: RigidTransform) -> NDArray[np.float64]:
        """Pose (3) x, z, phi of the plate's middle [m, m, rad], from that of its body."""
        (x_P, z_P), R = self.geometry.p_OP, X_WP.rotation().matrix()
        x, _, z = X_WP.translation() - x_P * R[:, 0] - z_P * R[:, 2]
        return np.array((x, z, atan2(float(R[0, 2]), float(R[2, 2]))))

    def loop_error(self, context: Context) -> NDArray[np.float64]:
        """Distances (2) by which the loops are open: link 2 and P, strut and slider 3 [m].

        Args:
            context: the plant's context.
        """
        plant = self.plant
        return self.loop_error_of(lambda name: plant.EvalBodyPoseInWorld(context, self.body(name)))

    def loop_error_of(self, pose: Callable[[str], RigidTransform]) -> NDArray[np.float64]:
        """The same from the poses of the bodies, by their names."""
        closed = (
            ("link_2", self.geometry.link, "plate"),
            ("strut", -self.geometry.strut, "slider_3"),
        )
        gaps = []
        for name, length, other in closed:
            bar = pose(name)
            end = bar.translation() + length * bar.rotation().matrix()[:, 0]
            gaps.append(math.hypot(*(end - pose(other).translation()).tolist()))
        return np.array(gaps)

    def body(self, name: str) -> RigidBody:
        """Body of the bench by its name; a leg may have one of the same."""
        plant, carried = self.plant, self.carried
        is_carried = plant.HasBodyNamed(name, carried)
        return plant.GetBodyByName(name, carried if is_carried else self.rail)

    def positions(self, pose: ArrayLike) -> NDArray[np.float64]:
        """Positions (7) of the joints for a pose of the plate, in the order of `motion`."""
        return np.array(self._positions(np.asarray(pose, dtype=float)), dtype=float)

    @cached_property
    def order(self) -> list[int]:
        """Indices (7) of these joints among the plant's positions."""
        return [joint.position_start() for joint in self._joints]

    @property
    def _joints(self) -> list[Joint]:
        plant = self.plant
        groups = ((_ON_RAIL, self.rail), (_CARRIED, self.carried))
        return [plant.GetJointByName(name, of) for names, of in groups for name in names]

    def _positions(self, pose: NDArray[Any]) -> list[Any]:
        ((x, z, phi),), _ = columns((pose, 3, "pose"))
        a_1, a_2, a_3 = slider_places(self.geometry, pose)
        s, c = sin_cos(phi)
        (p_x, p_z), (t_x, t_z) = self.geometry.p_OP, self.geometry.p_OT
        s_1, z_P = 0.5 * (a_2 - a_1), z - s * p_x + c * p_z
        first, second = -atan2(z_P, s_1), -atan2(z_P, -s_1)
        strut = -atan2(z - s * t_x + c * t_z, x + c * t_x + s * t_z - a_3)
        return [a_1, a_2, a_3, first, second, phi - first, strut - phi]


class BenchTruth(LeafSystem):
    """True pose of the plate, and how well the bench's loops are closed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `body_poses` | abstract | - | poses of the plant's bodies |
    | out `pose` | 3 | m, m, rad | x, z, phi of the plate's middle |
    | out `loop_error` | 2 | m | gaps of link 2 and P, and of the strut and slider 3 |

    State: none.
    """

    def __init__(self, model: BenchModel):
        super().__init__()
        self.set_name("bench_truth")
        self._model = model
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]([]))
        self._index = {name: model.body(name).index() for name in _CLOSED}
        # Once for both ports: all poses are copied into Python.
        self._both = declare_cached(self, "both", self._calc_both, {self._poses.ticket()})
        here = {self._both.ticket}
        self.DeclareVectorOutputPort("pose", 3, self._copy_pose, here)
        self.DeclareVectorOutputPort("loop_error", 2, self._copy_loop_error, here)

    def _calc_both(self, context: Context) -> tuple[Array, Array]:
        poses: Any = self._poses.Eval(context)
        model, index = self._model, self._index
        pose = model.pose_of(poses[index["plate"]])
        return pose, model.loop_error_of(lambda name: poses[index[name]])

    def _copy_pose(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._both.value(self, context)[0])

    def _copy_loop_error(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._both.value(self, context)[1])


class BenchPositions(LeafSystem):
    """Positions of the model's joints for a pose of the plate, all loops closed.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pose` | 3 | m, m, rad | x, z, phi of the plate's middle |
    | in `hip` | 2 | m | place of the column along the rail, height of the hip |
    | in `leg` | n | rad or m | actuated joints of the leg |
    | out `positions` | n | - | positions of all joints of the model's plant |

    State: none.

    Bad input: a pose that no sliders lead to gives positions that are not finite.

    Args:
        model: the bench, with a leg on the slide.
        order: indices of column, slide and the leg's joints among the plant's positions.
        joints: number of the leg's actuated joints; None if it has no others.
        all_joints: gives the positions of all joints of the leg by those of the actuated ones;
            None if it has no others.
    """

    def __init__(
        self,
        model: BenchModel,
        order: tuple[int, ...],
        joints: int | None = None,
        all_joints: Callable[[Array], Array] | None = None,
    ):
        super().__init__()
        self.set_name("bench_positions")
        self._model, self._order, self._all_joints = model, list(order), all_joints
        self._pose = self.DeclareVectorInputPort("pose", 3)
        self._hip = self.DeclareVectorInputPort("hip", 2)
        self._leg = self.DeclareVectorInputPort("leg", joints or len(order) - 2)
        self.DeclareVectorOutputPort(
            "positions",
            model.plant.num_positions(),
            self._calc_positions,
            {self.all_input_ports_ticket()},
        )

    def _calc_positions(self, context: Context, output: BasicVector) -> None:
        positions = np.zeros(self._model.plant.num_positions())
        joints = self._model.positions(read_array(self._pose, context))
        positions[self._model.order] = joints
        hip, leg = read_array(self._hip, context), read_array(self._leg, context)
        leg = leg if self._all_joints is None else self._all_joints(leg)
        positions[self._order] = np.concatenate((hip, leg))
        output.SetFromVector(positions)


class PlatePose(LeafSystem):
    """Pose of the plate where the sliders are: a bench without dynamics.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `position` | 3 | m | places of the sliders |
    | out `pose` | 3 | m, m, rad | x, z, phi of the plate's middle |

    State: none.

    Bad input: NaN where no pose belongs to the sliders.

    Args:
        geometry: the bench.
    """

    def __init__(self, geometry: BenchGeometry = BenchGeometry.pedal()):
        super().__init__()
        self.set_name("plate_pose")
        self._geometry = geometry
        self._position = self.DeclareVectorInputPort("position", 3)
        self.DeclareVectorOutputPort("pose", 3, self._calc_pose, {self._position.ticket()})

    def _calc_pose(self, context: Context, output: BasicVector) -> None:
        try:
            pose = forward_kinematics(self._geometry, read_array(self._position, context))
        except UnreachablePlate:
            pose = np.full(3, np.nan)
        output.SetFromVector(pose)
