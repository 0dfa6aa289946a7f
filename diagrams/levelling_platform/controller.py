"""The levelling platform's controller: from posture commands and measurements to voltages."""

from typing import Literal

from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.pi_controller import PiController, PiControllerParams
from parapod.systems.levelling_platform.ground_estimator import GroundEstimator
from parapod.systems.levelling_platform.kinematic_feedforward import KinematicFeedforward
from parapod.systems.levelling_platform.passive_leg_solver import PassiveLegSolver
from parapod.systems.levelling_platform.platform_model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.posture_loop import PostureLoop, PostureLoopParams
from parapod.systems.levelling_platform.posture_reference import PostureReference
from parapod.systems.sensors.attitude_estimator import AttitudeEstimator


def make_controller(
    scenario: LevellingScenario, on_unreachable: Literal["raise", "clamp"] = "raise"
) -> Diagram:
    """Wires Fig. 18: estimators, reference, kinematic feedforward, passive leg and PI loops.

    Inputs: `legs.extension` (4), `imu.gyro` (3), `imu.accel` (3), `posture_command` (3) and
    `estimate_ground` (1), whose rise makes the ground be estimated and control begin.
    Outputs: `legs.voltage` (4), `posture_desired_state` (6), `extension_desired_state` (8),
    `ground_estimated` (2), `ground_valid` (1), `foot_offsets_estimated` (4),
    `attitude_estimated` (2).

    Args:
        scenario: its `control` part is used.
        on_unreachable: what `PostureReference` does with a command outside the workspace.
    """
    geometry, control = MODEL_GEOMETRY, scenario.control
    period = control.period
    builder = DiagramBuilder()
    attitude = add(builder, AttitudeEstimator(period=period))
    ground = add(builder, GroundEstimator(geometry, period))
    reference = add(
        builder, PostureReference(geometry, on_unreachable=on_unreachable, period=period)
    )
    feedforward = add(
        builder, KinematicFeedforward(geometry, law=control.feedforward, period=period)
    )
    passive = add(builder, PassiveLegSolver(geometry))
    pi = add(builder, PiController(pi_params(scenario), period=period))

    posture = reference.GetOutputPort("posture_desired_state")
    if control.outer_loop:
        posture = _add_posture_loop(builder, scenario, posture, attitude, ground)

    for source, system, port in (
        (attitude.GetOutputPort("attitude"), ground, "attitude"),
        (ground.GetOutputPort("ground"), reference, "ground"),
        (ground.GetOutputPort("ground"), feedforward, "ground"),
        (ground.GetOutputPort("ground"), passive, "ground"),
        (ground.GetOutputPort("foot_offsets"), reference, "foot_offsets"),
        (ground.GetOutputPort("foot_offsets"), feedforward, "foot_offsets"),
        (ground.GetOutputPort("foot_offsets"), passive, "foot_offsets"),
        (ground.GetOutputPort("valid"), reference, "enable"),
        (ground.GetOutputPort("valid"), feedforward, "enable"),
        (ground.GetOutputPort("valid"), pi, "enable"),
        (posture, feedforward, "posture_desired_state"),
        (posture, passive, "posture_desired_state"),
        (feedforward.GetOutputPort("active_desired_state"), passive, "active_desired_state"),
        (passive.GetOutputPort("extension_desired_state"), pi, "desired_state"),
    ):
        connect(builder, source, system.GetInputPort(port))

    builder.ExportInput(attitude.GetInputPort("gyro"), "imu.gyro")
    builder.ExportInput(attitude.GetInputPort("accel"), "imu.accel")
    builder.ExportInput(ground.GetInputPort("trigger"), "estimate_ground")
    builder.ExportInput(reference.GetInputPort("posture_command"), "posture_command")
    extension = builder.ExportInput(pi.GetInputPort("measured"), "legs.extension")
    builder.ConnectInput(extension, ground.GetInputPort("extension"))
    builder.ConnectInput(extension, reference.GetInputPort("extension_measured"))
    builder.ConnectInput(extension, feedforward.GetInputPort("extension_measured"))
    for output, name in (
        (pi.GetOutputPort("voltage"), "legs.voltage"),
        (reference.GetOutputPort("posture_desired_state"), "posture_desired_state"),
        (passive.GetOutputPort("extension_desired_state"), "extension_desired_state"),
        (ground.GetOutputPort("ground"), "ground_estimated"),
        (ground.GetOutputPort("valid"), "ground_valid"),
        (ground.GetOutputPort("foot_offsets"), "foot_offsets_estimated"),
        (attitude.GetOutputPort("attitude"), "attitude_estimated"),
    ):
        builder.ExportOutput(output, name)
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram


def pi_params(scenario: LevellingScenario) -> PiControllerParams:
    """Design of the actuators' position controllers."""
    control = scenario.control
    extending, retracting = control.friction_feedforward
    return PiControllerParams(
        pole=control.pole,
        voltage_limit=control.voltage_limit,
        rate_feedforward=control.rate_feedforward,
        friction_feedforward=(extending, retracting),
    )


def posture_loop_params(scenario: LevellingScenario) -> PostureLoopParams:
    """Design of the outer inclination loop."""
    return PostureLoopParams(
        gain=scenario.control.outer_loop_gain,
        lag=PostureLoopParams().lag + 1e-3 * scenario.sensors.imu_delay_ms,
    )


def _add_posture_loop(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    desired: OutputPort,
    attitude: AttitudeEstimator,
    ground: GroundEstimator,
) -> OutputPort:
    """Puts the outer inclination loop behind the reference; returns the corrected one."""
    loop = add(builder, PostureLoop(posture_loop_params(scenario), period=scenario.control.period))
    connect(builder, desired, loop.GetInputPort("posture_desired_state"))
    connect(builder, attitude.GetOutputPort("attitude"), loop.GetInputPort("attitude"))
    connect(builder, ground.GetOutputPort("valid"), loop.GetInputPort("enable"))
    port: OutputPort = loop.get_output_port()
    return port
