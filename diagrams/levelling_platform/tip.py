"""The arm behind a platform's station: truth about its tip, and a rod of it that bends."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import SceneGraph
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain

from parapod.diagrams.levelling_platform.beginning import Beginning
from parapod.diagrams.levelling_platform.disturbances import Disturbances
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.simulated import Simulation
from parapod.diagrams.wiring import add, connect, sum_of
from parapod.systems.arm.arm_tip import ArmTip
from parapod.systems.arm.bent_rod import BentRod
from parapod.systems.arm.external_load import ExternalLoad
from parapod.systems.arm.flexible_arm import FlexibleArm
from parapod.systems.arm.flexible_rod import FlexibleRod
from parapod.systems.arm.rod_motion import carried_modes, check_rod, longest_period
from parapod.systems.arm.serial_arm import ArmLink, SerialArm
from parapod.systems.arm.yielding_drives import yielded_on
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.model import PlatformModel, standing_pose

# Longest step of a rod that bends [s], unless its plant's are longer, and by how much a whole
# number of the plant's steps may seem less for rounding [-].
_LONGEST, _ROUNDED = 5e-3, 1e-9
# Options of a rod on bodies, and of one on a platform that has no dynamics.
_ON_BODIES: Mapping[str, Any] = {"base_motion": "velocity", "forces": ["bending_force"]}
_AT_REST: Mapping[str, Any] = {"base_motion": "pose", "forces": ["wrench"]}


@dataclass(frozen=True)
class ArmMotion:
    """Motion of the platform and of the arm on it.

    Attributes:
        platform_pose: quaternion and place (7) of the platform.
        joint_state: positions of the arm's joints, and their rates (2n); None without an arm.
        platform_velocity: angular and linear velocity (6) of the platform; None where unknown.
    """

    platform_pose: OutputPort
    joint_state: OutputPort | None = None
    platform_velocity: OutputPort | None = None


def motion_in(builder: DiagramBuilder, model: PlatformModel, state: OutputPort) -> ArmMotion:
    """Motion in the state of a plant of rigid bodies."""
    count, joints = model.plant.num_positions(), model.arm_joints
    pose = model.base.floating_positions_start()
    velocity = count + model.base.floating_velocities_start_in_v()
    rates = [count + joint.velocity_start() for joint in joints]
    parts = {
        "platform_pose": [*range(pose, pose + 7)],
        "joint_state": [joint.position_start() for joint in joints] + rates,
        "platform_velocity": [*range(velocity, velocity + 6)],
    }
    ports = {}
    for name, indices in parts.items():
        if indices:
            selection = add(builder, MatrixGain(np.eye(state.size())[indices]), name)
            connect(builder, state, selection.get_input_port())
            ports[name] = selection.get_output_port()
    return ArmMotion(**ports)


def applied_force(
    builder: DiagramBuilder, model: PlatformModel, loads: Sequence[FlexibleArm | ExternalLoad]
) -> OutputPort:
    """Generalized force of loads along all velocities of a plant."""
    start = model.base.floating_velocities_start_in_v()
    joints = [joint.velocity_start() for joint in model.arm_joints]
    rows = [*range(start, start + 6), *joints]
    gain = add(builder, MatrixGain(np.eye(model.plant.num_velocities())[:, rows]), "loads")
    forces = [
        each.GetOutputPort("bending_force" if isinstance(each, FlexibleArm) else "applied_force")
        for each in loads
    ]
    connect(builder, sum_of(builder, forces, "force_of_loads"), gain.get_input_port())
    return gain.get_output_port()


def add_external_load(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    motion: ArmMotion,
    disturbances: Disturbances,
    period: float,
) -> ExternalLoad | None:
    """Adds what pushes the platform, and what hangs on the tip of a rigid arm; None if nothing.

    Args:
        builder: builder of the station.
        scenario: the scenario to build.
        motion: motion of platform and arm.
        disturbances: the disturbances.
        period: period of the plant [s].
    """
    machine = scenario.machine
    payload = disturbances.payload if machine.arm.bending is None else None
    if disturbances.pushes is None and payload is None:
        return None
    load = add(builder, ExternalLoad(disturbances.places, machine.masses.arm, period))
    connect(builder, motion.platform_pose, load.GetInputPort("base_pose"))
    for name, port in (
        ("joint_state", motion.joint_state),
        ("pushes", disturbances.pushes),
        ("payload", payload),
    ):
        if port is not None:
            connect(builder, port, load.GetInputPort(name))
    return load


def draw_bending(
    builder: DiagramBuilder, model: PlatformModel, scene_graph: SceneGraph, rod: FlexibleArm
) -> None:
    """Has the rod of a model that is drawn bend.

    Args:
        builder: builder of the diagram that holds `scene_graph`.
        model: the platform, whose last link of the arm is the rod.
        scene_graph: scene in which it is drawn.
        rod: the rod that bends.
    """
    link = model.arm_joints[-1].child_body()
    bent = add(builder, BentRod(rod.rod, model.plant, link, scene_graph))
    for name in ("clamp_pose", "modal_state"):
        connect(builder, rod.GetOutputPort(name), bent.GetInputPort(name))
    connect(builder, bent.get_output_port(), scene_graph.get_source_pose_port(bent.source_id))


def make_flexible_arm(
    rod: FlexibleRod, period: float, arm: SerialArm, payload: float = 0.0, **options: Any
) -> FlexibleArm:
    """A rod that bends on an arm.

    Args:
        rod: the rod.
        period: length of a step [s].
        arm: the arm.
        payload: mass of the payload that the tip may take [kg].
        options: further options of `FlexibleArm`.

    Raises:
        ScenarioError: modes above what the period carries, or a payload above what the rod does.
    """
    try:
        check_rod(rod, period)
    except ValueError as error:
        raise ScenarioError(f"machine.arm.{error}", "machine.arm.modes") from None
    try:
        return FlexibleArm(rod, period, arm, payload=payload, **options)
    except ValueError as error:
        key = "disturbances"
        raise ScenarioError(f"{key}: with a payload of {payload:g} kg, {error}", key) from None


def observed_arm(scenario: LevellingScenario, payload: float = 0.0) -> FlexibleArm | None:
    """A rod that bends as a controller follows it by poses; None of a rigid arm.

    Of the modes it has those that the controller's period carries: the others follow their load
    without delay. A rod of which it carries none is as good as rigid.

    Args:
        scenario: its `machine` and `control` are used.
        payload: mass of the payload that the tip may take [kg].

    Raises:
        ScenarioError: a rod that buckles, under its own weight or with the payload.
    """
    machine, period = scenario.machine, scenario.control.period
    rod = machine.arm.bending
    if rod is None or not (modes := carried_modes(rod, period)):
        return None
    rod, arm = replace(rod, modes=modes), machine.masses.arm
    return make_flexible_arm(rod, period, arm, payload, base_motion="pose", forces=())


def without_rod(arm: SerialArm) -> SerialArm:
    """An arm whose last link weighs nothing."""
    return replace(arm, links=(*arm.links[:-1], ArmLink()))


def add_tip(
    simulation: Simulation[LevellingScenario, Beginning],
    scenario: LevellingScenario,
    motion: ArmMotion,
    step: float,
    disturbances: Disturbances,
) -> FlexibleArm | None:
    """Adds truth about an arm's tip and, if the arm has one, its rod that bends: returns it.

    Args:
        simulation: the simulated machine.
        scenario: the scenario to build.
        motion: motion of platform and arm.
        step: step of the plant [s]; a rod's step is some of these.
        disturbances: their payload is taken by a rod that bends.

    Raises:
        ScenarioError: modes above what the period carries, or a payload above what the rod does.
    """
    builder, machine = simulation.builder, scenario.machine
    assert motion.joint_state is not None
    rod, arm = machine.arm.bending, machine.masses.arm
    if rod is None:
        tip = add(builder, ArmTip(arm))
        straight = add(builder, ConstantVectorSource(np.zeros(3)), "no_deflection")
        connect(builder, motion.platform_pose, tip.GetInputPort("platform_pose"))
        connect(builder, motion.joint_state, tip.GetInputPort("arm_state"))
        simulation.outputs["truth.tip_pose"] = tip.GetOutputPort("pose")
        simulation.outputs["truth.tip_deflection"] = straight.get_output_port()
        return None

    def pose_at(beginning: Beginning) -> NDArray[np.float64]:
        return standing_pose(beginning.posture, beginning.ground)

    def joints_on(pose: NDArray[np.float64]) -> Sequence[float]:
        """Joints of drives at zero: those of bodies begin to give way when these are let go."""
        zeros = [0.0] * arm.count
        return zeros if is_moving else yielded_on(arm, zeros, pose[:4].tolist())

    is_moving = motion.platform_velocity is not None
    begins = pose_at(simulation.beginning)
    longest = min(_LONGEST, longest_period(rod))
    period = max(1, int(longest / step + _ROUNDED)) * step
    options = _ON_BODIES if is_moving else _AT_REST
    begins_at = {"base_pose": begins, "position": joints_on(begins)}
    bends = make_flexible_arm(rod, period, arm, disturbances.mass, **options, **begins_at)
    add(builder, bends)
    connect(builder, motion.platform_pose, bends.GetInputPort("base_pose"))
    connect(builder, motion.joint_state, bends.GetInputPort("joint_state"))
    if motion.platform_velocity is not None:
        connect(builder, motion.platform_velocity, bends.GetInputPort("base_velocity"))
    if disturbances.payload is not None:
        connect(builder, disturbances.payload, bends.GetInputPort("payload"))

    def put(root_context: Context, beginning: Beginning) -> None:
        pose = pose_at(beginning)
        context = bends.GetMyMutableContextFromRoot(root_context)
        bends.set_rest(context, pose, joints_on(pose))

    simulation.on_put(put)
    simulation.outputs["truth.tip_pose"] = bends.GetOutputPort("tip_pose")
    simulation.outputs["truth.tip_deflection"] = bends.GetOutputPort("deflection")
    return bends
