"""Ground that gives way: pads under feet, moved along the ground's normal by drives."""

from collections.abc import Sequence

import numpy as np
from pydrake.geometry import (
    Box,
    CollisionFilterDeclaration,
    GeometryId,
    GeometrySet,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    Frame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)

from parapod.diagrams.multibody import ground_contact
from parapod.systems.physics.description import bodies_of

# Name of the model instance of a plant's pads.
PADS = "pads"
# Mass of a pad [kg], and its drive; depth and side of one as large as the ground [m].
_MASS, _GAINS = 20.0, PdControllerGains(p=1e8, d=1e6)
PAD_DEPTH, _SIDE = 0.1, 100.0


def add_moving_body(plant: MultibodyPlant, ground: Frame, name: str) -> RigidBody:
    """Adds a body that a drive moves along the z axis of a frame, to the instance `PADS`.

    Args:
        plant: plant, not finalized.
        ground: frame in whose origin the body is while the drive is at zero.
        name: name of body, joint and drive.
    """
    if not plant.HasModelInstanceNamed(PADS):
        plant.AddModelInstance(PADS)
    instance = plant.GetModelInstanceByName(PADS)
    inertia = SpatialInertia(_MASS, np.zeros(3), UnitInertia.SolidCube(PAD_DEPTH))
    body: RigidBody = plant.AddRigidBody(name, instance, inertia)
    up = np.array([0.0, 0.0, 1.0])
    joint = plant.AddJoint(PrismaticJoint(name, ground, body.body_frame(), up))
    plant.AddJointActuator(name, joint).set_controller_gains(_GAINS)
    return body


def add_pads(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    ground: RigidBody,
    feet: Sequence[Sequence[GeometryId]],
) -> ModelInstanceIndex:
    """Adds ground for each foot alone, as wide as the ground that all stand on.

    Args:
        plant: plant, not finalized.
        scene_graph: its scene graph.
        ground: body of the ground, whose plane is the one of its axes x and y.
        feet: shapes of each foot.
    """
    below, size = RigidTransform(np.array([0.0, 0.0, -0.5 * PAD_DEPTH])), (_SIDE, _SIDE, PAD_DEPTH)
    pads, frame = [], ground.body_frame()
    for i in range(len(feet)):
        name = f"pad_{i + 1}"
        body = add_moving_body(plant, frame, name)
        pad = plant.RegisterCollisionGeometry(body, below, Box(*size), name, ground_contact())
        pads.append(pad)
    shapes = [s for body in bodies_of(plant) for s in plant.GetCollisionGeometriesForBody(body)]
    filters = scene_graph.collision_filter_manager()
    for pad, foot in zip(pads, feet, strict=True):
        others = GeometrySet([s for s in shapes if s not in foot and s != pad])
        filters.Apply(CollisionFilterDeclaration().ExcludeBetween(GeometrySet([pad]), others))
    plane = GeometrySet(plant.GetCollisionGeometriesForBody(ground))
    every = GeometrySet([shape for foot in feet for shape in foot])
    filters.Apply(CollisionFilterDeclaration().ExcludeBetween(every, plane))
    return plant.GetModelInstanceByName(PADS)
