"""Plants behind the levelling platform's station: rigid bodies, statics, mock.

Rigid bodies of another engine are in `parapod.diagrams.levelling_platform.mujoco`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, DiagramBuilder, InputPort, LeafSystem, OutputPort
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    DiscreteTimeDelay,
    MatrixGain,
    Multiplexer,
    PassThrough,
    StateInterpolatorWithDiscreteDerivative,
    ZeroOrderHold,
)

from parapod.diagrams.drawing import remove_visuals
from parapod.diagrams.levelling_platform.beginning import Beginning
from parapod.diagrams.levelling_platform.model import (
    add_drawing,
    add_platform,
    add_visualization,
)
from parapod.diagrams.levelling_platform.ports import PARTS
from parapod.diagrams.levelling_platform.scenario import LevellingScenario
from parapod.diagrams.multibody import add_discrete_plant
from parapod.diagrams.ports import Behind
from parapod.diagrams.wiring import add, connect, split_states
from parapod.systems.actuators.linear_actuator import LinearActuator
from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams
from parapod.systems.levelling_platform.geometry import LEG_COUNT, PlatformGeometry
from parapod.systems.levelling_platform.inclined_ground import OnInclinedGround
from parapod.systems.levelling_platform.kinematic_platform import KinematicPlatform
from parapod.systems.levelling_platform.model import (
    WHEEL_COUNT,
    FootTruth,
    LegTransmission,
    PlatformModel,
    PlatformTruth,
)
from parapod.systems.sensors.device_status import DeviceStatus
from parapod.systems.sensors.encoder import Encoder
from parapod.systems.sensors.hold import Hold
from parapod.systems.sensors.imu import (
    Imu,
    ImuParams,
    add_imu,
    sample_period,
)
from parapod.systems.sensors.inertial_motion import InertialMotion
from parapod.systems.sensors.limit_switches import LimitSwitches
from parapod.systems.sensors.noise import NoiseSource


@dataclass(frozen=True)
class Drives:
    """Drives that all backends share.

    Attributes:
        rods: outputs `extension`, `velocity`, `next_state` of the linear actuators.
        wheels: angles and velocities (8) that the wheels are held to.
        arm: angles and velocities (4) of turntable and arm.
        arm_angles: angles (2) of turntable and arm.
    """

    rods: LeafSystem
    wheels: OutputPort
    arm: OutputPort
    arm_angles: OutputPort


@dataclass(frozen=True)
class Plant:
    """Signals of a plant for the sensors and the truth.

    Attributes:
        signals: ports by name: posture, attitude, angular_velocity, specific_force,
            contact_force, foot_height, load_force, loop_error.
        on_ground: systems that know how the ground is inclined.
        put: puts what moves at a beginning, in a root context.
        model: bodies and joints of a `MultibodyPlant`; None where none is simulated.
    """

    signals: dict[str, OutputPort]
    on_ground: tuple[OnInclinedGround, ...]
    put: Callable[[Context, Beginning], None]
    model: PlatformModel | None = None


def _add_multibody_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    beginning: Beginning,
    drives: Drives,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the plant of rigid bodies with closed loops and contact."""
    plant, scene_graph = add_discrete_plant(
        builder, scenario.plant.time_step, scenario.plant.contact_approximation
    )
    model = add_platform(
        plant,
        scenario.plant.leg_model,
        scenario.plant.wheels,
        beginning.ground,
        scenario.geometry_as_built,
        beginning.foot_offsets,
        scenario.machine.structure,
    )
    plant.SetDefaultPositions(beginning.positions(model))
    connect(builder, drives.arm, plant.get_desired_state_input_port(model.arm))
    if model.has_rolling_wheels:
        _drive_wheels(builder, model, drives)
    load_force = _drive_legs(builder, model, drives, scenario.plant.time_step)
    state, poses = plant.get_state_output_port(), plant.get_body_poses_output_port()
    place = scenario.machine.sensors.imu_place
    signals, observers = observe(builder, model, beginning, state, poses, place)
    feet = observers[1]
    connect(builder, plant.get_contact_results_output_port(), feet.GetInputPort("contact_results"))
    signals |= {"load_force": load_force, "contact_force": feet.GetOutputPort("contact_force")}
    if meshcat is not None and model.is_full:
        add_visualization(builder, model, state, scene_graph, meshcat)
    else:
        remove_visuals(plant, scene_graph)
    if meshcat is not None and not model.is_full:
        draw_as_full(builder, scenario, model, drives, state, meshcat)

    def put(root_context: Context, beginning: Beginning) -> None:
        context = plant.GetMyMutableContextFromRoot(root_context)
        model.put(context, beginning.positions(model), beginning.ground, beginning.foot_offsets)

    return Plant(signals, observers, put, model)


def observe(
    builder: DiagramBuilder,
    model: PlatformModel,
    beginning: Beginning,
    state: OutputPort,
    body_poses: OutputPort,
    imu_place: Sequence[float],
) -> tuple[dict[str, OutputPort], tuple[PlatformTruth, FootTruth]]:
    """Adds what tells about simulated bodies: signals of a `Plant` but forces, and observers.

    Args:
        builder: builder of the station.
        model: the platform.
        beginning: the beginning.
        state: state of the model's plant.
        body_poses: poses of its bodies in the world.
        imu_place: place of the inertial sensor, from the platform's centre F [m].
    """
    truth = add(builder, PlatformTruth(model, beginning.ground, beginning.foot_offsets))
    connect(builder, state, truth.GetInputPort("state"))
    feet = add(builder, FootTruth(model, beginning.ground, beginning.foot_offsets))
    connect(builder, body_poses, feet.GetInputPort("body_poses"))
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
) -> None:
    """Draws reduced legs as what they stand for.

    Args:
        builder: builder of the station.
        scenario: its ground is drawn.
        model: the platform.
        drives: its drives.
        state: state of the model's plant.
        meshcat: scene in which to draw.
    """
    plant = model.plant
    start = model.base.floating_positions_start()
    joints = [plant.get_joint(i) for i in plant.GetJointIndices(model.arm)]
    starts = [joint.position_start() for joint in joints if joint.num_positions()]
    parts = []
    for name, indices in (("base_pose", range(start, start + 7)), ("arm_position", starts)):
        selection = np.eye(plant.num_multibody_states())[list(indices)]
        part = add(builder, MatrixGain(selection), f"drawn_{name}")
        connect(builder, state, part.get_input_port())
        parts.append(part.get_output_port())
    rods = drives.rods.GetOutputPort("extension")
    add_drawing(
        builder,
        scenario.ground.inclination,
        meshcat,
        rods,
        *parts,
        geometry=scenario.machine.geometry,
        structure=scenario.machine.structure,
    )


def _drive_wheels(builder: DiagramBuilder, model: PlatformModel, drives: Drives) -> None:
    split = split_states(builder, "wheel_states", drives.wheels, WHEEL_COUNT)
    for port, wheel in zip(split, model.wheels, strict=True):
        connect(builder, port, model.plant.get_desired_state_input_port(wheel))


def _drive_legs(
    builder: DiagramBuilder, model: PlatformModel, drives: Drives, time_step: float
) -> OutputPort:
    """Connects the rods to the legs' joints; returns the force with which they hold (4).

    That force is the one of the step before, which breaks the loop from the actuators' next
    state through the plant back to their load.
    """
    plant = model.plant
    count = plant.num_actuators()
    holding = add(builder, ZeroOrderHold(time_step, count), "holding_effort")
    connect(builder, plant.get_net_actuation_output_port(), holding.get_input_port())
    # The legs' actuators come first.
    parts = add(builder, Demultiplexer([LEG_COUNT, count - LEG_COUNT]), "efforts")
    connect(builder, holding.get_output_port(), parts.get_input_port(0))
    ahead, load_force = led_legs(builder, model, drives, parts.get_output_port(0))
    split = split_states(builder, "leg_states", ahead, LEG_COUNT)
    for port, leg in zip(split, model.legs, strict=True):
        connect(builder, port, plant.get_desired_state_input_port(leg))
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
    # One step ahead: the plant's implicit drives then arrive where the actuators will be.
    ahead = drives.rods.GetOutputPort("next_state")
    if model.is_full:
        return ahead, holding
    transmission = add(builder, LegTransmission(model.geometry))
    connect(builder, ahead, transmission.GetInputPort("rod_state"))
    extension = drives.rods.GetOutputPort("extension")
    connect(builder, extension, transmission.GetInputPort("extension"))
    connect(builder, holding, transmission.GetInputPort("swing_torque"))
    return transmission.GetOutputPort("swing_state"), transmission.GetOutputPort("load_force")


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


def _add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    beginning: Beginning,
    drives: Drives,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the quasi-static plant, and with `meshcat` a drawing of it."""
    statics = KinematicPlatform(
        scenario.geometry_as_built,
        scenario.machine.masses,
        scenario.machine.wheel_geometry,
        ground=beginning.ground,
        foot_offsets=beginning.foot_offsets,
    )
    platform = add(builder, statics)
    connect(builder, drives.rods.GetOutputPort("extension"), platform.GetInputPort("extension"))
    connect(builder, drives.rods.GetOutputPort("velocity"), platform.GetInputPort("velocity"))
    connect(builder, drives.arm_angles, platform.GetInputPort("arm_position"))
    stance = add(builder, Demultiplexer([3, 9, 4, 4, 4]), "stance_parts")
    connect(builder, platform.GetOutputPort("stance"), stance.get_input_port(0))
    names = ("posture", "inertial_motion", "contact_force", "load_force", "foot_height")
    signals = {name: stance.get_output_port(i) for i, name in enumerate(names)}
    motion = signals.pop("inertial_motion")
    # The inertial sensor samples at instants of its own; held, the platform's statics are solved
    # once a period and not again for every sample.
    hold = add(builder, Hold(scenario.control.period, beginning.inertial_motion), "held_motion")
    parts = add(builder, Demultiplexer(9, 3), "inertial_motion_parts")
    for i, name in enumerate(("attitude", "angular_velocity", "specific_force")):
        signals[name] = parts.get_output_port(i)
    connect(builder, motion, hold.get_input_port())
    connect(builder, hold.get_output_port(), parts.get_input_port(0))
    signals["loop_error"] = _zeros(builder, "no_loops")

    def put(root_context: Context, beginning: Beginning) -> None:
        hold.set_value(hold.GetMyMutableContextFromRoot(root_context), beginning.inertial_motion)

    plant = Plant(signals, (platform,), put)
    if meshcat is None:
        return plant
    add_drawing(
        builder,
        scenario.ground.inclination,
        meshcat,
        drives.rods.GetOutputPort("extension"),
        platform.GetOutputPort("base_pose"),
        drives.arm_angles,
        geometry=scenario.machine.geometry,
        structure=scenario.machine.structure,
    )
    return plant


def _zeros(builder: DiagramBuilder, name: str) -> OutputPort:
    source = add(builder, ConstantVectorSource(np.zeros(LEG_COUNT)), name)
    return source.get_output_port()


@dataclass(frozen=True)
class Simulation:
    """A simulated platform and the handles that put it at a beginning.

    Attributes:
        plant: the plant.
        actuators: the four linear actuators.
        imu: the inertial sensor.
        noise: source of the sensor's noise.
        geometry: dimensions of the machine as built.
    """

    plant: Plant
    actuators: LinearActuator
    imu: Imu
    noise: NoiseSource
    geometry: PlatformGeometry

    @property
    def model(self) -> PlatformModel | None:
        """Bodies and joints of the plant; None where none are simulated."""
        return self.plant.model

    def reset(self, root_context: Context, scenario: LevellingScenario) -> None:
        """Puts the platform on feet or wheels and draws gains, biases and noise from the seed.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: its `Beginning` is taken. What is built in, such as the plant with its
                dimensions, the sensors' resolution and the job's times, stays.
        """
        beginning = Beginning.from_scenario(scenario, self.geometry)
        actuators = self.actuators.GetMyMutableContextFromRoot(root_context)
        self.actuators.set_extension(actuators, beginning.extension)
        self.actuators.set_gain_scale(actuators, beginning.gain_scale)
        imu = self.imu.GetMyMutableContextFromRoot(root_context)
        self.imu.set_turn_on_bias(imu, beginning.gyro_bias, beginning.accel_bias)
        noise = self.noise.GetMyMutableContextFromRoot(root_context)
        self.noise.set_seed(noise, beginning.noise_seed)
        for system in self.plant.on_ground:
            context = system.GetMyMutableContextFromRoot(root_context)
            system.set_ground(context, beginning.ground, beginning.foot_offsets)
        self.plant.put(root_context, beginning)


type PlantMaker = Callable[
    [DiagramBuilder, LevellingScenario, Beginning, Drives, Meshcat | None], Plant
]


def add_simulated(
    add_plant: PlantMaker,
    time_step: float,
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    meshcat: Meshcat | None,
) -> Behind:
    """Adds drives, a plant and sensors.

    Args:
        add_plant: adds the plant.
        time_step: step of the actuators [s].
        builder: builder of the station.
        scenario: the scenario to build.
        meshcat: draws the machine there; None for no drawing.
    """
    geometry, period = scenario.geometry_as_built, scenario.control.period
    beginning = Beginning.from_scenario(scenario, geometry)
    rods = LinearActuator(
        scenario.machine.actuators.params,
        time_step=time_step,
        extension=beginning.extension,
        gain_scale=beginning.gain_scale,
    )
    actuators = add(builder, rods)
    wheels = add(
        builder, VelocityServo(scenario.machine.wheels.drive, WHEEL_COUNT, period), "wheel_drive"
    )
    arm = add(builder, Multiplexer(2), "arm_command")
    drive = add(builder, StateInterpolatorWithDiscreteDerivative(2, period), "arm_drive")
    connect(builder, arm.get_output_port(), drive.get_input_port())
    drives = Drives(
        rods=actuators,
        wheels=wheels.GetOutputPort("state"),
        arm=drive.get_output_port(),
        arm_angles=arm.get_output_port(),
    )
    plant = add_plant(builder, scenario, beginning, drives, meshcat)
    connect(builder, plant.signals["load_force"], actuators.GetInputPort("load_force"))
    outputs, imu, noise = _add_sensors(builder, scenario, beginning, actuators, wheels, plant)
    for name in ("posture", "contact_force", "foot_height", "load_force", "loop_error"):
        outputs[f"truth.{name}"] = plant.signals[name]
    outputs["truth.extension"] = actuators.GetOutputPort("extension")
    simulation = Simulation(plant, actuators, imu, noise, geometry)
    inputs = _drive_inputs(actuators, wheels) | {
        "turntable.position_command": arm.get_input_port(0),
        "arm.position_command": arm.get_input_port(1),
    }
    return Behind(inputs, outputs, simulation.reset, handle=simulation)


def add_bodies(
    builder: DiagramBuilder, scenario: LevellingScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the platform as rigid bodies with closed loops and contact, its drives and sensors."""
    step = scenario.plant.time_step
    return add_simulated(_add_multibody_plant, step, builder, scenario, meshcat)


def add_statics(
    builder: DiagramBuilder, scenario: LevellingScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the platform as closed-form statics, its drives and sensors."""
    step = scenario.control.period
    return add_simulated(_add_kinematic_plant, step, builder, scenario, meshcat)


def _drive_inputs(actuators: LinearActuator, wheels: VelocityServo) -> dict[str, InputPort]:
    return {
        "legs.voltage": actuators.GetInputPort("voltage"),
        "legs.stop": actuators.GetInputPort("stop"),
        "wheels.velocity_command": wheels.GetInputPort("velocity_command"),
        "wheels.brake": wheels.GetInputPort("brake"),
    }


def _add_sensors(
    builder: DiagramBuilder,
    scenario: LevellingScenario,
    beginning: Beginning,
    actuators: LinearActuator,
    wheels: VelocityServo,
    plant: Plant,
) -> tuple[dict[str, OutputPort], Imu, NoiseSource]:
    """Encoders, limit switches, inertial sensor and device status, by the names of the ports."""
    sensors, period = scenario.machine.sensors, scenario.control.period
    outputs: dict[str, OutputPort] = {}
    resolution = 1e-3 * sensors.encoder_resolution_mm
    encoder = add(builder, Encoder(resolution=resolution, gate_time=period))
    connect(builder, actuators.GetOutputPort("extension"), encoder.GetInputPort("position"))
    connect(builder, actuators.GetOutputPort("velocity"), encoder.GetInputPort("velocity"))
    outputs["legs.extension"] = encoder.GetOutputPort("position_measured")
    outputs["legs.velocity"] = encoder.GetOutputPort("velocity_measured")

    switches = add(builder, LimitSwitches(params=scenario.machine.actuators.switches))
    connect(builder, actuators.GetOutputPort("extension"), switches.GetInputPort("extension"))
    connect(builder, plant.signals["contact_force"], switches.GetInputPort("contact_force"))
    outputs["legs.limits"] = switches.GetOutputPort("limits")

    inertial = replace(
        ImuParams() if sensors.imu_noise else ImuParams.ideal(),
        gyro_turn_on_bias=beginning.gyro_bias,
        accel_turn_on_bias=beginning.accel_bias,
    )
    imu, noise = add_imu(builder, inertial, seed=beginning.noise_seed)
    for name in ("angular_velocity", "specific_force", "attitude"):
        connect(builder, plant.signals[name], imu.GetInputPort(name))
    late = round(1e-3 * sensors.imu_delay_ms / imu.period)
    for name in ("gyro", "accel", "mag"):
        sample = imu.GetOutputPort(name)
        if late:
            # It takes what was shown before the sample of the same instant: one more period.
            delay = add(builder, DiscreteTimeDelay(imu.period, late - 1, 3), f"delayed_{name}")
            connect(builder, sample, delay.get_input_port())
            sample = delay.get_output_port()
        outputs[f"imu.{name}"] = sample

    for name in ("position", "velocity"):
        outputs[f"wheels.{name}"] = wheels.GetOutputPort(f"{name}_measured")
    periods, delays = (0.0, imu.period, period, 0.0), (0.0, late * imu.period, 0.0, 0.0)
    outputs |= _add_status(builder, periods, delays)
    return outputs, imu, noise


def _add_status(
    builder: DiagramBuilder, periods: Sequence[float], delays: Sequence[float] = ()
) -> dict[str, OutputPort]:
    status = add(builder, DeviceStatus(PARTS, periods, delays))
    return {f"status.{name}": status.GetOutputPort(name) for name in ("age", "fault")}


def add_mock(
    builder: DiagramBuilder, scenario: LevellingScenario, meshcat: Meshcat | None = None
) -> Behind:
    """Adds what mirrors commands to measurements, exactly and without dynamics.

    Legs extend at K times their voltage, wheels turn as commanded, the platform stands on level
    ground as its legs say, and every sensor shows the exact value. There are no `truth` ports:
    nothing is hidden. Its use: to try out a program around the ports where neither a plant's nor
    the hardware's peculiarities matter.

    Args:
        builder: builder of the station.
        scenario: its period, job and supply of the actuators are taken.
        meshcat: not used; there is nothing to draw.
    """
    period = scenario.control.period
    params = replace(scenario.machine.actuators.params, model="integrator", coulomb_friction=0.0)
    start = scenario.initial_extensions
    actuators = add(builder, LinearActuator(params, time_step=period, extension=start))
    # Without lag and counts; as fast as the real ones.
    exact = VelocityServoParams(0.0, 1e-9, scenario.machine.wheels.drive.max_velocity)
    wheels = add(builder, VelocityServo(exact, WHEEL_COUNT, period), "wheel_drive")
    inputs = _drive_inputs(actuators, wheels)
    for name in ("arm.position_command", "turntable.position_command"):
        inputs[name] = add(builder, PassThrough(1), name).get_input_port()  # leads nowhere

    switches = add(builder, LimitSwitches(params=scenario.machine.actuators.switches))
    extension = actuators.GetOutputPort("extension")
    connect(builder, extension, switches.GetInputPort("extension"))
    platform = add(builder, KinematicPlatform(scenario.machine.geometry, scenario.machine.masses))
    for name in ("extension", "velocity"):
        connect(builder, actuators.GetOutputPort(name), platform.GetInputPort(name))
    force = platform.GetOutputPort("contact_force")
    connect(builder, force, switches.GetInputPort("contact_force"))
    magnetic = np.array(ImuParams().magnetic_field)
    field = add(builder, ConstantVectorSource(magnetic), "mag")
    outputs = {
        "legs.extension": extension,
        "legs.velocity": actuators.GetOutputPort("velocity"),
        "legs.limits": switches.GetOutputPort("limits"),
        "imu.gyro": platform.GetOutputPort("angular_velocity"),
        "imu.accel": platform.GetOutputPort("specific_force"),
        "imu.mag": field.get_output_port(),
        "wheels.position": wheels.GetOutputPort("position_measured"),
        "wheels.velocity": wheels.GetOutputPort("velocity_measured"),
    } | _add_status(builder, (0.0,) * len(PARTS))

    def reset(root_context: Context, beginning: LevellingScenario) -> None:
        context = actuators.GetMyMutableContextFromRoot(root_context)
        actuators.set_extension(context, beginning.initial_extensions)

    return Behind(inputs, outputs, reset)
