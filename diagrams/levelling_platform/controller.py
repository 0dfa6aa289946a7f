"""The levelling platform's controllers: from posture commands and measurements to voltages.

The posture chain of Fig. 18 is shared; one controller obeys a trigger, the other a supervisor.
"""

from collections.abc import Sequence
from typing import Literal

from pydrake.systems.framework import Diagram, System
from pydrake.systems.primitives import Adder, ConstantVectorSource, MatrixGain

from parapod.diagrams.levelling_platform.position_loops import pi_params
from parapod.diagrams.levelling_platform.scenario import ControlScenario, LevellingScenario
from parapod.diagrams.levelling_platform.vibration import damping_systems, shaping_system
from parapod.diagrams.wiring import Wired, named, wired
from parapod.systems.actuators.pi_controller import PiController
from parapod.systems.core.vectors import Array
from parapod.systems.levelling_platform.fault_detection import FaultDetector
from parapod.systems.levelling_platform.feedforward import KinematicFeedforward, PassiveLegSolver
from parapod.systems.levelling_platform.ground_estimator import GroundEstimator
from parapod.systems.levelling_platform.inclination_loop import PostureLoop, PostureLoopParams
from parapod.systems.levelling_platform.leg_motion import ContactKeeper, LegRamp
from parapod.systems.levelling_platform.reference import PostureReference
from parapod.systems.levelling_platform.stability_monitor import StabilityMonitor
from parapod.systems.levelling_platform.supervisor import Supervisor
from parapod.systems.sensors.attitude_estimator import AttitudeEstimator

# Signals by the names of the ports inside, where all controllers of legs have the same.
_SIGNALS = {
    "gyro": "imu.gyro",
    "accel": "imu.accel",
    "attitude": "attitude_estimated",
    "error": "attitude_error",
    "ground": "ground_estimated",
    "valid": "ground_valid",
    "foot_offsets": "foot_offsets_estimated",
    "desired_state": "extension_desired_state",
    "voltage": "legs.voltage",
    "limits": "legs.limits",
}
_SHOWN = (
    *("attitude_estimated", "posture_desired_state", "ground_estimated", "ground_valid"),
    *("foot_offsets_estimated", "legs.voltage", "extension_desired_state"),
)
_SUPERVISED = {
    "trigger": "estimate_ground",
    "wheel_velocity": "wheels.velocity",
    "wheel_velocity_command": "wheels.velocity_command",
    "wheel_brake": "wheels.brake",
    "legs_stop": "legs.stop",
    "age": "status.age",
    "emergency_stop": "legs.emergency_stop",
    "arm_command": "arm.position_command",
    "margin": "stability_margin",
    "margin_requested": "arm_margin",
    "refused": "arm_refused",
}
_SUPERVISED_SHOWN = (
    *("wheels.velocity_command", "wheels.brake", "legs.stop", "phase", "refusal"),
    *("findings", "severity", "stability_margin"),
)
_ARM_SHOWN = ("arm.position_command", "arm_margin", "arm_refused")


def measuring_systems(control: ControlScenario) -> tuple[list[Wired], dict[str, str]]:
    """The attitude's estimator and what corrects measurements; signals of ports by their names.

    Args:
        control: its period, `encoder_offsets_mm` and `inclination_bias_deg` are used.
    """
    estimator = AttitudeEstimator(period=control.period)
    systems: list[Wired] = [(estimator, {})]
    extension, bias, offsets = "legs.extension", control.inclination_bias, control.encoder_offsets
    if bias.any():
        systems = [(estimator, {"attitude": "attitude_measured"})]
        systems += _shifted("inclination", "attitude_measured", "attitude_estimated", -bias)
    if offsets.any():
        extension = "extension_known"
        systems += _shifted("encoder", "legs.extension", extension, offsets)
    of_extension = dict.fromkeys(("extension", "extension_measured", "measured"), extension)
    return systems, _SIGNALS | of_extension


def _shifted(what: str, measured: str, corrected: str, by: Array) -> tuple[Wired, Wired]:
    """Systems that add a constant to a signal."""
    total, offset = named(f"{what}_correction", Adder(2, by.size)), f"{what}_offset"
    constant = named(offset, ConstantVectorSource(by))
    return (total, {"u0": measured, "u1": offset, "sum": corrected}), (constant, {"y0": offset})


def posture_chain(
    scenario: LevellingScenario,
    on_unreachable: Literal["raise", "clamp"],
    enable: str,
    calculated: str = "extension_desired_state",
    correction: Sequence[Wired] | None = None,
) -> tuple[list[System | Wired], dict[str, str]]:
    """Estimators, reference, kinematic feedforward and passive leg, and signals of their ports.

    Args:
        scenario: its `control` and `machine` are used.
        on_unreachable: reaction of `PostureReference` to a command outside the workspace.
        enable: signal that tells that postures are to be followed.
        calculated: signal of the extensions and rates that follow from the posture.
        correction: systems that make `posture_corrected_state` of the reference; None: the loop
            of the inclination, if the scenario has it.
    """
    control, geometry = scenario.control, scenario.geometry_as_known
    period, limits = control.period, scenario.machine.posture_reference
    systems, names = measuring_systems(control)
    enabled = {"enable": enable}
    reference = PostureReference(geometry, limits, on_unreachable, period)
    chain: list[System | Wired] = [*systems, GroundEstimator(geometry, period)]
    chain.append((reference, enabled))
    followed = {}
    if correction:
        chain += correction
        followed = {"posture_desired_state": "posture_corrected_state"}
    if damping := damping_systems(scenario, enable):
        chain += [(system, {**signals, **followed}) for system, signals in damping]
        followed = {"posture_desired_state": "posture_damped_state"}
    if control.outer_loop and not correction:
        loop = PostureLoop(posture_loop_params(scenario), period=period)
        chain.append((loop, enabled | followed))
        followed = {"posture_desired_state": "posture_corrected_state"}
    feedforward = KinematicFeedforward(geometry, law=control.feedforward, period=period)
    passive = PassiveLegSolver(geometry), followed | {"extension_desired_state": calculated}
    chain += [(feedforward, enabled | followed), passive]
    return chain, names


def posture_loop_params(scenario: LevellingScenario) -> PostureLoopParams:
    """Design of the outer inclination loop."""
    return PostureLoopParams(
        gain=scenario.control.outer_loop_gain,
        lag=PostureLoopParams().lag + 1e-3 * scenario.machine.sensors.imu_delay_ms,
    )


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
    chain, names = posture_chain(scenario, on_unreachable, "ground_valid")
    pi = PiController(pi_params(scenario), period=scenario.control.period)
    systems = [*chain, (pi, {"enable": "ground_valid"})]
    return wired("controller", systems, _SHOWN, names | {"trigger": "estimate_ground"})


def make_supervised_controller(scenario: LevellingScenario, is_operated: bool = False) -> Diagram:
    """Wires supervisor, posture chain, contact keeper, ramps, PI loops and stability monitor.

    Inputs: `legs.extension` (4), `legs.limits` (12), `imu.gyro` (3), `imu.accel` (3),
    `legs.emergency_stop` (1), `wheels.velocity` (4) and `status.age` (4), as the station has
    them; from the operator `operator` (1), `drive_request` (2: forward speed, yaw rate),
    `posture_request` (3), `arm_request` (n) of an arm; and where a person operates,
    `jog_request` (4: rates of legs) and `operator_age` (1: time since the person was heard).
    Outputs: `legs.voltage` (4), `legs.stop` (1), `wheels.velocity_command` (4), `wheels.brake`
    (1), `findings` (18), `severity` (1); `phase` (1), `refusal` (2), `stability_margin` (1: now);
    of an arm `arm.position_command` (n), `arm_refused` (1), `arm_margin` (1: along the move asked
    for); and what the posture chain exports.

    Args:
        scenario: its `control` part is used.
        is_operated: true if a person operates it.
    """
    machine, period = scenario.machine, scenario.control.period
    geometry, wheels = scenario.geometry_as_known, machine.wheel_geometry
    calculated = "extension_calculated_state"
    chain, names = posture_chain(scenario, "clamp", "posture_control", calculated)
    supervisor = Supervisor(geometry, machine.supervisor, wheels.standing_height, period)
    # Legs follow the posture, trimmed by contact, or go up and down by themselves.
    trimmed = {
        "extension_desired_state": calculated,
        "extension_trimmed_state": "posture_extension_state",
        "enable": "posture_control",
    }
    systems = [
        *chain,
        (supervisor, {"drive_request": "wheel_request"}),
        (ContactKeeper(period=period), trimmed),
        (LegRamp(period=period), {"enable": "legs_enable"}),
        (PiController(pi_params(scenario), period=period), {"enable": "legs_enable"}),
        (
            named("skid_steering", MatrixGain(wheels.skid_steering())),
            {"u0": "drive_request", "y0": "wheel_request"},
        ),
        FaultDetector(geometry, scenario.fault_detector, period),
        *arm_chain(scenario),
    ]
    unused = () if is_operated else ("jog_request", "operator_age")
    arm = _ARM_SHOWN if machine.masses.arm.count else ()
    outputs = (*_SHOWN, *_SUPERVISED_SHOWN, *arm)
    return wired("controller", systems, outputs, names | _SUPERVISED, unused)


def arm_chain(scenario: LevellingScenario, enable: str = "arm_enable") -> list[Wired]:
    """The monitor of the arm's moves and, if the scenario says so, what shapes them.

    Args:
        scenario: its `machine` and `control` are used.
        enable: signal that tells that moves may begin.
    """
    machine, period = scenario.machine, scenario.control.period
    geometry, limits = scenario.geometry_as_known, machine.stability_monitor
    signals = {"enable": enable}
    monitor, shaper = StabilityMonitor(geometry, limits, period=period), shaping_system(scenario)
    if shaper is None:
        return [(monitor, signals)]
    ports = {"command": "arm_move", "shaped_command": "arm.position_command"}
    return [(monitor, signals | {"arm_command": "arm_move"}), (shaper, ports)]
