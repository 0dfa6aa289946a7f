"""The terrain simulator's bodies, joints and loops in a MultibodyPlant; pictures."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PdControllerGains, RevoluteJoint
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.drawing import View, add_renderer, take
from parapod.systems.terrain_simulator.geometry import BenchGeometry
from parapod.systems.terrain_simulator.model import SLIDERS, BenchModel
from parapod.urdf import configure_parser

# Stiffness of a slider's drive [N/m], and its damping [N s/m]: assumptions.
STIFFNESS = PdControllerGains(p=1e7, d=2e4)
_FOLDER = "package://parapod/terrain_simulator"
_BENCHES = {"pedal": BenchGeometry.pedal(), "treadmill": BenchGeometry.treadmill()}


def add_bench(
    plant: MultibodyPlant, configuration: str, stiffness: PdControllerGains = STIFFNESS
) -> BenchModel:
    """Adds a bench to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        configuration: "pedal" or "treadmill".
        stiffness: stiffness and damping of each slider's drive [N/m, N s/m].

    Raises:
        ValueError: another configuration.
    """
    if configuration not in _BENCHES:
        raise ValueError(f"configuration must be one of {', '.join(_BENCHES)}: {configuration!r}")
    geometry = _BENCHES[configuration]
    parser = Parser(plant)
    configure_parser(parser)
    parser.AddModels(url=f"{_FOLDER}/rail.urdf")
    parser.AddModels(url=f"{_FOLDER}/{configuration}.urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("rail"))
    link = plant.GetFrameByName("link_1")
    X_LP = RigidTransform(np.array((geometry.link, 0.0, 0.0)))
    pivot: Any = plant.AddFrame(FixedOffsetFrame("P", link, X_LP))
    y = np.array((0.0, 1.0, 0.0))
    plant.AddJoint(RevoluteJoint("plate", pivot, plant.GetFrameByName("plate"), y))
    bodies = {name: plant.GetBodyByName(name) for name in ("link_2", "plate", "strut", "slider_3")}
    here = np.zeros(3)
    tip, foot = np.array((geometry.link, 0.0, 0.0)), np.array((-geometry.strut, 0.0, 0.0))
    plant.AddBallConstraint(bodies["link_2"], tip, bodies["plate"], here)
    plant.AddBallConstraint(bodies["strut"], foot, bodies["slider_3"], here)
    for name in SLIDERS:
        plant.GetJointActuatorByName(name).set_controller_gains(stiffness)
    plant.Finalize()
    return BenchModel(plant, geometry)


def photograph(
    views: Sequence[View], configuration: str, pose: ArrayLike
) -> list[NDArray[np.uint8]]:
    """Pictures (height, width, 3) of a bench in a pose.

    Args:
        views: from where; one picture each.
        configuration: "pedal" or "treadmill".
        pose: (3) x, z, phi of the plate's middle [m, m, rad].

    Raises:
        RuntimeError: there is no OpenGL that Drake's renderer could use.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=1e-3)
    add_renderer(scene_graph)
    model = add_bench(plant, configuration)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    model.stand(plant.GetMyMutableContextFromRoot(context), pose)
    return take(scene_graph, context, views)
