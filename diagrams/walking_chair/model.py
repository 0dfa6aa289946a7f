"""The walking chair's bodies, joints and ground in a MultibodyPlant; pictures."""

import functools
from collections.abc import Sequence
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.drawing import View, add_renderer, take
from parapod.diagrams.multibody import add_adapted_model, add_ground
from parapod.systems.walking_chair.chair import chair_inverse
from parapod.systems.walking_chair.gait import Walk
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.model import (
    CHAIR_GEOMETRY,
    ChairModel,
    inertia_of,
    moment_of_inertia,
)
from parapod.urdf import configure_parser

_FOLDER = "package://parapod/walking_chair"


def add_chair(plant: MultibodyPlant, passenger: Passenger = Passenger()) -> ChairModel:
    """Adds chair, passenger and ground to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        passenger: person on the seat in a default context; one without mass is not drawn.
    """
    parser = Parser(plant)
    configure_parser(parser)
    parser.AddModels(url=f"{_FOLDER}/chair.dmd.yaml")
    X_SP = RigidTransform(passenger.place)
    seat: Any = plant.AddFrame(FixedOffsetFrame("seat", plant.GetFrameByName("body"), X_SP))
    if passenger.mass > 0.0:
        weigh = functools.partial(_weigh, passenger)
        add_adapted_model(parser, f"{_FOLDER}/passenger.urdf", "passenger", weigh)
    else:
        nobody = inertia_of(passenger)
        plant.AddRigidBody("passenger", plant.AddModelInstance("passenger"), nobody)
    plant.WeldFrames(seat, plant.GetFrameByName("passenger"))
    slab = add_ground(parser)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("ground", slab))
    plant.Finalize()
    return ChairModel(plant)


def add_passenger(plant: MultibodyPlant) -> None:
    """Adds a passenger who floats to a plant that is drawn, and finalizes it."""
    parser = Parser(plant)
    configure_parser(parser)
    parser.AddModels(url=f"{_FOLDER}/passenger.urdf")
    plant.Finalize()


def _weigh(passenger: Passenger, root: Element) -> None:
    """Gives the model of a passenger its mass and moments of inertia."""
    mass, inertia = root.find("link/inertial/mass"), root.find("link/inertial/inertia")
    assert mass is not None
    assert inertia is not None
    mass.set("value", repr(float(passenger.mass)))
    for axis in ("ixx", "iyy", "izz"):
        inertia.set(axis, repr(moment_of_inertia(passenger)))


def photograph(
    views: Sequence[View], walk: Walk, time: float, passenger: Passenger
) -> list[NDArray[np.uint8]]:
    """Pictures (height, width, 3) of the chair at a time of a walk.

    Args:
        views: from where; one picture each.
        walk: the gaits.
        time: since the walk began [s].
        passenger: person on the seat; one without mass is not seen.

    Raises:
        RuntimeError: there is no OpenGL that Drake's renderer could use.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1.0)
    add_renderer(scene_graph)
    model = add_chair(plant, passenger)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    motion = walk.motion(CHAIR_GEOMETRY, time)
    body = motion.body.position
    lengths = chair_inverse(
        CHAIR_GEOMETRY, body, np.eye(3), motion.feet.position, motion.references
    )
    model.stand(plant.GetMyMutableContextFromRoot(context), lengths, body, passenger)
    return take(scene_graph, context, views)
