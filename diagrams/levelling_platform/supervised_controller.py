"""The levelling platform's controller under a supervisor: drive there, stand up, work, leave."""

from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import MatrixGain

from parapod.diagrams.levelling_platform.posture_chain import (
    PostureChain,
    add_position_control,
    add_posture_chain,
)
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.pi_controller import PiController
from parapod.systems.levelling_platform.fault_detection import FaultDetector
from parapod.systems.levelling_platform.leg_motion import ContactKeeper, LegRamp
from parapod.systems.levelling_platform.model import MODEL_GEOMETRY
from parapod.systems.levelling_platform.stability_monitor import StabilityMonitor
from parapod.systems.levelling_platform.supervisor import Supervisor
from parapod.systems.levelling_platform.wheels import WheelGeometry


def make_supervised_controller(scenario: LevellingScenario) -> Diagram:
    """Wires supervisor, posture chain, contact keeper, ramps, PI loops and stability monitor.

    Inputs: `legs.extension` (4), `legs.limits` (12), `imu.gyro` (3), `imu.accel` (3),
    `wheels.velocity` (4) and `status.age` (4), as the station has them; from the operator
    `operator` (1), `drive_request` (2: forward speed, yaw rate), `posture_request` (3),
    `arm_request` (2).
    Outputs: `legs.voltage` (4), `legs.stop` (1), `wheels.velocity_command` (4), `wheels.brake`
    (1), `arm_command` (2: turntable, arm); `findings` (16), `severity` (1); `phase` (1),
    `refusal` (2), `arm_refused` (1), `arm_margin` (1: along the move asked for),
    `stability_margin` (1: now), and what `add_posture_chain` and `add_position_control` export.

    Args:
        scenario: its `control` part is used.
    """
    builder = DiagramBuilder()
    period = scenario.control.period
    chain = add_posture_chain(builder, scenario, on_unreachable="clamp")
    supervisor = add(
        builder,
        Supervisor(MODEL_GEOMETRY, standing_height=WheelGeometry().standing_height, period=period),
    )
    keeper = add(builder, ContactKeeper(period=period))
    ramp = add(builder, LegRamp(period=period))
    _wire_legs(builder, chain, supervisor, keeper, ramp)
    desired = ramp.GetOutputPort("extension_desired_state")
    enable = supervisor.GetOutputPort("legs_enable")
    pi = add_position_control(builder, scenario, desired, enable)
    connect(builder, desired, supervisor.GetInputPort("extension_desired_state"))
    _wire_supervisor(builder, chain, supervisor)
    _add_fault_detector(builder, chain, supervisor, pi, period)
    _add_stability_monitor(builder, chain, supervisor, keeper, period)
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram


def _wire_legs(
    builder: DiagramBuilder,
    chain: PostureChain,
    supervisor: Supervisor,
    keeper: ContactKeeper,
    ramp: LegRamp,
) -> None:
    """Legs follow the posture, trimmed by contact, or go up and down by themselves."""
    control = supervisor.GetOutputPort("posture_control")
    chain.enable(builder, control)
    calculated = chain.passive.GetOutputPort("extension_desired_state")
    for source, system, port in (
        (calculated, keeper, "extension_desired_state"),
        (control, keeper, "enable"),
        (keeper.GetOutputPort("extension_trimmed_state"), ramp, "posture_extension_state"),
        (control, ramp, "posture_control"),
        (supervisor.GetOutputPort("leg_rate"), ramp, "leg_rate"),
        (supervisor.GetOutputPort("legs_enable"), ramp, "enable"),
    ):
        connect(builder, source, system.GetInputPort(port))
    builder.ConnectInput("legs.extension", ramp.GetInputPort("extension"))
    builder.ExportInput(keeper.GetInputPort("limits"), "legs.limits")


def _wire_supervisor(builder: DiagramBuilder, chain: PostureChain, supervisor: Supervisor) -> None:
    ground = chain.ground
    for source, port in (
        (ground.GetOutputPort("ground"), "ground"),
        (ground.GetOutputPort("valid"), "ground_valid"),
        (ground.GetOutputPort("foot_offsets"), "foot_offsets"),
        (chain.reference.GetOutputPort("posture_desired_state"), "posture_desired_state"),
    ):
        connect(builder, source, supervisor.GetInputPort(port))
    trigger = supervisor.GetOutputPort("estimate_ground")
    connect(builder, trigger, ground.GetInputPort("trigger"))
    command = supervisor.GetOutputPort("posture_command")
    connect(builder, command, chain.reference.GetInputPort("posture_command"))

    builder.ConnectInput("legs.extension", supervisor.GetInputPort("extension"))
    builder.ConnectInput("legs.limits", supervisor.GetInputPort("limits"))
    builder.ExportInput(supervisor.GetInputPort("wheel_velocity"), "wheels.velocity")
    for name in ("operator", "posture_request"):
        builder.ExportInput(supervisor.GetInputPort(name), name)
    steering = add(builder, MatrixGain(WheelGeometry().skid_steering()), "skid_steering")
    builder.ExportInput(steering.get_input_port(), "drive_request")
    connect(builder, steering.get_output_port(), supervisor.GetInputPort("drive_request"))
    for port, name in (
        ("wheel_velocity_command", "wheels.velocity_command"),
        ("wheel_brake", "wheels.brake"),
        ("legs_stop", "legs.stop"),
        ("phase", "phase"),
        ("refusal", "refusal"),
    ):
        builder.ExportOutput(supervisor.GetOutputPort(port), name)


def _add_fault_detector(
    builder: DiagramBuilder,
    chain: PostureChain,
    supervisor: Supervisor,
    pi: PiController,
    period: float,
) -> None:
    detector = add(builder, FaultDetector(MODEL_GEOMETRY, period=period))
    for source, port in (
        (pi.GetOutputPort("voltage"), "voltage"),
        (chain.attitude.GetOutputPort("attitude"), "attitude"),
        (chain.ground.GetOutputPort("ground"), "ground"),
        (chain.ground.GetOutputPort("foot_offsets"), "foot_offsets"),
        (supervisor.GetOutputPort("phase"), "phase"),
    ):
        connect(builder, source, detector.GetInputPort(port))
    for name, port in (
        ("legs.extension", "extension"),
        ("legs.limits", "limits"),
        ("imu.gyro", "gyro"),
        ("imu.accel", "accel"),
        ("posture_request", "posture_request"),
        ("operator", "operator"),
    ):
        builder.ConnectInput(name, detector.GetInputPort(port))
    builder.ExportInput(detector.GetInputPort("age"), "status.age")
    connect(builder, detector.GetOutputPort("severity"), supervisor.GetInputPort("severity"))
    for name in ("findings", "severity"):
        builder.ExportOutput(detector.GetOutputPort(name), name)


def _add_stability_monitor(
    builder: DiagramBuilder,
    chain: PostureChain,
    supervisor: Supervisor,
    keeper: ContactKeeper,
    period: float,
) -> None:
    monitor = add(builder, StabilityMonitor(MODEL_GEOMETRY, period=period))
    builder.ConnectInput("legs.extension", monitor.GetInputPort("extension"))
    for source, port in (
        (keeper.GetOutputPort("standing"), "standing"),
        (chain.attitude.GetOutputPort("attitude"), "attitude"),
        (chain.ground.GetOutputPort("ground"), "ground"),
        (supervisor.GetOutputPort("arm_enable"), "enable"),
    ):
        connect(builder, source, monitor.GetInputPort(port))
    builder.ExportInput(monitor.GetInputPort("arm_request"), "arm_request")
    for port, name in (
        ("arm_command", "arm_command"),
        ("margin", "stability_margin"),
        ("margin_requested", "arm_margin"),
        ("refused", "arm_refused"),
    ):
        builder.ExportOutput(monitor.GetOutputPort(port), name)
