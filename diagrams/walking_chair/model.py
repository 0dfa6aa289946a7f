"""Builds the walking chair's bodies, joints and ground into a MultibodyPlant."""

from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, SpatialInertia, UnitInertia

from parapod.diagrams.ground import add_ground
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.model import ChairModel
from parapod.urdf import configure_parser

_FOLDER = "package://parapod/walking_chair"


def add_chair(plant: MultibodyPlant, passenger: Passenger = Passenger()) -> ChairModel:
    """Adds chair, passenger and ground to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        passenger: where the passenger sits until `ChairModel.stand`; one without mass is not
            drawn.
    """
    parser = Parser(plant)
    configure_parser(parser)
    parser.AddModels(url=f"{_FOLDER}/chair.dmd.yaml")
    X_SP = RigidTransform(passenger.place)
    seat: Any = plant.AddFrame(FixedOffsetFrame("seat", plant.GetFrameByName("body"), X_SP))
    if passenger.mass > 0.0:
        parser.AddModels(url=f"{_FOLDER}/passenger.urdf")
    else:
        nobody = SpatialInertia(0.0, np.zeros(3), UnitInertia.SolidSphere(1.0))
        plant.AddRigidBody("passenger", plant.AddModelInstance("passenger"), nobody)
    plant.WeldFrames(seat, plant.GetFrameByName("passenger"))
    slab = add_ground(parser)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("ground", slab))
    plant.Finalize()
    return ChairModel(plant)
