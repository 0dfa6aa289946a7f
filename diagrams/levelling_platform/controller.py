"""The levelling platform's controllers: from posture commands and measurements to voltages.

The posture chain is shared; one controller obeys a trigger, the other a supervisor.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort, OutputPort
from pydrake.systems.primitives import Adder, ConstantVectorSource, Demultiplexer, MatrixGain

from parapod.diagrams.levelling_platform.scenario import ControlScenario, LevellingScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.linear_actuator import LinearActuatorParams
from parapod.systems.actuators.pi_controller import PiController, PiControllerParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.fault_detection import FaultDetector
from parapod.systems.levelling_platform.feedforward import KinematicFeedforward, PassiveLegSolver
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.ground_estimator import GroundEstimator
from parapod.systems.levelling_platform.inclination_loop import PostureLoop, PostureLoopParams
from parapod.systems.levelling_platform.leg_motion import ContactKeeper, LegRamp
from parapod.systems.levelling_platform.reference import PostureReference
from parapod.systems.levelling_platform.stability_monitor import (
    StabilityMonitor,
    StabilityMonitorParams,
)
from parapod.systems.levelling_platform.supervisor import Supervisor
from parapod.systems.levelling_platform.wheels import WheelGeometry
from parapod.systems.sensors.attitude_estimator import AttitudeEstimator

# Legs follow their references within a millimetre; tracking errors above this share of their way
# mean a failed encoder [-].
_ERROR_LIMIT = 0.25
# Least damping of the position loops: with less they ring [-].
_LEAST_DAMPING = 0.1
_EXTENSION = "legs.extension"


class Extension:
    """The exported input `legs.extension` of a controller, corrected by the encoders' offsets."""

    def __init__(self, builder: DiagramBuilder, control: ControlScenario):
        self._builder, self._is_exported = builder, False
        self._corrected: OutputPort | None = None
        if control.encoder_offsets.any():
            total = add(builder, Adder(2, LEG_COUNT), "encoder_correction")
            offsets = ConstantVectorSource(control.encoder_offsets)
            source = add(builder, offsets, "encoder_offsets").get_output_port()
            connect(builder, source, total.get_input_port(1))
            builder.ExportInput(total.get_input_port(0), _EXTENSION)
            self._corrected = total.get_output_port()

    def feed(self, sink: InputPort) -> None:
        """Gives an input the extensions."""
        if self._corrected is not None:
            connect(self._builder, self._corrected, sink)
        elif self._is_exported:
            self._builder.ConnectInput(_EXTENSION, sink)
        else:
            self._builder.ExportInput(sink, _EXTENSION)
            self._is_exported = True


@dataclass(frozen=True)
class PostureChain:
    """Fig. 18 without the position controllers.

    Attributes:
        extension: extensions (4), as the encoders measure them with their offsets.
        attitude: estimated roll and pitch (2), less the sensor's bias.
        estimator: estimates roll and pitch.
        ground: estimates the ground.
        reference: makes commands smooth.
        loop: corrects the inclination, or None.
        feedforward: inverse kinematics of the active legs.
        passive: inverse kinematics of the fourth leg.
    """

    extension: Extension
    attitude: OutputPort
    estimator: AttitudeEstimator
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
        builder: builder of the controller.
        scenario: its `control` part is used.
        on_unreachable: reaction of `PostureReference` to a command outside the workspace.
    """
    control = scenario.control
    geometry, period = scenario.geometry_as_known, control.period
    limits = scenario.machine.posture_reference
    reference = PostureReference(geometry, limits, on_unreachable, period)
    feedforward = KinematicFeedforward(geometry, law=control.feedforward, period=period)
    estimator, attitude = add_attitude(builder, control)
    chain = PostureChain(
        extension=Extension(builder, control),
        attitude=attitude,
        estimator=estimator,
        ground=add(builder, GroundEstimator(geometry, period)),
        reference=add(builder, reference),
        loop=_add_posture_loop(builder, scenario) if control.outer_loop else None,
        feedforward=add(builder, feedforward),
        passive=add(builder, PassiveLegSolver(geometry)),
    )
    _wire(builder, chain)
    _export(builder, chain)
    return chain


def add_attitude(
    builder: DiagramBuilder, control: ControlScenario
) -> tuple[AttitudeEstimator, OutputPort]:
    """Adds the attitude's estimator; returns it, and roll and pitch less the sensor's bias.

    Exports the inputs `imu.gyro` (3) and `imu.accel` (3), and the output `attitude_estimated` (2).
    """
    estimator = add(builder, AttitudeEstimator(period=control.period))
    builder.ExportInput(estimator.GetInputPort("gyro"), "imu.gyro")
    builder.ExportInput(estimator.GetInputPort("accel"), "imu.accel")
    attitude = estimator.GetOutputPort("attitude")
    if control.inclination_bias.any():
        total = add(builder, Adder(2, 2), "inclination_correction")
        bias = add(builder, ConstantVectorSource(-control.inclination_bias), "inclination_bias")
        connect(builder, attitude, total.get_input_port(0))
        connect(builder, bias.get_output_port(), total.get_input_port(1))
        attitude = total.get_output_port()
    builder.ExportOutput(attitude, "attitude_estimated")
    return estimator, attitude


def _wire(builder: DiagramBuilder, chain: PostureChain) -> None:
    ground, reference = chain.ground, chain.reference
    feedforward, passive = chain.feedforward, chain.passive
    chain.extension.feed(ground.GetInputPort("extension"))
    for system in (reference, feedforward):
        chain.extension.feed(system.GetInputPort("extension_measured"))
    posture = reference.GetOutputPort("posture_desired_state")
    if chain.loop is not None:
        connect(builder, posture, chain.loop.GetInputPort("posture_desired_state"))
        connect(builder, chain.attitude, chain.loop.GetInputPort("attitude"))
        trusted = chain.estimator.GetOutputPort("trusted")
        connect(builder, trusted, chain.loop.GetInputPort("trusted"))
        posture = chain.loop.get_output_port()
    for source, system, port in (
        (chain.attitude, ground, "attitude"),
        (chain.estimator.GetOutputPort("error"), ground, "attitude_error"),
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
    ground, reference = chain.ground, chain.reference
    for output, name in (
        (reference.GetOutputPort("posture_desired_state"), "posture_desired_state"),
        (ground.GetOutputPort("ground"), "ground_estimated"),
        (ground.GetOutputPort("valid"), "ground_valid"),
        (ground.GetOutputPort("foot_offsets"), "foot_offsets_estimated"),
    ):
        builder.ExportOutput(output, name)


def pi_params(scenario: LevellingScenario) -> PiControllerParams:
    """Design of the actuators' position controllers.

    Raises:
        ScenarioError: a period that is too long for the pole.
    """
    control, actuators = scenario.tuned_control, scenario.machine.actuators
    pole, limit, friction = control.pole, control.voltage_limit, control.friction_feedforward
    assert pole is not None
    assert limit is not None
    assert friction is not None
    if control.period > (longest := longest_period(pole, actuators.time_constant_ms / 1e3)):
        raise ScenarioError(
            f"control.period = {control.period:g} s is too long for control.pole = "
            f"{pole:g} rad/s, the position loops would ring: it must be "
            f"{1e-4 * math.floor(1e4 * longest):g} s or less",
            "control.period",
        )
    extending, retracting = friction
    params = actuators.params
    return PiControllerParams(
        gain=params.gain,
        pole=pole,
        voltage_limit=limit,
        rate_feedforward=control.rate_feedforward,
        friction_feedforward=(extending, retracting),
        error_limit=_ERROR_LIMIT * (params.stop_max - params.stop_min),
        gain_share=scenario.gain_share,
    )


def longest_period(pole: float, tau: float = LinearActuatorParams().time_constant) -> float:
    """Longest sampling period with which position loops do not ring [s].

    Args:
        pole: pole of the loops [rad/s].
        tau: time constant of the actuators [s].
    """
    low, high = 0.0, 1.0
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if _damping(pole, middle, tau) >= _LEAST_DAMPING else (low, middle)
        )
    return low


def _damping(pole: float, period: float, tau: float) -> float:
    """Smallest damping of a sampled position loop, Eqs. (17) and (32).

    The actuator is K / (s (tau s + 1)), and a command takes effect a period after its measurement.
    """
    decay = math.exp(-period / tau)
    way = tau * (1.0 - decay)
    k_v, k_i = 2.0 * pole, pole**2 * period  # of u = K times the voltage
    # Position, velocity, integral and the command that takes effect next.
    step = np.array(
        [
            [1.0, way, 0.0, period - way],
            [0.0, decay, 0.0, 1.0 - decay],
            [-k_i, 0.0, 1.0, 0.0],
            [-k_v, 0.0, 1.0, 0.0],
        ]
    )
    poles = np.log(np.linalg.eigvals(step).astype(complex))
    return float((-poles.real / np.abs(poles)).min())


def add_position_control(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    extension: Extension,
    desired: OutputPort,
    enable: OutputPort,
) -> PiController:
    """Adds the actuators' position controllers behind a posture chain; exports `legs.voltage`.

    Args:
        builder: builder of the controller.
        scenario: its `control` part is used.
        extension: extensions (4) of the legs.
        desired: extensions and rates (8) that the legs are asked for; exported too, as
            `extension_desired_state`.
        enable: above 0.5: control.
    """
    pi = add(builder, PiController(pi_params(scenario), period=scenario.control.period))
    connect(builder, desired, pi.GetInputPort("desired_state"))
    connect(builder, enable, pi.GetInputPort("enable"))
    extension.feed(pi.GetInputPort("measured"))
    builder.ExportOutput(pi.GetOutputPort("voltage"), "legs.voltage")
    builder.ExportOutput(desired, "extension_desired_state")
    return pi


def posture_loop_params(scenario: LevellingScenario) -> PostureLoopParams:
    """Design of the outer inclination loop."""
    return PostureLoopParams(
        gain=scenario.control.outer_loop_gain,
        lag=PostureLoopParams().lag + 1e-3 * scenario.machine.sensors.imu_delay_ms,
    )


def _add_posture_loop(builder: DiagramBuilder, scenario: LevellingScenario) -> PostureLoop:
    params = posture_loop_params(scenario)
    return add(builder, PostureLoop(params, period=scenario.control.period))


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
        on_unreachable: reaction of `PostureReference` to a command outside the workspace.
    """
    builder = DiagramBuilder()
    chain = add_posture_chain(builder, scenario, on_unreachable)
    valid = chain.ground.GetOutputPort("valid")
    chain.enable(builder, valid)
    desired = chain.passive.GetOutputPort("extension_desired_state")
    add_position_control(builder, scenario, chain.extension, desired, valid)
    builder.ExportInput(chain.ground.GetInputPort("trigger"), "estimate_ground")
    builder.ExportInput(chain.reference.GetInputPort("posture_command"), "posture_command")
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram


def make_supervised_controller(scenario: LevellingScenario, is_operated: bool = False) -> Diagram:
    """Wires supervisor, posture chain, contact keeper, ramps, PI loops and stability monitor.

    Inputs: `legs.extension` (4), `legs.limits` (12), `imu.gyro` (3), `imu.accel` (3),
    `legs.emergency_stop` (1), `wheels.velocity` (4) and `status.age` (4), as the station has
    them; from the operator `operator` (1), `drive_request` (2: forward speed, yaw rate),
    `posture_request` (3), `arm_request` (2); and where a person operates, `jog_request` (4: rates
    of legs) and `operator_age` (1: time since the person was heard).
    Outputs: `legs.voltage` (4), `legs.stop` (1), `wheels.velocity_command` (4), `wheels.brake`
    (1), `turntable.position_command` (1), `arm.position_command` (1), `arm_command` (2: both);
    `findings` (18), `severity` (1); `phase` (1),
    `refusal` (2), `arm_refused` (1), `arm_margin` (1: along the move asked for),
    `stability_margin` (1: now), and what `add_posture_chain` and `add_position_control` export.

    Args:
        scenario: its `control` part is used.
        is_operated: true if a person operates it.
    """
    builder, machine = DiagramBuilder(), scenario.machine
    period, geometry = scenario.control.period, scenario.geometry_as_known
    chain = add_posture_chain(builder, scenario, on_unreachable="clamp")
    supervisor = add(
        builder,
        Supervisor(geometry, machine.supervisor, machine.wheel_geometry.standing_height, period),
    )
    keeper = add(builder, ContactKeeper(period=period))
    ramp = add(builder, LegRamp(period=period))
    _wire_legs(builder, chain, supervisor, keeper, ramp)
    desired = ramp.GetOutputPort("extension_desired_state")
    enable = supervisor.GetOutputPort("legs_enable")
    pi = add_position_control(builder, scenario, chain.extension, desired, enable)
    connect(builder, desired, supervisor.GetInputPort("extension_desired_state"))
    _wire_supervisor(builder, chain, supervisor, machine.wheel_geometry)
    fault_detector = FaultDetector(geometry, machine.fault_detector, period)
    detector = _add_fault_detector(builder, chain, supervisor, pi, fault_detector)
    if is_operated:
        builder.ExportInput(supervisor.GetInputPort("jog_request"), "jog_request")
        builder.ExportInput(detector.GetInputPort("operator_age"), "operator_age")
    limits = StabilityMonitorParams(platform=machine.masses)
    monitor = StabilityMonitor(geometry, limits, period=period)
    _add_stability_monitor(builder, chain, supervisor, keeper, monitor)
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
    chain.extension.feed(ramp.GetInputPort("extension"))
    builder.ExportInput(keeper.GetInputPort("limits"), "legs.limits")


def _wire_supervisor(
    builder: DiagramBuilder, chain: PostureChain, supervisor: Supervisor, wheels: WheelGeometry
) -> None:
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

    chain.extension.feed(supervisor.GetInputPort("extension"))
    builder.ConnectInput("legs.limits", supervisor.GetInputPort("limits"))
    builder.ExportInput(supervisor.GetInputPort("wheel_velocity"), "wheels.velocity")
    for name in ("operator", "posture_request"):
        builder.ExportInput(supervisor.GetInputPort(name), name)
    steering = add(builder, MatrixGain(wheels.skid_steering()), "skid_steering")
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
    detector: FaultDetector,
) -> FaultDetector:
    add(builder, detector)
    chain.extension.feed(detector.GetInputPort("extension"))
    for source, port in (
        (pi.GetOutputPort("voltage"), "voltage"),
        (chain.attitude, "attitude"),
        (chain.ground.GetOutputPort("ground"), "ground"),
        (chain.ground.GetOutputPort("foot_offsets"), "foot_offsets"),
        (supervisor.GetOutputPort("phase"), "phase"),
    ):
        connect(builder, source, detector.GetInputPort(port))
    for name, port in (
        ("legs.limits", "limits"),
        ("imu.gyro", "gyro"),
        ("imu.accel", "accel"),
        ("posture_request", "posture_request"),
        ("operator", "operator"),
    ):
        builder.ConnectInput(name, detector.GetInputPort(port))
    builder.ExportInput(detector.GetInputPort("age"), "status.age")
    builder.ExportInput(detector.GetInputPort("emergency_stop"), "legs.emergency_stop")
    connect(builder, detector.GetOutputPort("severity"), supervisor.GetInputPort("severity"))
    for name in ("findings", "severity"):
        builder.ExportOutput(detector.GetOutputPort(name), name)
    return detector


def _add_stability_monitor(
    builder: DiagramBuilder,
    chain: PostureChain,
    supervisor: Supervisor,
    keeper: ContactKeeper,
    monitor: StabilityMonitor,
) -> None:
    add(builder, monitor)
    chain.extension.feed(monitor.GetInputPort("extension"))
    for source, port in (
        (keeper.GetOutputPort("standing"), "standing"),
        (chain.attitude, "attitude"),
        (chain.ground.GetOutputPort("ground"), "ground"),
        (supervisor.GetOutputPort("arm_enable"), "enable"),
    ):
        connect(builder, source, monitor.GetInputPort(port))
    builder.ExportInput(monitor.GetInputPort("arm_request"), "arm_request")
    command = monitor.GetOutputPort("arm_command")
    parts = add(builder, Demultiplexer(2), "arm_command_parts")
    connect(builder, command, parts.get_input_port(0))
    for i, name in enumerate(("turntable.position_command", "arm.position_command")):
        builder.ExportOutput(parts.get_output_port(i), name)
    for port, name in (
        ("arm_command", "arm_command"),
        ("margin", "stability_margin"),
        ("margin_requested", "arm_margin"),
        ("refused", "arm_refused"),
    ):
        builder.ExportOutput(monitor.GetOutputPort(port), name)
