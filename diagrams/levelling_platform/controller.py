"""The levelling platform's controller: from posture commands and measurements to voltages."""

from typing import Literal

from pydrake.systems.framework import Diagram, DiagramBuilder

from parapod.diagrams.levelling_platform.posture_chain import (
    add_position_control,
    add_posture_chain,
)
from parapod.diagrams.levelling_platform.scenario import LevellingScenario


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
    builder = DiagramBuilder()
    chain = add_posture_chain(builder, scenario, on_unreachable)
    valid = chain.ground.GetOutputPort("valid")
    chain.enable(builder, valid)
    desired = chain.passive.GetOutputPort("extension_desired_state")
    add_position_control(builder, scenario, desired, valid)
    builder.ExportInput(chain.ground.GetInputPort("trigger"), "estimate_ground")
    builder.ExportInput(chain.reference.GetInputPort("posture_command"), "posture_command")
    diagram = builder.Build()
    diagram.set_name("controller")
    return diagram
