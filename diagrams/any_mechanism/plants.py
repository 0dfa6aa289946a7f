"""Plants behind a mechanism's station: closed loops at rest, and rigid bodies, with the drives."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from pydrake.geometry import (
    CollisionFilterDeclaration,
    GeometrySet,
    Meshcat,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    Frame,
    JointActuator,
    JointIndex,
    PdControllerGains,
)
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import Adder, ConstantVectorSource, MatrixGain, ZeroOrderHold

from parapod.diagrams.any_mechanism.design import GROUND, BuiltMechanism, MechanismDesign
from parapod.diagrams.any_mechanism.ports import PART, PARTS_OF_STATION
from parapod.diagrams.any_mechanism.scenario import MechanismScenario
from parapod.diagrams.disturbances import rising_ground
from parapod.diagrams.drawing import draw_model, publish, remove_visuals
from parapod.diagrams.multibody import (
    add_ground,
    add_plant,
    arrival,
    ground_contact,
    lead_joints,
    mean_force,
    moving,
)
from parapod.diagrams.pads import PADS, add_pads
from parapod.diagrams.ports import Behind
from parapod.diagrams.pushes import push_bodies, pushes_in
from parapod.diagrams.simulated import Plant, Rest, Simulation
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.pi_servo import PiServo
from parapod.systems.actuators.position_servo import PositionServo
from parapod.systems.actuators.velocity_servo import VelocityServoParams
from parapod.systems.core.errors import ScenarioError
from parapod.systems.core.function import FunctionSystem
from parapod.systems.core.vectors import Array
from parapod.systems.mechanism.leaf_systems import MechanismForces, MechanismForward
from parapod.systems.mechanism.mechanism import Mechanism
from parapod.systems.mechanism.model import add_model
from parapod.systems.mechanism.parts import Model, frames_by_name, joints_by_name
from parapod.systems.mechanism.watched import FramePose, LoopGaps
from parapod.systems.physics.description import joints_of
from parapod.urdf import configure_parser

type Simulated = Simulation[MechanismScenario, MechanismScenario]
type Servo = PositionServo | PiServo

# Damping ratio of a motor's drive with what it moves [-].
_DAMPING = 1.0
# Share of the largest inertia below which one is none [-].
_LIGHTEST = 1e-14
# Radius of the balls with which a base touches the ground [m].
_FOOT = 5e-3


def simulation_of(builder: DiagramBuilder, scenario: MechanismScenario) -> Simulated:
    """A mechanism that begins at home, whatever the scenario."""
    return Simulation(builder, lambda scenario: scenario, scenario)


def _add_drives(simulation: Simulated, scenario: MechanismScenario) -> Servo:
    design, period = scenario.machine, scenario.control.period
    drives = design.drives.make(design.built.motors, period, scenario.plant.time_step)
    simulation.add_drives(drives, PART)  # their default context has them at home
    simulation.inputs.pop(f"{PART}.load_force", None)  # which the plant gives
    return drives


def _beside_encoders(
    simulation: Simulated, scenario: MechanismScenario, measured: OutputPort, name: str
) -> OutputPort:
    """Positions of motors whose encoders show something else: their zeros are wrong.

    Args:
        simulation: takes what puts the errors.
        scenario: its errors are built in.
        measured: positions (n) that drives lead to, or positions and rates (2n) [m, rad].
        name: name of what is added.
    """
    size = measured.size()

    def errors(scenario: MechanismScenario) -> Array:
        zeros = scenario.zero_errors
        return np.concatenate((zeros, np.zeros(size - len(zeros))))

    builder = simulation.builder
    source = add(builder, ConstantVectorSource(errors(scenario)), f"{name}_errors")
    true = add(builder, Adder(2, size), name)
    connect(builder, measured, true.get_input_port(0))
    connect(builder, source.get_output_port(), true.get_input_port(1))

    def put(root_context: Context, scenario: MechanismScenario) -> None:
        context = source.GetMyMutableContextFromRoot(root_context)
        source.get_mutable_source_value(context).SetFromVector(errors(scenario))

    simulation.on_put(put)
    return true.get_output_port()


def beginning(scenario: MechanismScenario) -> Array:
    """Positions (q) at home by the encoders [m, rad]."""
    built = scenario.machine.built
    home, errors = built.q, scenario.zero_errors
    return built.mechanism.forward(built.motors.home + errors, home) if errors.any() else home


def mirror(mock: Simulated, scenario: MechanismScenario) -> Rest:
    """Motors are at their commands a period later."""
    motors, period = scenario.machine.built.motors, scenario.control.period
    params = VelocityServoParams(
        resolution=0.0,
        time_constant=1e-9,
        max_velocity=max(motors.velocities),
        stop_min=motors.lower,
        stop_max=motors.upper,
    )
    drives = PositionServo(params, len(motors.names), period, position=motors.home)
    mock.add_drives(drives, PART)
    return {}


def _connect_load(drives: Servo, builder: DiagramBuilder, force: OutputPort) -> None:
    """Has actuators feel what they move; position servos do not give way."""
    if isinstance(drives, PiServo):
        connect(builder, force, drives.GetInputPort("load_force"))


# --- at rest at every instant


def add_kinematics(
    builder: DiagramBuilder, scenario: MechanismScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds drives, and the mechanism as their positions have it, at rest."""
    simulation, built = simulation_of(builder, scenario), scenario.machine.built
    drives = _add_drives(simulation, scenario)
    mechanism, period = built.mechanism, scenario.control.period
    pose = MechanismForward(mechanism, built.frame, period, beginning(scenario))
    forward = add(builder, pose, "plant_forward")
    forces = add(builder, MechanismForces(mechanism, built.frame), "plant_forces")
    gaps = add(builder, LoopGaps(mechanism))
    held = add(builder, ZeroOrderHold(period, len(mechanism.motors)), "holding_force")
    base = add(builder, ConstantVectorSource(np.zeros(6)), "base_pose")
    positions = forward.GetOutputPort("positions")
    places = _beside_encoders(simulation, scenario, drives.GetOutputPort("position"), "motors_at")
    for source, sink in (
        (places, forward.GetInputPort("position")),
        (positions, forces.GetInputPort("positions")),
        (positions, gaps.GetInputPort("positions")),
        (forces.GetOutputPort("force"), held.get_input_port()),
    ):
        connect(builder, source, sink)
    _connect_load(drives, builder, held.get_output_port())

    def put(root_context: Context, scenario: MechanismScenario) -> None:
        forward.begin(forward.GetMyMutableContextFromRoot(root_context), beginning(scenario))

    signals = {
        "pose": forward.GetOutputPort("pose"),
        "base": base.get_output_port(),
        "motor_force": held.get_output_port(),
        "loop_error": gaps.get_output_port(),
    }
    simulation.add_plant(Plant(signals, put))
    simulation.add_current(PART, held.get_output_port(), scenario.machine.force_per_current_N_A)
    if meshcat is not None:
        add_drawing(builder, scenario.machine, positions, meshcat)
    return simulation.behind(PARTS_OF_STATION)


# --- rigid bodies


def add_bodies(
    builder: DiagramBuilder, scenario: MechanismScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds drives, and the mechanism as rigid bodies whose loops constraints close."""
    simulation, design = simulation_of(builder, scenario), scenario.machine
    built, settings = design.built, scenario.plant
    plant, scene_graph = add_plant(builder, settings.time_step, "lagged", settings.accuracy)
    feet = len(design.feet_mm)
    rising = rising_ground(builder, scenario.disturbances, feet)
    model, base = _add_model(plant, scene_graph, design, rising is not None)
    actuators = _give_gains(plant, model, design)
    _damp_idle(plant, built, design.idle_decay_Hz)
    plant.Finalize()
    _check_masses(plant)
    if rising is not None:
        lead_joints(builder, plant, plant.GetModelInstanceByName(PADS), rising)
    to_mechanism = _positions_of(plant, built.mechanism)
    usual = plant.GetDefaultPositions()
    select = to_mechanism[:, : len(usual)]

    def begin_at(scenario: MechanismScenario) -> Array:
        return np.where(select.any(axis=0), select.T @ beginning(scenario), usual)

    plant.SetDefaultPositions(begin_at(scenario))
    drives = _add_drives(simulation, scenario)
    force = _drive(simulation, scenario, plant, actuators, drives)
    _connect_load(drives, builder, force)
    frame = frames_by_name(plant)[built.frame]
    pushed = pushes_in(builder, plant, scenario.disturbances, frame.body())
    weigh = push_bodies(builder, plant, scene_graph, pushed, meshcat)
    positions = add(builder, MatrixGain(to_mechanism), "positions")
    connect(builder, plant.get_state_output_port(), positions.get_input_port())
    gaps = add(builder, LoopGaps(built.mechanism))
    connect(builder, positions.get_output_port(), gaps.get_input_port())
    signals = {"motor_force": force, "loop_error": gaps.get_output_port()}
    for name, of in (("pose", frame), ("base", base)):
        pose = add(builder, FramePose(of, f"{name}_of_bodies"))
        connect(builder, plant.get_body_poses_output_port(), pose.get_input_port())
        signals[name] = pose.get_output_port()
    if meshcat is None:
        remove_visuals(plant, scene_graph)
    else:
        publish(builder, scene_graph, meshcat, "mechanism")

    def put(root_context: Context, scenario: MechanismScenario) -> None:
        context = plant.GetMyMutableContextFromRoot(root_context)
        plant.SetPositions(context, begin_at(scenario))
        plant.SetVelocities(context, np.zeros(plant.num_velocities()))

    simulation.add_plant(Plant(signals, put, weigh, model))
    simulation.add_current(PART, force, design.force_per_current_N_A)
    return simulation.behind(PARTS_OF_STATION)


def _add_model(
    plant: MultibodyPlant, scene_graph: SceneGraph, design: MechanismDesign, ground_gives: bool
) -> tuple[Model, Frame]:
    """Adds the mechanism, and the ground where it stands on it; returns the base's frame."""
    is_standing = design.base == GROUND
    motors = tuple(design.motors)
    least = design.least_mass_kg
    model = add_model(plant, design.path, design.loops_path, motors, is_standing, least_mass=least)
    bodies = [plant.get_body(BodyIndex(i)) for i in range(1, plant.num_bodies())]
    # Links touch nothing: those that loops join would touch each other there.
    shapes = [shape for body in bodies for shape in plant.GetCollisionGeometriesForBody(body)]
    within = CollisionFilterDeclaration().ExcludeWithin(GeometrySet(shapes))
    scene_graph.collision_filter_manager().Apply(within)
    if not is_standing:
        return model, plant.world_frame()
    hung = {int(joint.child_body().index()) for joint in joints_of(plant)}
    base, *others = [body for body in bodies if int(body.index()) not in hung]
    if others:
        names, key = ", ".join(body.name() for body in (base, *others)), "machine.base"
        raise ScenarioError(f"{key} = {GROUND} needs one base, not {names}", key)
    feet = 1e-3 * np.array(design.feet_mm)
    balls = []
    for i, foot in enumerate(feet):
        place = RigidTransform(foot + np.array((0.0, 0.0, _FOOT)))
        name, material = f"foot_{i + 1}", ground_contact()
        ball = plant.RegisterCollisionGeometry(base, place, Sphere(_FOOT), name, material)
        balls.append([ball])
    parser = Parser(plant)
    configure_parser(parser)
    instance = add_ground(parser)
    at = plant.GetDefaultFloatingBaseBodyPose(base).translation()
    height = RigidTransform(np.array((0.0, 0.0, at[2] + feet[:, 2].min())))
    ground = plant.GetFrameByName("ground", instance)
    plant.WeldFrames(plant.world_frame(), ground, height)
    if ground_gives:
        add_pads(plant, scene_graph, ground.body(), balls)
    return model, base.body_frame()


def _damp_idle(plant: MultibodyPlant, built: BuiltMechanism, rate: float) -> None:
    """Damps joints that no motor governs, such as the spin of a rod between two ball joints."""
    of, joints = built.mechanism, joints_by_name(plant)
    context = of.plant.CreateDefaultContext()
    of.plant.SetPositions(context, built.q)
    masses = np.diag(of.plant.CalcMassMatrix(context))
    for index in of.mobility.idle:
        joint = of.plant.get_joint(index)
        first, count = joint.velocity_start(), joint.num_velocities()
        damping = 2.0 * math.pi * rate * masses[first : first + count]
        own = joints[of.name(joint)]
        own.set_default_damping_vector(own.default_damping_vector() + damping.max())


def _check_masses(plant: MultibodyPlant) -> None:
    """Refuses links without inertia, which nothing could simulate.

    Raises:
        ScenarioError: names them.
    """
    context = plant.CreateDefaultContext()
    values, vectors = np.linalg.eigh(plant.CalcMassMatrix(context))
    if values[0] > _LIGHTEST * values[-1]:
        return
    light = np.abs(vectors[:, values <= _LIGHTEST * values[-1]]).max(axis=1) > 0.5
    names = [
        joint.child_body().name()
        for joint in joints_of(plant)
        if light[joint.velocity_start() : joint.velocity_start() + joint.num_velocities()].any()
    ]
    raise ScenarioError(
        f"machine.file: {', '.join(names) or 'some links'} have no inertia, which rigid bodies "
        "need; the backend must be kinematic",
        "machine.file",
    )


def _give_gains(
    plant: MultibodyPlant, model: Model, design: MechanismDesign
) -> list[JointActuator]:
    """Gives the motors implicit drives; returns their actuators, in the motors' order."""
    by_joint = {
        int(actuator.joint().index()): actuator
        for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices())
    }
    motors = model.motors or list(map(JointIndex, by_joint))
    actuators = []
    for index, force in zip(motors, design.built.motors.forces, strict=True):
        plant.RemoveJointActuator(by_joint[int(index)])  # whose limit is the file's
        joint = plant.get_joint(index)
        actuators.append(plant.AddJointActuator(f"{joint.name()}_motor", joint, force))
    damping = 2.0 * _DAMPING / (2.0 * math.pi * design.natural_frequency_Hz)
    for actuator, stiffness in zip(actuators, design.stiffnesses.tolist(), strict=True):
        gains = PdControllerGains(p=stiffness, d=damping * stiffness)
        actuator.set_controller_gains(gains)
    return actuators


def _positions_of(plant: MultibodyPlant, mechanism: Mechanism) -> Array:
    """Positions of a mechanism (q) by the state of a plant that holds it."""
    joints = joints_by_name(plant)
    select = np.zeros((mechanism.plant.num_positions(), plant.num_multibody_states()))
    for joint in mechanism.joints:
        first, other = joint.position_start(), joints[mechanism.name(joint)].position_start()
        for i in range(joint.num_positions()):
            select[first + i, other + i] = 1.0
    return select


def _drive(
    simulation: Simulated,
    scenario: MechanismScenario,
    plant: MultibodyPlant,
    actuators: Sequence[JointActuator],
    drives: Servo,
) -> OutputPort:
    """Has the motors follow their drives; returns their forces, sampled, in the motors' order."""
    builder, settings = simulation.builder, scenario.plant
    ends, n = arrival(drives, settings.accuracy), len(actuators)
    ends = _beside_encoders(simulation, scenario, ends, "motors_led")
    step = min(settings.time_step, scenario.control.period)
    reference = moving(builder, plant, ends, step)
    instances = sorted({actuator.model_instance() for actuator in actuators}, key=int)
    ordered = [
        next(i for i, each in enumerate(actuators) if each.index() == index)
        for instance in instances
        for index in plant.GetJointActuatorIndices(instance)
    ]
    begin = 0
    for instance in instances:
        count = plant.num_actuators(instance)
        mine = ordered[begin : begin + count]
        rows = np.eye(2 * n)[[*mine, *(n + i for i in mine)]]
        part = add(builder, MatrixGain(rows), f"led_{plant.GetModelInstanceName(instance)}")
        connect(builder, reference.now, part.get_input_port())
        lead_joints(builder, plant, instance, part.get_output_port())
        begin += count
    if settings.accuracy is None:
        force = plant.get_net_actuation_output_port()
        places = [int(actuator.input_start()) for actuator in actuators]
    else:
        whole = add(builder, MatrixGain(np.eye(2 * n)[[*ordered, *(n + i for i in ordered)]]))
        connect(builder, reference.during, whole.get_input_port())
        force = mean_force(builder, plant, instances, whole.get_output_port(), step)
        places = [ordered.index(i) for i in range(n)]
    select = add(builder, MatrixGain(np.eye(force.size())[places]), "motor_forces")
    held = add(builder, ZeroOrderHold(step, n), "motor_force")
    connect(builder, force, select.get_input_port())
    connect(builder, select.get_output_port(), held.get_input_port())
    return held.get_output_port()


# --- drawing


def add_drawing(
    builder: DiagramBuilder,
    design: MechanismDesign,
    positions: OutputPort,
    meshcat: Meshcat | None,
    path: str = "mechanism",
) -> None:
    """Draws the mechanism where it is.

    Args:
        builder: builder of the diagram that holds the port's system.
        design: the mechanism.
        positions: positions of all joints of its plant (q).
        meshcat: the scene; None: poses are all that is asked for.
        path: its path in the scene.
    """

    def add_drawn(plant: MultibodyPlant) -> System:
        motors = tuple(design.motors)
        model = add_model(plant, design.path, design.loops_path, motors)
        plant.Finalize()
        count = plant.num_positions()
        # Its meshes are there as long as it is.
        law = partial(_as_it_is, model)
        return FunctionSystem({"positions": count}, {"positions_shown": (count, law)})

    scene_graph, _ = draw_model(builder, path, add_drawn, {"positions": positions})
    publish(builder, scene_graph, meshcat, path)


def _as_it_is(model: Model, positions: Array) -> Array:
    return positions
