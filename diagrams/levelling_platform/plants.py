"""Plants behind the levelling platform's station: rigid bodies and statics, with the drives.

Rigid bodies of another engine are in `parapod.diagrams.levelling_platform.mujoco`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    DiscreteTimeDelay,
    MatrixGain,
    Multiplexer,
    ZeroOrderHold,
)

from parapod.diagrams.drawing import remove_visuals
from parapod.diagrams.levelling_platform.beginning import Beginning
from parapod.diagrams.levelling_platform.disturbances import Disturbances, add_disturbances
from parapod.diagrams.levelling_platform.model import (
    add_drawing,
    add_platform,
    add_visualization,
    put_feet_on_pads,
)
from parapod.diagrams.levelling_platform.ports import PARTS
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.levelling_platform.tip import (
    ArmMotion,
    add_external_load,
    add_tip,
    applied_force,
    draw_bending,
    motion_in,
    without_rod,
)
from parapod.diagrams.multibody import add_plant, lead_joints, mean_force, moving
from parapod.diagrams.ports import Behind
from parapod.diagrams.pushes import PushArrows, push_bodies, pushes_in
from parapod.diagrams.simulated import Plant, Rest, Simulation
from parapod.diagrams.wiring import add, connect, first_of, split_states, sum_of
from parapod.systems.actuators.linear_actuator import LinearActuator, LinearActuatorParams
from parapod.systems.actuators.position_drive import PositionDrive, PositionDriveParams
from parapod.systems.actuators.velocity_servo import VelocityServo
from parapod.systems.arm.external_load import ExternalLoad
from parapod.systems.arm.flexible_arm import FlexibleArm
from parapod.systems.arm.yielding_drives import YieldingDrives
from parapod.systems.levelling_platform.geometry import LEG_COUNT
from parapod.systems.levelling_platform.inclined_ground import OnInclinedGround
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.model import (
    WHEEL_COUNT,
    FootTruth,
    LegTransmission,
    PlatformModel,
    PlatformTruth,
)
from parapod.systems.sensors.encoder import Encoder
from parapod.systems.sensors.hold import Hold
from parapod.systems.sensors.imu import (
    ImuParams,
    add_imu,
    sample_period,
)
from parapod.systems.sensors.inertial_motion import InertialMotion
from parapod.systems.sensors.limit_switches import LimitSwitches
from parapod.systems.sensors.step_mean import StepMean


@dataclass(frozen=True)
class Drives:
    """Drives and disturbances that all backends share.

    Attributes:
        rods: outputs `extension`, `velocity`, `next_state` of the linear actuators.
        wheels: angles and velocities (8) that the wheels are held to.
        arm: drives of the arm's joints; None: there is no arm.
        disturbances: pushes, payload and moving ground.
    """

    rods: LeafSystem
    wheels: OutputPort
    arm: PositionDrive | None
    disturbances: Disturbances


@dataclass(frozen=True, kw_only=True)
class PlatformPlant(Plant[Beginning]):
    """A plant on which an arm and what disturbs it act.

    Attributes:
        motion: gives the motion of platform and arm.
        load: has systems of `bending_force` or `applied_force` and `wrench` act on it.
        bend: has a rod that is drawn bend.
        pressing: forces (4) that close the feet's switches; None: the signal contact_force.
    """

    motion: Callable[[], ArmMotion]
    load: Callable[[Sequence[FlexibleArm | ExternalLoad]], None]
    bend: Callable[[FlexibleArm], None] = lambda rod: None
    pressing: OutputPort | None = None


type PlantMaker = Callable[
    [DiagramBuilder, LevellingScenario, Beginning, Drives, Meshcat | None], PlatformPlant
]
# Length of the arrow of the largest push by the machine's size [m].
_ARROW = 0.7
# Signals that are for sensors alone.
_HIDDEN = ("attitude", "angular_velocity", "specific_force")


def add_multibody_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    beginning: Beginning,
    drives: Drives,
    meshcat: Meshcat | None,
) -> PlatformPlant:
    """Adds the plant of rigid bodies with closed loops and contact."""
    settings = scenario.plant
    plant, scene_graph = add_plant(
        builder, settings.time_step, settings.contact_approximation, settings.accuracy
    )
    model = add_platform(
        plant,
        scenario.plant.leg_model,
        scenario.plant.wheels,
        beginning.ground,
        scenario.geometry_as_built,
        beginning.foot_offsets,
        scenario.machine.structure,
        drives.disturbances.rising is not None,
    )
    plant.SetDefaultPositions(beginning.positions(model))
    rising = drives.disturbances.rising
    if rising is not None:
        put_feet_on_pads(model, scene_graph)
        lead_joints(builder, plant, model.pads, rising)
    if drives.arm is not None:
        lead_joints(builder, plant, model.arm, drives.arm.GetOutputPort("state"))
    if model.has_rolling_wheels:
        _drive_wheels(builder, model, drives)
    load_force = _drive_legs(builder, model, drives, scenario.plant.time_step)
    base = model.base
    pushed = pushes_in(builder, plant, scenario.disturbances, base, usual_is_pushed=False)
    weigh = push_bodies(builder, plant, scene_graph, pushed, meshcat)
    state, poses = plant.get_state_output_port(), plant.get_body_poses_output_port()
    place = scenario.machine.sensors.imu_place
    signals, observers = observe(builder, model, beginning, state, poses, place, rising)
    feet = observers[1]
    connect(builder, plant.get_contact_results_output_port(), feet.GetInputPort("contact_results"))
    pressing = contact_force = feet.GetOutputPort("contact_force")
    if settings.accuracy is not None:
        contact_force = _mean_over_steps(builder, pressing, scenario.control.period)
    signals |= {"load_force": load_force, "contact_force": contact_force}
    if meshcat is not None and model.is_full:
        add_visualization(builder, model, state, scene_graph, meshcat)
    else:
        remove_visuals(plant, scene_graph)
    drawing = model, scene_graph
    if meshcat is not None and not model.is_full:
        drawing = draw_as_full(builder, scenario, model, drives, state, meshcat)

    def put(root_context: Context, beginning: Beginning) -> None:
        context = plant.GetMyMutableContextFromRoot(root_context)
        model.put(context, beginning.positions(model), beginning.ground, beginning.foot_offsets)
        put_on_ground(observers, root_context, beginning)

    def load(loads: Sequence[FlexibleArm | ExternalLoad]) -> None:
        applied = applied_force(builder, model, loads)
        connect(builder, applied, plant.get_applied_generalized_force_input_port())

    def bend(rod: FlexibleArm) -> None:
        if meshcat is not None:
            draw_bending(builder, *drawing, rod)

    motion = partial(motion_in, builder, model, state)
    return PlatformPlant(
        signals, put, weigh, model, motion=motion, load=load, bend=bend, pressing=pressing
    )


def _mean_over_steps(builder: DiagramBuilder, force: OutputPort, period: float) -> OutputPort:
    """Mean of the contact forces (4) since the last sample, for a continuous plant.

    Its loops are springs whose stiffness goes with the inverse square of the step. Wherever
    something that is sampled off the drives' steps, as the inertial sensor is, cuts one of the
    integrator's, they give way by a fraction of a micrometre, and feet of 2.5e7 N/m ring for
    some milliseconds by ten newtons, which means nothing.
    """
    mean = add(builder, StepMean(force.size(), period), "mean_contact_force")
    connect(builder, force, mean.GetInputPort("signal"))
    return mean.GetOutputPort("mean")


def put_on_ground(
    systems: Sequence[OnInclinedGround], root_context: Context, beginning: Beginning
) -> None:
    """Tells systems how the ground of a beginning is inclined."""
    for system in systems:
        context = system.GetMyMutableContextFromRoot(root_context)
        system.set_ground(context, beginning.ground, beginning.foot_offsets)


def observe(
    builder: DiagramBuilder,
    model: PlatformModel,
    beginning: Beginning,
    state: OutputPort,
    body_poses: OutputPort,
    imu_place: Sequence[float],
    rising: OutputPort | None,
) -> tuple[dict[str, OutputPort], tuple[PlatformTruth, FootTruth]]:
    """Adds what tells about simulated bodies: signals of a `Plant` but forces, and observers.

    Args:
        builder: builder of the station.
        model: the platform.
        beginning: the beginning.
        state: state of the model's plant.
        body_poses: poses of its bodies in the world.
        imu_place: place of the inertial sensor, from the platform's centre F [m].
        rising: rise of the ground under each foot, and its rate (8); None: it does not move.
    """
    truth = add(builder, PlatformTruth(model, beginning.ground, beginning.foot_offsets))
    connect(builder, state, truth.GetInputPort("state"))
    feet = add(builder, FootTruth(model, beginning.ground, beginning.foot_offsets))
    connect(builder, body_poses, feet.GetInputPort("body_poses"))
    if rising is not None:
        connect(builder, rising, feet.GetInputPort("rising"))
    inertial = _add_inertial_motion(builder, model, state, imu_place)
    attitude, angular_velocity, specific_force = inertial
    signals = {
        "posture": truth.GetOutputPort("posture"),
        "attitude": attitude,
        "angular_velocity": angular_velocity,
        "specific_force": specific_force,
        "foot_height": feet.GetOutputPort("foot_height"),
        "loop_error": feet.GetOutputPort("loop_error"),
    }
    return signals, (truth, feet)


def draw_as_full(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    model: PlatformModel,
    drives: Drives,
    state: OutputPort,
    meshcat: Meshcat,
) -> tuple[PlatformModel, SceneGraph]:
    """Draws reduced legs as what they stand for.

    Args:
        builder: builder of the station.
        scenario: its ground is drawn.
        model: the platform.
        drives: its drives.
        state: state of the model's plant.
        meshcat: scene in which to draw.

    Returns:
        The model that is drawn, and its scene graph.
    """
    plant = model.plant
    start = model.base.floating_positions_start()
    starts = [joint.position_start() for joint in model.arm_joints]
    parts: dict[str, OutputPort] = {}
    for name, indices in (("base_pose", range(start, start + 7)), ("arm_position", starts)):
        if not indices:
            continue
        selection = np.eye(plant.num_multibody_states())[list(indices)]
        part = add(builder, MatrixGain(selection), f"drawn_{name}")
        connect(builder, state, part.get_input_port())
        parts[name] = part.get_output_port()
    rods = drives.rods.GetOutputPort("extension")
    return add_drawing(
        builder,
        scenario.ground.inclination,
        meshcat,
        rods,
        parts["base_pose"],
        parts.get("arm_position"),
        geometry=scenario.machine.geometry,
        structure=scenario.machine.structure,
    )


def _drive_wheels(builder: DiagramBuilder, model: PlatformModel, drives: Drives) -> None:
    split = split_states(builder, "wheel_states", drives.wheels, WHEEL_COUNT)
    for port, wheel in zip(split, model.wheels, strict=True):
        lead_joints(builder, model.plant, wheel, port)


def _drive_legs(
    builder: DiagramBuilder, model: PlatformModel, drives: Drives, time_step: float
) -> OutputPort:
    """Connects the rods to the legs' joints; returns the force with which they hold (4).

    That force is the one of the step before, which breaks the loop from the actuators' next
    state through the plant back to their load.
    """
    plant = model.plant
    is_continuous = plant.time_step() == 0.0
    count = LEG_COUNT if is_continuous else plant.num_actuators()
    holding = add(builder, ZeroOrderHold(time_step, count), "holding_effort")
    efforts = first_of(builder, holding.get_output_port(), LEG_COUNT, "efforts")
    ends, load_force = led_legs(builder, model, drives, efforts)
    reference = moving(builder, plant, ends, time_step, [sample_period()])
    force = plant.get_net_actuation_output_port()
    if is_continuous:
        force = mean_force(builder, plant, model.legs, reference.during, time_step)
    connect(builder, force, holding.get_input_port())
    split = split_states(builder, "leg_states", reference.now, LEG_COUNT)
    for port, leg in zip(split, model.legs, strict=True):
        lead_joints(builder, plant, leg, port)
    return load_force


def led_legs(
    builder: DiagramBuilder, model: PlatformModel, drives: Drives, holding: OutputPort
) -> tuple[OutputPort, OutputPort]:
    """States (8) that the legs' joints are led to, and the forces (4) of their rods.

    Args:
        builder: builder of the station.
        model: the platform.
        drives: its drives.
        holding: forces or torques (4) that hold the legs' joints.
    """
    if model.plant.time_step() > 0.0:
        # One step ahead: the plant's implicit drives then arrive where the actuators will be.
        ends = drives.rods.GetOutputPort("next_state")
    else:
        ends = _state_of_rods(builder, drives.rods)
    if model.is_full:
        return ends, holding
    transmission = add(builder, LegTransmission(model.geometry))
    connect(builder, ends, transmission.GetInputPort("rod_state"))
    extension = drives.rods.GetOutputPort("extension")
    connect(builder, extension, transmission.GetInputPort("extension"))
    connect(builder, holding, transmission.GetInputPort("swing_torque"))
    return transmission.GetOutputPort("swing_state"), transmission.GetOutputPort("load_force")


def _state_of_rods(builder: DiagramBuilder, rods: LeafSystem) -> OutputPort:
    """Extensions and velocities (8), to which a continuous plant is led until the next ones."""
    state = add(builder, Multiplexer([LEG_COUNT, LEG_COUNT]), "rod_state")
    for i, name in enumerate(("extension", "velocity")):
        connect(builder, rods.GetOutputPort(name), state.get_input_port(i))
    return state.get_output_port()


def _add_inertial_motion(
    builder: DiagramBuilder, model: PlatformModel, state: OutputPort, place: Sequence[float]
) -> list[OutputPort]:
    """True attitude, angular velocity and specific force at a place on the platform [m]."""
    plant = model.plant
    period = sample_period()
    motion = add(
        builder,
        InertialMotion(
            plant.num_multibody_states(),
            model.base.floating_positions_start(),
            plant.num_positions() + model.base.floating_velocities_start_in_v(),
            period,
            place=place,
        ),
    )
    last = add(builder, ZeroOrderHold(period, plant.num_multibody_states()), "last_state")
    connect(builder, state, last.get_input_port())
    connect(builder, state, motion.GetInputPort("state"))
    connect(builder, last.get_output_port(), motion.GetInputPort("last_state"))
    parts = add(builder, Demultiplexer(9, 3), "inertial_motion_parts")
    connect(builder, motion.get_output_port(), parts.get_input_port(0))
    return [parts.get_output_port(i) for i in range(3)]


def add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    beginning: Beginning,
    drives: Drives,
    meshcat: Meshcat | None,
) -> PlatformPlant:
    """Adds the quasi-static plant, and with `meshcat` a drawing of it."""
    masses, is_flexible = scenario.machine.masses, scenario.machine.arm.bending is not None
    statics = KinematicPlatform(
        scenario.geometry_as_built,
        # All of the weight of a rod that bends is in its wrench.
        replace(masses, arm=without_rod(masses.arm)) if is_flexible else masses,
        scenario.machine.wheel_geometry,
        ground=beginning.ground,
        foot_offsets=beginning.foot_offsets,
    )
    platform = add(builder, statics)
    connect(builder, drives.rods.GetOutputPort("extension"), platform.GetInputPort("extension"))
    connect(builder, drives.rods.GetOutputPort("velocity"), platform.GetInputPort("velocity"))
    if drives.disturbances.rising is not None:
        connect(builder, drives.disturbances.rising, platform.GetInputPort("rising"))
    motion = ArmMotion(platform.GetOutputPort("base_pose"))
    if drives.arm is not None:
        arm = drives.arm.GetOutputPort("position")
        connect(builder, arm, platform.GetInputPort("arm_position"))
        # What drives give way depends on the posture, and the posture by less than a micrometre
        # on that: without it there is no loop.
        behind = add(builder, YieldingDrives(masses.arm))
        connect(builder, platform.GetOutputPort("base_pose"), behind.GetInputPort("base_pose"))
        connect(builder, drives.arm.GetOutputPort("state"), behind.GetInputPort("drive_state"))
        if drives.disturbances.payload is not None:
            connect(builder, drives.disturbances.payload, behind.GetInputPort("payload"))
        motion = replace(motion, joint_state=behind.get_output_port())
    stance = add(builder, Demultiplexer([3, 9, 4, 4, 4]), "stance_parts")
    connect(builder, platform.GetOutputPort("stance"), stance.get_input_port(0))
    names = ("posture", "inertial_motion", "contact_force", "load_force", "foot_height")
    signals = {name: stance.get_output_port(i) for i, name in enumerate(names)}
    inertial = signals.pop("inertial_motion")
    # The inertial sensor samples at instants of its own; held, the platform's statics are solved
    # once a period and not again for every sample.
    hold = add(builder, Hold(scenario.control.period, beginning.inertial_motion), "held_motion")
    parts = add(builder, Demultiplexer(9, 3), "inertial_motion_parts")
    for i, name in enumerate(("attitude", "angular_velocity", "specific_force")):
        signals[name] = parts.get_output_port(i)
    connect(builder, inertial, hold.get_input_port())
    connect(builder, hold.get_output_port(), parts.get_input_port(0))
    no_loops = add(builder, ConstantVectorSource(np.zeros(LEG_COUNT)), "no_loops")
    signals["loop_error"] = no_loops.get_output_port()

    def put(root_context: Context, beginning: Beginning) -> None:
        hold.set_value(hold.GetMyMutableContextFromRoot(root_context), beginning.inertial_motion)
        put_on_ground((platform,), root_context, beginning)

    drawing = None
    if meshcat is not None:
        drawing = add_drawing(
            builder,
            scenario.ground.inclination,
            meshcat,
            drives.rods.GetOutputPort("extension"),
            platform.GetOutputPort("base_pose"),
            drives.arm.GetOutputPort("position") if drives.arm is not None else None,
            geometry=scenario.machine.geometry,
            structure=scenario.machine.structure,
        )

    def load(loads: Sequence[FlexibleArm | ExternalLoad]) -> None:
        wrenches = [each.GetOutputPort("wrench") for each in loads]
        connect(builder, sum_of(builder, wrenches, "load"), platform.GetInputPort("load"))

    def bend(rod: FlexibleArm) -> None:
        if drawing is not None:
            draw_bending(builder, *drawing, rod)

    return PlatformPlant(signals, put, motion=lambda: motion, load=load, bend=bend)


def add_simulated(
    add_plant: PlantMaker,
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    meshcat: Meshcat | None,
) -> Behind:
    """Adds drives, a plant and sensors.

    Args:
        add_plant: adds the plant.
        builder: builder of the station.
        scenario: the scenario to build.
        meshcat: draws the machine there; None for no drawing.
    """
    period, geometry = scenario.control.period, scenario.geometry_as_built
    begin = partial(Beginning.from_scenario, geometry)
    simulation = Simulation(builder, begin, scenario)
    beginning = simulation.beginning
    step = period if scenario.backend == "kinematic" else scenario.plant.time_step
    actuators = _add_actuators(simulation, scenario.machine.actuators.params, step)
    drive = scenario.machine.wheels.drive
    wheels = simulation.add_drives(VelocityServo(drive, WHEEL_COUNT, period), "wheels")
    arm = _add_arm(simulation, scenario.machine.arm_drives, period)
    has_bodies = scenario.backend != "kinematic"
    disturbances = add_disturbances(builder, scenario.disturbances, has_bodies)
    drives = Drives(actuators, wheels.GetOutputPort("state"), arm, disturbances)
    plant = add_plant(builder, scenario, beginning, drives, meshcat)
    simulation.add_plant(plant, _HIDDEN)
    is_pushed = disturbances.pushes is not None or disturbances.payload is not None
    if arm is not None or is_pushed:
        _add_loads(simulation, scenario, plant, disturbances, step, meshcat)
    connect(builder, plant.signals["load_force"], actuators.GetInputPort("load_force"))
    simulation.outputs["truth.extension"] = actuators.GetOutputPort("extension")
    pressing = plant.pressing or plant.signals["contact_force"]
    _add_leg_sensors(simulation, scenario, actuators, pressing)
    imu_period, late = _add_imu(simulation, scenario, plant.signals)
    return simulation.behind(PARTS, (0.0, imu_period, period, 0.0), (0.0, late, 0.0, 0.0))


def _add_loads(
    simulation: Simulation[LevellingScenario, Beginning],
    scenario: LevellingScenario,
    plant: PlatformPlant,
    disturbances: Disturbances,
    step: float,
    meshcat: Meshcat | None,
) -> None:
    """Adds truth about the arm's tip, a rod that bends, and what pushes, with its arrows."""
    motion = plant.motion()
    loads: list[FlexibleArm | ExternalLoad] = []
    if motion.joint_state is not None:
        rod = add_tip(simulation, scenario, motion, step, disturbances)
        if rod is not None:
            loads.append(rod)
            plant.bend(rod)
    external = add_external_load(simulation.builder, scenario, motion, disturbances, step)
    if external is not None:
        loads.append(external)
    if loads:
        plant.load(loads)
    if meshcat is not None and disturbances.pushes is not None and disturbances.largest > 0.0:
        scale = _ARROW * scenario.machine.size / disturbances.largest
        arrows = add(simulation.builder, PushArrows(meshcat, disturbances.places, scale))
        connect(simulation.builder, disturbances.pushes, arrows.GetInputPort("pushes"))
        connect(simulation.builder, motion.platform_pose, arrows.GetInputPort("base_pose"))


def _add_actuators(
    simulation: Simulation[LevellingScenario, Beginning], params: LinearActuatorParams, step: float
) -> LinearActuator:
    """Adds the four linear actuators."""
    beginning = simulation.beginning
    rods = LinearActuator(
        params, time_step=step, extension=beginning.extension, gain_scale=beginning.gain_scale
    )
    actuators = add(simulation.builder, rods)
    for name in ("voltage", "stop"):
        simulation.inputs[f"legs.{name}"] = actuators.GetInputPort(name)

    def put(root_context: Context, beginning: Beginning) -> None:
        context = actuators.GetMyMutableContextFromRoot(root_context)
        actuators.set_extension(context, beginning.extension)
        actuators.set_gain_scale(context, beginning.gain_scale)

    simulation.on_put(put)
    return actuators


def _add_arm[B](
    simulation: Simulation[LevellingScenario, B],
    drives: Sequence[PositionDriveParams],
    period: float,
) -> PositionDrive | None:
    """Adds the drives of the arm's joints, if there is an arm."""
    return simulation.add_drives(PositionDrive(drives, period), "arm") if drives else None


def _add_leg_sensors(
    simulation: Simulation[LevellingScenario, Beginning],
    scenario: LevellingScenario,
    actuators: LinearActuator,
    contact_force: OutputPort,
) -> None:
    """Encoders and limit switches."""
    builder = simulation.builder
    resolution = 1e-3 * scenario.machine.sensors.encoder_resolution_mm
    encoder = add(builder, Encoder(resolution=resolution, gate_time=scenario.control.period))
    connect(builder, actuators.GetOutputPort("extension"), encoder.GetInputPort("position"))
    connect(builder, actuators.GetOutputPort("velocity"), encoder.GetInputPort("velocity"))
    simulation.outputs["legs.extension"] = encoder.GetOutputPort("position_measured")
    simulation.outputs["legs.velocity"] = encoder.GetOutputPort("velocity_measured")
    _add_switches(simulation, scenario, actuators, contact_force)


def _add_switches[B](
    simulation: Simulation[LevellingScenario, B],
    scenario: LevellingScenario,
    actuators: LinearActuator,
    contact_force: OutputPort,
) -> None:
    builder, params = simulation.builder, scenario.machine.actuators.switches
    switches = add(builder, LimitSwitches(params=params))
    connect(builder, actuators.GetOutputPort("extension"), switches.GetInputPort("extension"))
    connect(builder, contact_force, switches.GetInputPort("contact_force"))
    simulation.outputs["legs.limits"] = switches.GetOutputPort("limits")


def _add_imu(
    simulation: Simulation[LevellingScenario, Beginning],
    scenario: LevellingScenario,
    signals: Mapping[str, OutputPort],
) -> tuple[float, float]:
    """Adds the inertial sensor; returns its period, and the further age of its data [s]."""
    builder, beginning = simulation.builder, simulation.beginning
    sensors = scenario.machine.sensors
    inertial = replace(
        ImuParams() if sensors.imu_noise else ImuParams.ideal(),
        gyro_turn_on_bias=beginning.gyro_bias,
        accel_turn_on_bias=beginning.accel_bias,
    )
    imu, noise = add_imu(builder, inertial, seed=beginning.noise_seed)
    for name in _HIDDEN:
        connect(builder, signals[name], imu.GetInputPort(name))
    late = round(1e-3 * sensors.imu_delay_ms / imu.period)
    for name in ("gyro", "accel", "mag"):
        sample = imu.GetOutputPort(name)
        if late:
            # It takes what was shown before the sample of the same instant: one more period.
            delay = add(builder, DiscreteTimeDelay(imu.period, late - 1, 3), f"delayed_{name}")
            connect(builder, sample, delay.get_input_port())
            sample = delay.get_output_port()
        simulation.outputs[f"imu.{name}"] = sample

    def put(root_context: Context, beginning: Beginning) -> None:
        context = imu.GetMyMutableContextFromRoot(root_context)
        imu.set_turn_on_bias(context, beginning.gyro_bias, beginning.accel_bias)
        noise.set_seed(noise.GetMyMutableContextFromRoot(root_context), beginning.noise_seed)

    simulation.on_put(put)
    return imu.period, late * imu.period


def mirror(
    mock: Simulation[LevellingScenario, LevellingScenario], scenario: LevellingScenario
) -> Rest:
    """Legs extend at K times their voltage, and the platform stands level as they say.

    Wheels turn as commanded; every sensor shows the exact value.
    """
    builder, period, machine = mock.builder, scenario.control.period, scenario.machine
    params = replace(machine.actuators.params, model="integrator", coulomb_friction=0.0)
    start = scenario.initial_extensions
    actuators = add(builder, LinearActuator(params, time_step=period, extension=start))
    for name in ("voltage", "stop"):
        mock.inputs[f"legs.{name}"] = actuators.GetInputPort(name)

    def put(root_context: Context, scenario: LevellingScenario) -> None:
        context = actuators.GetMyMutableContextFromRoot(root_context)
        actuators.set_extension(context, scenario.initial_extensions)

    mock.on_put(put)
    # Without lag and counts; as fast as the real ones.
    mock.add_drives(VelocityServo(machine.wheels.drive.exact(), WHEEL_COUNT, period), "wheels")
    _add_arm(mock, [PositionDriveParams()] * machine.masses.arm.count, period)
    platform = add(builder, KinematicPlatform(machine.geometry, machine.masses))
    for name in ("extension", "velocity"):
        mock.outputs[f"legs.{name}"] = actuators.GetOutputPort(name)
        connect(builder, actuators.GetOutputPort(name), platform.GetInputPort(name))
    _add_switches(mock, scenario, actuators, platform.GetOutputPort("contact_force"))
    for name, signal in (("gyro", "angular_velocity"), ("accel", "specific_force")):
        mock.outputs[f"imu.{name}"] = platform.GetOutputPort(signal)
    return {"imu.mag": ImuParams().magnetic_field}
