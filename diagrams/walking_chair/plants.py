"""Plants behind the walking chair's station: rigid bodies, statics, mock.

Rigid bodies of another engine are in `parapod.diagrams.walking_chair.mujoco`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import Meshcat, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context, DiagramBuilder, OutputPort
from pydrake.systems.primitives import ConstantVectorSource, MatrixGain

from parapod.diagrams.drawing import draw, publish, remove_visuals
from parapod.diagrams.multibody import add_discrete_plant, drive_joints
from parapod.diagrams.ports import Behind
from parapod.diagrams.simulated import add_status, ports_of_drives
from parapod.diagrams.walking_chair.model import BranchDrive, add_chair, add_passenger
from parapod.diagrams.walking_chair.ports import PARTS
from parapod.diagrams.walking_chair.scenario import ChairScenario
from parapod.diagrams.wiring import add, connect
from parapod.systems.actuators.velocity_servo import VelocityServo, VelocityServoParams
from parapod.systems.walking_chair.gait import Walk, starting_lengths
from parapod.systems.walking_chair.geometry import BRANCHES, LEG_COUNT
from parapod.systems.walking_chair.kinematic_chair import KinematicChair
from parapod.systems.walking_chair.masses import Passenger
from parapod.systems.walking_chair.model import ChairModel, ChairPose, ChairTruth


@dataclass(frozen=True, eq=False)
class Beginning:
    """Beginning of a scenario, in the quantities that the parts of the machine are set to.

    Attributes:
        lengths: lengths of the branches (4, 3) [m].
        body: centre of the body (3) in the world [m].
        passenger: person on the seat.
        gain: gains of the drives (12) [-].
        offset: velocities of the drives at a command of zero (12) [m/s].
    """

    lengths: NDArray[np.float64]
    body: NDArray[np.float64]
    passenger: Passenger
    gain: NDArray[np.float64]
    offset: NDArray[np.float64]

    @classmethod
    def from_scenario(cls, scenario: ChairScenario, walk: Walk) -> Self:
        """Works out the beginning of a scenario.

        Args:
            scenario: its passenger, drives' errors and seed are taken.
            walk: the walk that begins.
        """
        # One stream for both: their order is part of what a seed means.
        random = np.random.default_rng(scenario.seed)
        error, offset = (
            scenario.machine.drives.gain_error,
            1e-3 * scenario.machine.drives.offset_mm_s,
        )
        return cls(
            lengths=starting_lengths(scenario.machine.geometry, walk),
            body=np.asarray(walk.motion(scenario.machine.geometry, 0.0).body.position),
            passenger=scenario.passenger.passenger,
            gain=1.0 + random.uniform(-error, error, len(BRANCHES)),
            offset=random.uniform(-offset, offset, len(BRANCHES)),
        )


@dataclass(frozen=True)
class Plant:
    """Signals of a plant for the sensors and the truth.

    Attributes:
        signals: ports by name: body_position, body_attitude, force, contact_force, foot_height,
            loop_error.
        stand: puts the chair at rest, in a root context, at a beginning.
        seat: exchanges the passenger, in a root context.
    """

    signals: dict[str, OutputPort]
    stand: Callable[[Context, Beginning], None]
    seat: Callable[[Context, Passenger], None]


def add_designed_chair(
    plant: MultibodyPlant, scenario: ChairScenario, passenger: Passenger
) -> ChairModel:
    """Adds the chair of a scenario to a plant, and finalizes it; see `add_chair`."""
    machine, drives = scenario.machine, scenario.machine.drives
    branch = BranchDrive(drives.stiffness, drives.max_force_N)
    return add_chair(plant, passenger, machine.geometry, machine.bodies, branch)


def make_statics(scenario: ChairScenario, beginning: Beginning) -> KinematicChair:
    """The chair of a scenario in closed form, at its beginning."""
    machine = scenario.machine
    return KinematicChair(
        machine.geometry,
        machine.masses,
        beginning.passenger,
        scenario.control.period,
        beginning.body[:2],
        machine.drives.stiffness,
    )


def _add_multibody_plant(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    beginning: Beginning,
    drives: VelocityServo,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the plant of rigid bodies, whose branches are held to where the drives are."""
    time_step = scenario.plant.time_step
    plant, scene_graph = add_discrete_plant(
        builder, time_step, scenario.plant.contact_approximation
    )
    model = add_designed_chair(plant, scenario, beginning.passenger)
    plant.SetDefaultPositions(model.standing_positions(beginning.lengths, beginning.body))
    force = drive_joints(builder, plant, model.legs, drives.GetOutputPort("next_state"))
    truth = add(builder, ChairTruth(model))
    contact = plant.get_contact_results_output_port()
    connect(builder, contact, truth.GetInputPort("contact_results"))
    connect(builder, plant.get_body_poses_output_port(), truth.GetInputPort("body_poses"))
    if meshcat is None:
        remove_visuals(plant, scene_graph)
    else:
        publish(builder, scene_graph, meshcat, "chair")
    names = ("body_position", "body_attitude", "contact_force", "foot_height", "loop_error")
    signals = {name: truth.GetOutputPort(name) for name in names} | {"force": force}

    def stand(root_context: Context, beginning: Beginning) -> None:
        context = plant.GetMyMutableContextFromRoot(root_context)
        model.stand(context, beginning.lengths, beginning.body, beginning.passenger)

    def seat(root_context: Context, passenger: Passenger) -> None:
        model.seat(plant.GetMyMutableContextFromRoot(root_context), passenger)

    return Plant(signals, stand, seat)


def _add_kinematic_plant(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    beginning: Beginning,
    drives: VelocityServo,
    meshcat: Meshcat | None,
) -> Plant:
    """Adds the quasi-static plant, and with `meshcat` a drawing of it."""
    statics = make_statics(scenario, beginning)
    chair = add(builder, statics)
    connect(builder, drives.GetOutputPort("position"), chair.GetInputPort("position"))
    names = ("body_position", "body_attitude", "contact_force", "foot_height", "force")
    signals = {name: chair.GetOutputPort(name) for name in names}
    no_loops = add(builder, ConstantVectorSource(np.zeros(2 * LEG_COUNT)), "no_loops")
    signals["loop_error"] = no_loops.get_output_port()
    if meshcat is not None:
        add_drawing(builder, scenario, drives.GetOutputPort("position"), chair, meshcat)

    def stand(root_context: Context, beginning: Beginning) -> None:
        chair.stand(root_context, beginning.body[:2], beginning.passenger)

    return Plant(signals, stand, chair.seat)


def add_drawing(
    builder: DiagramBuilder,
    scenario: ChairScenario,
    position: OutputPort,
    chair: KinematicChair,
    meshcat: Meshcat | None,
    path: str = "chair",
) -> None:
    """Draws the bodies where the statics have them; the passenger is moved on the seat.

    Args:
        builder: builder of the diagram that holds `chair`.
        scenario: its passenger is drawn.
        position: lengths of the branches (12) [m].
        chair: statics with these lengths.
        meshcat: scene in which to draw; None: poses are all that is asked for.
        path: its path in the scene.
    """
    plant, figure = MultibodyPlant(time_step=1.0), MultibodyPlant(time_step=1.0)
    scene_graph = add(builder, SceneGraph(), f"drawing_of_{path}")
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    model = add_designed_chair(plant, scenario, replace(scenario.passenger.passenger, mass=0.0))
    pose = add(builder, ChairPose(model), f"pose_of_{path}")
    connect(builder, position, pose.GetInputPort("position"))
    connect(builder, chair.GetOutputPort("body_pose"), pose.GetInputPort("body_pose"))
    draw(builder, plant, pose.get_output_port(), scene_graph)
    if scenario.passenger.mass_kg > 0.0:
        figure.RegisterAsSourceForSceneGraph(scene_graph)
        add_passenger(figure, scenario.passenger.passenger)
        draw(builder, figure, chair.GetOutputPort("passenger_pose"), scene_graph)
    publish(builder, scene_graph, meshcat, path)


@dataclass(frozen=True)
class Simulation:
    """A simulated chair and the handles that put it at its beginning.

    Attributes:
        plant: the plant.
        drives: the twelve drives.
        walk: the walk that it was built for.
    """

    plant: Plant
    drives: VelocityServo
    walk: Walk

    def reset(self, root_context: Context, scenario: ChairScenario) -> None:
        """Puts the chair where its walk begins and draws the drives' imperfections from the seed.

        Args:
            root_context: context, at its defaults, of the diagram that contains the station.
            scenario: its `Beginning` is taken. What is built in, such as the walk and the
                encoders' resolution, stays.
        """
        beginning = Beginning.from_scenario(scenario, self.walk)
        self.drives.set_position(root_context, beginning.lengths.ravel())
        self.drives.set_imperfection(root_context, beginning.gain, beginning.offset)
        self.plant.stand(root_context, beginning)


type PlantMaker = Callable[
    [DiagramBuilder, ChairScenario, Beginning, VelocityServo, Meshcat | None], Plant
]


def add_simulated(
    add_plant: PlantMaker,
    drive_step: float,
    builder: DiagramBuilder,
    scenario: ChairScenario,
    meshcat: Meshcat | None,
) -> Behind:
    """Adds drives, a plant, currents and status.

    Args:
        add_plant: adds the plant.
        drive_step: step of the drives' model [s].
        builder: builder of the station.
        scenario: the scenario to build.
        meshcat: draws the machine there; None for no drawing.
    """
    walk = scenario.walk
    beginning = Beginning.from_scenario(scenario, walk)
    servo = VelocityServo(
        drive_params(scenario),
        len(BRANCHES),
        scenario.control.period,
        drive_step,
        position=beginning.lengths.ravel(),
        gain=beginning.gain,
        offset=beginning.offset,
    )
    drives = add(builder, servo, "drives")
    plant = add_plant(builder, scenario, beginning, drives, meshcat)
    per_newton = 1.0 / scenario.machine.drives.force_per_current
    current = add(builder, MatrixGain(per_newton * np.eye(len(BRANCHES))), "motor_current")
    connect(builder, plant.signals["force"], current.get_input_port())
    inputs, outputs = ports_of_drives(drives, "velocity_command")
    outputs |= {"legs.current": current.get_output_port()} | add_status(builder, PARTS)
    outputs |= {f"truth.{name}": port for name, port in plant.signals.items()}
    outputs["truth.position"] = drives.GetOutputPort("position")
    simulation = Simulation(plant, drives, walk)
    return Behind(inputs, outputs, simulation.reset, handle=simulation)


def add_bodies(
    builder: DiagramBuilder, scenario: ChairScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the chair as rigid bodies with closed loops and contact, and its drives."""
    step = scenario.plant.time_step
    return add_simulated(_add_multibody_plant, step, builder, scenario, meshcat)


def add_statics(
    builder: DiagramBuilder, scenario: ChairScenario, meshcat: Meshcat | None
) -> Behind:
    """Adds the chair as closed-form statics, and its drives."""
    # Only samples of this plant count: twice as often as the command.
    step = 0.5 * scenario.control.period
    return add_simulated(_add_kinematic_plant, step, builder, scenario, meshcat)


def drive_params(scenario: ChairScenario) -> VelocityServoParams:
    """Parameters of the twelve drives, with the stroke of each."""
    drives, strokes = scenario.machine.drives, scenario.machine.geometry.leg.strokes
    return VelocityServoParams(
        resolution=1e-3 * drives.encoder_resolution_mm,
        time_constant=1e-3 * drives.time_constant_ms,
        max_velocity=1e-3 * drives.max_velocity_mm_s,
        stop_min=tuple(strokes[:, 0].tolist()) * LEG_COUNT,
        stop_max=tuple(strokes[:, 1].tolist()) * LEG_COUNT,
    )


def add_mock(
    builder: DiagramBuilder, scenario: ChairScenario, meshcat: Meshcat | None = None
) -> Behind:
    """Adds what mirrors commands to measurements, exactly and without dynamics.

    Branches move at their commanded velocities, within their stroke and their speed; the motors
    draw no current. There are no `truth` ports: nothing is hidden. Its use: to try out a program
    around the ports where neither a plant's nor the hardware's peculiarities matter.

    Args:
        builder: builder of the station.
        scenario: its period, drives' limits and walk are taken.
        meshcat: not used; there is nothing to draw.
    """
    exact = replace(drive_params(scenario), resolution=0.0, time_constant=1e-9)
    start = starting_lengths(scenario.machine.geometry, scenario.walk).ravel()
    servo = VelocityServo(exact, len(BRANCHES), scenario.control.period, position=start)
    drives = add(builder, servo, "drives")
    current = add(builder, ConstantVectorSource(np.zeros(len(BRANCHES))), "motor_current")
    inputs, outputs = ports_of_drives(drives, "velocity_command")
    outputs |= {"legs.current": current.get_output_port()} | add_status(builder, PARTS)
    return Behind(inputs, outputs)
