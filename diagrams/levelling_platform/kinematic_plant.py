"""The quasi-static plant: closed-form statics instead of bodies."""

import numpy as np
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, ZeroOrderHold
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.levelling_platform.plant import Drives, Plant
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.visualization import add_visualization
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.platform_model import MODEL_GEOMETRY, PlatformModel
from parapod.systems.levelling_platform.platform_truth import PlatformPose


def add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    drives: Drives,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the quasi-static plant, and with `meshcat` a drawing of it."""
    platform = add(builder, KinematicPlatform(MODEL_GEOMETRY))
    connect(builder, drives.rods.GetOutputPort("extension"), platform.GetInputPort("extension"))
    connect(builder, drives.rods.GetOutputPort("velocity"), platform.GetInputPort("velocity"))
    connect(builder, drives.arm_angles, platform.GetInputPort("arm_position"))
    names = (
        "posture",
        "attitude",
        "angular_velocity",
        "specific_force",
        "contact_force",
        "foot_height",
        "load_force",
    )
    signals = {name: platform.GetOutputPort(name) for name in names}
    # The inertial sensor samples at instants of its own; held, the platform's statics are solved
    # once a period and not again for every sample.
    holds = {}
    for name in ("attitude", "angular_velocity", "specific_force"):
        held = add(builder, ZeroOrderHold(scenario.control.period, 3), f"held_{name}")
        connect(builder, signals[name], held.get_input_port())
        signals[name] = held.get_output_port()
        holds[name] = held
    signals["loop_error"] = _zeros(builder, "no_loops")
    if meshcat is None:
        return Plant(signals, (platform,), holds, None)
    pose, model = _add_drawing(builder, scenario.ground.inclination, meshcat)
    connect(builder, drives.rods.GetOutputPort("extension"), pose.GetInputPort("extension"))
    connect(builder, signals["posture"], pose.GetInputPort("posture"))
    connect(builder, drives.arm_angles, pose.GetInputPort("arm_position"))
    return Plant(signals, (platform, pose), holds, model)


def _add_drawing(
    builder: DiagramBuilder, ground: tuple[float, float], meshcat: Meshcat
) -> tuple[PlatformPose, PlatformModel]:
    """A scene graph that shows the joint positions which `PlatformPose` computes.

    The slab is drawn as inclined as the ground was when the diagram was built.
    """
    plant = MultibodyPlant(time_step=1.0)
    scene_graph = add(builder, SceneGraph())
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = add_platform(plant, "full", ground=ground)
    pose = add(builder, PlatformPose(model))
    to_geometry = add(builder, MultibodyPositionToGeometryPose(plant))
    connect(builder, pose.get_output_port(), to_geometry.get_input_port())
    source_id = plant.get_source_id()
    assert source_id is not None
    connect(
        builder,
        to_geometry.get_output_port(),
        scene_graph.get_source_pose_port(source_id),
    )
    add_visualization(builder, model, pose.get_output_port(), scene_graph, meshcat)
    return pose, model


def _zeros(builder: DiagramBuilder, name: str) -> OutputPort:
    source = add(builder, ConstantVectorSource(np.zeros(LEG_COUNT)), name)
    return source.get_output_port()
