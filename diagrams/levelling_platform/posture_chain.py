"""From measurements and a posture command to the legs' extensions: what all controllers share."""

from dataclasses import dataclass
from typing import Literal

from pydrake.systems.framework import DiagramBuilder, OutputPort

from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.pi_controller import PiController, PiControllerParams
from parapod.systems.levelling_platform.feedforward import KinematicFeedforward, PassiveLegSolver
from parapod.systems.levelling_platform.ground_estimator import GroundEstimator
from parapod.systems.levelling_platform.inclination_loop import PostureLoop, PostureLoopParams
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.reference import PostureReference
from parapod.systems.sensors.attitude_estimator import AttitudeEstimator

# Legs follow their references within a millimetre; what is further off is no leg [m].
_ERROR_LIMIT = 0.02


@dataclass(frozen=True)
class PostureChain:
    """Fig. 18 without the position controllers.

    Attributes:
        attitude: estimates roll and pitch.
        ground: estimates the ground.
        reference: makes commands smooth.
        loop: corrects the inclination, or None.
        feedforward: inverse kinematics of the active legs.
        passive: that of the fourth.
    """

    attitude: AttitudeEstimator
    ground: GroundEstimator
    reference: PostureReference
    loop: PostureLoop | None
    feedforward: KinematicFeedforward
    passive: PassiveLegSolver

    def enable(self, builder: DiagramBuilder, port: OutputPort) -> None:
        """Connects what says that postures are to be followed."""
        for system in (self.reference, self.feedforward, self.loop):
            if system is not None:
                connect(builder, port, system.GetInputPort("enable"))


def add_posture_chain(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    on_unreachable: Literal["raise", "clamp"] = "raise",
) -> PostureChain:
    """Adds estimators, reference, kinematic feedforward and passive leg, wired to each other.

    Exports the inputs `imu.gyro` (3), `imu.accel` (3) and `legs.extension` (4), and the outputs
    `posture_desired_state` (6), `ground_estimated` (2), `ground_valid` (1),
    `foot_offsets_estimated` (4), `attitude_estimated` (2). What is left to connect: the ground's
    `trigger`, the reference's `posture_command`, and `PostureChain.enable`.

    Args:
        builder: of the controller.
        scenario: its `control` part is used.
        on_unreachable: what `PostureReference` does with a command outside the workspace.
    """
    geometry, control = MODEL_GEOMETRY, scenario.control
    period = control.period
    reference = PostureReference(geometry, on_unreachable=on_unreachable, period=period)
    feedforward = KinematicFeedforward(geometry, law=control.feedforward, period=period)
    chain = PostureChain(
        attitude=add(builder, AttitudeEstimator(period=period)),
        ground=add(builder, GroundEstimator(geometry, period)),
        reference=add(builder, reference),
        loop=_add_posture_loop(builder, scenario) if control.outer_loop else None,
        feedforward=add(builder, feedforward),
        passive=add(builder, PassiveLegSolver(geometry)),
    )
    _wire(builder, chain)
    _export(builder, chain)
    return chain


def _wire(builder: DiagramBuilder, chain: PostureChain) -> None:
    attitude, ground, reference = chain.attitude, chain.ground, chain.reference
    feedforward, passive = chain.feedforward, chain.passive
    posture = reference.GetOutputPort("posture_desired_state")
    if chain.loop is not None:
        connect(builder, posture, chain.loop.GetInputPort("posture_desired_state"))
        connect(builder, attitude.GetOutputPort("attitude"), chain.loop.GetInputPort("attitude"))
        posture = chain.loop.get_output_port()
    for source, system, port in (
        (attitude.GetOutputPort("attitude"), ground, "attitude"),
        (ground.GetOutputPort("ground"), reference, "ground"),
        (ground.GetOutputPort("ground"), feedforward, "ground"),
        (ground.GetOutputPort("ground"), passive, "ground"),
        (ground.GetOutputPort("foot_offsets"), reference, "foot_offsets"),
        (ground.GetOutputPort("foot_offsets"), feedforward, "foot_offsets"),
        (ground.GetOutputPort("foot_offsets"), passive, "foot_offsets"),
        (posture, feedforward, "posture_desired_state"),
        (posture, passive, "posture_desired_state"),
        (feedforward.GetOutputPort("active_desired_state"), passive, "active_desired_state"),
    ):
        connect(builder, source, system.GetInputPort(port))


def _export(builder: DiagramBuilder, chain: PostureChain) -> None:
    attitude, ground, reference = chain.attitude, chain.ground, chain.reference
    builder.ExportInput(attitude.GetInputPort("gyro"), "imu.gyro")
    builder.ExportInput(attitude.GetInputPort("accel"), "imu.accel")
    extension = builder.ExportInput(ground.GetInputPort("extension"), "legs.extension")
    builder.ConnectInput(extension, reference.GetInputPort("extension_measured"))
    builder.ConnectInput(extension, chain.feedforward.GetInputPort("extension_measured"))
    for output, name in (
        (reference.GetOutputPort("posture_desired_state"), "posture_desired_state"),
        (ground.GetOutputPort("ground"), "ground_estimated"),
        (ground.GetOutputPort("valid"), "ground_valid"),
        (ground.GetOutputPort("foot_offsets"), "foot_offsets_estimated"),
        (attitude.GetOutputPort("attitude"), "attitude_estimated"),
    ):
        builder.ExportOutput(output, name)


def pi_params(scenario: LevellingScenario) -> PiControllerParams:
    """Design of the actuators' position controllers."""
    control = scenario.control
    extending, retracting = control.friction_feedforward
    return PiControllerParams(
        pole=control.pole,
        voltage_limit=control.voltage_limit,
        rate_feedforward=control.rate_feedforward,
        friction_feedforward=(extending, retracting),
        error_limit=_ERROR_LIMIT,
    )


def add_position_control(
    builder: DiagramBuilder, scenario: LevellingScenario, desired: OutputPort, enable: OutputPort
) -> PiController:
    """Adds the actuators' position controllers behind a posture chain; exports `legs.voltage`.

    Args:
        builder: of the controller, with a posture chain.
        scenario: its `control` part is used.
        desired: extensions and rates (8) that the legs are asked for; exported too, as
            `extension_desired_state`.
        enable: above 0.5: control.
    """
    pi = add(builder, PiController(pi_params(scenario), period=scenario.control.period))
    connect(builder, desired, pi.GetInputPort("desired_state"))
    connect(builder, enable, pi.GetInputPort("enable"))
    builder.ConnectInput("legs.extension", pi.GetInputPort("measured"))
    builder.ExportOutput(pi.GetOutputPort("voltage"), "legs.voltage")
    builder.ExportOutput(desired, "extension_desired_state")
    return pi


def posture_loop_params(scenario: LevellingScenario) -> PostureLoopParams:
    """Design of the outer inclination loop."""
    return PostureLoopParams(
        gain=scenario.control.outer_loop_gain,
        lag=PostureLoopParams().lag + 1e-3 * scenario.sensors.imu_delay_ms,
    )


def _add_posture_loop(builder: DiagramBuilder, scenario: LevellingScenario) -> PostureLoop:
    params = posture_loop_params(scenario)
    return add(builder, PostureLoop(params, period=scenario.control.period))
