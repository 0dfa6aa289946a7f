"""Translation of a machine's `MultibodyPlant` into a model of MuJoCo.

One description serves both engines: bodies, inertias, joints, drives, geometry and friction come
from the finalized plant, so that there is no second file that could say something else. Beside
the plant it needs the loops and couplings, which Drake's Python bindings do not tell.

Stiffness and damping come from the plant too. A constraint of MuJoCo has a regularisation R, a
stiffness k and a damping b; with the integrator `discrete` it exerts, over a step h,

    f = -(a + b v' + k (r + h v')) / R,    v' = v + h a,

an implicit spring of k / R, a damper of b / R, and a mass of 1 / R that is felt while the
constraint holds. (Found by experiment with 4.0.0, and held by tests.) Drake's contacts are such
springs, so that contacts and loops get R = 1 / mass, with a mass that does not matter, and k and b
as the springs have them: `_Spring`. Drives and damped joints need no such detour, as the
integrator takes their stiffness and damping implicitly as it is.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Box, GeometryId, HalfSpace, Role, SceneGraph, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Joint,
    JointActuatorIndex,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    WeldJoint,
)
from pydrake.systems.framework import Context

from parapod.systems.core.errors import WiringError
from parapod.systems.core.extras import need

_LOG = logging.getLogger(__name__)

# Stiffness of loops and couplings [N/m, N m/rad], with which a leg's loop gapes by .1 um.
_RIGID = 1e10
# Mass that MuJoCo adds where a constraint holds [kg]: small beside a foot's.
_ADDED_MASS = 1e-2
# Rate at which friction stops what slides [1/s]. MuJoCo's convex contact lifts a foot that slides
# by a share h b / (1 + h b) of friction times its way in a step; with a rate far above 1 / h that
# is more than the micrometres by which feet sink in, and they chatter.
_STOPPING = 100.0
# Ratio of the regularisations of normal and tangential forces. With the two values above it makes
# a friction below the cone of 1e4 N s/m and as much mass, which lets a platform on a slope of 5
# deg creep by 1e-3 mm/s at 1 ms. From 1e6 on the solver does not converge at steps above 1 ms.
_FRICTION_RATIO = 1e4
# Weight that all bodies and joints have in MuJoCo's estimate of a constraint's inertia. It
# otherwise depends on the masses and on the model's first pose; with a number that is known, the
# impedance that belongs to a regularisation is known too.
_WEIGHT = 0.5
# Of the iterations [-]. Newton's method has converged after two to four.
_TOLERANCE, _ITERATIONS = 1e-10, 50
# Radius of the site around a body's spheres in which its contacts are felt, by theirs [-].
_FELT = 1.5


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball joint that closes a loop: a point of one body is a point of another.

    Attributes:
        body: one body.
        point: the point (3) in its frame [m].
        other: the other body.
        other_point: the point (3) in the other's frame [m].
    """

    body: RigidBody
    point: ArrayLike
    other: RigidBody
    other_point: ArrayLike


@dataclass(frozen=True)
class Coupling:
    """A joint whose position is a multiple of another's.

    Attributes:
        joint: the joint.
        leader: the other joint.
        ratio: position of the joint by the leader's.
    """

    joint: Joint
    leader: Joint
    ratio: float


@dataclass(frozen=True)
class _Spring:
    """Spring and damper as MuJoCo's parameters of a constraint, see the module.

    Attributes:
        stiffness: [N/m, N m/rad].
        damping: [N s/m, N m s/rad].
    """

    stiffness: float
    damping: float = 0.0

    @property
    def reference(self) -> NDArray[np.float64]:
        """`solref` (2): negative, which makes MuJoCo take them as stiffness and damping."""
        # It divides both by the impedance, and multiplies the stiffness by it again.
        return -np.array((self.stiffness, self.damping)) * self.impedance[0] / _ADDED_MASS

    @property
    def impedance(self) -> NDArray[np.float64]:
        """`solimp` (5) of a constraint between two weights of `_WEIGHT`."""
        inertia = 2.0 * _WEIGHT
        impedance = inertia / (inertia + 1.0 / _ADDED_MASS)
        # The same whatever the gap; width, midpoint and power do not matter then.
        return np.array((impedance, impedance, 1.0, 0.5, 1.0))


class MujocoModel:
    """A model of MuJoCo translated from a plant, and the maps between the states of both.

    Attributes:
        spec: the specification from which the model is compiled.
        model: the compiled model.
        data: scratch memory for calculations; nothing in it outlives a call.
        plant: the plant that was translated.
        feet: bodies whose contact forces `model`'s sensors tell, in their order.
        loads: bodies whose inertia and place the model takes from `set_loads`.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        scene_graph: SceneGraph,
        balls: Sequence[Ball] = (),
        couplings: Sequence[Coupling] = (),
        feet: Sequence[RigidBody] = (),
        loads: Sequence[RigidBody] = (),
    ):
        """Translates a plant.

        Args:
            plant: finalized, with a time step above zero and registered with `scene_graph`.
            scene_graph: holds the geometry of the plant.
            balls: ball joints that close the plant's loops.
            couplings: its coupled joints.
            feet: bodies whose contact forces are wanted.
            loads: bodies, welded to others, whose inertia and place may be exchanged.

        Raises:
            MissingExtra: MuJoCo is not installed.
            WiringError: a part of the plant that cannot be translated.
        """
        told = len(balls) + len(couplings)
        if plant.num_constraints() != told:
            raise WiringError(
                f"the plant has {plant.num_constraints()} constraints, {told} of them are told"
            )
        self.plant, self.feet, self.loads = plant, tuple(feet), tuple(loads)
        self._mujoco: Any = need("mujoco")
        # It would write a file into the folder in which the program runs.
        self._mujoco.set_mju_user_warning(_LOG.warning)
        self._defaults = plant.CreateDefaultContext()
        translation = _Translation(self._mujoco, plant, self._defaults)
        self.spec: Any = translation.spec
        translation.add_bodies()
        translation.add_drives()
        translation.add_balls(balls)
        translation.add_couplings(couplings)
        translation.add_contacts(scene_graph)
        translation.add_sensors(scene_graph, self.feet)
        self.model: Any = self.spec.compile()
        self.data: Any = self._mujoco.MjData(self.model)
        self._maps = _StateMaps(self._mujoco, self.model, plant)
        self._poses = [self.model.body(body_name(b)).id for b in bodies_of(plant)]
        self._anchored = {
            index: self.model.body_mocapid[self._poses[index]]
            for index in range(plant.num_bodies())
            if self.model.body_mocapid[self._poses[index]] >= 0
        }
        self._load_ids = [self.model.body(body_name(body)).id for body in self.loads]
        self._set: NDArray[np.float64] | None = None
        self.set_loads(self.loads_of(self._defaults))

    @property
    def state_size(self) -> int:
        """Size of MuJoCo's state."""
        return int(self._mujoco.mj_stateSize(self.model, self._state))

    @property
    def _state(self) -> int:
        """Everything that a step depends on, the solver's warm start included."""
        return int(self._mujoco.mjtState.mjSTATE_INTEGRATION)

    def read_state(self) -> NDArray[np.float64]:
        """The state in the scratch memory."""
        state = np.empty(self.state_size)
        self._mujoco.mj_getState(self.model, self.data, state, self._state)
        return state

    def write_state(self, state: NDArray[np.float64]) -> None:
        """Puts a state into the scratch memory."""
        self._mujoco.mj_setState(self.model, self.data, state, self._state)

    def begin(self, plant_context: Context) -> NDArray[np.float64]:
        """State of MuJoCo that begins where a context of the plant is.

        Args:
            plant_context: its positions, velocities and poses of what is anchored are taken.
        """
        self._mujoco.mj_resetData(self.model, self.data)
        q = self.plant.GetPositions(plant_context)
        v = self.plant.GetVelocities(plant_context)
        self.data.qpos[:], self.data.qvel[:] = self._maps.to_mujoco(q, v)
        for index, mocap in self._anchored.items():
            body = self.plant.get_body(BodyIndex(index))
            X_WB = self.plant.EvalBodyPoseInWorld(plant_context, body)
            self.data.mocap_pos[mocap] = X_WB.translation()
            self.data.mocap_quat[mocap] = X_WB.rotation().ToQuaternion().wxyz()
        return self.read_state()

    def step(self) -> None:
        """Steps what is in the scratch memory."""
        self._mujoco.mj_step(self.model, self.data)

    def plant_state(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """State of the plant, positions and velocities, in a state of MuJoCo."""
        # Which begins with the time, positions and velocities.
        end = 1 + self.model.nq
        return self._maps.to_plant(state[1:end], state[end : end + self.model.nv])

    def poses(self) -> list[RigidTransform]:
        """Poses of the plant's bodies in the world, by their indices."""
        self._mujoco.mj_kinematics(self.model, self.data)
        places, turns = self.data.xpos, self.data.xmat
        return [
            RigidTransform(RotationMatrix(turns[i].reshape(3, 3)), places[i]) for i in self._poses
        ]

    def loads_of(self, plant_context: Context) -> NDArray[np.float64]:
        """Inertias and poses of the loads in a context of the plant (17 each)."""
        rows: list[ArrayLike] = [np.zeros(0)]
        for body in self.loads:
            mass, centre, inertia = inertia_of(body, plant_context)
            X_PB = _weld_of(self.plant, body, plant_context)
            quaternion = X_PB.rotation().ToQuaternion().wxyz()
            rows += [[mass], centre, inertia[np.triu_indices(3)], X_PB.translation(), quaternion]
        return np.concatenate(rows)

    def set_loads(self, loads: NDArray[np.float64]) -> None:
        """Gives the loads inertias and places, as `loads_of` tells them.

        Cheap where they are those that the model has.
        """
        if self._set is not None and np.array_equal(loads, self._set):
            return
        model = self.model
        for i, row in zip(self._load_ids, loads.reshape(-1, _LOAD), strict=True):
            inertia = np.zeros((3, 3))
            inertia[np.triu_indices(3)] = row[4:10]
            model.body_mass[i], model.body_ipos[i] = row[0], row[1:4]
            model.body_inertia[i], model.body_iquat[i] = _principal(inertia)
            model.body_pos[i], model.body_quat[i] = row[10:13], row[13:]
        self._mujoco.mj_setConst(model, self._mujoco.MjData(model))
        model.body_invweight0[:] = _WEIGHT
        model.dof_invweight0[:] = _WEIGHT
        self._set = loads.copy()

    def index_of(self, joint: Joint) -> tuple[int, int]:
        """Indices of a joint's position and velocity in MuJoCo's."""
        found = self.model.joint(joint_name(joint))
        return int(found.qposadr[0]), int(found.dofadr[0])


_LOAD = 17  # mass, centre of mass (3), inertia about it (6), position (3) and quaternion (4)


def bodies_of(plant: MultibodyPlant) -> list[RigidBody]:
    """The bodies of a plant in the order of their indices."""
    return [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]


def body_name(body: RigidBody) -> str:
    """Name of a body in MuJoCo's model."""
    return "world" if body.index() == 0 else str(body.scoped_name())


def joint_name(joint: Joint) -> str:
    """Name of a joint in MuJoCo's model; names are unique within an instance only."""
    return f"{int(joint.model_instance())}::{joint.name()}"


def inertia_of(
    body: RigidBody, plant_context: Context
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
    """Mass [kg], centre of mass (3) [m] and inertia about it (3, 3) [kg m^2] of a body."""
    inertia = body.CalcSpatialInertiaInBodyFrame(plant_context)
    mass, centre = inertia.get_mass(), np.asarray(inertia.get_com())
    about_origin = inertia.CalcRotationalInertia().CopyToFullMatrix3()
    shift = centre @ centre * np.eye(3) - np.outer(centre, centre)
    return mass, centre, about_origin - mass * shift


def _principal(inertia: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Principal moments (3) and the quaternion of their axes; reads the upper triangle."""
    moments, axes = np.linalg.eigh(inertia, UPLO="U")
    axes[:, 0] *= np.linalg.det(axes)
    # Rods have two that make up the third, which rounding lets MuJoCo refuse.
    moments[2] = min(moments[2], moments[0] + moments[1])
    return moments, Quaternion(axes).wxyz()


def _weld_of(plant: MultibodyPlant, body: RigidBody, plant_context: Context) -> RigidTransform:
    """Pose of a body in the frame of the one that it is welded to."""
    for joint in _joints_of(plant):
        if joint.child_body().index() == body.index() and isinstance(joint, WeldJoint):
            return _pose_at_zero(joint, plant_context)
    raise WiringError(f"{body.scoped_name()} is welded to nothing")


def _joints_of(plant: MultibodyPlant) -> list[Joint]:
    return [plant.get_joint(i) for i in plant.GetJointIndices()]


def _pose_at_zero(joint: Joint, plant_context: Context) -> RigidTransform:
    """X_PB: pose of a joint's child in its parent, with the joint at zero."""
    X_PF = joint.frame_on_parent().CalcPoseInBodyFrame(plant_context)
    X_BM = joint.frame_on_child().CalcPoseInBodyFrame(plant_context)
    X_FM = joint.X_FM() if isinstance(joint, WeldJoint) else RigidTransform()
    return X_PF.multiply(X_FM).multiply(X_BM.inverse())


class _Translation:
    """Fills a specification of MuJoCo with what a plant has.

    Attributes:
        spec: the specification.
    """

    def __init__(self, mujoco: ModuleType, plant: MultibodyPlant, plant_context: Context):
        self._mujoco: Any = mujoco
        self._plant, self._context = plant, plant_context
        self.spec = self._mujoco.MjSpec()
        compiler, option = self.spec.compiler, self.spec.option
        compiler.degree = compiler.autolimits = compiler.balanceinertia = False
        compiler.fusestatic = compiler.alignfree = False
        compiler.inertiafromgeom = self._mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        option.timestep = plant.time_step()
        option.gravity = plant.gravity_field().gravity_vector()
        # The only one that solves constraints together with stiff drives, as Drake does; the
        # others have contacts and loops hold against forces that the drives do not exert.
        option.integrator = self._mujoco.mjtIntegrator.mjINT_DISCRETE
        option.solver = self._mujoco.mjtSolver.mjSOL_NEWTON
        option.cone = self._mujoco.mjtCone.mjCONE_ELLIPTIC
        # Not sparse, which 4.0.0 factorizes wrongly, and which gains nothing at this size.
        option.jacobian = self._mujoco.mjtJacobian.mjJAC_DENSE
        option.impratio = _FRICTION_RATIO
        option.tolerance, option.iterations = _TOLERANCE, _ITERATIONS
        # What is not finite is to be seen, not to be reset.
        option.disableflags |= self._mujoco.mjtDisableBit.mjDSBL_AUTORESET

    def add_bodies(self) -> None:
        """Adds bodies and joints, from the world outwards."""
        joints = _joints_of(self._plant)
        added = {0: self.spec.worldbody}
        while len(added) < self._plant.num_bodies():
            ready = [
                joint
                for joint in joints
                if int(joint.parent_body().index()) in added
                and int(joint.child_body().index()) not in added
            ]
            if not ready:
                missing = self._plant.num_bodies() - len(added)
                raise WiringError(f"{missing} bodies hang on joints the wrong way round")
            for joint in ready:
                parent = added[int(joint.parent_body().index())]
                added[int(joint.child_body().index())] = self._add_body(parent, joint)

    def _add_body(self, parent: Any, joint: Joint) -> Any:
        body = joint.child_body()
        X_PB = _pose_at_zero(joint, self._context)
        mass, centre, inertia = inertia_of(body, self._context)
        moments, turn = _principal(inertia)
        added = parent.add_body(
            name=body_name(body),
            pos=X_PB.translation(),
            quat=X_PB.rotation().ToQuaternion().wxyz(),
            mass=mass,
            ipos=centre,
            inertia=moments,
            iquat=turn,
            explicitinertial=True,
        )
        if isinstance(joint, WeldJoint):
            # What is anchored is moved by the state: grounds are inclined without a new model.
            added.mocap = parent is self.spec.worldbody
        else:
            self._add_joint(added, joint)
        return added

    def _add_joint(self, body: Any, joint: Joint) -> None:
        kinds, name = self._mujoco.mjtJoint, joint_name(joint)
        if isinstance(joint, QuaternionFloatingJoint):
            body.add_joint(name=name, type=kinds.mjJNT_FREE)
            return
        X_BM = joint.frame_on_child().CalcPoseInBodyFrame(self._context)
        if isinstance(joint, RevoluteJoint):
            kind, axis = kinds.mjJNT_HINGE, joint.revolute_axis()
        elif isinstance(joint, PrismaticJoint):
            kind, axis = kinds.mjJNT_SLIDE, joint.translation_axis()
        else:
            raise WiringError(f"{joint.name()} is a joint of a kind that is not translated")
        lower, upper = joint.position_lower_limits()[0], joint.position_upper_limits()[0]
        body.add_joint(
            name=name,
            type=kind,
            axis=X_BM.rotation().matrix() @ axis,
            pos=X_BM.translation(),
            damping=joint.GetDampingVector(self._context)[0],
            limited=bool(np.isfinite(lower) and np.isfinite(upper)),
            range=[lower, upper] if np.isfinite(lower) and np.isfinite(upper) else [0.0, 0.0],
            solref_limit=_Spring(_RIGID).reference,
            solimp_limit=_Spring(_RIGID).impedance,
        )

    def add_drives(self) -> None:
        """Adds the drives, whose control is what their springs and dampers aim at [N, N m].

        Limits of their effort are left out: MuJoCo cuts a force before it is taken implicitly,
        and so cuts what Drake does not.
        """
        for i in range(self._plant.num_actuators()):
            drive = self._plant.get_joint_actuator(JointActuatorIndex(i))
            gains = drive.get_controller_gains()
            self.spec.add_actuator(
                name=joint_name(drive.joint()),
                target=joint_name(drive.joint()),
                trntype=self._mujoco.mjtTrn.mjTRN_JOINT,
                gaintype=self._mujoco.mjtGain.mjGAIN_FIXED,
                gainprm=_padded(1.0),
                biastype=self._mujoco.mjtBias.mjBIAS_AFFINE,
                biasprm=_padded(0.0, -gains.p, -gains.d),
            )

    def add_balls(self, balls: Sequence[Ball]) -> None:
        """Adds the ball joints that close loops."""
        for i, ball in enumerate(balls):
            ends = ((ball.body, ball.point), (ball.other, ball.other_point))
            for k, (body, point) in enumerate(ends):
                # By sites, as points of bodies would have to meet in the model's first pose.
                owner = self.spec.body(body_name(body))
                owner.add_site(name=f"ball {i} {k}", pos=np.asarray(point))
            self.spec.add_equality(
                type=self._mujoco.mjtEq.mjEQ_CONNECT,
                objtype=self._mujoco.mjtObj.mjOBJ_SITE,
                name1=f"ball {i} 0",
                name2=f"ball {i} 1",
                solref=_Spring(_RIGID).reference,
                solimp=_Spring(_RIGID).impedance,
            )

    def add_couplings(self, couplings: Sequence[Coupling]) -> None:
        """Adds the coupled joints."""
        for coupling in couplings:
            equality = self.spec.add_equality(
                type=self._mujoco.mjtEq.mjEQ_JOINT,
                objtype=self._mujoco.mjtObj.mjOBJ_JOINT,
                name1=joint_name(coupling.joint),
                name2=joint_name(coupling.leader),
                solref=_Spring(_RIGID).reference,
                solimp=_Spring(_RIGID).impedance,
            )
            equality.data[1] = coupling.ratio

    def add_contacts(self, scene_graph: SceneGraph) -> None:
        """Adds the pairs of geometry that may touch in Drake, and no others."""
        inspector = scene_graph.model_inspector()
        is_anchored: dict[GeometryId, bool] = {}
        for geometry in sorted(inspector.GetAllGeometryIds(Role.kProximity), key=_number):
            # What the plant has registered; some of it may have been removed since.
            body = self._plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
            if body is not None:
                is_anchored[geometry] = self._plant.IsAnchored(body)
                self._add_geometry(body, geometry, inspector)
        # In an order that is the same in every process: it decides how contacts are summed.
        candidates = (sorted(pair, key=_number) for pair in inspector.GetCollisionCandidates())
        for one, other in sorted(candidates, key=lambda pair: [*map(_number, pair)]):
            if not (is_anchored.get(one, True) and is_anchored.get(other, True)):
                self._add_pair(inspector, one, other)

    def _add_geometry(self, body: RigidBody, geometry: GeometryId, inspector: Any) -> None:
        shape, kinds = inspector.GetShape(geometry), self._mujoco.mjtGeom
        if isinstance(shape, HalfSpace):
            kind, size = kinds.mjGEOM_PLANE, [0.0, 0.0, 1.0]
        elif isinstance(shape, Sphere):
            kind, size = kinds.mjGEOM_SPHERE, [shape.radius(), 0.0, 0.0]
        elif isinstance(shape, Box):
            kind, size = kinds.mjGEOM_BOX, list(0.5 * shape.size())
        else:
            raise WiringError(f"{inspector.GetName(geometry)} has a shape that is not translated")
        X_BG = inspector.GetPoseInFrame(geometry)
        self.spec.body(body_name(body)).add_geom(
            name=_geometry_name(geometry),
            type=kind,
            size=size,
            pos=X_BG.translation(),
            quat=X_BG.rotation().ToQuaternion().wxyz(),
            contype=0,
            conaffinity=0,
        )

    def _add_pair(self, inspector: Any, one: GeometryId, other: GeometryId) -> None:
        """Adds a pair, with the properties that Drake combines from those of both."""
        both = [inspector.GetProximityProperties(geometry) for geometry in (one, other)]
        frictions = [of.GetProperty("material", "coulomb_friction") for of in both]
        springs = [of.GetProperty("material", "point_contact_stiffness") for of in both]
        friction = _harmonic(*(of.static_friction() for of in frictions))
        # Two springs in a row. Dissipation is left out: it grows with the penetration, and that
        # of these stiff contacts is below what the implicit step damps anyway.
        spring = _Spring(0.5 * _harmonic(*springs))
        self.spec.add_pair(
            geomname1=_geometry_name(one),
            geomname2=_geometry_name(other),
            condim=3,
            friction=[friction, friction, 0.0, 0.0, 0.0],
            solref=spring.reference,
            solreffriction=_Spring(0.0, _STOPPING * _ADDED_MASS).reference,
            solimp=spring.impedance,
        )

    def add_sensors(self, scene_graph: SceneGraph, feet: Sequence[RigidBody]) -> None:
        """Adds sensors of the normal contact forces on bodies with spheres."""
        inspector = scene_graph.model_inspector()
        for i, foot in enumerate(feet):
            reach = 0.0
            for geometry in self._plant.GetCollisionGeometriesForBody(foot):
                away = np.linalg.norm(inspector.GetPoseInFrame(geometry).translation())
                sphere: Any = inspector.GetShape(geometry)
                reach = max(reach, float(away) + sphere.radius())
            self.spec.body(body_name(foot)).add_site(
                name=f"foot {i}",
                type=self._mujoco.mjtGeom.mjGEOM_SPHERE,
                size=[_FELT * reach, 0.0, 0.0],
            )
            self.spec.add_sensor(
                type=self._mujoco.mjtSensor.mjSENS_TOUCH,
                objtype=self._mujoco.mjtObj.mjOBJ_SITE,
                objname=f"foot {i}",
            )


def _harmonic(one: float, other: float) -> float:
    """Drake's combination of two frictions, and twice that of two stiffnesses."""
    return 2.0 * one * other / (one + other)


def _number(geometry: GeometryId) -> int:
    """Number of a geometry, in the order in which they were made."""
    return int(geometry.get_value())


def _geometry_name(geometry: GeometryId) -> str:
    return f"geometry {_number(geometry)}"


def _padded(*values: float) -> NDArray[np.float64]:
    """Parameters of an actuator, of which MuJoCo has ten."""
    return np.array(values + (0.0,) * (10 - len(values)))


class _StateMaps:
    """Positions and velocities of plant and MuJoCo, which order them differently.

    A floating body has its quaternion first in Drake and its position first in MuJoCo; its angular
    velocity is along the world's axes there and along its own here.
    """

    def __init__(self, mujoco: Any, model: Any, plant: MultibodyPlant):
        self._positions = np.zeros(plant.num_positions(), dtype=int)
        self._velocities = np.zeros(plant.num_velocities(), dtype=int)
        self._mujoco = mujoco
        self._floating: list[tuple[int, int]] = []  # where quaternion and angular velocity begin
        for joint in _joints_of(plant):
            if joint.num_velocities() == 0:
                continue
            found = model.joint(joint_name(joint))
            q, v = int(found.qposadr[0]), int(found.dofadr[0])
            start, rate = joint.position_start(), joint.velocity_start()
            if isinstance(joint, QuaternionFloatingJoint):
                self._positions[start : start + 7] = (q + 3, q + 4, q + 5, q + 6, q, q + 1, q + 2)
                self._velocities[rate : rate + 6] = (v + 3, v + 4, v + 5, v, v + 1, v + 2)
                self._floating.append((start, rate))
            else:
                self._positions[start], self._velocities[rate] = q, v
        self._size = plant.num_positions()

    def to_plant(
        self, qpos: NDArray[np.float64], qvel: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """State of the plant for MuJoCo's positions and velocities."""
        state = np.concatenate((qpos[self._positions], qvel[self._velocities]))
        for start, rate in self._floating:
            w = slice(self._size + rate, self._size + rate + 3)
            self._mujoco.mju_rotVecQuat(turned := np.empty(3), state[w], state[start : start + 4])
            state[w] = turned
        return state

    def to_mujoco(
        self, q: NDArray[np.float64], v: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """MuJoCo's positions and velocities for those of the plant."""
        qpos, qvel = np.empty_like(q), v.copy()
        for start, rate in self._floating:
            back = q[start : start + 4] * (1.0, -1.0, -1.0, -1.0)
            w = v[rate : rate + 3]
            self._mujoco.mju_rotVecQuat(turned := np.empty(3), w, back)
            qvel[rate : rate + 3] = turned
        qpos[self._positions] = q
        reordered = np.empty_like(v)
        reordered[self._velocities] = qvel
        return qpos, reordered
