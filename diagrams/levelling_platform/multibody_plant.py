"""The plant of rigid bodies, with closed loops and contact."""

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Demultiplexer, MatrixGain, ZeroOrderHold

from parapod.diagrams.levelling_platform.model import add_platform, geometry_as_built
from parapod.diagrams.levelling_platform.plant import Drives, Plant
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.visualization import add_drawing, add_visualization
from parapod.diagrams.multibody import add_discrete_plant
from parapod.diagrams.visualization import remove_visuals
from parapod.diagrams.wiring import add, connect, split_states
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.model import (
    WHEEL_COUNT,
    FootTruth,
    LegTransmission,
    PlatformModel,
    PlatformTruth,
)
from parapod.systems.sensors.imu import sample_period
from parapod.systems.sensors.inertial_motion import InertialMotion


def add_multibody_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    drives: Drives,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the plant of rigid bodies with closed loops and contact."""
    plant, scene_graph = add_discrete_plant(
        builder, scenario.plant.time_step, scenario.plant.contact_approximation
    )
    model = add_platform(
        plant,
        scenario.plant.leg_model,
        scenario.plant.wheels,
        geometry=geometry_as_built(scenario),
        foot_offsets=scenario.ground.foot_offsets,
    )
    connect(builder, drives.arm, plant.get_desired_state_input_port(model.arm))
    if model.has_rolling_wheels:
        _drive_wheels(builder, model, drives)
    load_force = _drive_legs(builder, model, drives, scenario.plant.time_step)

    truth = add(builder, PlatformTruth(model))
    connect(builder, plant.get_state_output_port(), truth.GetInputPort("state"))
    feet = add(builder, FootTruth(model))
    connect(builder, plant.get_contact_results_output_port(), feet.GetInputPort("contact_results"))
    connect(builder, plant.get_body_poses_output_port(), feet.GetInputPort("body_poses"))
    attitude, angular_velocity, specific_force = _add_inertial_motion(builder, model)
    if meshcat is not None and model.is_full:
        add_visualization(builder, model, plant.get_state_output_port(), scene_graph, meshcat)
    else:
        remove_visuals(plant, scene_graph)
    if meshcat is not None and not model.is_full:
        _draw_as_full(builder, scenario, model, drives, meshcat)
    signals = {
        "posture": truth.GetOutputPort("posture"),
        "attitude": attitude,
        "angular_velocity": angular_velocity,
        "specific_force": specific_force,
        "load_force": load_force,
    } | {name: feet.GetOutputPort(name) for name in ("contact_force", "foot_height", "loop_error")}
    return Plant(signals, (truth, feet), {}, model)


def _draw_as_full(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    model: PlatformModel,
    drives: Drives,
    meshcat: Meshcat,
) -> None:
    """Draws reduced legs as what they stand for."""
    plant = model.plant
    start = model.base.floating_positions_start()
    joints = [plant.get_joint(i) for i in plant.GetJointIndices(model.arm)]
    turned = [joint.position_start() for joint in joints if joint.num_positions()]
    parts = []
    for name, indices in (("base_pose", range(start, start + 7)), ("arm_position", turned)):
        selection = np.eye(plant.num_multibody_states())[list(indices)]
        part = add(builder, MatrixGain(selection), f"drawn_{name}")
        connect(builder, plant.get_state_output_port(), part.get_input_port())
        parts.append(part.get_output_port())
    rods = drives.rods.GetOutputPort("extension")
    add_drawing(builder, scenario.ground.inclination, meshcat, rods, *parts)


def _drive_wheels(builder: DiagramBuilder, model: PlatformModel, drives: Drives) -> None:
    split = split_states(builder, "wheel_states", drives.wheels, WHEEL_COUNT)
    for port, wheel in zip(split, model.wheels, strict=True):
        connect(builder, port, model.plant.get_desired_state_input_port(wheel))


def _drive_legs(
    builder: DiagramBuilder, model: PlatformModel, drives: Drives, time_step: float
) -> OutputPort:
    """Connects the rods to the legs' joints; returns the force with which they hold (4).

    That force is the one of the step before, which breaks the loop from the actuators' next
    state through the plant back to their load.
    """
    plant = model.plant
    count = plant.num_actuators()
    holding = add(builder, ZeroOrderHold(time_step, count), "holding_effort")
    connect(builder, plant.get_net_actuation_output_port(), holding.get_input_port())
    # The legs' actuators come first.
    parts = add(builder, Demultiplexer([LEG_COUNT, count - LEG_COUNT]), "efforts")
    connect(builder, holding.get_output_port(), parts.get_input_port(0))
    # One step ahead: the plant's implicit drives then arrive where the actuators will be.
    ahead = drives.rods.GetOutputPort("next_state")
    load_force = parts.get_output_port(0)
    if not model.is_full:
        transmission = add(builder, LegTransmission(model.geometry))
        connect(builder, ahead, transmission.GetInputPort("rod_state"))
        connect(
            builder, drives.rods.GetOutputPort("extension"), transmission.GetInputPort("extension")
        )
        connect(builder, load_force, transmission.GetInputPort("swing_torque"))
        ahead = transmission.GetOutputPort("swing_state")
        load_force = transmission.GetOutputPort("load_force")
    split = split_states(builder, "leg_states", ahead, LEG_COUNT)
    for port, leg in zip(split, model.legs, strict=True):
        connect(builder, port, plant.get_desired_state_input_port(leg))
    return load_force


def _add_inertial_motion(builder: DiagramBuilder, model: PlatformModel) -> list[OutputPort]:
    """True attitude, angular velocity and specific force at the platform's centre."""
    plant, state = model.plant, model.plant.get_state_output_port()
    period = sample_period()
    motion = add(
        builder,
        InertialMotion(
            plant.num_multibody_states(),
            model.base.floating_positions_start(),
            plant.num_positions() + model.base.floating_velocities_start_in_v(),
            period,
        ),
    )
    last = add(builder, ZeroOrderHold(period, plant.num_multibody_states()), "last_state")
    connect(builder, state, last.get_input_port())
    connect(builder, state, motion.GetInputPort("state"))
    connect(builder, last.get_output_port(), motion.GetInputPort("last_state"))
    parts = add(builder, Demultiplexer(9, 3), "inertial_motion_parts")
    connect(builder, motion.get_output_port(), parts.get_input_port(0))
    return [parts.get_output_port(i) for i in range(3)]
