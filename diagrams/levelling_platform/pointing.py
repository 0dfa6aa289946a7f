"""The controller that puts the arm's tip to points, and what it knows of platform and arm."""

from typing import Literal

from pydrake.systems.framework import Diagram
from pydrake.systems.primitives import Multiplexer

from parapod.diagrams.levelling_platform.controller import arm_chain, posture_chain
from parapod.diagrams.levelling_platform.disturbances import payload_in
from parapod.diagrams.levelling_platform.position_loops import pi_params
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.tip import observed_arm
from parapod.diagrams.wiring import Wired, named, wired
from parapod.systems.actuators.pi_controller import PiController
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.carried_arm import CarriedArm
from parapod.systems.levelling_platform.leg_motion import ContactKeeper
from parapod.systems.levelling_platform.pointing import TipFeedforward, TipLoop
from parapod.systems.levelling_platform.stability_monitor import usual_margin

_SHOWN = (
    *("attitude_estimated", "posture_desired_state", "ground_estimated", "ground_valid"),
    *("foot_offsets_estimated", "legs.voltage", "extension_desired_state", "posture_command"),
    *("stability_margin", "arm.position_command", "arm_margin", "arm_refused"),
    *("tip_goal", "tip_estimated", "tip_arrived", "tip_refused"),
)
_OBSERVED = ("rod_observed", "tip_deflection_observed")
# Time in which another process has worked out posture and joints for a point [ms].
_ANSWER = 300.0
# Rate of the passive leg's trim [m/s]: where ground gives way, a platform on two feet rolls down
# the slope until the others stand again. Twice as fast, the trim goes on beyond the contact.
_TRIM_RATE = 1.5e-3
_SIGNALS = {
    "trigger": "estimate_ground",
    "arm_position": "arm.position",
    "arm_command": "arm.position_command",
    "margin": "stability_margin",
    "margin_requested": "arm_margin",
    "refused": "arm_refused",
}


def carried_arm(scenario: LevellingScenario) -> CarriedArm:
    """Platform and arm as the controller knows them, on level ground.

    Args:
        scenario: its `machine` and `control` are used.

    Raises:
        ScenarioError: a platform without an arm.
    """
    machine, geometry = scenario.machine, scenario.geometry_as_known
    monitor = machine.stability_monitor
    if not monitor.platform.arm.count:
        raise ScenarioError("machine.arm must be an arm: its tip is put to points", "machine.arm")
    margin = usual_margin(geometry) if monitor.margin is None else monitor.margin
    first = machine.structure.underside[0].tolist()
    return CarriedArm(
        geometry,
        monitor.platform,
        machine.arm.bending,
        margin=margin,
        # Of a base of one's own nothing is known.
        base=None if machine.base.urdf else (-first[0], -first[1], -first[2]),
        rates=monitor.rate,
    )


def make_pointing_controller(
    scenario: LevellingScenario,
    has_view: bool = False,
    on_unreachable: Literal["raise", "clamp"] = "raise",
    has_payload: bool = False,
) -> Diagram:
    """Wires the tip's feedforward and loop, posture chain, contact keeper and stability monitor.

    Inputs: `legs.extension` (4), `legs.limits` (12), `imu.gyro` (3), `imu.accel` (3),
    `arm.position` (n), `estimate_ground` (1), whose rise makes the ground be estimated and control
    begin, `tip_command` (3, or 6 with directions of view), and where payloads are told `payload`
    (1).
    Outputs: `legs.voltage` (4), `arm.position_command` (n), `tip_goal` (3), `tip_estimated` (3),
    `tip_arrived` (1), `tip_refused` (1), `posture_command` (3), `stability_margin` (1: now),
    `arm_margin` (1: along the move asked for), `arm_refused` (1), and what the posture chain has.

    Args:
        scenario: its `machine` and `control` are used.
        has_view: true if commands have a direction of view.
        on_unreachable: reaction to a point that the tip cannot be at.
        has_payload: true if the controller is told what the tip bears besides.
    """
    carried, period = carried_arm(scenario), scenario.control.period
    is_real, answer_ms = scenario.backend == "hardware", scenario.control.tip_answer_ms
    if answer_ms is None:
        answer_ms = _ANSWER if is_real else 0.0
    calculated, enabled = "extension_calculated_state", {"enable": "ground_valid"}
    loop = TipLoop(carried, period=period), enabled
    chain, names = posture_chain(scenario, "clamp", "ground_valid", calculated, [loop])
    how = has_view, on_unreachable, period, 1e-3 * answer_ms, is_real
    feedforward = TipFeedforward(carried, scenario.level_height, *how)
    trimmed = {
        "extension_desired_state": calculated,
        "extension_trimmed_state": "extension_desired_state",
    }
    systems = [
        *chain,
        (feedforward, enabled),
        (ContactKeeper(_TRIM_RATE, period=period), trimmed | enabled),
        (PiController(pi_params(scenario), period=period), enabled),
        *arm_chain(scenario, "ground_valid"),
    ]
    observer = observer_systems(scenario, has_payload)
    outputs = (*_SHOWN, *_OBSERVED) if observer else _SHOWN
    skip = ("base_velocity",) if has_payload else ("base_velocity", "payload")
    return wired("controller", [*systems, *observer], outputs, names | _SIGNALS, skip)


def observer_systems(scenario: LevellingScenario, has_payload: bool) -> list[Wired]:
    """Systems that observe how the rod bends, which no sensor does; none of a rigid one.

    The platform's pose is not a number before the ground is known: the rod rests until then.

    Args:
        scenario: its `machine` and `control` are used.
        has_payload: true if the controller is told what the tip bears besides.

    Raises:
        ScenarioError: a payload under which the rod buckles.
    """
    observer = observed_arm(scenario, payload_in(scenario.disturbances) if has_payload else 0.0)
    if observer is None:
        return []
    count = scenario.machine.masses.arm.count
    joints = named("arm_state_measured", Multiplexer([count, count]))
    measured = {"u0": "arm.position", "u1": "arm.velocity", "y0": "joint_state"}
    signals = {
        "base_pose": "platform_pose_measured",
        "modal_state": "rod_observed",
        "deflection": "tip_deflection_observed",
    }
    return [(joints, measured), (observer, signals)]
