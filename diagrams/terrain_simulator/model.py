"""The terrain simulator's bodies, joints and loops in a MultibodyPlant; pictures.

Three sliders, two links, plate and strut, two loops closed by ball constraints. Masses and the
drives' stiffness are assumptions. Loops stay closed within 5 um at 1 ms, four times as well at
half the step; a plate whose sliders are led one step ahead follows within .03 mm and .006 deg, and
trails by speed times step without that.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    ModelInstanceIndex,
    PdControllerGains,
    PrismaticJoint,
    RevoluteJoint,
)
from pydrake.systems.framework import DiagramBuilder

from parapod.diagrams.drawing import View, add_renderer, take
from parapod.diagrams.multibody import add_adapted_model
from parapod.diagrams.terrain_simulator.leg import AddedLeg, LegUnderTest
from parapod.systems.core.errors import ScenarioError
from parapod.systems.terrain_simulator.geometry import CONFIGURATIONS
from parapod.systems.terrain_simulator.model import SLIDERS, BenchModel
from parapod.urdf import configure_parser

# Stiffness of a slider's drive [N/m], and its damping [N s/m]: assumptions.
STIFFNESS = PdControllerGains(p=1e7, d=2e4)
# Gains of the drive that holds the column or moves it, which is not one of the bench's own.
_COLUMN = PdControllerGains(p=1e9, d=2e6)
_FOLDER = "package://parapod/terrain_simulator"


# Ends of the slide [m].
_LOWEST, _HIGHEST = 0.4, 1.4


@dataclass(frozen=True)
class LegOnSlide:
    """A leg on the slide of the column, in a plant.

    Attributes:
        leg: the leg.
        column: model instance of the column.
        slide: model instance of the slide.
    """

    leg: AddedLeg
    column: ModelInstanceIndex
    slide: ModelInstanceIndex

    def order(self, plant: MultibodyPlant) -> tuple[int, ...]:
        """Indices of column, slide and the leg's joints among the plant's positions."""
        carriers = (("column", self.column), ("slide", self.slide))
        joints = [plant.GetJointByName(*carrier) for carrier in carriers]
        joints += [*self.leg.joints, *self.leg.passive]
        return tuple(joint.position_start() for joint in joints)


def add_bench(
    plant: MultibodyPlant,
    configuration: str,
    stiffness: PdControllerGains = STIFFNESS,
    add_more: Callable[[], None] = lambda: None,
    max_force: float | None = None,
) -> BenchModel:
    """Adds a bench to a plant that is part of a diagram, and finalizes it.

    Args:
        plant: a plant with a registered scene graph and a time step above zero.
        configuration: "pedal" or "treadmill".
        stiffness: stiffness and damping of each slider's drive [N/m, N s/m].
        add_more: adds what else is to be in the plant.
        max_force: largest force of each slider's drive [N]; None: that of the file.

    Raises:
        ValueError: another configuration.
    """
    if configuration not in CONFIGURATIONS:
        names = ", ".join(CONFIGURATIONS)
        raise ValueError(f"configuration must be one of {names}: {configuration!r}")
    geometry = CONFIGURATIONS[configuration]
    parser = Parser(plant)
    configure_parser(parser)

    def limit(root: ElementTree.Element) -> None:
        for name in SLIDERS if max_force is not None else ():
            limit_element = root.find(f"joint[@name='{name}']/limit")
            assert limit_element is not None
            limit_element.set("effort", repr(max_force))

    rail = add_adapted_model(parser, f"{_FOLDER}/rail.urdf", "rail", limit)
    (carried,) = parser.AddModels(url=f"{_FOLDER}/{configuration}.urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("rail", rail))
    link = plant.GetFrameByName("link_1", rail)
    X_LP = RigidTransform(np.array((geometry.link, 0.0, 0.0)))
    pivot: Any = plant.AddFrame(FixedOffsetFrame("P", link, X_LP))
    y = np.array((0.0, 1.0, 0.0))
    plant.AddJoint(RevoluteJoint("plate", pivot, plant.GetFrameByName("plate", carried), y))
    model = BenchModel(plant, geometry, rail, carried)
    here = np.zeros(3)
    tip, foot = np.array((geometry.link, 0.0, 0.0)), np.array((-geometry.strut, 0.0, 0.0))
    plant.AddBallConstraint(model.body("link_2"), tip, model.body("plate"), here)
    plant.AddBallConstraint(model.body("strut"), foot, model.body("slider_3"), here)
    for name in SLIDERS:
        plant.GetJointActuatorByName(name, rail).set_controller_gains(stiffness)
    add_more()
    plant.Finalize()
    return model


def add_leg_on_slide(
    plant: MultibodyPlant,
    leg: LegUnderTest,
    mass: float,
    scene_graph: SceneGraph | None = None,
    ends: tuple[float, float] = (_LOWEST, _HIGHEST),
) -> LegOnSlide:
    """Adds the column, the hip's slide and the leg on it to a plant that is not finalized.

    Args:
        plant: the plant.
        leg: the leg.
        mass: mass that the slide has with its leg [kg].
        scene_graph: scene graph with which the plant is registered; None: nothing collides.
        ends: ends of the slide's way [m].

    Raises:
        ScenarioError: the leg is not usable, or is heavier than that.
    """
    weight = mass - leg.mass
    if weight <= 0.0:
        raise ScenarioError(
            f"hip.mass_kg = {mass:g} must be more than the {mass - weight:.3g} kg of the leg",
            "hip.mass_kg",
        )

    def adapt(root: ElementTree.Element) -> None:
        inertial = root.find("link[@name='slide']/inertial/mass")
        assert inertial is not None
        inertial.set("value", repr(weight))

    parser = Parser(plant)
    configure_parser(parser)
    (column,) = parser.AddModels(url=f"{_FOLDER}/column.urdf")
    plant.GetJointActuatorByName("column", column).set_controller_gains(_COLUMN)
    slide = add_adapted_model(parser, f"{_FOLDER}/slide.urdf", "slide", adapt)
    body = plant.GetFrameByName("slide", slide)
    frame, up = plant.GetFrameByName("column", column), np.array((0.0, 0.0, 1.0))
    joint = plant.AddJoint(PrismaticJoint("slide", frame, body, up, *ends))
    plant.AddJointActuator("slide", joint)
    return LegOnSlide(leg.add(plant, body, scene_graph), column, slide)


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
