"""The two simulated plants of the levelling platform, with the same signals."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlant,
    MultibodyPlant,
    MultibodyPlantConfig,
)
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    MatrixGain,
    Multiplexer,
)
from pydrake.systems.rendering import MultibodyPositionToGeometryPose
from pydrake.systems.sensors import Accelerometer, Gyroscope
from pydrake.visualization import ApplyVisualizationConfig, VisualizationConfig

from parapod.diagrams.levelling_platform.model import add_platform
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.inclined_ground import OnInclinedGround
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.leg_transmission import LegTransmission
from parapod.systems.levelling_platform.platform_model import MODEL_GEOMETRY, PlatformModel
from parapod.systems.levelling_platform.platform_truth import (
    FootTruth,
    PlatformPose,
    PlatformTruth,
)


@dataclass(frozen=True)
class Drives:
    """What moves a plant: the drives that all backends share.

    Attributes:
        rods: outputs `extension`, `velocity`, `next_state` of the linear actuators.
        wheels: angles and velocities (8) that the wheels are held to.
        arm: angles and velocities (4) of turntable and arm.
        arm_angles: angles (2) of turntable and arm.
    """

    rods: LeafSystem
    wheels: OutputPort
    arm: OutputPort
    arm_angles: OutputPort


@dataclass(frozen=True)
class Plant:
    """What a plant offers to the sensors and to the truth.

    Attributes:
        signals: ports by name: posture, attitude, angular_velocity, specific_force,
            contact_force, foot_height, load_force, loop_error.
        on_ground: systems that must be told how the ground is inclined.
        model: bodies and joints; None where nothing is simulated or drawn as such.
    """

    signals: dict[str, OutputPort]
    on_ground: tuple[OnInclinedGround, ...]
    model: PlatformModel | None


type PlantMaker = Callable[[DiagramBuilder, LevellingScenario, Drives, Meshcat | None], Plant]


def add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    drives: Drives,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the quasi-static plant, and with `meshcat` a drawing of it."""
    platform = builder.AddSystem(KinematicPlatform(MODEL_GEOMETRY))
    builder.Connect(drives.rods.GetOutputPort("extension"), platform.GetInputPort("extension"))
    builder.Connect(drives.rods.GetOutputPort("velocity"), platform.GetInputPort("velocity"))
    builder.Connect(drives.arm_angles, platform.GetInputPort("arm_position"))
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
    signals["loop_error"] = _zeros(builder, "no_loops")
    if meshcat is None:
        return Plant(signals, (platform,), None)
    pose, model = _add_drawing(builder, meshcat)
    builder.Connect(drives.rods.GetOutputPort("extension"), pose.GetInputPort("extension"))
    builder.Connect(signals["posture"], pose.GetInputPort("posture"))
    builder.Connect(drives.arm_angles, pose.GetInputPort("arm_position"))
    return Plant(signals, (platform, pose), model)


def add_multibody_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    drives: Drives,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the plant of rigid bodies with closed loops and contact."""
    plant, scene_graph = AddMultibodyPlant(
        MultibodyPlantConfig(
            time_step=scenario.plant.time_step,
            contact_model="point",
            discrete_contact_approximation=scenario.plant.contact_approximation,
        ),
        builder,
    )
    model = add_platform(plant, scenario.plant.leg_model)
    _drive_base_and_arm(builder, model, drives)
    load_force = _drive_legs(builder, model, drives)

    truth = builder.AddSystem(PlatformTruth(model))
    builder.Connect(plant.get_state_output_port(), truth.GetInputPort("state"))
    feet = builder.AddSystem(FootTruth(model))
    builder.Connect(plant.get_contact_results_output_port(), feet.GetInputPort("contact_results"))
    builder.Connect(plant.get_body_poses_output_port(), feet.GetInputPort("body_poses"))
    gyro, accelerometer = _add_ideal_inertial_sensors(builder, model)
    if meshcat is not None:
        _visualize(builder, plant, scene_graph, meshcat)
    signals = {
        "posture": truth.GetOutputPort("posture"),
        "attitude": truth.GetOutputPort("attitude"),
        "angular_velocity": gyro,
        "specific_force": accelerometer,
        "load_force": load_force,
    } | {name: feet.GetOutputPort(name) for name in ("contact_force", "foot_height", "loop_error")}
    return Plant(signals, (truth, feet), model)


def _drive_base_and_arm(builder: DiagramBuilder, model: PlatformModel, drives: Drives) -> None:
    plant = model.plant
    builder.Connect(drives.wheels, plant.get_desired_state_input_port(model.base_instance))
    builder.Connect(drives.arm, plant.get_desired_state_input_port(model.arm))


def _drive_legs(builder: DiagramBuilder, model: PlatformModel, drives: Drives) -> OutputPort:
    """Connects the rods to the legs' joints; returns the force with which they hold (4)."""
    plant = model.plant
    holding = builder.AddNamedSystem("holding_effort", Multiplexer(LEG_COUNT))
    split = builder.AddNamedSystem("leg_states", Demultiplexer(2 * LEG_COUNT, 2))
    for i, leg in enumerate(model.legs):
        builder.Connect(split.get_output_port(i), plant.get_desired_state_input_port(leg))
        builder.Connect(plant.get_net_actuation_output_port(leg), holding.get_input_port(i))
    # One step ahead: the plant's implicit drives then arrive where the actuators will be.
    ahead = drives.rods.GetOutputPort("next_state")
    if model.is_full:
        by_leg = builder.AddNamedSystem("by_leg", MatrixGain(_by_leg()))
        builder.Connect(ahead, by_leg.get_input_port())
        builder.Connect(by_leg.get_output_port(), split.get_input_port(0))
        return holding.get_output_port(0)
    transmission = builder.AddSystem(LegTransmission(model.geometry))
    builder.Connect(ahead, transmission.GetInputPort("rod_state"))
    builder.Connect(drives.rods.GetOutputPort("extension"), transmission.GetInputPort("extension"))
    builder.Connect(holding.get_output_port(0), transmission.GetInputPort("swing_torque"))
    builder.Connect(transmission.GetOutputPort("swing_state"), split.get_input_port(0))
    return transmission.GetOutputPort("load_force")


def _by_leg() -> np.ndarray:
    """Permutation from (positions, velocities) to (position, velocity) leg by leg."""
    permutation = np.zeros((2 * LEG_COUNT, 2 * LEG_COUNT))
    for leg in range(LEG_COUNT):
        permutation[2 * leg, leg] = permutation[2 * leg + 1, LEG_COUNT + leg] = 1.0
    return permutation


def _add_ideal_inertial_sensors(
    builder: DiagramBuilder, model: PlatformModel
) -> tuple[OutputPort, OutputPort]:
    """True angular velocity and specific force at the platform's centre."""
    plant = model.plant
    gyro = builder.AddNamedSystem("true_gyro", Gyroscope(model.base, RigidTransform.Identity()))
    gravity = plant.gravity_field().gravity_vector()
    accelerometer = builder.AddNamedSystem(
        "true_accelerometer", Accelerometer(model.base, RigidTransform.Identity(), gravity)
    )
    for sensor in (gyro, accelerometer):
        builder.Connect(plant.get_body_poses_output_port(), sensor.get_body_poses_input_port())
        builder.Connect(
            plant.get_body_spatial_velocities_output_port(),
            sensor.get_body_velocities_input_port(),
        )
    builder.Connect(
        plant.get_body_spatial_accelerations_output_port(),
        accelerometer.get_body_accelerations_input_port(),
    )
    return gyro.get_measurement_output_port(), accelerometer.get_measurement_output_port()


def _add_drawing(builder: DiagramBuilder, meshcat: Meshcat) -> tuple[PlatformPose, PlatformModel]:
    """A scene graph that shows the joint positions which `PlatformPose` computes."""
    plant = MultibodyPlant(time_step=1.0)
    scene_graph = builder.AddSystem(SceneGraph())
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = add_platform(plant, "full")
    pose = builder.AddSystem(PlatformPose(model))
    to_geometry = builder.AddSystem(MultibodyPositionToGeometryPose(plant))
    builder.Connect(pose.get_output_port(), to_geometry.get_input_port())
    builder.Connect(
        to_geometry.get_output_port(),
        scene_graph.get_source_pose_port(plant.get_source_id()),
    )
    _visualize(builder, plant, scene_graph, meshcat)
    return pose, model


def _visualize(
    builder: DiagramBuilder, plant: MultibodyPlant, scene_graph: SceneGraph, meshcat: Meshcat
) -> None:
    config = VisualizationConfig(
        publish_period=1.0 / 30.0,
        publish_contacts=False,
        publish_inertia=False,
        publish_proximity=False,
        enable_alpha_sliders=False,
        delete_on_initialization_event=False,
    )
    ApplyVisualizationConfig(
        config, builder, plant=plant, scene_graph=scene_graph, meshcat=meshcat
    )


def _zeros(builder: DiagramBuilder, name: str) -> OutputPort:
    source = builder.AddNamedSystem(name, ConstantVectorSource(np.zeros(LEG_COUNT)))
    return source.get_output_port()
