"""The chair's quasi-static plant: closed-form statics instead of bodies."""

import numpy as np
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource

from parapod.diagrams.visualization import draw, publish
from parapod.diagrams.walking_chair.model import add_chair
from parapod.diagrams.walking_chair.plant import Plant
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.velocity_servo import VelocityServo
from parapod.systems.walking_chair.geometry import LEG_COUNT
from parapod.systems.walking_chair.kinematic_chair import KinematicChair
from parapod.systems.walking_chair.model import ChairPose


def add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    drives: VelocityServo,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the quasi-static plant, and with `meshcat` a drawing of it."""
    chair = add(
        builder,
        KinematicChair(passenger=scenario.passenger.passenger, period=scenario.control.period),
    )
    connect(builder, drives.GetOutputPort("position"), chair.GetInputPort("position"))
    names = ("body_position", "body_attitude", "contact_force", "foot_height", "force")
    signals = {name: chair.GetOutputPort(name) for name in names}
    no_loops = add(builder, ConstantVectorSource(np.zeros(2 * LEG_COUNT)), "no_loops")
    signals["loop_error"] = no_loops.get_output_port()
    if meshcat is not None:
        _draw(builder, scenario, drives, chair.GetOutputPort("body_pose"), meshcat)
    return Plant(signals, chair.stand, chair.seat)


def _draw(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    drives: VelocityServo,
    body_pose: OutputPort,
    meshcat: Meshcat,
) -> None:
    """Draws the bodies where the statics have them."""
    plant = MultibodyPlant(time_step=1.0)
    scene_graph = add(builder, SceneGraph(), "drawing")
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = add_chair(plant, scenario.passenger.passenger)
    pose = add(builder, ChairPose(model))
    connect(builder, drives.GetOutputPort("position"), pose.GetInputPort("position"))
    connect(builder, body_pose, pose.GetInputPort("body_pose"))
    draw(builder, plant, pose.get_output_port(), scene_graph)
    publish(builder, scene_graph, meshcat, "chair")
