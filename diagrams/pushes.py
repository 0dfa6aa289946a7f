"""Bodies of simulated machines pushed by a scenario, by tools, and by the mouse in Meshcat."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.common.value import Value
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba, SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import ExternallyAppliedSpatialForceMultiplexer, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from parapod.diagrams.disturbances import BodyForce, Disturbance, Weight, courses_of
from parapod.diagrams.drawing import NO_LCM
from parapod.diagrams.wiring import add, connect, joined
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.leaf_system import LeafSystem
from parapod.systems.mechanism.parts import bodies_by_name, named
from parapod.systems.physics.description import bodies_of
from parapod.systems.physics.mujoco.plant import MujocoPlant
from parapod.systems.physics.mujoco.pushes import Place
from parapod.systems.physics.point_masses import Points
from parapod.systems.physics.push_forces import PushForces

# Stiffness of the mouse's spring by the mass of the body that it pulls [1/s^2].
_MOUSE = 100.0
# Length of the largest arrow by the size of the machine.
_LONG = 0.7
# Arrows by their length: radius, length of the head and its radius; and their colour.
_SLIM, _HEAD, _WIDE = 0.02, 0.18, 0.05
_COLOUR = Rgba(0.85, 0.25, 0.15, 1.0)
_RATE = 30.0  # [Hz]


@dataclass(frozen=True)
class Pushed:
    """Pushes on bodies of a plant, and masses that are put on them.

    Attributes:
        bodies: bodies (k) that are pushed.
        places: places (k, 3) from their origins, by their axes [m].
        pushes: moment and force of each (6k), by the world's axes [N m, N].
        weights: indices of those that are weights of masses, which the bodies have.
        largest: largest force of all [N].
    """

    bodies: tuple[RigidBody, ...]
    places: tuple[tuple[float, float, float], ...]
    pushes: OutputPort
    weights: tuple[int, ...]
    largest: float

    @cached_property
    def points(self) -> Points:
        """The masses."""
        return Points([(i, self.bodies[i], self.places[i]) for i in self.weights])


def pushes_in(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    disturbances: Sequence[Disturbance],
    usual: RigidBody,
    exchanged: Sequence[RigidBody] = (),
    usual_is_pushed: bool = True,
) -> Pushed | None:
    """Adds courses of the pushes of a scenario, and of masses; None if it has none.

    Args:
        builder: builder of the station.
        plant: finalized.
        disturbances: disturbances of the scenario, of which the pushes are taken.
        usual: body of those that name none.
        exchanged: bodies whose inertia is that of a context, so that they take no mass.
        usual_is_pushed: false if pushes that name no body act otherwise, masses excepted.

    Raises:
        ScenarioError: a body that does not exist, or cannot move, or cannot lose so much.
    """
    by_name = bodies_by_name(plant)
    forces: list[tuple[BodyForce, OutputPort]] = []
    bodies, weights = [], []
    for force, course in courses_of(builder, disturbances):
        is_mass, key = isinstance(force, Weight), f"disturbances.{disturbances.index(force)}"
        if force.body:
            body = named(force.body, by_name, "body", f"{key}.body")
        elif is_mass or usual_is_pushed:
            body = usual
        else:
            continue
        if is_mass:
            if body in exchanged:
                raise ScenarioError(
                    f"{key}.body: the mass of {body.name()} is that of another key; admissible: "
                    f"another body, such as {usual.name()}",
                    f"{key}.body",
                )
            weights.append(len(forces))
        forces.append((force, course))
        bodies.append(body)
    if not forces:
        return None
    largest = max(force.largest for force, _ in forces)
    places = tuple(force.place for force, _ in forces)
    both = joined(builder, [course for _, course in forces], "body_forces")
    pushed = Pushed(tuple(bodies), places, both, tuple(weights), largest)
    _check_losses(pushed, disturbances)
    return pushed


def _check_losses(pushed: Pushed, disturbances: Sequence[Disturbance]) -> None:
    """Refuses masses that a body does not have to lose.

    Raises:
        ScenarioError: names the body.
    """
    masses = [each.mass_kg for each in disturbances if isinstance(each, Weight)]
    for body in pushed.points.impossible(masses):
        raise ScenarioError(
            f"disturbances: {body.name()}, of {body.default_mass():g} kg, cannot lose "
            f"{-np.minimum(masses, 0.0).sum():g} kg there",
            "disturbances",
        )


def push_bodies(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    pushed: Pushed | None,
    meshcat: Meshcat | None,
    others: Sequence[OutputPort] = (),
) -> Callable[[Context], None] | None:
    """Has a plant of Drake's take pushes, other forces, and the mouse in Meshcat.

    Args:
        builder: builder of the diagram that holds the plant.
        plant: finalized; nothing is connected to its `applied_spatial_force`.
        scene_graph: scene graph in which it is registered.
        pushed: pushes of the scenario.
        meshcat: scene in which pushes are arrows, and the mouse drags bodies with Ctrl held; None
            for neither.
        others: other forces, as the plant takes them.

    Returns:
        What gives bodies their masses between two steps, see `Behind.between_steps`; None if none
        are put on them.
    """
    applied = plant.get_applied_spatial_force_input_port()
    forces = list(others)
    if pushed is not None:
        indices = [body.index() for body in pushed.bodies]
        system = add(builder, PushForces(indices, pushed.places, pushed.weights))
        connect(builder, pushed.pushes, system.get_input_port())
        forces.append(system.get_output_port())
    draw_pushes(builder, plant, pushed, plant.get_body_poses_output_port(), meshcat)
    if meshcat is not None:
        # It loads matplotlib, which takes as long as all the rest.
        from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

        nothing = VisualizationConfig(
            publish_illustration=False,
            publish_proximity=False,
            publish_inertia=False,
            publish_contacts=False,
            enable_alpha_sliders=False,
            mouse_interaction_stiffness=_MOUSE,
        )
        ApplyVisualizationConfig(nothing, builder, None, plant, scene_graph, meshcat, NO_LCM)
        mouse = builder.GetSubsystemByName("meshcat_mouse_spring").get_output_port()
        builder.Disconnect(mouse, applied)
        forces.append(mouse)
    if len(forces) > 1:
        joined = add(builder, ExternallyAppliedSpatialForceMultiplexer(len(forces)), "forces")
        for i, force in enumerate(forces):
            connect(builder, force, joined.get_input_port(i))
        forces = [joined.get_output_port()]
    for force in forces:
        connect(builder, force, applied)
    return None if pushed is None or not pushed.weights else _weighing(plant, pushed)


def _weighing(plant: MultibodyPlant, pushed: Pushed) -> Callable[[Context], None]:
    """Call that gives bodies of a plant of Drake's the masses on them, in a root context."""
    source: Any = pushed.pushes.get_system()

    def weigh(root_context: Context) -> None:
        pushes: Any = pushed.pushes.Eval(source.GetMyContextFromRoot(root_context))
        context = plant.GetMyMutableContextFromRoot(root_context)
        for body, inertia in pushed.points.inertias(pushed.points.masses(pushes)):
            now = body.CalcCenterOfMassInBodyFrame(context)
            if body.get_mass(context) != inertia.get_mass() or (now != inertia.get_com()).any():
                body.SetSpatialInertiaInBodyFrame(context, inertia)

    return weigh


def after[C](*calls: Callable[[C], None] | None) -> Callable[[C], None] | None:
    """Calls one after the other, of which there may be none."""
    real = [call for call in calls if call is not None]

    def call_all(argument: C) -> None:
        for call in real:
            call(argument)

    return call_all if real else None


def places_of(pushed: Pushed | None) -> list[Place]:
    """Bodies that are pushed and the places on them, as a `MujocoPlant` takes them."""
    if pushed is None:
        return []
    parts = zip(pushed.bodies, pushed.places, strict=True)
    return [Place(body, place, i in pushed.weights) for i, (body, place) in enumerate(parts)]


def push_mujoco(
    builder: DiagramBuilder,
    bodies: MujocoPlant,
    pushed: Pushed | None,
    meshcat: Meshcat | None,
) -> None:
    """Has a plant of MuJoCo's take pushes.

    Args:
        builder: builder of the diagram that holds the plant.
        bodies: the plant, made with `places_of` the pushes.
        pushed: pushes of the scenario.
        meshcat: scene in which they are arrows; None for none.
    """
    if pushed is not None:
        connect(builder, pushed.pushes, bodies.GetInputPort("pushes"))
    poses = bodies.GetOutputPort("body_poses")
    draw_pushes(builder, bodies.model.plant, pushed, poses, meshcat)


def draw_pushes(
    builder: DiagramBuilder,
    plant: MultibodyPlant,
    pushed: Pushed | None,
    body_poses: OutputPort,
    meshcat: Meshcat | None,
) -> None:
    """Draws pushes as arrows in Meshcat.

    Args:
        builder: builder of the station.
        plant: the plant.
        pushed: pushes of the scenario; None: none.
        body_poses: poses of the plant's bodies in the world.
        meshcat: scene; None: nothing is drawn.
    """
    if pushed is None or meshcat is None or pushed.largest <= 0.0:
        return
    context, bodies = plant.CreateDefaultContext(), bodies_of(plant)[1:]
    origins = [plant.EvalBodyPoseInWorld(context, body).translation() for body in bodies]
    scale = _LONG * float(np.ptp(origins, axis=0).max()) / pushed.largest
    indices = [int(body.index()) for body in pushed.bodies]
    arrows = add(builder, PushArrows(meshcat, pushed.places, scale, indices))
    connect(builder, pushed.pushes, arrows.GetInputPort("pushes"))
    connect(builder, body_poses, arrows.GetInputPort("body_poses"))


class PushArrows(LeafSystem):
    """Arrows of forces on bodies in Meshcat, whose points are where the forces act.

    | port | size | unit | meaning |
    |---|---|---|---|
    | in `pushes` | 6k | N m, N | moment and force of each, by the world's axes |
    | in `body_poses` | abstract | - | poses of bodies in the world, by their indices |
    | in `base_pose` | 7 | -, m | quaternion (w, x, y, z) and place of the one body pushed |

    It has `base_pose` if it is made without indices of bodies, and else `body_poses`.

    State: none. Arrows are published thirty times a second.

    Bad input: an arrow whose force is not finite is not drawn.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        places: Sequence[Sequence[float]],
        scale: float,
        bodies: Sequence[int] | None = None,
    ):
        """Draws the arrows, to be seen when there is a force.

        Args:
            meshcat: the scene.
            places: places (k, 3) of the pushes, from the bodies' origins by their axes [m].
            scale: length of an arrow by its force [m/N].
            bodies: indices (k) of the bodies that are pushed; None: all of them are one body.
        """
        super().__init__()
        self.set_name("push_arrows")
        self._meshcat, self._bodies, self._scale = meshcat, bodies, scale
        self._places = np.array(places, dtype=float)
        self._pushes = self.DeclareVectorInputPort("pushes", 6 * len(places))
        if bodies is None:
            self._poses = self.DeclareVectorInputPort("base_pose", 7)
        else:
            model = Value[list[RigidTransform]]()
            self._poses = self.DeclareAbstractInputPort("body_poses", model)
        for path in self._paths():
            # Of length 1, its point in the origin; the cone's own one is its point as well.
            behind = RigidTransform(np.array((0.0, 0.0, -0.5 * (1.0 + _HEAD))))
            backwards = RigidTransform(RotationMatrix.MakeXRotation(np.pi), np.zeros(3))
            meshcat.SetObject(f"{path}/arrow/shaft", Cylinder(_SLIM, 1.0 - _HEAD), _COLOUR)
            meshcat.SetTransform(f"{path}/arrow/shaft", behind)
            meshcat.SetObject(f"{path}/arrow/head", MeshcatCone(_HEAD, _WIDE, _WIDE), _COLOUR)
            meshcat.SetTransform(f"{path}/arrow/head", backwards)
            meshcat.SetProperty(path, "visible", value=False)
        self.DeclarePeriodicPublishEvent(1.0 / _RATE, 0.0, self._publish)

    def _paths(self) -> list[str]:
        kind = "base" if self._bodies is None else "bodies"
        return [f"/pushes/{kind}/{i}" for i in range(len(self._places))]

    def _poses_of_pushed(self, context: Context) -> list[RigidTransform]:
        """Poses (k) of the bodies that are pushed."""
        poses: Any = self._poses.Eval(context)
        if self._bodies is not None:
            return [poses[i] for i in self._bodies]
        quaternion, place = np.split(poses, [4])
        return [RigidTransform(Quaternion(quaternion), place)] * len(self._places)

    def _publish(self, context: Context) -> None:
        pushes: Any = self._pushes.Eval(context)
        poses = self._poses_of_pushed(context)
        time = context.get_time()
        for i, path in enumerate(self._paths()):
            force = pushes[6 * i + 3 : 6 * i + 6]
            length = self._scale * float(np.linalg.norm(force))
            is_on = np.isfinite(length) and length > 1e-3 * _HEAD
            self._meshcat.SetProperty(path, "visible", bool(is_on), time_in_recording=time)
            if is_on:
                R_WA = RotationMatrix.MakeFromOneVector(np.array(force), 2)
                X_WA = RigidTransform(R_WA, poses[i] @ self._places[i])
                self._meshcat.SetTransform(path, X_WA, time_in_recording=time)
                self._meshcat.SetProperty(
                    f"{path}/arrow", "scale", [length] * 3, time_in_recording=time
                )
