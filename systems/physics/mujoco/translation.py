"""Translation of a machine's `MultibodyPlant` into a specification for MuJoCo.

One description serves both engines: bodies, inertias, joints, drives, geometry and friction come
from the finalized plant, so that there is no second file that could say something else. Beside
the plant it needs the loops and couplings, which Drake's Python bindings do not return.

Stiffness and damping come from the plant too. A constraint of MuJoCo has a regularisation R, a
stiffness k and a damping b; with the integrator `discrete` it exerts, over a step h,

    f = -(a + b v' + k (r + h v')) / R,    v' = v + h a,

an implicit spring of k / R, a damper of b / R, and a mass of 1 / R that is felt while the
constraint holds. (Found by experiment with 4.0.0, and held by tests.) Drake's contacts are such
springs, so that contacts and loops get R = 1 / mass, with a mass that does not matter, and k and b
as the springs have them: `_Spring`. Drives and damped joints need no such detour, as the
integrator takes their stiffness and damping implicitly as it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    HalfSpace,
    Mesh,
    Role,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Joint,
    PrismaticJoint,
    QuaternionFloatingJoint,
    RevoluteJoint,
    RigidBody,
    WeldJoint,
)
from pydrake.systems.framework import Context

from parapod.systems.core.errors import WiringError
from parapod.systems.physics.description import inertia_of, joints_of, pose_at_zero
from parapod.systems.physics.loops import Ball, Coupling, Distance, Weld

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
WEIGHT = 0.5
# Of the iterations [-]. Newton's method has converged after two to four.
_TOLERANCE, _ITERATIONS = 1e-10, 50
# Group of geometry that is only seen.
_SEEN = 2
# Radius of the site around a body's spheres in which its contacts are felt, by theirs [-].
_FELT = 1.5


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
        """`solimp` (5) of a constraint between two weights of `WEIGHT`."""
        inertia = 2.0 * WEIGHT
        impedance = inertia / (inertia + 1.0 / _ADDED_MASS)
        # The same whatever the gap; width, midpoint and power do not matter then.
        return np.array((impedance, impedance, 1.0, 0.5, 1.0))


# Inertia of a link that moves and has less, which MuJoCo refuses [kg, kg m^2].
_LEAST_MASS, _LEAST_MOMENT = 1e-6, 4e-13


def body_name(body: RigidBody) -> str:
    """Name of a body in MuJoCo's model."""
    return "world" if body.index() == 0 else str(body.scoped_name())


def joint_name(joint: Joint) -> str:
    """Name of a joint in MuJoCo's model; names are unique within an instance only."""
    return f"{int(joint.model_instance())}::{joint.name()}"


def principal(inertia: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Principal moments (3) and the quaternion of their axes; reads the upper triangle."""
    moments, axes = np.linalg.eigh(inertia, UPLO="U")
    axes[:, 0] *= np.linalg.det(axes)
    # Rods have two that make up the third, which rounding lets MuJoCo refuse.
    moments[2] = min(moments[2], moments[0] + moments[1])
    return moments, Quaternion(axes).wxyz()


def weld_of(plant: MultibodyPlant, body: RigidBody, plant_context: Context) -> RigidTransform:
    """Pose of a body in the frame of the one that it is welded to."""
    for joint in joints_of(plant):
        if joint.child_body().index() == body.index() and isinstance(joint, WeldJoint):
            return pose_at_zero(joint, plant_context)
    raise WiringError(f"{body.scoped_name()} is welded to nothing")


class Translation:
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
        joints = joints_of(self._plant)
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
        X_PB = pose_at_zero(joint, self._context)
        mass, centre, inertia = inertia_of(body, self._context)
        moments, turn = principal(inertia)
        if not isinstance(joint, WeldJoint):
            mass, moments = max(mass, _LEAST_MASS), np.maximum(moments, _LEAST_MOMENT)
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
        for drive in map(self._plant.get_joint_actuator, self._plant.GetJointActuatorIndices()):
            servo = drive.get_controller_gains() if drive.has_controller() else None
            self.spec.add_actuator(
                name=joint_name(drive.joint()),
                target=joint_name(drive.joint()),
                trntype=self._mujoco.mjtTrn.mjTRN_JOINT,
                gaintype=self._mujoco.mjtGain.mjGAIN_FIXED,
                gainprm=_padded(1.0),
                biastype=self._mujoco.mjtBias.mjBIAS_AFFINE,
                biasprm=_padded(0.0, -servo.p, -servo.d) if servo else _padded(0.0),
            )

    def add_balls(self, balls: Sequence[Ball]) -> None:
        """Adds the ball joints that close loops."""
        for i, ball in enumerate(balls):
            ends = ((ball.body, ball.point), (ball.other, ball.other_point))
            poses = [(body, RigidTransform(np.asarray(point))) for body, point in ends]
            self._add_closure(self._mujoco.mjtEq.mjEQ_CONNECT, f"ball {i}", poses)

    def add_welds(self, welds: Sequence[Weld]) -> None:
        """Adds the welds that close loops."""
        for i, weld in enumerate(welds):
            ends = [(weld.body, weld.frame), (weld.other, weld.other_frame)]
            self._add_closure(self._mujoco.mjtEq.mjEQ_WELD, f"weld {i}", ends)

    def _add_closure(
        self, kind: Any, name: str, ends: Sequence[tuple[RigidBody, RigidTransform]]
    ) -> None:
        for k, (body, pose) in enumerate(ends):
            # By sites, as points of bodies would have to meet in the model's first pose.
            quaternion = pose.rotation().ToQuaternion().wxyz()
            site = {"name": f"{name} {k}", "pos": pose.translation(), "quat": quaternion}
            self.spec.body(body_name(body)).add_site(**site)
        self.spec.add_equality(
            type=kind,
            objtype=self._mujoco.mjtObj.mjOBJ_SITE,
            name1=f"{name} 0",
            name2=f"{name} 1",
            solref=_Spring(_RIGID).reference,
            solimp=_Spring(_RIGID).impedance,
        )

    def add_rods(self, rods: Sequence[Distance]) -> None:
        """Adds rods as tendons between two sites, whose length an equality keeps.

        How much longer each is than in the model's first pose is known once that is compiled; see
        `measure_rods`.
        """
        for i, rod in enumerate(rods):
            tendon = self.spec.add_tendon(name=f"rod {i}")
            for k, (body, point) in enumerate(
                ((rod.body, rod.point), (rod.other, rod.other_point))
            ):
                site = f"rod {i} {k}"
                self.spec.body(body_name(body)).add_site(name=site, pos=np.asarray(point))
                tendon.wrap_site(site)
            self.spec.add_equality(
                type=self._mujoco.mjtEq.mjEQ_TENDON,
                objtype=self._mujoco.mjtObj.mjOBJ_TENDON,
                name1=f"rod {i}",
                solref=_Spring(_RIGID).reference,
                solimp=_Spring(_RIGID).impedance,
            )

    def measure_rods(self, rods: Sequence[Distance], model: Any) -> None:
        """Gives rods their lengths, in a model that has been compiled without them."""
        kept = [e for e in self.spec.equalities if e.type == self._mujoco.mjtEq.mjEQ_TENDON]
        for equality, rod in zip(kept, rods, strict=True):
            equality.data[0] = rod.distance - model.tendon_length0[model.tendon(equality.name1).id]

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
            equality.data[:2] = coupling.offset, coupling.ratio

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

    def add_visuals(self, scene_graph: SceneGraph) -> None:
        """Adds geometry that is only seen; MuJoCo reads meshes from .obj and .stl alone."""
        inspector = scene_graph.model_inspector()
        for geometry in sorted(inspector.GetAllGeometryIds(Role.kIllustration), key=_number):
            body = self._plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
            if body is None or inspector.GetProximityProperties(geometry) is not None:
                continue
            properties: Any = inspector.GetIllustrationProperties(geometry)
            self._add_geometry(body, geometry, inspector)
            geom = self.spec.geom(_geometry_name(geometry))
            geom.group = _SEEN
            if properties.HasProperty("phong", "diffuse"):
                geom.rgba = properties.GetProperty("phong", "diffuse").rgba

    def _add_geometry(self, body: RigidBody, geometry: GeometryId, inspector: Any) -> None:
        X_BG = inspector.GetPoseInFrame(geometry)
        self.spec.body(body_name(body)).add_geom(
            name=_geometry_name(geometry),
            pos=X_BG.translation(),
            quat=X_BG.rotation().ToQuaternion().wxyz(),
            contype=0,
            conaffinity=0,
            **self._form(inspector.GetShape(geometry), inspector.GetName(geometry)),
        )

    def _form(self, shape: Any, name: str) -> dict[str, Any]:
        """Type, size and mesh of a shape."""
        kinds = self._mujoco.mjtGeom
        if isinstance(shape, HalfSpace):
            return {"type": kinds.mjGEOM_PLANE, "size": [0.0, 0.0, 1.0]}
        if isinstance(shape, Sphere):
            return {"type": kinds.mjGEOM_SPHERE, "size": [shape.radius(), 0.0, 0.0]}
        if isinstance(shape, Box):
            return {"type": kinds.mjGEOM_BOX, "size": list(0.5 * shape.size())}
        if isinstance(shape, Cylinder | Capsule):
            is_capsule = isinstance(shape, Capsule)
            kind = kinds.mjGEOM_CAPSULE if is_capsule else kinds.mjGEOM_CYLINDER
            return {"type": kind, "size": [shape.radius(), 0.5 * shape.length(), 0.0]}
        if isinstance(shape, Ellipsoid):
            return {"type": kinds.mjGEOM_ELLIPSOID, "size": [shape.a(), shape.b(), shape.c()]}
        if isinstance(shape, Mesh | Convex) and shape.extension() in (".obj", ".stl"):
            source, scale = str(shape.source().path()), shape.scale3()
            meshes = [m for m in self.spec.meshes if m.file == source and (m.scale == scale).all()]
            mesh = (
                meshes[0]
                if meshes
                else self.spec.add_mesh(
                    name=f"mesh {len(self.spec.meshes)}",
                    file=source,
                    scale=scale,
                    inertia=self._mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,  # also of open ones
                )
            )
            return {"type": kinds.mjGEOM_MESH, "meshname": mesh.name}
        raise WiringError(f"{name} has a shape that is not translated")

    def _add_pair(self, inspector: Any, one: GeometryId, other: GeometryId) -> None:
        """Adds a pair, with the properties that Drake combines from those of both."""
        both = [inspector.GetProximityProperties(geometry) for geometry in (one, other)]
        for geometry, of in zip((one, other), both, strict=True):
            if not of.HasProperty("material", "point_contact_stiffness"):
                name = inspector.GetName(geometry)
                raise WiringError(f"{name} collides, but has no drake:point_contact_stiffness")
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
