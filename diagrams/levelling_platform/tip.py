"""The arm behind a platform's station: truth about its tip, and a rod of it that bends."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import SceneGraph
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain

from parapod.diagrams.levelling_platform.beginning import Beginning
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.simulated import Simulation
from parapod.diagrams.wiring import add, connect
from parapod.systems.arm.arm_tip import ArmTip
from parapod.systems.arm.bent_rod import BentRod
from parapod.systems.arm.flexible_arm import FlexibleArm
from parapod.systems.arm.serial_arm import ArmLink, SerialArm
from parapod.systems.core.errors import ScenarioError
from parapod.systems.levelling_platform.model import PlatformModel, standing_pose


@dataclass(frozen=True)
class ArmMotion:
    """Motion of the platform and of the arm on it.

    Attributes:
        platform_pose: quaternion and place (7) of the platform.
        joint_state: positions of the arm's joints, and their rates (2n).
        platform_velocity: angular and linear velocity (6) of the platform; None where unknown.
    """

    platform_pose: OutputPort
    joint_state: OutputPort
    platform_velocity: OutputPort | None = None


def motion_in(
    builder: DiagramBuilder, model: PlatformModel, state: OutputPort
) -> ArmMotion | None:
    """Motion in the state of a plant of rigid bodies; None where there is no arm."""
    count, joints = model.plant.num_positions(), model.arm_joints
    if not joints:
        return None
    pose = model.base.floating_positions_start()
    velocity = count + model.base.floating_velocities_start_in_v()
    rates = [count + joint.velocity_start() for joint in joints]
    ports = []
    for name, indices in (
        ("platform_pose", [*range(pose, pose + 7)]),
        ("joint_state", [joint.position_start() for joint in joints] + rates),
        ("platform_velocity", [*range(velocity, velocity + 6)]),
    ):
        selection = add(builder, MatrixGain(np.eye(state.size())[indices]), name)
        connect(builder, state, selection.get_input_port())
        ports.append(selection.get_output_port())
    return ArmMotion(*ports)


def applied_force(builder: DiagramBuilder, model: PlatformModel, rod: FlexibleArm) -> OutputPort:
    """Generalized force of a rod that bends, along all velocities of a plant."""
    start = model.base.floating_velocities_start_in_v()
    joints = [joint.velocity_start() for joint in model.arm_joints]
    rows = [*range(start, start + 6), *joints]
    gain = MatrixGain(np.eye(model.plant.num_velocities())[:, rows])
    add(builder, gain, "bending_force")
    connect(builder, rod.GetOutputPort("bending_force"), gain.get_input_port())
    return gain.get_output_port()


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


def without_rod(arm: SerialArm) -> SerialArm:
    """An arm whose last link weighs nothing."""
    return replace(arm, links=(*arm.links[:-1], ArmLink()))


def add_tip(
    simulation: Simulation[LevellingScenario, Beginning],
    scenario: LevellingScenario,
    motion: ArmMotion,
    bend: Callable[[FlexibleArm], None],
    period: float,
) -> None:
    """Adds truth about an arm's tip and, if the arm has one, its rod that bends.

    Args:
        simulation: the simulated machine.
        scenario: the scenario to build.
        motion: motion of platform and arm.
        bend: has the rod act on the plant.
        period: length of the rod's steps [s].

    Raises:
        ScenarioError: modes above what the period carries.
    """
    builder, machine = simulation.builder, scenario.machine
    rod, arm = machine.arm.bending, machine.masses.arm
    if rod is None:
        tip = add(builder, ArmTip(arm))
        straight = add(builder, ConstantVectorSource(np.zeros(3)), "no_deflection")
        connect(builder, motion.platform_pose, tip.GetInputPort("platform_pose"))
        connect(builder, motion.joint_state, tip.GetInputPort("arm_state"))
        simulation.outputs["truth.tip_pose"] = tip.GetOutputPort("pose")
        simulation.outputs["truth.tip_deflection"] = straight.get_output_port()
        return

    def pose_at(beginning: Beginning) -> NDArray[np.float64]:
        return standing_pose(beginning.posture, beginning.ground)

    is_moving = motion.platform_velocity is not None
    begins = pose_at(simulation.beginning)
    try:
        bends = FlexibleArm(rod, period, arm, begins, "velocity" if is_moving else "pose")
    except ValueError as error:
        raise ScenarioError(f"machine.arm.{error}", "machine.arm.modes") from None
    add(builder, bends)
    connect(builder, motion.platform_pose, bends.GetInputPort("base_pose"))
    connect(builder, motion.joint_state, bends.GetInputPort("joint_state"))
    if motion.platform_velocity is not None:
        connect(builder, motion.platform_velocity, bends.GetInputPort("base_velocity"))
    bend(bends)

    def put(root_context: Context, beginning: Beginning) -> None:
        bends.set_rest(bends.GetMyMutableContextFromRoot(root_context), pose_at(beginning))

    simulation.on_put(put)
    simulation.outputs["truth.tip_pose"] = bends.GetOutputPort("tip_pose")
    simulation.outputs["truth.tip_deflection"] = bends.GetOutputPort("deflection")
