"""The quasi-static plant: closed-form statics instead of bodies."""

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, ZeroOrderHold

from parapod.diagrams.levelling_platform.model import geometry_as_built
from parapod.diagrams.levelling_platform.plant import Drives, Plant
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.visualization import add_drawing
from parapod.diagrams.wiring import add, connect
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.wheels import WheelGeometry


def add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    drives: Drives,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the quasi-static plant, and with `meshcat` a drawing of it."""
    platform = add(builder, KinematicPlatform(geometry_as_built(scenario), wheels=WheelGeometry()))
    connect(builder, drives.rods.GetOutputPort("extension"), platform.GetInputPort("extension"))
    connect(builder, drives.rods.GetOutputPort("velocity"), platform.GetInputPort("velocity"))
    connect(builder, drives.arm_angles, platform.GetInputPort("arm_position"))
    names = (
        "posture",
        "attitude",
        "angular_velocity",
        "specific_force",
        "contact_force",
        "foot_height",
        "load_force",
    )
    signals = {name: platform.GetOutputPort(name) for name in names}
    # The inertial sensor samples at instants of its own; held, the platform's statics are solved
    # once a period and not again for every sample.
    holds = {}
    for name in ("attitude", "angular_velocity", "specific_force"):
        held = add(builder, ZeroOrderHold(scenario.control.period, 3), f"held_{name}")
        connect(builder, signals[name], held.get_input_port())
        signals[name] = held.get_output_port()
        holds[name] = held
    signals["loop_error"] = _zeros(builder, "no_loops")
    plant = Plant(signals, (platform,), holds, None)
    if meshcat is None:
        return plant
    add_drawing(
        builder,
        scenario.ground.inclination,
        meshcat,
        drives.rods.GetOutputPort("extension"),
        platform.GetOutputPort("base_pose"),
        drives.arm_angles,
    )
    return plant


def _zeros(builder: DiagramBuilder, name: str) -> OutputPort:
    source = add(builder, ConstantVectorSource(np.zeros(LEG_COUNT)), name)
    return source.get_output_port()
