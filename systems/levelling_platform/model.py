"""The levelling platform as bodies and joints: names, closed-form pose, truth, drawn links.

Beside the model itself: the true posture, feet and loops that only a simulation knows; the
parallelograms' second long sides, drawn where the joints put them; and the transmission of the
reduced leg, between the actuator's rod and the parallelogram's swing.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import Value
from pydrake.geometry import (
    Box,
    Cylinder,
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    MakePhongIllustrationProperties,
    PerceptionProperties,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import ContactResults, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, Joint, ModelInstanceIndex, RigidBody
from pydrake.systems.framework import BasicVector, Context

from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.core.ports import has_value, read, read_array, read_or_zeros, read_vector
from parapod.systems.core.remembered import Remembered
from parapod.systems.core.triples import dot
from parapod.systems.core.vectors import Axes
from parapod.systems.levelling_platform.geometry import LEG_COUNT, LegGeometry, PlatformGeometry
from parapod.systems.levelling_platform.inclined_ground import (
    LEVEL_GROUND,
    NO_OFFSETS,
    OnInclinedGround,
)
from parapod.systems.levelling_platform.leg import (
    diagonal_angle,
    swing_angle,
    swing_motion,
    swing_rate,
)
from parapod.systems.levelling_platform.plane import normal_of
from parapod.systems.levelling_platform.statics import resting_posture
from parapod.systems.physics.loops import Ball, Coupling
from parapod.systems.physics.poses import Gaps, poses_at

WHEEL_COUNT = 4


def standing_pose(posture: ArrayLike, ground: ArrayLike, yaw: float = 0.0) -> NDArray[np.float64]:
    """Quaternion (w, x, y, z) and position (7) of a platform with this posture.

    Its centre stands above the world's origin, through which the ground's plane goes.

    Args:
        posture: (3) roll, pitch, height [rad, rad, m].
        ground: (2) roll and pitch of the ground [rad].
        yaw: its heading [rad].
    """
    roll, pitch, height = np.asarray(posture).tolist()
    normal = normal_of(*np.asarray(ground).tolist())
    quaternion = RollPitchYaw(roll, pitch, yaw).ToQuaternion().wxyz()
    return np.concatenate((quaternion, height * np.array(normal)))


@dataclass(frozen=True)
class PlatformModel:
    """A finalized plant that holds the platform of `parapod.urdf.levelling_platform`.

    Attributes:
        plant: the plant.
        ground_mount: frame on the world that carries the ground and can be inclined.
        geometry: dimensions of the legs as built.
    """

    plant: MultibodyPlant
    ground_mount: FixedOffsetFrame
    geometry: PlatformGeometry

    @cached_property
    def base(self) -> RigidBody:
        """The platform's body; its origin is the centre F."""
        return self.plant.GetBodyByName("base", self.plant.GetModelInstanceByName("base"))

    @cached_property
    def legs(self) -> tuple[ModelInstanceIndex, ...]:
        """The legs' model instances, 1..4."""
        return tuple(self.plant.GetModelInstanceByName(f"leg_{i + 1}") for i in range(LEG_COUNT))

    @cached_property
    def arm(self) -> ModelInstanceIndex:
        """The model instance of the arm, if it has one."""
        return self.plant.GetModelInstanceByName("arm")

    @cached_property
    def arm_joints(self) -> tuple[Joint, ...]:
        """The arm's joints that are driven (n), from the platform to the tip."""
        if not self.plant.HasModelInstanceNamed("arm"):
            return ()
        actuators = map(
            self.plant.get_joint_actuator, self.plant.GetJointActuatorIndices(self.arm)
        )
        return tuple(actuator.joint() for actuator in actuators)

    @cached_property
    def wheels(self) -> tuple[ModelInstanceIndex, ...]:
        """The wheels' model instances, 1..4."""
        return tuple(
            self.plant.GetModelInstanceByName(f"wheel_{i + 1}") for i in range(WHEEL_COUNT)
        )

    @cached_property
    def pads(self) -> ModelInstanceIndex:
        """The model instance of the pads, if ground moves."""
        return self.plant.GetModelInstanceByName("pads")

    @cached_property
    def has_rolling_wheels(self) -> bool:
        """Whether the wheels turn, instead of being part of the base."""
        return self.plant.num_actuators(self.wheels[0]) > 0

    @cached_property
    def is_full(self) -> bool:
        """Whether the legs' actuators are modelled as bodies."""
        return self.plant.HasBodyNamed("rod", self.legs[0])

    @cached_property
    def balls(self) -> tuple[Ball, ...]:
        """The ball joints at K that close the legs' loops, between rod and coupler."""
        if not self.is_full:
            return ()
        # As built, the actuator's pivot is moved, not K.
        legs = self.geometry.drawn_legs
        bodies = zip(legs, self.leg_bodies("rod"), self.leg_bodies("coupler"), strict=True)
        return tuple(
            Ball(rod, np.zeros(3), coupler, leg.l_3 * _in_plane(*leg.e_a))
            for leg, rod, coupler in bodies
        )

    @cached_property
    def couplings(self) -> tuple[Coupling, ...]:
        """The parallelograms: couplers turn against the lower links, and so not at all."""
        if not self.is_full:
            return ()
        joint = self.plant.GetJointByName
        return tuple(
            Coupling(joint("coupler_swing", leg), joint("swing", leg), -1.0) for leg in self.legs
        )

    def leg_bodies(self, name: str) -> tuple[RigidBody, ...]:
        """The body of that name of each leg."""
        return tuple(self.plant.GetBodyByName(name, leg) for leg in self.legs)

    def leg_angles(self, leg: int, extension: float) -> dict[str, float]:
        """Positions of a leg's joints at an extension, in closed form."""
        dimensions = self.geometry.legs[leg]
        swing = swing_angle(dimensions, extension)
        angles = {"swing": swing}
        if self.is_full:
            angles["coupler_swing"] = -swing
            angles["cylinder_swing"] = diagonal_angle(dimensions, extension)
            angles["extension"] = extension
        return angles

    @cached_property
    def _position_starts(self) -> list[dict[str, int]]:
        """Index of each leg's joint position among the plant's positions."""
        starts: list[dict[str, int]] = []
        for leg in self.legs:
            joints = [self.plant.get_joint(i) for i in self.plant.GetJointIndices(leg)]
            starts.append({joint.name(): joint.position_start() for joint in joints})
        return starts

    def positions(
        self,
        extension: ArrayLike,
        posture: ArrayLike,
        ground: ArrayLike,
        arm: ArrayLike | None = None,
    ) -> NDArray[np.float64]:
        """All positions of the plant, loops closed and feet on the ground.

        Args:
            extension: (4) extensions [m].
            posture: (3) roll, pitch, height [rad, rad, m].
            ground: (2) roll and pitch of the ground [rad].
            arm: (n) positions of the arm's joints [rad or m]; None: zero.
        """
        return self.positions_at(extension, standing_pose(posture, ground), arm)

    def positions_at(
        self, extension: ArrayLike, base_pose: ArrayLike, arm: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """All positions of the plant, loops closed; wheels and rollers are at zero.

        Args:
            extension: (4) extensions [m].
            base_pose: (7) quaternion (w, x, y, z) and position [m] of the platform.
            arm: (n) positions of the arm's joints [rad or m]; None: zero.
        """
        q = np.zeros(self.plant.num_positions())
        for leg, d in enumerate(np.asarray(extension).tolist()):
            for joint, value in self.leg_angles(leg, d).items():
                q[self._position_starts[leg][joint]] = value
        start = self.base.floating_positions_start()
        q[start : start + 7] = base_pose
        if arm is not None:
            starts = [joint.position_start() for joint in self.arm_joints]
            if starts:
                q[starts] = np.asarray(arm, dtype=float)
        return q

    def base_pose(self, positions: NDArray[np.float64]) -> RigidTransform:
        """X_WF: pose of the platform at these positions of the plant (or its whole state)."""
        start = self.base.floating_positions_start()
        quaternion = positions[start : start + 4]
        rotation = RotationMatrix(Quaternion(quaternion / np.linalg.norm(quaternion)))
        return RigidTransform(rotation, positions[start + 4 : start + 7])

    def swing(self, leg: int, positions: NDArray[np.float64]) -> float:
        """Angle psi of a leg's lower link at these positions of the plant [rad]."""
        return float(positions[self._position_starts[leg]["swing"]])

    def standing_positions(
        self, extension: ArrayLike, ground: ArrayLike, foot_offsets: ArrayLike = NO_OFFSETS
    ) -> NDArray[np.float64]:
        """All positions of the plant with the platform at rest on its feet.

        Args:
            extension: (4) extensions [m].
            ground: (2) roll and pitch of the ground [rad].
            foot_offsets: (4) heights under the feet above the ground's plane [m].
        """
        posture = resting_posture(self.geometry, extension, ground, foot_offsets)
        return self.positions(extension, posture, ground)

    def positions_on_wheels(
        self, extension: ArrayLike, posture: ArrayLike, ground: ArrayLike, x: float = 0.0
    ) -> NDArray[np.float64]:
        """All positions of the plant with the platform at rest on its wheels.

        Args:
            extension: (4) extensions, with the legs raised [m].
            posture: (3) of a platform on its wheels [rad, rad, m].
            ground: (2) roll and pitch of the ground [rad].
            x: distance from the places of the feet, along the platform's x axis [m].
        """
        pose = standing_pose(posture, ground)
        pose[4:] += ground_pose(ground).rotation().matrix() @ [x, 0.0, 0.0]
        return self.positions_at(extension, pose)

    def put(
        self,
        context: Context,
        positions: ArrayLike,
        ground: ArrayLike,
        foot_offsets: ArrayLike = NO_OFFSETS,
    ) -> None:
        """Inclines the ground and puts the plant at rest.

        Args:
            context: the plant's context.
            positions: all positions of the plant.
            ground: (2) roll and pitch of the ground [rad].
            foot_offsets: (4) heights under the feet above the ground's plane, which the model
                must have been built with [m].
        """
        self.ground_mount.SetPoseInParentFrame(context, ground_pose(ground, foot_offsets))
        self.plant.SetPositions(context, np.asarray(positions))
        self.plant.SetVelocities(context, np.zeros(self.plant.num_velocities()))


def ground_pose(ground: ArrayLike, foot_offsets: ArrayLike = NO_OFFSETS) -> RigidTransform:
    """X_WG: pose of the model's plane, which is the lowest part of the ground.

    Args:
        ground: (2) roll and pitch of the ground [rad].
        foot_offsets: (4) heights under the feet above the ground's plane [m].
    """
    roll, pitch = np.asarray(ground).tolist()
    lowest = min(0.0, float(np.min(np.asarray(foot_offsets))))
    return RigidTransform(
        RollPitchYaw(roll, pitch, 0.0), lowest * np.array(normal_of(roll, pitch))
    )


def hip_pose(leg: LegGeometry) -> RigidTransform:
    """X_FD: pose of a leg's hip in the platform's frame."""
    p_FE = np.array([-leg.l_x, -leg.l_y, -leg.l_z])
    return RigidTransform(RotationMatrix.MakeZRotation(leg.beta), p_FE)


def joint_origins(
    leg: LegGeometry, reference: LegGeometry, leg_model: str
) -> dict[str, list[float]]:
    """Origins (3) of the joints that a leg as built has elsewhere than the drawn one [m].

    Args:
        leg: the leg as built.
        reference: the leg of the model's files.
        leg_model: "full" or "reduced".
    """
    p_MC = -leg.l_6 * _in_plane(*leg.e_a) - _in_plane(0.0, leg.l_7 - leg.foot_radius)
    along = np.array([leg.l_4, 0.0, 0.0])
    if leg_model == "full":
        # The coupler only translates, so what it is longer at K, the pivot may recede.
        longer = leg.l_3 * _in_plane(*leg.e_a) - reference.l_3 * _in_plane(*reference.e_a)
        origins = {"coupler_swing": along, "roll": p_MC, "cylinder_swing": -longer}
    else:
        origins = {"swing": p_MC, "roll": along}
    return {joint: origin.tolist() for joint, origin in origins.items()}


def _in_plane(x: float, z: float) -> NDArray[np.float64]:
    """A vector of a leg's plane."""
    return np.array([x, 0.0, z])


class PlatformTruth(OnInclinedGround):
    """True posture of the platform, from the plant's state.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `state` | n | - | state of the plant |
    | out `posture` | 3 | rad, rad, m | roll, pitch, height above the ground |

    State: none. Parameters (Context): the ground, see `OnInclinedGround`.

    Bad input: NaN for a pose that is not finite.
    """

    def __init__(
        self,
        model: PlatformModel,
        ground: ArrayLike = LEVEL_GROUND,
        foot_offsets: ArrayLike = NO_OFFSETS,
    ):
        super().__init__(ground, foot_offsets)
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
        state = read_vector(self._state, context)
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
    | in `rising` | 8 | m, m/s | how far the ground under each foot has risen; unconnected: 0 |
    | out `contact_force` | 4 | N | of the ground on the feet, normal to the ground |
    | out `foot_height` | 4 | m | lowest point of the rollers above the ground |
    | out `loop_error` | 4 | m | distance of rod end and coupler at K; zero for reduced legs |

    State: none. Parameters (Context): the ground, see `OnInclinedGround`.

    Bad input: a rise that is not finite is passed on.
    """

    def __init__(
        self,
        model: PlatformModel,
        ground: ArrayLike = LEVEL_GROUND,
        foot_offsets: ArrayLike = NO_OFFSETS,
    ):
        super().__init__(ground, foot_offsets)
        self.set_name("foot_truth")
        self._radius = model.geometry.foot_radius
        self._rollers = [int(body.index()) for body in model.leg_bodies("roller")]
        self._gaps = Gaps(model.balls) if model.balls else None
        self._contact = self.DeclareAbstractInputPort("contact_results", Value[ContactResults]())
        self._poses = self.DeclareAbstractInputPort("body_poses", Value[list[RigidTransform]]([]))
        self._rising = self.DeclareVectorInputPort("rising", 2 * LEG_COUNT)
        parameters, poses = self.all_parameters_ticket(), self._poses.ticket()
        for name, calc, tickets in (
            ("contact_force", self._calc_force, {self._contact.ticket(), parameters}),
            ("foot_height", self._calc_height, {poses, parameters, self._rising.ticket()}),
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
        poses = poses_at(self._poses, context)
        n = normal_of(*self._ground_of(context))
        centres = [poses.origin(roller) for roller in self._rollers]
        offsets, rising = self._offsets_of(context), read_or_zeros(self._rising, context)
        heights = [
            dot(n, centre) - self._radius - offset - risen
            for centre, offset, risen in zip(centres, offsets, rising[:LEG_COUNT], strict=True)
        ]
        output.SetFromVector(np.array(heights))

    def _calc_loop_error(self, context: Context, output: BasicVector) -> None:
        if self._gaps is None:
            output.SetFromVector(np.zeros(LEG_COUNT))
        else:
            output.SetFromVector(np.array(self._gaps.of(poses_at(self._poses, context))))


class PlatformPose(LeafSystem):
    """Positions of all joints of a platform's model, for drawing a plant that has no such joints.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `extension` | 4 | m | extensions |
    | in `base_pose` | 7 | -, m | quaternion (w, x, y, z) and position of the platform |
    | in `arm_position` | n | rad or m | positions of the arm's joints; unconnected: zero |
    | out `positions` | n | - | positions of the model's plant |

    State: none.

    Bad input: NaN where an extension cannot be built; a pose or the arm's positions are passed on.
    """

    def __init__(self, model: PlatformModel):
        super().__init__()
        self.set_name("platform_pose")
        self._model = model
        self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._base_pose = self.DeclareVectorInputPort("base_pose", 7)
        self._arm = self.DeclareVectorInputPort("arm_position", len(model.arm_joints))
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
            read_array(self._arm, context) if has_value(self._arm, context) else None,
        )
        output.SetFromVector(q)


# Positions from here on are of no platform, but of one that could not be built [m, rad].
_NOWHERE = 1e6
_ORANGE, _DARK = np.array([0.95, 0.45, 0.10, 1.0]), np.array([0.13, 0.15, 0.19, 1.0])


def _perceived(colour: NDArray[np.float64]) -> PerceptionProperties:
    """Colour as a renderer sees it."""
    properties = PerceptionProperties()
    properties.AddProperty("phong", "diffuse", Rgba(*colour))
    return properties


class ParallelLinks(LeafSystem):
    """Poses of the links parallel to the legs' lower links, for a SceneGraph.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `positions` | n | - | positions of the model's joints, or its whole state |
    | out `geometry_pose` | abstract | - | poses of the links in the world |

    These links carry nothing that the parallelogram's mimic joint does not, so the plant leaves
    them out and gains a tenth of its speed. State: none.

    Bad input: of positions that are not finite, as of legs that cannot be built, all links are
    drawn at the origin.
    """

    def __init__(self, model: PlatformModel, scene_graph: SceneGraph, size: int):
        """Registers the links' geometry.

        Args:
            model: the platform.
            scene_graph: scene graph in which the links are drawn.
            size: size of the input; positions come first.
        """
        super().__init__()
        self.set_name("parallel_links")
        self._model = model
        self._source = scene_graph.RegisterSource("parallel_links")
        self._frames = [
            self._register(scene_graph, i + 1, leg) for i, leg in enumerate(model.geometry.legs)
        ]
        self._positions = self.DeclareVectorInputPort("positions", size)
        self.DeclareAbstractOutputPort(
            "geometry_pose",
            Value[FramePoseVector],
            self._calc_poses,
            {self._positions.ticket()},
        )

    @property
    def source_id(self) -> Any:
        """The SceneGraph's name for this source."""
        return self._source

    def _register(self, scene_graph: SceneGraph, number: int, leg: LegGeometry) -> FrameId:
        """A frame at the link's hip end, x along the link, with two bars and a pin."""
        frame = GeometryFrame(f"parallel_link_{number}")
        frame_id = scene_graph.RegisterFrame(self._source, frame)
        bar = Box(leg.l_4, 0.008, 0.034)
        across = RotationMatrix.MakeXRotation(0.5 * np.pi)
        for name, shape, colour, X_LG in (
            ("left", bar, _ORANGE, RigidTransform(np.array([leg.l_4 / 2.0, 0.028, 0.0]))),
            ("right", bar, _ORANGE, RigidTransform(np.array([leg.l_4 / 2.0, -0.028, 0.0]))),
            (
                "pin",
                Cylinder(0.016, 0.066),
                _DARK,
                RigidTransform(across, np.array([leg.l_4, 0.0, 0.0])),
            ),
        ):
            instance = GeometryInstance(X_LG, shape, name)
            instance.set_illustration_properties(MakePhongIllustrationProperties(colour))
            instance.set_perception_properties(_perceived(colour))
            scene_graph.RegisterGeometry(self._source, frame_id, instance)
        return frame_id

    def _calc_poses(self, context: Any, output: Any) -> None:
        positions = read_array(self._positions, context)
        poses = FramePoseVector()
        if not (np.abs(positions) < _NOWHERE).all():
            for frame in self._frames:
                poses.set_value(frame, RigidTransform())
            output.set_value(poses)
            return
        X_WF = self._model.base_pose(positions)
        legs = zip(self._model.geometry.legs, self._frames, strict=True)
        for i, (leg, frame) in enumerate(legs):
            R_FD = RotationMatrix.MakeZRotation(leg.beta)
            p_EL_D = np.array([leg.l_3 * leg.e_a[0], 0.0, leg.l_3 * leg.e_a[1]])
            p_FL = R_FD.matrix() @ p_EL_D - np.array([leg.l_x, leg.l_y, leg.l_z])
            # The joints turn about -y, so that a positive angle turns x towards z.
            R_DL = RotationMatrix.MakeYRotation(-self._model.swing(i, positions))
            poses.set_value(frame, X_WF.multiply(RigidTransform(R_FD.multiply(R_DL), p_FL)))
        output.set_value(poses)


class LegTransmission(LeafSystem):
    """Exact, lossless transmission psi(d) of a leg whose actuator is not modelled as bodies.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `rod_state` | 8 | m, m/s | extensions and their rates to be transmitted |
    | in `extension` | 4 | m | present extensions, at which the load is taken |
    | in `swing_torque` | 4 | N m | torques that hold the swing joints |
    | out `swing_state` | 8 | rad, rad/s | angles psi and their rates |
    | out `load_force` | 4 | N | force of each rod: tau dpsi/dd, so that power is conserved |

    State: none. Bad input: NaN where an extension cannot be built.
    """

    def __init__(self, geometry: PlatformGeometry = PlatformGeometry()):
        super().__init__()
        self.set_name("leg_transmission")
        self._swing = Remembered(partial(_swing_states, geometry.legs))
        self._ratios = Remembered(partial(_swing_rates, geometry.legs))
        self._rods = self.DeclareVectorInputPort("rod_state", 2 * LEG_COUNT)
        self._extension = self.DeclareVectorInputPort("extension", LEG_COUNT)
        self._torque = self.DeclareVectorInputPort("swing_torque", LEG_COUNT)
        self.DeclareVectorOutputPort(
            "swing_state", 2 * LEG_COUNT, self._calc_swing, {self._rods.ticket()}
        )
        self.DeclareVectorOutputPort(
            "load_force",
            LEG_COUNT,
            self._calc_load,
            {self._extension.ticket(), self._torque.ticket()},
        )

    def _calc_swing(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._swing(read(self._rods, context)))

    def _calc_load(self, context: Context, output: BasicVector) -> None:
        ratios = self._ratios(read(self._extension, context))
        torques = read(self._torque, context)
        loads = [torque * ratio for torque, ratio in zip(torques, ratios, strict=True)]
        output.SetFromVector(np.array(loads))


def _swing_states(legs: Sequence[LegGeometry], rods: Sequence[float]) -> NDArray[np.float64]:
    """Angles psi and their rates (8) for extensions and their rates (8)."""
    angles, rates = [], []
    for leg, extension, rate in zip(legs, rods[:LEG_COUNT], rods[LEG_COUNT:], strict=True):
        angle, ratio = swing_motion(leg, extension)
        angles.append(angle)
        rates.append(ratio * rate)
    return np.array(angles + rates)


def _swing_rates(legs: Sequence[LegGeometry], extension: Sequence[float]) -> list[float]:
    """Transmission ratios dpsi/dd (4) at these extensions."""
    return [swing_rate(leg, d) for leg, d in zip(legs, extension, strict=True)]
