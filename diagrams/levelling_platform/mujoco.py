"""Plant of the levelling platform whose rigid bodies MuJoCo simulates."""

from collections.abc import Sequence
from functools import partial

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort

from parapod.diagrams.levelling_platform.beginning import Beginning
from parapod.diagrams.levelling_platform.model import (
    add_platform,
    add_visualization,
    put_feet_on_pads,
)
from parapod.diagrams.levelling_platform.plants import (
    Drives,
    PlatformPlant,
    draw_as_full,
    led_legs,
    observe,
    put_on_ground,
)
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.tip import applied_force, draw_bending, motion_in
from parapod.diagrams.mujoco import draw, make_plant
from parapod.diagrams.pushes import places_of, push_mujoco, pushes_in
from parapod.diagrams.wiring import add, connect, first_of, joined
from parapod.systems.arm.external_load import ExternalLoad
from parapod.systems.arm.flexible_arm import FlexibleArm
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.model import PlatformModel
from parapod.systems.physics.mujoco.model import MujocoModel
from parapod.systems.physics.mujoco.plant import MujocoPlant


def add_mujoco_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    beginning: Beginning,
    drives: Drives,
    meshcat: Meshcat | None,
) -> PlatformPlant:
    """Adds the plant of rigid bodies; translated from Drake's, so that both are one machine.

    Raises:
        MissingExtra: MuJoCo is not installed.
    """
    plant, scene_graph = make_plant(builder, scenario.plant.time_step, meshcat)
    settings, geometry = scenario.plant, scenario.geometry_as_built
    model = add_platform(
        plant,
        settings.leg_model,
        settings.wheels,
        beginning.ground,
        geometry,
        beginning.foot_offsets,
        scenario.machine.structure,
        drives.disturbances.rising is not None,
    )
    plant.SetDefaultPositions(beginning.positions(model))
    rising = drives.disturbances.rising
    if rising is not None:
        put_feet_on_pads(model, scene_graph)
    translated = MujocoModel(
        plant, scene_graph, model.balls, model.couplings, model.leg_bodies("roller")
    )
    groups = [model.legs]
    if model.arm_joints:
        groups.append((model.arm,))
    if model.has_rolling_wheels:
        groups.append(model.wheels)
    if rising is not None:
        groups.append((model.pads,))
    base = model.base
    pushed = pushes_in(builder, plant, scenario.disturbances, base, usual_is_pushed=False)
    bodies = add(builder, MujocoPlant(translated, groups, pushed=places_of(pushed)))
    push_mujoco(builder, bodies, pushed, meshcat)
    load_force = _drive(builder, model, drives, bodies)
    state = bodies.GetOutputPort("state")
    poses, place = bodies.GetOutputPort("body_poses"), scenario.machine.sensors.imu_place
    signals, observers = observe(builder, model, beginning, state, poses, place, rising)
    contact_force = bodies.GetOutputPort("contact_force")
    signals |= {"load_force": load_force, "contact_force": contact_force}
    drawing = model, scene_graph
    if meshcat is not None and model.is_full:
        draw(builder, bodies, scene_graph)
        add_visualization(builder, model, state, scene_graph, meshcat)
    elif meshcat is not None:
        drawing = draw_as_full(builder, scenario, model, drives, state, meshcat)

    def put(root_context: Context, beginning: Beginning) -> None:
        context = plant.CreateDefaultContext()
        model.put(context, beginning.positions(model), beginning.ground, beginning.foot_offsets)
        bodies.put(bodies.GetMyMutableContextFromRoot(root_context), context)
        put_on_ground(observers, root_context, beginning)

    def load(loads: Sequence[FlexibleArm | ExternalLoad]) -> None:
        applied = applied_force(builder, model, loads)
        connect(builder, applied, bodies.GetInputPort("applied_force"))

    def bend(rod: FlexibleArm) -> None:
        if meshcat is not None:
            draw_bending(builder, *drawing, rod)

    motion = partial(motion_in, builder, model, state)
    return PlatformPlant(signals, put, motion=motion, load=load, bend=bend)


def _drive(
    builder: DiagramBuilder, model: PlatformModel, drives: Drives, bodies: MujocoPlant
) -> OutputPort:
    """Has the bodies follow the drives, and the pads their ground; returns the rods' forces (4).

    The forces are those of the last step: the loop from the actuators' next state to their load
    is not a loop of one instant.
    """
    holding = first_of(builder, bodies.GetOutputPort("holding_force"), LEG_COUNT, "efforts")
    legs, load_force = led_legs(builder, model, drives, holding)
    driven_parts = [legs]
    if drives.arm is not None:
        driven_parts.append(drives.arm.GetOutputPort("state"))
    if model.has_rolling_wheels:
        driven_parts.append(drives.wheels)
    if drives.disturbances.rising is not None:
        driven_parts.append(drives.disturbances.rising)
    desired = joined(builder, driven_parts, "desired_state")
    connect(builder, desired, bodies.GetInputPort("desired_state"))
    return load_force
